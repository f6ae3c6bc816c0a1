"""Codes that drivers write into ranges: an error is no surface, however near or far its number seems."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from rosbag_samples import Message, read, scan, sonar

import logs
from logs.error_codes import blank_error_codes
from logs.notes import assumptions_of


def scans(
    codes: Sequence[float], *, n: int = 20, range_min: float = 0.1, range_max: float = 10.0
) -> list[Message]:
    """Scans of 40 rays that return 1 to 5 m; ray k of the first scan holds code k."""
    rng = np.random.default_rng(1)
    out = []
    for i in range(n):
        ranges = rng.uniform(1, 5, 40)
        if i == 0:
            ranges[: len(codes)] = codes
        out.append(scan(0.1 * i, ranges, range_min=range_min, range_max=range_max))
    return out


@pytest.mark.parametrize("range_min", [0.1, 0.02, 0.0])
def test_codes_of_one_to_nineteen_millimetres_are_invalid_and_not_too_close(
    range_min: float, tmp_path: Path
) -> None:
    codes = [0.001, 0.006, 0.007, 0.015, 0.019]
    run = read(tmp_path, scans(codes, range_min=range_min))
    assert np.isnan(run.ranges[0, :5]).all() and np.isfinite(run.ranges[0, 5:]).all()
    note = "5 ranges of 1 to 19 mm are error codes of the laser, invalid readings: nan"
    assert note in assumptions_of(run)


def test_a_surface_that_is_too_close_stays_so(tmp_path: Path) -> None:
    """Above 19 mm, between two millimetres, or nearer than a sonar that measures so close."""
    run = read(tmp_path, scans([0.05, 0.0204, 0.0123]))
    assert np.isneginf(run.ranges[0, :3]).all()
    near = [sonar(0.1 * i, 0.012, topic="/sonar", frame="s") for i in range(5)]
    (tmp_path / "two").mkdir()
    assert np.isneginf(read(tmp_path / "two", near).ranges).all()  # range_min is 20 mm


def test_codes_of_sick_beyond_the_reach_are_invalid_unless_they_are_the_missing_return(
    tmp_path: Path,
) -> None:
    run = read(tmp_path, scans([81.89, 81.91, 81.83], range_max=80.0))
    np.testing.assert_array_equal(run.ranges[0, :3], [np.nan, np.nan, np.inf])
    note = "2 ranges of 81.89, 81.91 m are error codes of the laser, invalid readings: nan"
    assert note in assumptions_of(run)
    (tmp_path / "frequent").mkdir()
    frequent = read(tmp_path / "frequent", scans([81.91] * 30, range_max=80.0))
    assert np.isposinf(frequent.ranges[0, :30]).all()
    (tmp_path / "far").mkdir()
    far = read(tmp_path / "far", scans([81.91], range_max=120.0))
    assert far.ranges[0, 0] == np.float32(81.91)


def test_a_carmen_log_of_a_hokuyo_has_the_same_codes(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    lines = []
    for i in range(6):
        ranges = rng.uniform(1, 4, 682).round(3)
        ranges[:3] = [0.006, 0.019, 0.02]
        lines.append(f"FLASER 682 {' '.join(map(str, ranges))} 0 0 0 0 0 0 {i} host {i}")
    (tmp_path / "a.log").write_text("\n".join(lines))
    run = logs.read(tmp_path / "a.log")
    assert np.isnan(run.ranges[:, :2]).all() and (run.ranges[:, 2] == 0.02).all()
    assert "12 ranges of 6 to 19 mm are error codes of the laser" in run.meta["notes"]


def test_readings_without_codes_are_unchanged() -> None:
    rng = np.random.default_rng(2)
    part = rng.uniform(0.02, 90, (50, 100)).round(3)
    same = part.copy()
    assert blank_error_codes([part], 0.1, 100.0) == []
    np.testing.assert_array_equal(part, same)


@pytest.mark.parametrize(("code", "range_max"), [(2.999, 3.0), (29.99, 30.0), (5.56, 5.6)])
def test_frequent_range_just_below_range_max_is_a_missing_return(
    code: float, range_max: float, tmp_path: Path
) -> None:
    """Real returns up to range_max are among them, but no wall is at one tenth of a millimetre."""
    rng = np.random.default_rng(2)
    ranges = rng.uniform(0.5, range_max, (30, 60)).round(3)
    missing = rng.random(ranges.shape) < 0.05
    ranges[missing] = code
    run = read(tmp_path, [scan(0.1 * i, each, range_max=range_max) for i, each in enumerate(ranges)])
    assert np.isposinf(run.ranges[missing[:, : run.sensor.n_rays]]).all()
    assert run.sensor.range_max == pytest.approx(code)
    assert any(f"many ranges are exactly {code:g} m" in note for note in assumptions_of(run))


def test_wall_just_below_range_max_stays_a_wall(tmp_path: Path) -> None:
    ranges = 2.95 + 0.01 * np.random.default_rng(3).normal(size=(40, 20))
    run = read(tmp_path, [scan(0.1 * i, each.round(3), range_max=3.0) for i, each in enumerate(ranges)])
    assert np.isfinite(run.ranges).mean() > 0.99 and run.sensor.range_max == 3.0
