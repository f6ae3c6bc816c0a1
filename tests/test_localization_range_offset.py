"""A laser that reads too long or too short: found, corrected for the poses, and taken neither for bearings nor for the mount."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely
from conftest import further
from localization_samples import ROOM, looking_about, room_run

import logs
from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.diagnosis.motion.calibration.laser_motion import laser_motion
from sensorgraph.localization.in_map import locate_in_map
from sensorgraph.localization.locate import corrections_of, located_run
from sensorgraph.localization.mapping import map_run
from sensorgraph.localization.range_offset import without_offset
from sensorgraph.localization.result import Localization
from sensorgraph.types import Floats

TRUTH = looking_about(np.arange(300) / 5.0)


@pytest.fixture(autouse=True)
def _not_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the search for older rays, most of the time, which no claim here is about."""
    monkeypatch.setattr("sensorgraph.localization.tracked_run.identify_older_rays", lambda *_: None)


def looking_ahead(offset: float) -> Run:
    """Return a run of a laser that sees the half circle ahead of it and reads too long by `offset` [m]."""
    run = room_run(TRUTH, n_rays=160)
    ahead = np.abs(run.sensor.bearings) <= np.pi / 2
    sensor = replace(run.sensor, bearings=run.sensor.bearings[ahead])
    return replace(run, sensor=sensor, ranges=np.ascontiguousarray(run.ranges[:, ahead]) + offset)


@cache
def mapped(offset: float) -> Localization:
    """Locate the run in a map of its own."""
    return map_run(looking_ahead(offset))


@pytest.mark.parametrize("offset", [0.03, *further(-0.03, -0.025, 0.06)])
def test_an_offset_of_the_ranges_is_found_and_moves_no_pose(offset: float) -> None:
    found = mapped(offset)
    word = "long" if offset > 0 else "short"
    assert any(f"cm too {word}" in note for note in found.notes)
    assert not any("bearings" in note or "mount" in note for note in found.notes)
    assert found.range_offset == pytest.approx(offset, abs=0.004)  # 0.4 times the noise of a range
    off = compose(compose(TRUTH[0], invert(found.poses[0])), found.poses) - TRUTH
    assert np.hypot(*off[:, :2].T).max() < 0.03
    assert np.abs(wrap(off[:, 2])).max() < np.radians(0.5)


def test_the_readings_stay_as_logged_and_the_motion_is_that_of_right_ranges(tmp_path: Path) -> None:
    run = looking_ahead(0.03)
    located = located_run(run, mapped(0.03))
    np.testing.assert_array_equal(located.ranges, run.ranges)
    path = tmp_path / "located.mcap"
    logs.write(located, path)
    kept = logs.read(path)
    (said,) = corrections_of(kept)
    assert "cm too long: corrected" in said and not corrections_of(run)
    moved = laser_motion(run, kept)
    true = compose(invert(TRUTH[moved.first]), TRUTH[moved.second])
    ahead, left, _ = np.abs(np.median(moved.steps - true, axis=0))
    assert max(ahead, left) < 0.001  # [m] 0.25 % of a step
    assert "range_offset" not in located_run(kept, replace(mapped(0.03), range_offset=0.0)).meta


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 1.03, 0.97])
def test_right_ranges_and_stretched_ones_have_no_offset(factor: float) -> None:
    """A scale of all ranges leaves the shape of the map, but not its size."""
    run = looking_ahead(0.0)
    found = map_run(replace(run, ranges=factor * run.ranges))
    assert found.range_offset == 0.0


def test_readings_beyond_the_limits_stay_left_out() -> None:
    run = looking_ahead(0.0)
    limit = run.sensor.range_max
    ranges = run.ranges[:2].copy()
    ranges[0, :4] = [limit, np.inf, -np.inf, 0.5 * run.sensor.range_min]
    corrected = without_offset(replace(run, ranges=ranges, stamps=run.stamps[:2]), 0.05)
    assert not np.isfinite(corrected[0, [0, 3]]).any()
    np.testing.assert_array_equal(corrected[0, 1:3], [np.inf, -np.inf])
    np.testing.assert_allclose(corrected[1], ranges[1] - 0.05)


def walls_seen(offset: float) -> Floats:
    """Return the walls (n, 2, 2) of the room as a laser that reads too long by `offset` [m] draws them: all further away."""
    rings = [shapely.Polygon([wall[:2] for wall in walls]) for walls in (ROOM[:-4], ROOM[-4:])]
    free = (rings[0] - rings[1]).buffer(offset, join_style="mitre")
    corners = [np.asarray(ring.coords) for ring in (free.exterior, *free.interiors)]
    return np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in corners])


@pytest.mark.parametrize("of_map", [0.03, *further(0.0, 0.015)])
def test_in_a_map_only_what_the_map_lacks_of_the_offset_is_corrected(of_map: float) -> None:
    found = locate_in_map(looking_ahead(0.03), walls_seen(of_map))
    assert any("and so is the map" in note for note in found.notes) == (of_map > 0)
    off = compose(invert(TRUTH), found.poses)
    assert np.abs(off[:, :2].mean(axis=0)).max() < 0.005  # [m] half of the noise of a range


def test_an_offset_within_the_errors_of_a_reading_is_not_corrected() -> None:
    assert map_run(looking_ahead(0.012)).range_offset == 0.0
