"""Rays that are older than the others of their scan, as of two lasers that a node merges, are found and used."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import further
from localization_samples import looking_about as path
from localization_samples import seen

import logs
from logs.motion import Motion
from logs.run import RangeSensor, Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.locate import LocatedRun, locate, located_run
from sensorgraph.localization.older_rays import best_part
from sensorgraph.localization.tracked_run import TrackedRun, track_run
from sensorgraph.localization.turning_pieces import DELAY_SD, TurningPieces, sweep_basis
from sensorgraph.types import Floats

N_RAYS, RATE, SECONDS, SIGMA = 120, 5.0, 40.0, 0.01
BEARINGS = np.linspace(-np.pi / 2, np.pi / 2, N_RAYS)


def run_of(ages: Floats, seed: int = 0) -> Run:
    """Return a run whose rays were taken some time (n_rays,) [s] before the stamp, which the log does not say."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(1.0, SECONDS, 1 / RATE)
    columns = [seen(path(stamps - age), BEARINGS[i : i + 1]) for i, age in enumerate(ages)]
    ranges = np.concatenate(columns, axis=1)
    fine = np.arange(0.0, SECONDS, 0.02)
    return Run(
        sensor=RangeSensor(bearings=BEARINGS, range_max=20.0, sigma=SIGMA, rate=RATE),
        stamps=stamps,
        ranges=ranges + SIGMA * rng.normal(size=ranges.shape),
        odom_stamps=fine,
        odometry=path(fine),
        odom_twists=np.zeros((len(fine), 2)),
    )


def errors(run: Run, poses: Floats) -> tuple[float, float]:
    truth = path(run.stamps)
    off = compose(invert(compose(truth[50], compose(invert(poses[50]), poses))), truth)
    return float(np.hypot(*off[:, :2].T).max()), float(np.abs(wrap(off[:, 2])).max())


@pytest.mark.parametrize(
    ("older", "age"),
    [
        ((33, 76), 0.08),
        *further(((0, 50), 0.08), ((71, 120), 0.15), ((33, 76), 0.02), ((10, 115), 0.1), ((40, 85), 0.2)),
    ],
)
def test_a_part_that_is_older_is_found(older: tuple[int, int], age: float, tmp_path: Path) -> None:
    ray = np.arange(N_RAYS)
    is_older = (ray >= older[0]) & (ray < older[1])
    run = run_of(age * is_older)
    found = locate(run)
    line = next(note for note in found.notes if "older" in note)
    assert (
        f"{1e3 * age:.0f} ±" in line or f"{1e3 * age - 1:.0f} ±" in line or f"{1e3 * age + 1:.0f} ±" in line
    )
    assert found.sensor is not None
    np.testing.assert_allclose(np.ptp(found.sensor.ray_delays), age, atol=0.003)
    assert (
        np.abs(found.sensor.ray_delays + age * is_older) > 0.005
    ).sum() <= 2  # rays at the ends of the part
    xy, yaw = errors(run, found.poses)
    assert xy < 0.03 and yaw < np.radians(0.6)
    kept = located_run(run, LocatedRun.of(run, found))
    logs.write(kept, tmp_path / "kept.mcap")
    np.testing.assert_allclose(
        logs.read(tmp_path / "kept.mcap").sensor.ray_delays, found.sensor.ray_delays, atol=1e-6
    )


def tracked(run: Run) -> TrackedRun:
    return track_run(run)


@cache
def tracked_at_once() -> TrackedRun:
    """Return the track of a run whose rays were all taken at the stamp."""
    return tracked(run_of(np.zeros(N_RAYS)))


def test_honest_scans_have_no_older_part() -> None:
    assert not any("older" in note for note in tracked_at_once().notes)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["a sweep", "late scans"])
def test_a_sweep_whose_ages_are_a_ramp_and_a_laser_whose_scans_are_all_late_have_no_older_part(
    kind: str,
) -> None:
    ages = {"a sweep": 0.1 * np.arange(N_RAYS) / N_RAYS, "late scans": np.full(N_RAYS, 0.1)}
    assert not any("older" in note for note in tracked(run_of(ages[kind])).notes)


def test_without_returns_only_the_prior_says_when_rays_were_taken() -> None:
    run, found = run_of(np.zeros(N_RAYS)), tracked_at_once()
    pieces = TurningPieces.of(run, found.odometry, found.track)
    assert pieces is not None
    blind = replace(pieces, run=replace(pieces.run, ranges=np.full_like(pieces.run.ranges, np.inf)))
    motion = Motion(stamps=run.odom_stamps, poses=run.odometry)
    basis = sweep_basis(N_RAYS)
    found = blind.linearised(run.sensor.ray_delays, motion).estimate(basis)
    np.testing.assert_allclose(found.change, 0.0)
    np.testing.assert_allclose(found.covariance, DELAY_SD**2 * np.eye(basis.shape[1]))
    assert best_part(blind, blind.poses, run.sensor.ray_delays, motion)[1] == 0.0
