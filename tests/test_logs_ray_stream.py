"""Scans that begin where the last one ended are cut into full turns: each ray keeps its range, bearing and time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbag_samples import EPOCH, Message, read, scan, write_bag2

from logs import stream
from logs.run import Run

N, PERIOD, FIRST = 60, 0.1, 0.3
STEP = 2 * np.pi / N


def spinning(lengths: list[int], sign: int = 1, gaps: tuple[int, ...] = ()) -> list[Message]:
    """Scans of a rotating laser whose ray j has the range 1 + j / 1000; those in `gaps` are lost."""
    bag, j = [], 0
    for k, n in enumerate(lengths):
        low = (FIRST + sign * STEP * j + np.pi) % (2 * np.pi) - np.pi
        ranges = 1 + np.arange(j, j + n) / 1000
        one = scan(
            PERIOD * j / N,
            ranges,
            angle_min=low,
            increment=sign * STEP,
            time_increment=PERIOD / N,
            range_max=100.0,
        )
        bag += [] if k in gaps else [one]
        j += n
    return bag


def rays(run: Run) -> np.ndarray:
    """Return the numbers (n_scans, n_rays) of the rays, -1 where there is none."""
    return np.where(np.isfinite(run.ranges), np.rint((run.ranges - 1) * 1000), -1).astype(int)


def check(run: Run, sign: int = 1) -> np.ndarray:
    """Every ray has its own bearing and time; return the numbers of the rays."""
    number = rays(run)
    seen = number >= 0
    bearings = np.broadcast_to(run.sensor.bearings, number.shape)
    off = bearings - (FIRST + sign * STEP * number)
    np.testing.assert_allclose(np.abs(np.exp(1j * off[seen]) - 1), 0, atol=1e-4)
    when = run.stamps[:, None] + run.sensor.ray_delays + (run.epoch_ns - EPOCH) / 1e9
    np.testing.assert_allclose(when[seen], (PERIOD / N * number)[seen], atol=1e-5)
    return number


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("lengths", [[58] * 40, [63] * 40, [20] * 90, [57, 61, 59, 62] * 12])
def test_every_ray_of_a_full_turn_is_kept_once_with_its_bearing_and_time(
    tmp_path: Path, lengths: list[int], sign: int
) -> None:
    run = read(tmp_path, spinning(lengths, sign))
    number = check(run, sign)
    assert run.sensor.n_rays == N and abs(run.sensor.sweep_time) == pytest.approx(PERIOD, rel=1e-3)
    inner = np.arange(N, sum(lengths) - N)  # the first and the last turn are incomplete
    assert np.isin(inner, number).all() and len(np.unique(number)) == number.size
    assert "were cut into" in run.meta["notes"] and "incomplete turns were left out" in run.meta["notes"]


def test_a_lost_scan_costs_its_rays_and_shifts_no_other(tmp_path: Path) -> None:
    whole = check(read(tmp_path / "whole", spinning([58] * 40)))
    number = check(read(tmp_path / "lost", spinning([58] * 40, gaps=(17, 18))))
    lost = set(range(58 * 17, 58 * 19))
    assert not lost & set(number.ravel()) and len(number) < len(whole)
    assert set(whole[(whole >= 58 * 21).all(axis=1)].ravel()) <= set(number.ravel())


def test_bearings_that_are_not_in_phase_are_interpolated_along_a_wall(tmp_path: Path) -> None:
    """A wall at x = 2 m, seen by rays whose phase differs from turn to turn."""
    bag, angle = [], 0.0
    for _ in range(40):
        bearings = angle + STEP * np.arange(59)
        with np.errstate(divide="ignore"):
            ranges = np.where(np.cos(bearings) > 0.2, 2 / np.cos(bearings), 50.0)
        low = (angle + np.pi) % (2 * np.pi) - np.pi
        bag.append(scan(PERIOD * angle / (2 * np.pi), ranges, angle_min=low, increment=STEP, range_max=100.0))
        angle += 59.3 * STEP
    run = read(tmp_path, bag)
    ahead = np.cos(run.sensor.bearings) > 0.5
    np.testing.assert_allclose(run.ranges[:, ahead] * np.cos(run.sensor.bearings[ahead]), 2.0, atol=5e-3)


@pytest.mark.parametrize("kind", ["same beginning", "sector", "random"])
def test_other_scans_are_not_cut(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(3)
    low = {
        "same beginning": np.full(30, -3.0),
        "sector": np.full(30, -1.5),
        "random": rng.uniform(-3, 3, 30),
    }[kind]
    n = 30 if kind == "sector" else N
    bag = [
        scan(PERIOD * k, np.full(n, 2.0 + k), angle_min=b, increment=STEP, range_max=100.0)
        for k, b in enumerate(low)
    ]
    run = read(tmp_path, bag)
    assert "cut into" not in run.meta["notes"] and len(run.stamps) == 30
    assert ("times of their rays are not known" in run.meta["notes"]) == (kind == "random")


def test_such_a_log_is_never_read_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = next(f for f in write_bag2(tmp_path / "bag", spinning([58] * 40)).iterdir() if f.suffix == ".mcap")
    for name, value in {"PIECE": 7, "AHEAD": 2, "FIRST_MESSAGES": 5}.items():
        monkeypatch.setattr(stream, name, value)
    log = stream.open_log(path)
    check(log.head if log.n_scans == 0 else next(iter(log.pieces())))
    assert log.n_scans == sum(len(piece.stamps) for piece in log.pieces())


def test_full_turns_that_begin_elsewhere_once_are_scans_and_no_stream(tmp_path: Path) -> None:
    """As after a reconfiguration of the driver: each scan is a turn, which begins where it ended, too."""
    bag = [
        scan(
            0.1 * k,
            1 + np.roll(np.arange(N), -30 * (k >= 20)) / 1000,
            angle_min=low,
            increment=STEP,
            range_max=100.0,
        )
        for k, low in enumerate([-np.pi] * 20 + [0.0] * 20)
    ]
    run = read(tmp_path, bag)
    assert run.n_scans == len(bag) and not run.sensor.has_ray_delays
    assert "full turns" not in run.meta.get("notes", "")
