"""Runs whose scans do not tell everything: corridors, round rooms, short or standing runs, breaks of the track."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import further
from localization_samples import CORRIDOR, any_times, loop_poses, room_run

import logs
from logs.run import Run
from logs.transforms import compose
from sensorgraph.cli import run as command
from sensorgraph.localization.locate import locate, maps
from sensorgraph.localization.result import Localization

N = 60
ANGLES = np.linspace(0, 2 * np.pi, 73)
ROUND = [(3 * np.cos(a), 3 * np.sin(a), 3 * np.cos(b), 3 * np.sin(b)) for a, b in pairwise(ANGLES)]
"""A round room: every heading looks the same."""
ALONG = np.column_stack([np.linspace(-6, 6, N), np.zeros((N, 2))])
SPIN = np.column_stack([np.zeros((N, 2)), np.linspace(0, 2 * np.pi, N)])
TRUTH = loop_poses(240, laps=3)
BROKEN = slice(100, 140)  # 8 s, half a lap


def without_odometry(run: Run) -> Run:
    return replace(run, odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2)))


def errors(found: Localization, truth: np.ndarray) -> np.ndarray:
    """Return errors (n, 3) of the poses relative to the first scan."""
    moved = compose(
        truth[0], compose(np.array([0.0, 0.0, -found.poses[0, 2]]), found.poses - found.poses[0] * [1, 1, 0])
    )
    off = moved - truth
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return off


def deviations(found: Localization) -> np.ndarray:
    return np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))


@pytest.mark.parametrize("sigma", [0.01, *further(1e-6)], ids=["noise", "no noise"])
@pytest.mark.parametrize("walls", [CORRIDOR[:1], *further(CORRIDOR)], ids=["one wall", "two walls"])
def test_scans_alone_do_not_tell_the_way_along_a_corridor_and_it_is_said(
    walls: list[tuple[float, float, float, float]], sigma: float
) -> None:
    found = locate(without_odometry(room_run(ALONG, walls=walls, sigma=sigma)))
    sd = deviations(found)
    assert set(found.status) == {"ambiguous"}
    assert sd[[0, -1], 0].min() > 1.0  # a robot drives at up to 0.6 m/s: within 12 s, several metres
    assert any("do not determine the position along" in note for note in found.notes)


@any_times
def test_odometry_tells_the_way_along_a_corridor(times: Callable[[Run], Run]) -> None:
    found = locate(times(room_run(ALONG, walls=CORRIDOR, way_scale=1.02)))
    sd, off = deviations(found), errors(found, ALONG)
    assert set(found.status) == {"ok"}
    assert 0.05 < sd[-1, 0] < 1.0 and abs(off[-1, 0]) < 2 * np.hypot(sd[-1, 0], sd[0, 0])
    assert sd[:, 1].max() < 0.01 and sd[:, 2].max() < 0.01
    assert found.wheels is not None
    assert found.wheels.way_scale_sd > 0.05  # nothing but the odometry tells the distance


def test_corridor_from_the_command_line_is_said_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs.write(without_odometry(room_run(ALONG, walls=CORRIDOR)), tmp_path / "corridor.mcap")
    outputs = [
        "-o",
        str(tmp_path / "out.mcap"),
        "--csv",
        str(tmp_path / "p.csv"),
        "--json",
        str(tmp_path / "p.json"),
    ]
    assert command(["locate", str(tmp_path / "corridor.mcap"), *outputs]) == 0
    said = capsys.readouterr().out
    assert "ambiguous from 0.0 s to 11.8 s" in said and "holds no pose" in said
    assert json.loads((tmp_path / "p.json").read_text())["ambiguous"] == N
    assert len((tmp_path / "p.csv").read_text().splitlines()) == N + 1


TEN, STANDS, SPINS = loop_poses(30)[:10], np.tile([2.0, 1.5, 0.3], (N, 1)), SPIN + [2.0, 1.5, 0.0]


@any_times
@pytest.mark.parametrize(
    ("truth", "has_odometry"),
    [
        (TEN, False), (STANDS, True), (STANDS, False), (SPINS, False),
        *further((TEN, True), (SPINS, True), (loop_poses(60)[:20], True), (loop_poses(60)[:20], False)),
    ],
    ids=[
        "10 scans alone", "stands", "stands, scans alone", "spins, scans alone", "10 scans", "spins", "20 scans", "20 scans alone",
    ],
)  # fmt: skip
def test_short_standing_and_spinning_runs_are_located(
    truth: np.ndarray, has_odometry: bool, times: Callable[[Run], Run]
) -> None:
    run = times(room_run(truth))
    found = locate(run if has_odometry else without_odometry(run))
    assert set(found.status) == {"ok"}
    assert np.abs(errors(found, truth)).max() < 0.02
    sd = deviations(found)
    assert (sd > 0).all() and sd.max() < 0.01


@pytest.mark.slow
def test_round_room_does_not_tell_the_heading() -> None:
    run = room_run(SPIN, walls=ROUND)
    assert set(locate(run).status) == {"ok"}  # the wheels tell it
    found = locate(without_odometry(run))
    assert set(found.status) == {"ambiguous"}
    assert any("do not determine the heading" in note for note in found.notes)


def disturbed(run: Run, kind: str) -> tuple[Run, np.ndarray]:
    """Return a run with no useful scan in `BROKEN`, and the numbers of its scans in the whole run."""
    ranges, chosen = run.ranges.copy(), np.arange(run.n_scans)
    if kind == "blind":
        ranges[BROKEN] = np.inf
    run = replace(run, ranges=ranges)
    if kind == "gap":
        chosen = np.delete(chosen, BROKEN)
        run = run.take_scans(chosen)
    return run, chosen


@any_times
@pytest.mark.parametrize("kind", ["blind", *further("gap")])
def test_odometry_carries_the_pose_over_a_break(kind: str, times: Callable[[Run], Run]) -> None:
    run, chosen = disturbed(times(room_run(TRUTH[:180], way_scale=0.98)), kind)
    found = locate(run)
    assert set(found.status) == {"ok"} and set(found.map_numbers.tolist()) == {1}
    off, sd = errors(found, TRUTH[chosen]), deviations(found)
    inside = np.isin(chosen, np.arange(180)[BROKEN])
    assert np.hypot(*off[~inside, :2].T).max() < 0.03  # closures join what lies before and after
    assert (np.abs(off[inside]) < 3 * sd[inside] + 0.01).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["gap", *further("blind")])
def test_scans_alone_join_after_a_break_or_are_a_second_map(kind: str) -> None:
    """The second lap shows the room again: closures join; a few scans of it do not, and are never stated as known."""
    run, chosen = disturbed(room_run(TRUTH), kind)
    found = locate(without_odometry(run))
    ok = np.array(found.status) == "ok"
    first = int(ok.argmax())
    truth = TRUTH[chosen]
    off = errors(
        replace(
            found,
            t=found.t[first:],
            poses=found.poses[first:],
            covariances=found.covariances[first:],
            status=found.status[first:],
        ),
        truth[first:],
    )[ok[first:]]
    assert np.hypot(*off[:, :2].T).max() < 0.05
    assert ok.sum() > 90 and any("interrupted" in note for note in found.notes)


@any_times
def test_what_nothing_connects_is_a_second_map(times: Callable[[Run], Run]) -> None:
    """Without odometry, through a dark stretch into another room: two maps, each consistent."""
    other = [(2 * b, a, 2 * d, c) for a, b, c, d in CORRIDOR] + [
        (-9, 5, 9, 4),
        (-9, -4, 9, -6),
        (9, -6, 9, 4),
        (-9, -4, -9, 5),
    ]
    one, two = room_run(TRUTH[:60]), room_run(loop_poses(40) - [3.2, 2.6, 0.0], walls=other[2:], seed=1)
    stamps = np.concatenate([one.stamps, two.stamps + one.stamps[-1] + 30.0])
    both = replace(one, stamps=stamps, ranges=np.concatenate([one.ranges, two.ranges]))
    found = locate(times(without_odometry(both)))
    assert set(found.map_numbers.tolist()) == {1, 2}
    assert set(found.status[:60]) == {"ok"} and set(found.status[60:]) == {"lost"}
    assert [one["n_scans"] for one in maps(found)] == [60, 40]
    assert any(note.startswith("map 2 (40 scans") for note in found.notes)


def looking_around(seed: int) -> np.ndarray:
    """Return poses (n, 3) of a robot that stops at eight places of a loop, and turns there to anywhere and on."""
    rng, places = np.random.default_rng(seed), loop_poses(10)[:9, :2]
    poses, phi, here = list[tuple[float, float, float]](), 1.6, places[0]
    for there in places[1:]:
        ahead = float(np.arctan2(*(there - here)[::-1]))
        for heading in (phi + rng.uniform(-2.5, 2.5), ahead):
            turn = (heading - phi + np.pi) % (2 * np.pi) - np.pi
            n = int(abs(turn) / 0.12) + 1
            poses += [(*here, phi + turn * k / n) for k in range(1, n + 1)]
            phi += turn
        poses += [(*(here + k / 8 * (there - here)), phi) for k in range(1, 9)]
        here = there
    return np.array(poses)


def narrowed(run: Run, view: float) -> Run:
    """Return a run with the rays within a field of view [deg] ahead only."""
    kept = np.abs(run.sensor.bearings) <= np.radians(view / 2 + 0.01)
    sensor = replace(run.sensor, bearings=run.sensor.bearings[kept])
    return replace(run, sensor=sensor, ranges=run.ranges[:, kept])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *further(3)])
@pytest.mark.parametrize(("view", "is_certain"), [(30.0, False), (58.0, True)])
def test_new_surfaces_in_a_narrow_view_are_not_taken_for_known_ones(
    view: float, is_certain: bool, seed: int
) -> None:
    """A robot that turns on the spot sees other walls in each scan; most of them fit some wall that is known."""
    poses = looking_around(seed)
    found = locate(narrowed(room_run(poses, n_rays=360), view))
    assert (np.array(found.status) == "ok").any() == is_certain
    assert any("no pose is certain" in note for note in found.notes) != is_certain
    ok = np.array(found.status) == "ok"
    off = errors(found, poses)[ok] if is_certain else np.zeros((1, 3))
    assert np.abs(off[:, :2]).max() < 0.05 and np.abs(off[:, 2]).max() < 0.02


@any_times
def test_after_a_gap_in_a_corridor_a_similar_place_that_the_odometry_excludes_is_not_taken(
    times: Callable[[Run], Run],
) -> None:
    """The robot drives 8 m without scans, beyond what it saw before. The place where it was before looks alike."""

    def wall(y: float, depth: float, niches: tuple[float, ...]) -> list[tuple[float, float, float, float]]:
        corners = [(0.0, y)]
        for x in niches:
            corners += [(x, y), (x, y + depth), (x + 0.9, y + depth), (x + 0.9, y)]
        return [(*a, *b) for a, b in pairwise([*corners, (40.0, y)])]

    walls = [*wall(0.0, -0.35, (7, 15, 16.5, 29)), *wall(2.0, 0.3, (11, 22, 33))]
    x = np.arange(9, 33, 0.2)
    poses = np.column_stack([x, 0.95 + 0.05 * np.sin(0.7 * x), 0.035 * np.cos(0.7 * x)])
    run = room_run(poses, walls=walls, rate=4.0, seed=4)
    seen = (x < 17) | (x > 25)
    run = replace(run, ranges=np.where(run.ranges > 12, np.inf, run.ranges)).take_scans(seen)
    found = locate(times(run))
    off = errors(found, poses[seen])
    ok = np.array(found.status) == "ok"
    assert ok.sum() > 30
    assert np.hypot(off[ok, 0], off[ok, 1]).max() < 0.5


def test_late_odometry_in_a_round_room_does_not_bend_the_track_towards_its_lag() -> None:
    box = [(0.8, 0.5, 1.2, 0.6), (1.2, 0.6, 1.1, 1.0), (1.1, 1.0, 0.8, 0.5)]
    t = np.arange(0.0, 20.0, 0.1)
    around = np.column_stack([1.6 * np.cos(0.25 * t), 1.6 * np.sin(0.25 * t)])
    truth = np.column_stack([around, 0.25 * t + np.pi / 2 + 0.8 * np.sin(0.9 * t)])
    run = room_run(truth, n_rays=90, rate=10.0, walls=ROUND + box)
    found = locate(replace(run, odom_stamps=run.odom_stamps + 0.2))
    (note,) = (note for note in found.notes if "lag of the scans" in note)
    assert float(note.split("+")[1].split()[0]) == pytest.approx(200, abs=10)
    assert found.wheels is not None
    assert abs(found.wheels.turn_scale - 1.0) < 0.004 and abs(np.degrees(found.wheels.heading_bias)) < 0.3
