"""From which size on an effect gets a name: beyond the map's errors, the stated tolerances, and what a user would not mind."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scan_samples import data_of, drive

from planners.arena import Arena
from sensorgraph.diagnosis.scan.consequence import ScanError, is_map_error, material_chance, scan_change
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.naming import why_immaterial
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS
from sensorgraph.world.robot import parse_robot


@pytest.fixture(scope="module")
def null(hall: Arena) -> Fitted:
    """Return the fit without effects of a run that has none."""
    quiet = data_of(hall)
    return fit(quiet, (), start_state(quiet, NoiseBounds()), NoiseBounds())


@pytest.mark.parametrize(("sticks_out", "is_named"), [(0.008, False), (0.08, True)])
def test_what_hardly_stands_out_of_a_mapped_obstacle_is_none(
    null: Fitted, sticks_out: float, is_named: bool
) -> None:
    """A disc over the face x = 2.6 of a pillar, within what the map may be wrong there, or not."""
    r = 0.05
    disc = replace(
        EFFECTS["unmapped_obstacle"](x=2.6 + sticks_out - r, y=3.25, r=r),
        stderr={"x": 0.002, "y": 0.002, "r": 0.002},
    )
    assert (why_immaterial(null, disc, material_chance(null, disc)) is None) == is_named


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


@pytest.mark.parametrize(("moved", "error", "is_named"), [(0.066, 0.016, False), (0.066, 0.003, True)])
def test_a_wall_in_a_map_of_pixels_has_moved_if_it_surely_has_by_more_than_a_pixel(
    null: Fitted, hall: Arena, moved: float, error: float, is_named: bool
) -> None:
    """The cells are 5 cm wide."""
    pixels = replace(null, solver=copy(null.solver))
    pixels.solver.data = replace(null.solver.data, grain=0.025)
    wall = replace(EFFECTS["moved_wall"](d=moved).at(hall.names[0]), stderr={"d": error})
    assert is_map_error(pixels, wall) != is_named


@pytest.mark.parametrize(
    ("r", "error", "is_named"), [(0.795, 0.001, False), (0.77, 0.015, False), (0.7, 0.015, True)]
)
def test_a_disc_that_may_be_as_large_as_discs_are_is_something_flat(
    null: Fitted, r: float, error: float, is_named: bool
) -> None:
    """The largest is 0.8 m."""
    disc = replace(EFFECTS["unmapped_obstacle"](x=2.0, y=1.5, r=r), stderr={"r": error})
    assert is_map_error(null, disc) != is_named


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
