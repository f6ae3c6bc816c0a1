"""A number of the sensor that changed during the run is found with its time; one that holds is left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from scan_samples import checked_of, data_of

from planners.arena import Arena
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.unnamed import Doubt, sure
from sensorgraph.diagnosis.scan.unnamed.change_in_time import find
from sensorgraph.diagnosis.scan.unnamed.columns import N_PARTS
from sensorgraph.diagnosis.site_baseline import BaselineInterval, SitePrior
from sensorgraph.effects import EFFECTS, Amendment


@pytest.fixture(scope="module")
def quiet(hall: Arena) -> ScanData:
    return data_of(hall)


def fitted(data: ScanData, *model: Amendment) -> Fitted:
    return fit(data, model, start_state(data, NoiseBounds()), NoiseBounds())


def sure_changes(model: Fitted, null: Fitted | None = None) -> list[Doubt]:
    return sure(find(checked_of(model, null)))


def halves(first: ScanData, second: ScanData, share: float) -> ScanData:
    """Return one run until a share of it, another from there on."""
    late = np.arange(first.n_scans) >= share * first.n_scans
    return replace(first, ranges=np.where(late[:, None], second.ranges, first.ranges), memo={})


PLANTED = [
    ("range_bias", {"b": 0.02}),
    ("range_scale", {"s": 0.015}),
    ("mount_yaw", {"delta": 0.02}),
    ("mount_xy", {"dx": 0.03, "dy": 0.0}),
    ("latency", {"tau": 0.03}),
]
SOME_PLANTED = [PLANTED[0], *further(*PLANTED[1:3]), PLANTED[3], *further(PLANTED[4])]
"""One of the ranges and one of the mount in the quick suite."""


@pytest.mark.parametrize(("name", "values"), SOME_PLANTED, ids=[name for name, _ in PLANTED])
def test_what_begins_during_the_run_is_told_with_its_time(
    hall: Arena, quiet: ScanData, name: str, values: dict[str, float]
) -> None:
    """Fitted to the whole run it would be a smaller effect that was always there."""
    whole = data_of(hall, (EFFECTS[name](**values),))
    broken = halves(quiet, whole, 0.6)
    null = fitted(broken)
    (doubt,) = sure_changes(fitted(broken, EFFECTS[name](**dict.fromkeys(values, 0.0))), null)
    assert doubt.failed == {0} and EFFECTS[name].title in doubt.statement
    when = float(doubt.statement.split("only after ")[1].split(" s ")[0])
    assert abs(when - 0.6 * broken.span) < 1.01 * broken.span / N_PARTS
    (doubt,) = sure_changes(null)  # also where the search has not named it
    assert not doubt.failed


@pytest.mark.parametrize(("name", "values"), SOME_PLANTED, ids=[name for name, _ in PLANTED])
def test_what_holds_all_the_time_is_left_alone(hall: Arena, name: str, values: dict[str, float]) -> None:
    whole = data_of(hall, (EFFECTS[name](**values),))
    assert sure_changes(fitted(whole, EFFECTS[name](**dict.fromkeys(values, 0.0)))) == []


def test_errors_that_neighbouring_scans_share_are_no_change(quiet: ScanData) -> None:
    """A bias that wanders from second to second makes the halves differ; by how much, the seconds themselves tell."""
    rng, n = np.random.default_rng(1), round(quiet.span)
    seconds = np.linspace(0, n, quiet.n_scans)
    for _ in range(4):
        walk = np.interp(seconds, np.arange(n + 1), rng.normal(0, 0.01, n + 1))
        assert sure_changes(fitted(replace(quiet, ranges=quiet.ranges + walk[:, None], memo={}))) == []


@pytest.mark.parametrize(("spread", "is_told"), [(0.008, False), (0.0012, True)])
def test_a_jump_as_large_as_good_windows_differ_by_is_the_site(
    hall: Arena, quiet: ScanData, spread: float, is_told: bool
) -> None:
    """Where poses come from the scans, the mount seems to move by centimetres from one good window to the next."""
    broken = halves(quiet, data_of(hall, (EFFECTS["mount_xy"](dx=0.02, dy=0.0),)), 0.5)
    usual = BaselineInterval(
        mean={"dx": 0.01, "dy": 0.0},
        spread={"dx": spread, "dy": spread},
        stderr={"dx": 0.0, "dy": 0.0},
        dof=12.0,
    )
    site = replace(broken, site=SitePrior(intervals={"mount_xy": usual}), memo={})
    assert bool(sure_changes(fitted(site))) == is_told


@pytest.mark.parametrize(("pose_xy", "is_told"), [(0.0022, True), (0.02, False)])
def test_a_mount_that_jumps_by_what_the_reference_may_wander_is_none(
    hall: Arena, quiet: ScanData, pose_xy: float, is_told: bool
) -> None:
    """A reference that is off by 2 cm for seconds on end moves readings as a laser does that sits elsewhere from then on."""
    broken = halves(quiet, data_of(hall, (EFFECTS["mount_xy"](dx=0.03, dy=0.0),)), 0.6)
    told = replace(broken, tolerances=replace(broken.tolerances, pose_xy=pose_xy), memo={})
    assert bool(sure_changes(fitted(told))) == is_told


def test_a_sector_that_is_not_seen_for_half_of_the_run_does_not_end_it(quiet: ScanData) -> None:
    """Where none of its rays is judged nothing tells a change: its matrix is singular."""
    low, high = -0.3, 0.4
    inside = (quiet.sensor.bearings > low) & (quiet.sensor.bearings < high)
    late = np.arange(quiet.n_scans) > 0.5 * quiet.n_scans
    hidden = late[:, None] & inside
    ranges = np.where(inside, quiet.ranges + 0.05, quiet.ranges)
    partly = replace(quiet, ranges=np.where(hidden, np.nan, ranges), memo={})
    model = fitted(partly, EFFECTS["sector_bias"](theta1=low, theta2=high, b=0.05))
    assert sure_changes(model) == []
