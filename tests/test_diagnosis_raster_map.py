"""Maps of pixels in diagnosis: straight walls through the cells, unknown space, changes as things."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from conftest import polygon_arena
from PIL import Image

from logs.run import Run
from planners.arena import Arena
from planners.maps import ros_map
from sensorgraph.diagnosis.raster_map import RasterMap
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.types import Floats
from sensorgraph.world.pixel_walls import is_raster
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import parse_robot

PIXEL = 0.1
ROBOT = parse_robot("sensor: {n_rays: 61, mount: [0.0, 0.0, 0.0]}")
TURN = np.radians(8.0)


def turned(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    c, s = np.cos(TURN), np.sin(TURN)
    return [(c * x - s * y, s * x + c * y) for x, y in points]


ROOM = turned([(0, 0), (5, 0), (5, 4), (0, 4)])
BOX = turned([(3.2, 2.4), (3.9, 2.4), (3.9, 3.0), (3.2, 3.0)])


@pytest.fixture(scope="module")
def pixels(tmp_path_factory: pytest.TempPathFactory) -> Arena:
    """Draw an empty room that is turned against the grid; its last metre was never seen, nor was its far wall."""
    folder = tmp_path_factory.mktemp("raster")
    n, low = 72, np.array([-1.2, -0.6])
    x, y = np.meshgrid(
        low[0] + PIXEL * (np.arange(n) + 0.5), low[1] + PIXEL * (np.arange(n) + 0.5), indexing="ij"
    )
    room = shapely.Polygon(ROOM)
    seen = shapely.contains_xy(shapely.Polygon(turned([(-1, -1), (4, -1), (4, 5), (-1, 5)])), x, y)
    wall = shapely.intersects(
        shapely.box(x - PIXEL / 2, y - PIXEL / 2, x + PIXEL / 2, y + PIXEL / 2), room.exterior
    )
    grey = np.where(seen & wall, 0, np.where(seen & shapely.contains_xy(room, x, y), 254, 205)).astype(
        np.uint8
    )
    Image.fromarray(grey.T[::-1]).save(folder / "map.pgm")
    (folder / "map.yaml").write_text(
        f"image: map.pgm\nresolution: {PIXEL}\norigin: [{low[0]}, {low[1]}, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return ros_map.read(folder / "map.yaml")


def scanned(place: Arena) -> Run:
    """Turn round on a small circle in the place as it is."""
    t = 0.2 * np.arange(60)
    middle = np.array(turned([(1.8, 1.8)])[0])
    poses = np.column_stack([middle[0] + 0.4 * np.cos(t), middle[1] + 0.4 * np.sin(t), 0.7 * t])
    ranges, _ = cast_laser(
        place.walls, laser_poses(poses, ROBOT.sensor.mount), ROBOT.sensor.bearings, ROBOT.sensor.range_max
    )
    return Run(sensor=ROBOT.sensor, stamps=t, ranges=ranges, pose_stamps=t, poses=poses)


def judged(pixels: Arena, *things: list[tuple[float, float]]) -> tuple[ScanData, ScanData, dict[str, object]]:
    raster = RasterMap.of(pixels)
    data, _ = prepare_scans(scanned(polygon_arena(ROOM, *things)), raster.arena, raster.widened(ROBOT))
    after, notes = raster.judged(data)
    return data, after, notes


def test_walls_are_straight_and_lie_in_the_middle_of_their_cells(pixels: Arena) -> None:
    assert is_raster(pixels) and not is_raster(polygon_arena(ROOM))
    raster = RasterMap.of(pixels)
    assert raster.arena.n_walls < pixels.n_walls / 4
    length = np.hypot(*np.diff(raster.arena.walls, axis=1)[:, 0].T)
    true = shapely.Polygon(ROOM).exterior
    for wall in raster.arena.walls[length > 1.0]:
        points: Floats = wall[0] + np.linspace(0.05, 0.95, 9)[:, None] * (wall[1] - wall[0])
        assert shapely.distance(shapely.points(points), true).max() < 0.8 * PIXEL
    assert raster.widened(ROBOT).tolerances.map >= PIXEL / np.sqrt(12)


def test_unknown_space_is_not_judged(pixels: Arena) -> None:
    before, after, notes = judged(pixels)
    with np.errstate(invalid="ignore"):
        ends = before.poses[:, None, :2] + before.ranges[..., None] * np.stack(
            [
                np.cos(before.poses[:, 2:] + before.sensor.bearings),
                np.sin(before.poses[:, 2:] + before.sensor.bearings),
            ],
            axis=-1,
        )
    far = (ends @ np.array([np.cos(TURN), np.sin(TURN)])) > 4.3  # behind what was ever seen
    assert np.isnan(after.ranges[far]).all()
    near = (ends @ np.array([np.cos(TURN), np.sin(TURN)])) < 3.6
    assert np.isfinite(after.ranges[near]).mean() > 0.97
    assert not notes["changes"]


def test_what_stands_there_since_is_one_thing_with_a_place_and_a_size(pixels: Arena) -> None:
    _, _, notes = judged(pixels, BOX)
    (thing,) = notes["changes"]  # type: ignore[misc]
    middle = np.mean(BOX, axis=0)
    assert thing["kind"] == "new" and np.hypot(*(thing["xy"] - middle)) < 0.4
    assert max(thing["size_m"]) < 1.0
    assert 0.01 < notes["changes_share"] < 0.3  # type: ignore[operator]


def test_a_wrong_place_is_no_change_of_the_building(pixels: Arena) -> None:
    raster = RasterMap.of(pixels)
    data, _ = prepare_scans(scanned(polygon_arena(ROOM)), raster.arena, ROBOT)
    _, notes = raster.judged(replace(data, ranges=0.5 * data.ranges, memo={}))
    assert not notes["changes"]
