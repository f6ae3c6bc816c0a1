"""From which size on an effect gets a name: beyond the map's errors, the stated tolerances, and what a user would not mind."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scan_samples import drive

from planners.arena import Arena
from sensorgraph.diagnosis.scan.consequence import ScanError, material_chance, scan_change
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.naming import why_immaterial
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS
from sensorgraph.world.robot import parse_robot


@pytest.mark.parametrize(("stated", "is_named"), [(0.0006, True), (0.003, False)])
def test_a_mount_that_is_stated_to_be_coarse_takes_more_for_a_name(
    hall: Arena, stated: float, is_named: bool
) -> None:
    robot = parse_robot(f"sensor: {{n_rays: 61}}\ntolerances: {{mount_yaw: {stated}}}")
    data, _ = prepare_scans(drive(hall), hall, robot)
    turned = replace(EFFECTS["mount_yaw"](delta=0.005), stderr={"delta": 0.0003})
    null = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds())
    assert (why_immaterial(null, turned, material_chance(null, turned)) is None) == is_named


@pytest.mark.parametrize(("lost", "is_named"), [(0.0008, False), (0.02, True)])
def test_a_cut_off_that_takes_hardly_any_reading_has_no_name(
    hall: Arena, lost: float, is_named: bool
) -> None:
    run = drive(hall)
    farthest = float(np.quantile(run.ranges, 1 - lost))
    cut = replace(run, ranges=np.where(run.ranges > farthest, np.inf, run.ranges))
    data, _ = prepare_scans(cut, hall, parse_robot("sensor: {n_rays: 61}"))
    limit = EFFECTS["max_range"](R=farthest)
    got = fit(data, (limit,), start_state(data, NoiseBounds()), NoiseBounds())
    assert (why_immaterial(got, limit, material_chance(got, limit)) is None) == is_named


@pytest.mark.parametrize(("offset", "words"), [(0.0123, "1.2 cm"), (1.0, "1 m"), (12.3, "12 m")])
def test_what_it_costs_is_told_in_plain_lengths(offset: float, words: str) -> None:
    assert f"off by {words} in 3.4 %" in ScanError(offset=offset, affected=0.034).sentence()


def test_rays_at_edges_do_not_state_the_consequence_of_all() -> None:
    expected = {
        name: np.full(1000, value)
        for name, value in {"reading": 3.0, "sigma": 0.01, "lattice": 0.0, "p_return": 1.0}.items()
    }
    without = SimpleNamespace(stray=0.0, short=0.0, **expected)
    edge = np.arange(1000) < 20
    with_it = SimpleNamespace(
        stray=0.0, short=0.0, lattice=expected["lattice"], p_return=expected["p_return"],
        reading=np.where(edge, 5.0, 3.02), sigma=np.where(edge, 1.0, np.hypot(0.01, 0.004)),
    )  # fmt: skip
    change = scan_change(
        cast(Any, SimpleNamespace(expected=with_it)), cast(Any, SimpleNamespace(expected=without))
    )
    assert change.offset == pytest.approx(0.02)
    assert change.noise == pytest.approx(0.004)
    assert change.affected == 1.0
