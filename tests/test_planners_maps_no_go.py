"""Zones that a robot may not enter: kept free of all of it, seen through, read from files, refused in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import shapely
from planners_samples import outlined, shipped

from planners import PlanError, plan
from planners.check import check
from planners.maps.no_go import without, zones
from planners.vehicle import Vehicle

pytestmark = pytest.mark.usefixtures("narrow_search")

ROBOT = Vehicle()


GRID = {"cell": 0.5, "headings": 8}


def test_a_zone_is_kept_free_of_the_whole_robot_and_is_seen_through() -> None:
    arena = outlined(shapely.box(0, 0, 4, 3))
    zone = zones("1.5,0,2.5,0,2.5,1.5,1.5,1.5")
    less = without(arena, zone)
    assert less.walls is arena.walls
    made = plan(less, ROBOT, **GRID)
    places = shapely.points(made.trajectory.poses[:, :2])
    assert shapely.distance(places, zone[0]).min() >= ROBOT.footprint_radius
    assert made.report["coverage"] == 1.0
    assert made.report["limit_violations"] == 0
    assert check(made.trajectory, less, ROBOT).count == 0
    whole = plan(arena, ROBOT, **GRID)
    assert made.report["reachable_cells"] < whole.report["reachable_cells"]
    assert check(whole.trajectory, less, ROBOT).violations["clearance"] > 0


def test_zones_are_read_from_features_of_their_kind(tmp_path: Path) -> None:
    def feature(kind: str, *corners: tuple[float, float]) -> dict[str, object]:
        geometry = {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}
        return {"type": "Feature", "properties": {"name": kind, "kind": kind}, "geometry": geometry}

    path = tmp_path / "zones.geojson"
    features = [feature("arena", (0, 0), (4, 0), (4, 4)), feature("no_go", (1, 1), (2, 1), (2, 2))]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert [zone.area for zone in zones(str(path))] == [0.5]


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("1,1,2,2,2,1,1,2", "crosses or touches itself"),
        ("10,10,11,10,11,11", "outside the arena"),
        ("-1,-1,9,-1,9,9,-1,9", "cover all"),
        ("1,1,2,2", "at least three corners"),
        ("1,1,2,2,3", "at least three corners"),
        ("1,1,2,2,3,3", "touches itself|no area"),
        ("1,1,nan,2,3,1", "not finite"),
        ("nowhere.geojson", "is neither a file"),
    ],
)
def test_bad_zones_are_one_line(given: str, says: str) -> None:
    with pytest.raises(PlanError, match=says) as caught:
        without(shipped("square"), zones(given))
    assert "\n" not in str(caught.value)
