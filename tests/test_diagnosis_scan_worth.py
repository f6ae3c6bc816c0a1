"""What an effect is worth: smooth ones must show on plain walls, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import polygon_arena
from scan_samples import drive

from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.worth import (
    led_on_plain_walls,
    nats_away_from_edges,
    price,
    shows_everywhere,
    worth,
)
from sensorgraph.effects import EFFECTS
from sensorgraph.types import Bools
from sensorgraph.world.robot import parse_robot


@pytest.fixture(scope="module")
def scans() -> ScanData:
    posts = [[(x, 2.0), (x + 0.1, 2.0), (x + 0.1, 2.1), (x, 2.1)] for x in (1.0, 2.0, 3.0)]
    arena = polygon_arena([(0, 0), (6, 0), (6, 5), (0, 5)], *posts)
    return prepare_scans(drive(arena), arena, parse_robot("sensor: {n_rays: 61}"))[0]


@pytest.fixture(scope="module")
def null(scans: ScanData) -> Fitted:
    return fit(scans, (), start_state(scans, NoiseBounds()), NoiseBounds(), outer=1, inner=3)


def gaining(fitted: Fitted, where: Bools, nats: float) -> Fitted:
    """Return a fit that is better by so much, spread evenly over some rays (n_scans, n_rays)."""
    solution = fitted.solution
    log_p = solution.responsibilities.log_p + np.where(where, nats / where.sum(), 0.0)
    told = replace(solution.responsibilities, log_p=log_p)
    return replace(fitted, solution=replace(solution, j=solution.j + nats, responsibilities=told))


def edge_rays(fitted: Fitted) -> Bools:
    assert fitted.cast.edges is not None
    out = np.zeros(fitted.solution.responsibilities.log_p.shape, dtype=np.bool_)
    out[fitted.cast.edges.index] = True
    return out


def test_a_smooth_effect_that_only_rays_beside_edges_tell_is_worth_nothing(
    scans: ScanData, null: Fitted
) -> None:
    at_edges = edge_rays(null)
    assert at_edges.any()
    scale = EFFECTS["map_scale"](s=0.004, dx=0.0, dy=0.0)
    better = gaining(null, at_edges, 500.0)
    assert nats_away_from_edges(scans, better, null) == pytest.approx(0.0, abs=1e-6)
    assert worth(scans, scale, better, null) == pytest.approx(-price(scale, scans), abs=1e-6)
    disc = EFFECTS["unmapped_obstacle"](x=1.5, y=2.0, r=0.1)  # local, wherever its rays are
    assert worth(scans, disc, better, null) == pytest.approx(500.0 - price(disc, scans))


def test_one_that_all_rays_tell_is_worth_what_they_tell(scans: ScanData, null: Fitted) -> None:
    scale = EFFECTS["range_scale"](s=0.004)
    better = gaining(null, scans.returned, 500.0)
    assert nats_away_from_edges(scans, better, null) == pytest.approx(500.0, rel=1e-6)
    assert worth(scans, scale, better, null) == pytest.approx(500.0 - price(scale, scans))


def test_what_goes_with_the_whole_laser_or_the_whole_map_shows_everywhere() -> None:
    names = {name for name, effect in EFFECTS.items() if shows_everywhere(effect)}
    assert {"range_bias", "range_scale", "mount_xy", "mount_yaw", "latency", "map_scale"} <= names
    assert not names & {"moved_wall", "moved_obstacle", "mixed_pixels", "people", "sector_bias", "glass"}


def test_rays_beside_edges_do_not_choose_between_two_smooth_effects(scans: ScanData, null: Fitted) -> None:
    at_edges = edge_rays(null)
    scale, stretch = EFFECTS["range_scale"](s=0.004), EFFECTS["map_scale"](s=0.004, dx=0.0, dy=0.0)
    disc = EFFECTS["unmapped_obstacle"](x=1.5, y=2.0, r=0.1)
    of_laser = replace(gaining(null, scans.returned, 500.0), model=(scale,))
    of_map = replace(gaining(gaining(null, scans.returned, 300.0), at_edges, 600.0), model=(stretch,))
    local = replace(gaining(null, at_edges, 700.0), model=(disc,))
    tried = [(fitted, worth(scans, fitted.model[-1], fitted, null)) for fitted in (of_map, of_laser, local)]
    led = {fitted.model[-1].name: gain for fitted, gain in led_on_plain_walls(scans, tried, null)}
    assert led["range_scale"] == tried[1][1]
    assert led["unmapped_obstacle"] == tried[2][1]
    assert led["range_scale"] - led["map_scale"] > 150  # 200 nats, and a price of two more parameters
    assert tried[0][1] > tried[1][1]
    assert led_on_plain_walls(replace(scans, clutter_nats={"people": 100.0}), tried, null) == tried
