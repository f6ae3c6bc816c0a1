"""Maps of pixels in diagnosis: straight walls through the cells, unknown space, changes as things."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from conftest import polygon_arena
from PIL import Image
from scan_samples import checked_of

from logs.run import Run
from planners.arena import Arena
from planners.maps import ros_map
from sensorgraph.diagnosis.raster_map import RasterMap
from sensorgraph.diagnosis.scan.corner_sums import Corners
from sensorgraph.diagnosis.scan.fit import fit, solver_for, start_state
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.score_test import hypotheses
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.absorbed_readings import find
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.nuisance import Nuisance
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
BOX = turned([(2.8, 2.4), (3.8, 2.4), (3.8, 3.4), (2.8, 3.4)])
BIN = turned([(3.2, 2.4), (3.5, 2.4), (3.5, 2.7), (3.2, 2.7)])


@pytest.fixture(scope="module")
def pixels(tmp_path_factory: pytest.TempPathFactory) -> Arena:
    """Draw an empty room that is turned against the grid; its last metre was never seen, nor was its far wall."""
    return mapped(tmp_path_factory.mktemp("raster"))


def mapped(folder: Path, *things: list[tuple[float, float]]) -> Arena:
    """Draw the room, and things in it, as map_server does."""
    n, low = 72, np.array([-1.2, -0.6])
    x, y = np.meshgrid(
        low[0] + PIXEL * (np.arange(n) + 0.5), low[1] + PIXEL * (np.arange(n) + 0.5), indexing="ij"
    )
    room = shapely.Polygon(ROOM)
    seen = shapely.contains_xy(shapely.Polygon(turned([(-1, -1), (4, -1), (4, 5), (-1, 5)])), x, y)
    taken = shapely.union_all([shapely.Polygon(thing) for thing in things])
    cells = shapely.box(x - PIXEL / 2, y - PIXEL / 2, x + PIXEL / 2, y + PIXEL / 2)
    wall = shapely.intersects(cells, shapely.union_all([room.exterior, taken.boundary]))
    free = seen & shapely.contains_xy(room.difference(taken), x, y)
    grey = np.where(seen & wall, 0, np.where(free, 254, 205)).astype(np.uint8)
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
    (change,) = notes["changes"]  # type: ignore[misc]
    middle = np.mean(BOX, axis=0)
    assert change["kind"] == "new" and np.hypot(*(change["xy"] - middle)) < 0.4
    assert max(change["size_m"]) < 1.3
    assert 0.01 < notes["changes_share"] < 0.3  # type: ignore[operator]


def test_an_opening_is_passed_by_all_rays_and_a_pane_by_most(pixels: Arena) -> None:
    niche = turned([(0, 0), (1.2, 0), (1.2, -1.2), (2.6, -1.2), (2.6, 0), (5, 0), (5, 4), (0, 4)])
    raster = RasterMap.of(pixels)
    run, wall = scanned(polygon_arena(niche)), scanned(polygon_arena(ROOM)).ranges
    data, _ = prepare_scans(run, raster.arena, ROBOT)
    after, notes = raster.judged(data)
    (change,) = notes["changes"]
    middle = np.array(turned([(1.9, 0.0)])[0])
    assert change["kind"] == "open" and np.hypot(*(change["xy"] - middle)) < 0.3
    assert np.isnan(after.ranges).sum() > 0.01 * after.ranges.size
    some = np.random.default_rng(0).random(wall.shape) < 0.2
    pane, _ = prepare_scans(replace(run, ranges=np.where(some, wall, run.ranges)), raster.arena, ROBOT)
    assert not raster.judged(pane)[1]["changes"]


def test_something_small_that_is_new_is_left_to_be_named(pixels: Arena) -> None:
    _, after, notes = judged(pixels, BIN)
    assert not notes["changes"]
    assert np.isnan(after.ranges).sum() == np.isnan(judged(pixels)[1].ranges).sum()


def test_somebody_who_walks_by_and_rays_that_do_not_return_are_no_change_of_the_building(
    pixels: Arena,
) -> None:
    raster = RasterMap.of(pixels)
    run = scanned(polygon_arena(ROOM))
    there = scanned(polygon_arena(ROOM, BOX)).ranges
    ranges = np.where(np.arange(len(run.stamps))[:, None] % 4 == 0, there, run.ranges)
    ranges[ranges > 2.2] = np.inf
    data, _ = prepare_scans(replace(run, ranges=ranges), raster.arena, ROBOT)
    assert not raster.judged(data)[1]["changes"]


@pytest.mark.parametrize("coarse", [True, False])
def test_strays_that_are_not_uniform_are_of_what_pixels_lack(pixels: Arena, coarse: bool) -> None:
    """Readings that end before the walls, scattered about 1.2 m: of a map of lines they doubt all that is named."""
    raster = RasterMap.of(pixels)
    run, rng = scanned(polygon_arena(ROOM)), np.random.default_rng(5)
    odd = rng.random(run.ranges.shape) < 0.06
    ranges = np.where(odd, 1.2 + 0.1 * rng.normal(size=run.ranges.shape), run.ranges)
    ranges += 0.01 * rng.normal(size=ranges.shape)
    data, _ = prepare_scans(replace(run, ranges=ranges), raster.arena, raster.widened(ROBOT))
    data = replace(raster.judged(data)[0], grain=PIXEL / 2 if coarse else 0.0, memo={})
    strays = (EFFECTS["random_outliers"](p=0.06),)
    got = fit(data, strays, start_state(data, SCAN.noise), SCAN.noise)
    (doubt,) = find(checked_of(got, gained=500.0, gains={0: 500.0}))
    assert "outliers, most of them at 1.2" in doubt.statement and doubt.failed == {0}
    assert doubt.is_of_building == coarse


def test_walls_laid_on_readings_count_their_errors_from_the_map(pixels: Arena) -> None:
    _, data, _ = judged(pixels)
    null = fit(data, (), start_state(data, SCAN.noise), SCAN.noise)
    laid = data.laid_by(null.state.corners)
    assert laid.laid is not None and 0 < np.abs(laid.laid).max() <= PIXEL / 2
    assert null.j > fit(data, (), start_state(data, SCAN.noise), SCAN.noise).j - 1e-6
    seen = null.solver.jacobian.valid & data.returned
    left = np.abs(null.solver.y - null.solver.shift(null.state, np.zeros(0)))[seen]
    assert np.median(left) < 0.01
    true = shapely.Polygon(ROOM).exterior
    hit = np.unique(null.solver.jacobian.wall[seen])
    walls = laid.arena.walls[hit]
    middles = shapely.points(walls[np.hypot(*np.diff(walls, axis=1)[:, 0].T) > 1.0].mean(axis=1))
    assert shapely.distance(middles, true).max() < 0.02


def test_a_map_that_is_laid_and_one_that_is_not_have_the_same_linear_part(pixels: Arena) -> None:
    _, data, _ = judged(pixels)
    state = start_state(data, SCAN.noise)
    rng = np.random.default_rng(0)
    state.g[len(Nuisance) :] = rng.uniform(-0.001, 0.001, len(state.g) - len(Nuisance))
    plain, _ = solver_for(data, ())
    moved, _ = solver_for(data.laid_by(state.g[len(Nuisance) :]), ())
    both = plain.jacobian.valid & moved.jacobian.valid & (plain.jacobian.wall == moved.jacobian.wall)
    a, b = (s.y - s.shift(state, np.zeros(0)) for s in (plain, moved))
    slanting = np.abs(plain.jacobian.ends).max(axis=0) > 3
    assert np.abs(a - b)[both & ~slanting].max() < 1e-3  # of second order in 1 mm
    one, other = (s.assemble(np.where(both & ~slanting, 1e4, 0.0), 1.0) for s in (plain, moved))
    assert np.allclose(one.right, other.right, atol=0.02 * np.abs(one.right).max())


def test_corners_that_nothing_meets_stay_where_the_map_has_them() -> None:
    walls = polygon_arena(ROOM).walls
    met = np.array([True, False, False, False])
    assert Corners.of(walls).count == 4 and Corners.of(walls).rest == -1
    few = Corners.of(walls, met)
    assert few.count == 3 and few.ends[0, 0] != few.ends[0, 1]
    assert (few.ends[2] == few.rest).all() and few.rest == 2


def test_readings_on_walls_whose_corners_stay_scatter_as_the_map_errs() -> None:
    """Where a building has more corners than may shift, errors of the others are noise, and no places to look at."""
    arena = polygon_arena(ROOM)
    data, _ = prepare_scans(scanned(arena), arena, ROBOT)
    data = replace(data, corners=Corners.of(arena.walls, np.array([True, False, False, False])))
    fitted = fit(data, (), start_state(data, SCAN.noise), SCAN.noise)
    rest = len(Nuisance) + 2 * 2
    assert (fitted.state.g[rest : rest + 2] == 0).all() and fitted.state.g[rest - 1] != 0
    assert {h.amendment.place for h in hypotheses(data, fitted)[0] if h.amendment.place} == {"w/edge_0"}

    rng, lasers = np.random.default_rng(2), laser_poses(data.poses[:3], data.sensor.mount)
    n_draws, tau = 400, data.tolerances.map
    drawn = []
    d = np.diff(arena.walls, axis=1)[:, 0]
    normals = np.stack([d[:, 1], -d[:, 0]], axis=1) / np.hypot(*d.T)[:, None]
    for _ in range(n_draws):
        walls = arena.walls.copy()
        walls[2] += tau * rng.normal(size=(2, 1)) * normals[2]
        drawn.append(cast_laser(walls, lasers, data.sensor.bearings, 82.0)[0])
    steep = solver_for(data, ())[1].jacobian.steep[:3]
    _, wall = cast_laser(arena.walls, lasers, data.sensor.bearings, 82.0)
    inside = (wall == 2) & (np.ptp(np.array(drawn), axis=0) > 0)
    ratio = np.std(drawn, axis=0)[inside] / steep[inside]
    assert inside.sum() > 20 and abs(np.median(ratio) - 1) < 0.1
    assert (steep[wall == 0] == 0).mean() > 0.8


def test_a_wrong_place_is_no_change_of_the_building(pixels: Arena) -> None:
    raster = RasterMap.of(pixels)
    data, _ = prepare_scans(scanned(polygon_arena(ROOM)), raster.arena, ROBOT)
    _, notes = raster.judged(replace(data, ranges=0.5 * data.ranges, memo={}))
    assert not notes["changes"]
