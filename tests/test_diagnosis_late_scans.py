"""Scans of which a share is stamped late: what was planted is found, and nothing where one delay holds for all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_samples import drive, hall_arena

from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.late_scans import late_scans, late_stamps
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import parse_robot


def fitted(late: float, share: float, *effects: Amendment, seed: int = 3) -> Fitted:
    """Return the fit of a run of which a share of the scans is stamped late [s]."""
    hall = hall_arena()
    run = drive(hall, effects)
    is_late = np.random.default_rng(seed).random(len(run.stamps)) < share
    stamps = run.stamps + late * is_late
    data, _ = prepare_scans(replace(run, stamps=stamps), hall, parse_robot("sensor: {n_rays: 61}"))
    return fit(data, effects, start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=7)


@pytest.mark.parametrize(("late", "share"), [(0.06, 0.3), (-0.05, 0.2), (0.08, 0.1)])
def test_a_share_of_late_scans_is_found_with_its_size(late: float, share: float) -> None:
    got = fitted(late, share)
    found = late_scans(got)
    assert found is not None
    assert found.delay == pytest.approx(late, rel=0.12)
    assert found.share == pytest.approx(share, abs=0.06)
    (doubt,) = late_stamps(got)
    assert ("late" if late > 0 else "early") in doubt.statement
    assert doubt.size is not None and doubt.size.is_material(got.solver.data.sensor.sigma)


def test_one_delay_of_all_scans_is_no_mixture_and_keeps_its_name() -> None:
    assert late_stamps(fitted(0.0, 0.0)) == []
    assert late_stamps(fitted(0.0, 0.0, EFFECTS["latency"](tau=0.04))) == []


def test_a_latency_that_is_the_mean_of_two_loses_its_name() -> None:
    hall = hall_arena()
    run = drive(hall)
    is_late = np.random.default_rng(5).random(len(run.stamps)) < 0.4
    late = replace(run, stamps=run.stamps + 0.08 * is_late)
    data, _ = prepare_scans(late, hall, parse_robot("sensor: {n_rays: 61}"))
    null = fit(data, (), start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=7)
    mean = fit(
        data, (EFFECTS["latency"](tau=0.03),), start_state(data, SCAN.noise), SCAN.noise, outer=3, inner=5
    )
    (doubt,) = late_stamps(mean, null)
    assert doubt.failed == {0}
