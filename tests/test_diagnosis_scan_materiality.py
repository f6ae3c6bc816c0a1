"""From which size on an effect gets a name: beyond the map's errors, the stated tolerances, and what a user would not mind."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from conftest import polygon_arena
from scan_samples import data_of, drive

from planners.arena import Arena
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.materiality import is_map_error
from sensorgraph.diagnosis.scan.naming import is_material
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS
from sensorgraph.world.robot import parse_robot


@pytest.fixture(scope="module")
def null(hall: Arena) -> Fitted:
    """Return the fit without effects of a run that has none."""
    quiet = data_of(hall)
    return fit(quiet, (), start_state(quiet, NoiseBounds()), NoiseBounds(), outer=1, inner=5)


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
    assert is_material(null, disc) == is_named


@pytest.mark.parametrize(
    ("stated", "moved", "is_named"),
    [(None, 0.02, True), (0.008, 0.02, False), (0.008, 0.028, True)],
)
def test_what_moves_by_what_the_map_is_stated_to_be_off_has_not_moved(
    hall: Arena, stated: float | None, moved: float, is_named: bool
) -> None:
    tolerances = "" if stated is None else f"\ntolerances: {{map: {stated}}}"
    robot = parse_robot("sensor: {n_rays: 61}" + tolerances)
    data, _ = prepare_scans(drive(hall), hall, robot)
    null = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds(), outer=1, inner=3)
    pillar = hall.names[-1].split("/")[0]
    there = EFFECTS["moved_obstacle"](dx=0.6 * moved, dy=-0.8 * moved).at(pillar)
    shifted = replace(there, stderr={"dx": 0.001, "dy": 0.001})
    assert is_material(null, shifted) == is_named


@pytest.mark.parametrize(("stated", "is_named"), [(0.0006, True), (0.003, False)])
def test_a_mount_that_is_stated_to_be_coarse_takes_more_for_a_name(
    hall: Arena, stated: float, is_named: bool
) -> None:
    robot = parse_robot(f"sensor: {{n_rays: 61}}\ntolerances: {{mount_yaw: {stated}}}")
    data, _ = prepare_scans(drive(hall), hall, robot)
    turned = replace(EFFECTS["mount_yaw"](delta=0.005), stderr={"delta": 0.0003})
    null = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds(), outer=1, inner=3)
    assert is_material(null, turned) == is_named


@pytest.mark.parametrize(("share", "is_named"), [(2.9, False), (3.6, True)])
def test_one_wall_of_many_may_be_off_by_more_than_the_stated_tolerance(
    hall: Arena, share: float, is_named: bool
) -> None:
    robot = parse_robot("sensor: {n_rays: 61}\ntolerances: {map: 0.008}")
    data, _ = prepare_scans(drive(hall), hall, robot)
    null = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds(), outer=1, inner=3)
    moved = replace(EFFECTS["moved_wall"](d=0.008 * share).at(hall.names[0]), stderr={"d": 0.001})
    assert is_material(null, moved) == is_named


def test_one_post_of_many_may_be_off_by_more_than_the_stated_tolerance() -> None:
    """Of forty posts whose errors are normal with 8 mm along each axis, one is 2.8 cm off in one map of twelve."""
    corners = np.array([(0, 0), (0.06, 0), (0.06, 0.06), (0, 0.06)])
    posts = [corners + [0.3 + 0.27 * k, y] for k in range(20) for y in (0.2, 4.7)]
    many = polygon_arena([(0, 0), (6, 0), (6, 5), (0, 5)], *posts)
    many = replace(
        many, names=tuple(f"{'room' if k < 4 else f'post_{k // 4}'}/edge_{k % 4}" for k in range(164))
    )
    robot = parse_robot("sensor: {n_rays: 61}\ntolerances: {map: 0.008}")
    data, _ = prepare_scans(drive(many), many, robot)
    null = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds(), outer=1, inner=3)
    for moved, is_named in ((0.028, False), (0.036, True)):
        there = EFFECTS["moved_obstacle"](dx=moved, dy=0.0).at("post_40")
        assert is_material(null, replace(there, stderr={"dx": 0.001, "dy": 0.001})) == is_named


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
    assert is_material(got, limit) == is_named


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
    ("alpha", "error", "depth", "is_pane"),
    [(0.4, 0.02, 0.065, True), (0.0, 0.09, 0.065, False), (0.0, 0.09, 0.6, True), (0.0, 0.09, 0.0, True)],
)
def test_a_pane_that_returns_nothing_before_a_near_wall_is_that_wall_in_a_map_of_pixels(
    null: Fitted, hall: Arena, alpha: float, error: float, depth: float, is_pane: bool
) -> None:
    pixels = replace(null, solver=copy(null.solver))
    pixels.solver.data = replace(null.solver.data, grain=0.025)
    glass = EFFECTS["glass"](a=1.0, b=4.0, alpha_ret=alpha, depth=depth).at(hall.names[0])
    assert is_map_error(pixels, replace(glass, stderr={"alpha_ret": error})) != is_pane


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
