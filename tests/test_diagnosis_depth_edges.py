"""Steps in depth: what a ray reads past an edge is what it reads when it is turned past it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further, polygon_arena
from plain_kernels import nearest_walls_plain, plain_corners_between_rays
from scan_samples import data_of

from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.diagnosis.scan.corner_sums import corners_between_rays
from sensorgraph.diagnosis.scan.depth_edges import find_edges
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.types import Floats, Ints
from sensorgraph.world.ray_order import is_full_turn, neighbouring_rays

DIRECTION, PLACE = 0.004, 0.01
"""[rad, m] by which the direction and the place of a corner are uncertain."""


def classroom(seed: int = 0) -> Arena:
    """Return a 6 x 5 m room with the legs of tables, 3 cm thick and turned, and a box."""
    rng = np.random.default_rng(seed)
    rings: list[list[tuple[float, float]]] = [
        [(0, 0), (6, 0), (6, 5), (0, 5)],
        [(2.6, 2.1), (3.1, 2.1), (3.1, 2.6), (2.6, 2.6)],
    ]
    for x, y in rng.uniform([0.3, 0.3], [5.7, 4.7], (24, 2)):
        turn = rng.uniform(0, np.pi)
        c, s = 0.02 * np.cos(turn), 0.02 * np.sin(turn)
        rings.append([(x + c, y + s), (x - s, y + c), (x - c, y - s), (x + s, y - c)])
    return polygon_arena(*rings)


@pytest.fixture(scope="module", params=[0.0, 0.15], ids=["at once", "in a sweep"])
def data(request: pytest.FixtureRequest) -> ScanData:
    found = data_of(classroom())
    return replace(found, sensor=replace(found.sensor, sweep_time=request.param), memo={})


def turned(data: ScanData, angles: Floats) -> Floats:
    """Return what the rays read in the bare map, turned by angles (n,) [rad]: (n, n_scans, n_rays)."""
    return np.stack([data.scene().shoot(float(angle)).ranges for angle in angles])


def test_past_an_edge_a_ray_reads_what_it_reads_when_turned(data: ScanData) -> None:
    edges = find_edges(data, data.scene().shoot(), data.arena.walls)
    assert edges is not None
    t = data.tolerances
    near = np.hypot(np.hypot(t.pose_yaw, t.mount_yaw), np.sqrt(t.pose_xy**2 + t.map**2 + t.mount_xy**2) / 0.5)
    readings = turned(data, np.linspace(-3 * near, 3 * near, 121))[:, *edges.index]
    own = data.scene().shoot().ranges[edges.index]
    likely = (edges.chance > 0.05) & (np.minimum(own, edges.other) > 0.5)
    off = np.abs(readings - edges.other).min(axis=0) - 3 * edges.spread
    assert likely.sum() > 100
    assert (off[likely] < 0.03).mean() > 0.92  # some see a third surface, not that of the next ray


def test_every_ray_next_to_a_step_has_another_side(data: ScanData) -> None:
    """Also next to a leg that stands between two rays, and on one behind which a third surface is seen."""
    edges = find_edges(data, data.scene().shoot(), data.arena.walls)
    assert edges is not None
    chance = np.zeros(data.ranges.shape)
    chance[edges.index] = edges.chance
    least = float(np.hypot(data.tolerances.pose_yaw, data.tolerances.mount_yaw))
    readings = turned(data, np.array([-0.5, 0.0, 0.5]) * least)
    steps = np.abs(readings[[0, 2]] - readings[1]).max(axis=0) > 0.3
    inner = slice(1, -1)  # what stands outside of the field of view is nobody's neighbour
    assert steps[:, inner].sum() > 50
    assert (chance[:, inner][steps[:, inner]] > 0.2).mean() > 0.97


@pytest.mark.parametrize(("degrees", "spin"), [(270, 0.1), *further((360, 0.0), (270, 0.0), (360, 0.1))])
def test_the_compiled_search_for_corners_is_the_plain_one(degrees: float, spin: float) -> None:
    """Over origins among the legs, in full turns and part of one, of robots that turn within the sweep."""
    fov, rng, n_scans, n_rays = np.radians(degrees), np.random.default_rng(4), 25, 36
    arena = classroom(1)
    base = data_of(arena, n=60).sensor
    bearings = -fov / 2 + fov * np.arange(n_rays) / (n_rays if fov > 6 else n_rays - 1)
    sensor = replace(base, bearings=bearings, range_max=20.0)
    phi = rng.uniform(-np.pi, np.pi, (n_scans, 1)) + bearings + spin * np.arange(n_rays) / n_rays
    ox, oy = (rng.uniform(0.5, 4.5, (n_scans, 1)) + 0.002 * np.arange(n_rays) * (spin > 0) for _ in range(2))
    ux, uy = np.cos(phi), np.sin(phi)
    scene = data_of(arena, n=60).scene()
    ranges, wall = nearest(scene.walls, ox, oy, ux, uy)
    pairs = neighbouring_rays(sensor)
    corners = np.unique(scene.walls.reshape(-1, 2), axis=0)
    first = bearings[pairs[0]] - bearings[pairs[0][0]]
    blur, least = (DIRECTION, PLACE), 0.002
    got = corners_between_rays(
        corners,
        scene.walls,
        (ox, oy, ux, uy),
        ranges,
        wall,
        pairs,
        first,
        is_full_turn(bearings),
        blur,
        least,
    )
    plain = plain_corners_between_rays(
        corners, scene.walls, (ox, oy, ux, uy), ranges, wall, pairs, blur, least
    )
    assert (plain[0] > 0.01).sum() > 10
    np.testing.assert_allclose(got[0], plain[0], atol=1e-9)
    np.testing.assert_allclose(got[1], plain[1], atol=1e-9)


def nearest(walls: Floats, *rays: Floats) -> tuple[Floats, Ints]:
    shape = rays[2].shape
    ranges, wall = nearest_walls_plain(walls, *(np.broadcast_to(part, shape).ravel() for part in rays))
    return ranges.reshape(shape), wall.reshape(shape)


def test_a_leg_beside_a_ray_is_as_likely_as_it_is_near() -> None:
    """A leg of which the edge stands one standard error beside a ray is met by one reading in six."""
    arena = polygon_arena(
        [(0, 0), (6, 0), (6, 5), (0, 5)], [(3.0, 2.52), (3.1, 2.52), (3.1, 2.62), (3.0, 2.62)]
    )
    bearings = np.array([0.0, 0.5])
    ox, oy = np.full((1, 2), 1.0), np.full((1, 2), 2.5)
    ux, uy = np.cos(bearings)[None], np.sin(bearings)[None]
    ranges, wall = nearest(arena.walls, ox, oy, ux, uy)
    chance, met = corners_between_rays(
        np.unique(arena.walls.reshape(-1, 2), axis=0), arena.walls, (ox, oy, ux, uy), ranges, wall,
        (np.array([0]), np.array([1])), np.array([0.0]), False, (0.0, 0.02), 0.002,
    )  # fmt: skip
    assert chance[0, 0] == pytest.approx(0.1587, abs=1e-3)
    assert met[0, 0] == pytest.approx(2.0, abs=0.11)
    assert chance[0, 1] == 0.0


@pytest.mark.parametrize("is_far_pillar_there", [False, True])
def test_a_leg_is_seen_beside_an_edge_that_no_reading_reaches(is_far_pillar_there: bool) -> None:
    """A pillar beyond the sensor's reach, nearer to the ray by its angle, is no reason to forget the leg."""
    leg = [(2.95, 2.508), (3.05, 2.508), (3.05, 2.6), (2.95, 2.6)]
    pillar = [(20.0, 2.515), (20.2, 2.515), (20.2, 2.8), (20.0, 2.8)]
    hall = [(0.0, 0.0), (30.0, 0.0), (30.0, 5.0), (0.0, 5.0)]
    arena = polygon_arena(hall, leg, *([pillar] if is_far_pillar_there else []))
    sensor = RangeSensor(bearings=np.array([0.0, 0.2]), range_max=8.0, sigma=0.01)
    one = replace(data_of(classroom()), arena=arena, sensor=sensor, memo={})
    pose, when = np.array([[1.0, 2.5, 0.0]]), one.stamps[:1]
    one = replace(one, poses=pose, track=(when, pose), stamps=when, ranges=np.full((1, 2), np.inf))
    edges = find_edges(one, one.scene().shoot(), arena.walls)
    assert edges is not None
    at = np.flatnonzero(edges.index[1] == 0)
    np.testing.assert_allclose(edges.other[at], 1.95, atol=0.11)
