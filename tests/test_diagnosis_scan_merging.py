"""Two effects of a model that are one."""

from __future__ import annotations

import numpy as np
import pytest
from scan_samples import data_of, hall_arena

from benchmarks.hidden_effects.case import Spec
from benchmarks.hidden_effects.entrants.product import run_of
from benchmarks.hidden_effects.worlds.own.cases import make
from planners.maps import geojson
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.scan.model_selection import fewer_effects
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.types import Floats
from sensorgraph.world.robot import parse_robot

WALL = "arena/edge_0"
SECTOR = EFFECTS["sector_bias"]


@pytest.fixture(scope="module")
def quiet() -> ScanData:
    return data_of(hall_arena())


def part(name: str, a: float, b: float, wall: str = WALL) -> Amendment:
    own = {"black_surface": {"r0": 2.0}, "glass": {"alpha_ret": 0.2, "depth": 0.0}}[name]
    return EFFECTS[name](a=a, b=b, **own).at(wall)


def test_parts_of_a_wall_that_touch_may_be_one_of_either_kind(quiet: ScanData) -> None:
    pane, dark = part("glass", 1.0, 1.6), part("black_surface", 1.65, 2.1)
    found = list(fewer_effects((pane, dark), quiet))
    assert [(m[-1].name, m[-1]["a"], m[-1]["b"], len(m)) for m in found] == [
        ("glass", 1.0, 2.1, 1),
        ("black_surface", 1.0, 2.1, 1),
    ]


@pytest.mark.parametrize(
    "other", [part("black_surface", 2.1, 2.6), part("black_surface", 1.6, 2.1, "arena/edge_1")], ids=str
)
def test_parts_far_apart_or_of_two_walls_are_two(quiet: ScanData, other: Amendment) -> None:
    assert list(fewer_effects((part("glass", 1.0, 1.6), other), quiet)) == []


def added(model: tuple[Amendment, ...], bearings: Floats) -> Floats:
    """Return what biases add to rays (n,) [m], by their equations."""
    total = np.zeros(len(bearings))
    for a in model:
        if a.name == "sector_bias":
            inside = (bearings - a["theta1"]) % (2 * np.pi) <= (a["theta2"] - a["theta1"]) % (2 * np.pi)
            total += np.where(inside, a["b"], 0.0)
        else:
            total += a["b"]
    return total


def test_two_sectors_of_one_bias_are_all_rays_but_those_between(quiet: ScanData) -> None:
    bearings = quiet.sensor.bearings
    low, high = float(bearings[0]) - 0.01, float(bearings[-1]) + 0.01
    two = (SECTOR(theta1=0.4, theta2=high, b=-0.03), SECTOR(theta1=low, theta2=-0.7, b=-0.03))
    (found,) = fewer_effects(two, quiet)
    assert [a.name for a in found] == ["range_bias", "sector_bias"]
    np.testing.assert_allclose(added(found, bearings), added(two, bearings), atol=1e-12)


def test_a_bias_that_is_there_keeps_its_share(quiet: ScanData) -> None:
    bearings = quiet.sensor.bearings
    low, high = float(bearings[0]) - 0.01, float(bearings[-1]) + 0.01
    two = (SECTOR(theta1=0.4, theta2=high, b=-0.03), SECTOR(theta1=low, theta2=-0.7, b=-0.03))
    (found,) = fewer_effects((EFFECTS["range_bias"](b=0.01), *two), quiet)
    assert [a.name for a in found] == ["range_bias", "sector_bias"]
    np.testing.assert_allclose(added(found, bearings), added(two, bearings) + 0.01, atol=1e-12)


def test_sectors_of_opposite_biases_are_two(quiet: ScanData) -> None:
    two = (SECTOR(theta1=0.4, theta2=0.9, b=-0.03), SECTOR(theta1=-0.9, theta2=-0.7, b=0.03))
    assert list(fewer_effects(two, quiet)) == []


@pytest.mark.slow
def test_a_bias_beside_a_sector_of_the_other_sign_is_named_with_it() -> None:
    """What lies outside the sector is 4 cm off, what lies in it 1 cm: two sectors explained that, and were unknown."""
    case = make(Spec(suite="pairs", kinds="report", index=1023, background="dirty"))
    assert {e["name"] for e in case.truth["effects"]} == {"range_bias", "sector_bias"}
    arena = geojson.loads(case.map["arena.geojson"])
    finding = diagnose(run_of(case), arena, parse_robot(case.robot), plan_next=False)
    assert {a.name for a in finding.effects} == {"range_bias", "sector_bias"}
    assert finding.unknown is None
