"""Model faces: what was planted is found, what is printed is what is predicted, kernels agree with plain numpy."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from conftest import further

from logs.run import RangeSensor
from planners.arena import Arena
from planners.maps import geojson
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.faces.hit_moments import HitMoments
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.ray_march import FaceSet, bucket_grid, crossed_faces, new_march
from sensorgraph.planning.survey import LaserSurvey
from sensorgraph.planning.views import choose_views
from sensorgraph.types import Floats
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.raycast import cast

SIGMA = 0.01  # [m]
SENSOR = RangeSensor(bearings=np.linspace(-np.pi / 2, np.pi / 2, 91), range_max=12.0, sigma=SIGMA)
BOX = [(1.4, 1.6), (2.2, 1.6), (2.2, 2.2), (1.4, 2.2)]


def room(obstacle: list[tuple[float, float]] | None = None) -> Arena:
    """A 4 m square, with one obstacle or none."""
    square = "[[0,0],[4,0],[4,4],[0,4],[0,0]]"
    features = [
        f'{{"type":"Feature","properties":{{"name":"room","kind":"arena"}},'
        f'"geometry":{{"type":"Polygon","coordinates":[{square}]}}}}'
    ]
    if obstacle is not None:
        ring = [list(corner) for corner in [*obstacle, obstacle[0]]]
        features.append(
            f'{{"type":"Feature","properties":{{"name":"box","kind":"obstacle"}},'
            f'"geometry":{{"type":"Polygon","coordinates":[{ring}]}}}}'
        )
    return geojson.loads(f'{{"type":"FeatureCollection","features":[{",".join(features)}]}}')


def somewhere(arena: Arena, n: int, rng: np.random.Generator, clear: float = 0.15) -> Floats:
    """Poses (n, 3) in free space, off the walls."""
    space = Arena(
        free=arena.free.buffer(-clear), walls=arena.walls, names=arena.names, surfaces=arena.surfaces
    )
    x0, y0, x1, y1 = arena.bounds
    points = rng.uniform([x0, y0], [x1, y1], (8 * n, 2))
    points = points[space.contains(points)][:n]
    return np.column_stack([points, rng.uniform(-np.pi, np.pi, len(points))])


def scans_of(arena: Arena, poses: Floats, rng: np.random.Generator, sigma: float = SIGMA) -> TrainingScans:
    ranges = cast(arena, poses, SENSOR).ranges
    return TrainingScans(
        sensor=SENSOR,
        poses=poses,
        ranges=ranges + sigma * rng.normal(size=ranges.shape),
        run=np.zeros(len(poses), dtype=np.intp),
    )


@pytest.fixture(scope="module")
def boxed() -> tuple[Arena, Faces]:
    arena, rng = room(BOX), np.random.default_rng(3)
    return arena, Faces.fit(scans_of(arena, somewhere(arena, 400, rng), rng), calibrate=False)


def rays_on(arena: Arena, poses: Floats) -> tuple[Floats, np.ndarray]:
    """True ranges, and a mask of the rays that end on the obstacle."""
    hits = cast(arena, poses, SENSOR)
    return hits.ranges, np.array([name.startswith("box") for name in arena.names])[hits.wall]


@pytest.mark.parametrize("width", [0.02, *further(0.03, 0.04)])
def test_leg_as_thin_as_the_noise_is_seen_from_every_side(width: float) -> None:
    turn, corners = np.radians(20.0), np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * width / 2
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    arena, rng = room((corners @ axes + 2.0).tolist()), np.random.default_rng(6)
    model = Faces.fit(scans_of(arena, somewhere(arena, 1000, rng), rng), calibrate=False)
    fresh = somewhere(arena, 2000, rng)
    ranges, on_leg = rays_on(arena, fresh)
    said = model.predict(fresh, np.arange(SENSOR.n_rays), "mode")
    off = np.abs(said.mode - ranges) > 0.05
    assert off[on_leg].mean() < 0.2  # two thirds if it is seen from some sides only; a tenth of it is edges
    assert (off & said.answered)[on_leg].mean() < 0.05
    assert off[~on_leg].mean() < 1e-3


@pytest.mark.parametrize("growth", [0.02, *further(0.005, 0.05)])
def test_noise_that_grows_with_the_range_is_stated_at_each_range(growth: float) -> None:
    """As that of lasers that triangulate."""
    arena, rng = room(BOX), np.random.default_rng(4)
    poses, fresh = np.split(somewhere(arena, 800, rng), 2)
    scans, truth = scans_of(arena, poses, rng, 0.0), cast(arena, fresh, SENSOR).ranges
    noisy = [
        r * (1 + growth * rng.normal(size=r.shape)) + 0.002 * rng.normal(size=r.shape)
        for r in (scans.ranges, truth)
    ]
    model = Faces.fit(replace(scans, ranges=noisy[0]), calibrate=False)
    graph = Sensorgraph(model=model, sensor=SENSOR, pose_frame="base_link", origin={})
    within = np.abs(graph.predict(fresh).cdf(noisy[1]) - 0.5) < 0.45
    for low, high in ((0.2, 1.0), (1.0, 2.0), (2.0, 4.0)):
        assert within[(truth > low) & (truth < high)].mean() == pytest.approx(0.9, abs=0.02)


def test_square_room_is_four_faces_known_to_a_millimetre() -> None:
    arena, rng = room(), np.random.default_rng(1)
    model = Faces.fit(scans_of(arena, somewhere(arena, 100, rng), rng), calibrate=False)
    assert model.faces.n_faces == 4
    assert model.noise.sigma == pytest.approx(SIGMA, rel=0.05)  # 9,100 returns: 0.7 %
    fresh = somewhere(arena, 300, rng)
    off = model.predict(fresh, np.arange(SENSOR.n_rays), "mode").mode - cast(arena, fresh, SENSOR).ranges
    assert np.median(np.abs(off)) < 1e-3
    assert np.abs(off).max() < 0.02  # grazing rays magnify


def test_rays_beside_an_obstacle_end_where_its_corners_say(boxed: tuple[Arena, Faces]) -> None:
    arena, model = boxed
    fresh = somewhere(arena, 1000, np.random.default_rng(8))
    said = model.predict(fresh, np.arange(SENSOR.n_rays), "mode")
    wrong = np.abs(said.mode - cast(arena, fresh, SENSOR).ranges) > 0.05
    assert wrong.mean() < 1.5e-3
    assert wrong[said.answered].mean() < 1e-3
    assert said.answered.mean() > 0.98


@pytest.mark.parametrize("sigma", [0.03, *further(0.015, 0.02, 0.05)])
def test_a_noisy_laser_sees_the_same_faces(sigma: float) -> None:
    """Lasers of 3 cm were given several faces for each wall, and a quarter of the rays answered."""
    arena, rng = room(BOX), np.random.default_rng(4)
    model = Faces.fit(scans_of(arena, somewhere(arena, 400, rng), rng, sigma), calibrate=False)
    assert 8 <= model.faces.n_faces <= 12
    assert model.noise.sigma == pytest.approx(sigma, rel=0.05)
    fresh = somewhere(arena, 300, rng)
    said = model.predict(fresh, np.arange(SENSOR.n_rays), "mode")
    off = said.mode - cast(arena, fresh, SENSOR).ranges
    assert np.median(np.abs(off)) < 0.1 * sigma
    assert said.answered.mean() > 0.97


def test_corners_of_an_obstacle_are_found(boxed: tuple[Arena, Faces]) -> None:
    graph = Sensorgraph(model=boxed[1], sensor=SENSOR, pose_frame="base_link", origin={})
    found = arena_of(graph)
    assert {name.split("/")[0] for name in found.names} == {"room", "thing_1"}
    corners = found.walls[[name.startswith("thing_1") for name in found.names]].reshape(-1, 2)
    for corner in BOX:
        assert np.hypot(*(corners - corner).T).min() < 0.005  # two faces of 400 hits each: 1 mm
    assert found.free.area == pytest.approx(16 - 0.48, abs=0.5)  # cells of 10 cm
    assert not found.contains(np.array([1.8, 1.9]))


def test_printed_equation_gives_the_predicted_range(boxed: tuple[Arena, Faces]) -> None:
    arena, model = boxed
    ray = 60
    fractions = re.findall(r"r = \((.*?)\) / \((.*?)\)", model.equation(ray))
    assert len(fractions) == model.faces.n_faces
    poses = somewhere(arena, 50, np.random.default_rng(4))
    predicted = model.predict(poses, np.array([ray]), "mode").mode[:, 0]
    for (x, y, phi), wanted in zip(poses, predicted, strict=True):
        names = {"x": x, "y": y, "c": np.cos(phi), "s": np.sin(phi)}
        values = [
            evaluate(above, names) / below
            for above, text in fractions
            if (below := evaluate(text, names)) < 0
        ]
        assert np.abs(np.array(values) - wanted).min() < 2e-3  # printed to five digits


def evaluate(text: str, names: dict[str, float]) -> float:
    """Add up `a - b x + ...` by reading it, without the code that wrote it."""
    total = 0.0
    for sign, value, name in re.findall(r"(^-|[+-] |^)\s*([\d.]+)(?: ([xycs]))?", text):
        total += (-1 if "-" in sign else 1) * float(value) * (names[name] if name else 1.0)
    return total


def test_unseen_side_is_not_answered() -> None:
    arena, rng = room(BOX), np.random.default_rng(5)
    poses = somewhere(arena, 600, rng)
    poses = poses[poses[:, 1] < 1.3]  # all below the box: nobody saw what is above it
    model = Faces.fit(scans_of(arena, poses, rng), calibrate=False)
    above = np.array([[1.8, 3.0, -np.pi / 2]])
    said = model.predict(above, np.arange(30, 61), "mode")
    wrong = np.abs(said.mode - cast(arena, above, SENSOR).ranges[:, 30:61]) > 0.05
    assert wrong.any()
    assert not said.answered[wrong].any()


def test_march_lists_the_crossings_that_all_faces_against_all_rays_give() -> None:
    rng = np.random.default_rng(6)
    k = 40
    angle = rng.uniform(-np.pi, np.pi, k)
    normals = np.column_stack([np.cos(angle), np.sin(angle)])
    middle = rng.uniform(0, 6, (k, 2))
    tangents = np.column_stack([-normals[:, 1], normals[:, 0]])
    centre = (tangents * middle).sum(axis=1)
    half = rng.uniform(0.05, 2.0, k)
    faces = FaceSet(
        normals=normals,
        offsets=(normals * middle).sum(axis=1),
        first=2 * np.arange(k + 1, dtype=np.intp),
        edges=np.stack([centre - half, centre + half], axis=1).ravel(),
        levels=np.tile([0.5, 0.0], k),
        blur=np.zeros(2 * k),
        neighbour=np.full(2 * k, -1, dtype=np.intp),
    )
    buckets = bucket_grid(faces)
    work = new_march()
    r, f, j, _ = work
    march = numba.njit(lambda *arguments: crossed_faces(*arguments))  # only kernels call it
    crossings = 0
    for _ in range(400):
        q, theta = rng.uniform(-1, 7, 2), rng.uniform(-np.pi, np.pi)
        u = np.array([np.cos(theta), np.sin(theta)])
        den = normals @ u
        rho = (faces.offsets - normals @ q) / den
        s = (tangents * (q + rho[:, None] * u)).sum(axis=1)
        seen = np.flatnonzero((den < -1e-6) & (rho > 0) & (rho < 9) & (np.abs(s - centre) < half))
        n = march(q[0], q[1], u[0], u[1], 9.0, 0.0, faces, buckets, work)
        inside = [i for i in range(n) if j[i] == 2 * f[i]]  # not only in the margin
        assert f[inside].tolist() == seen[np.argsort(rho[seen])].tolist()
        np.testing.assert_allclose(r[inside], np.sort(rho[seen]), rtol=1e-12)
        crossings += len(seen)
    assert crossings > 500


def test_faces_too_far_apart_for_the_grid_are_refused_in_one_line() -> None:
    faces = FaceSet(
        normals=np.array([[1.0, 0.0], [0.0, 1.0]]),
        offsets=np.array([1e6, 1e6]),
        first=np.array([0, 2, 4]),
        edges=np.array([0.0, 1.0, 0.0, 1.0]),
        levels=np.array([1.0, 0.0, 1.0, 0.0]),
        blur=np.zeros(4),
        neighbour=np.full(4, -1),
    )
    with pytest.raises(
        SensorgraphError, match="faces lie 1,000,001 x 1,000,000 m apart, expected at most 11 km²"
    ) as caught:
        bucket_grid(faces)
    assert "\n" not in str(caught.value)


def test_pooled_moments_add_up() -> None:
    rng = np.random.default_rng(7)
    points, ways = rng.uniform(-3, 3, (5000, 2)), rng.normal(size=(5000, 2))
    whole = HitMoments.of(points, ways)
    parts = HitMoments.of(points[:1234], ways[:1234]).merge(HitMoments.of(points[1234:], ways[1234:]))
    np.testing.assert_array_equal(whole.cells, parts.cells)
    np.testing.assert_allclose(whole.moments, parts.moments, atol=1e-12)
    assert whole.counts.sum() == 5000
    np.testing.assert_allclose(
        (whole.centres * whole.counts[:, None] + whole.moments[:, 1:3]).sum(axis=0),
        points.sum(axis=0),
        rtol=1e-9,
    )


def test_file_gives_the_same_predictions_and_the_same_bytes(
    boxed: tuple[Arena, Faces], tmp_path: Path
) -> None:
    graph = Sensorgraph(model=boxed[1], sensor=SENSOR, pose_frame="base_link", origin={})
    graph.save(tmp_path / "a.sensorgraph")
    again = Sensorgraph.load(tmp_path / "a.sensorgraph")
    again.save(tmp_path / "b.sensorgraph")
    assert (tmp_path / "a.sensorgraph").read_bytes() == (tmp_path / "b.sensorgraph").read_bytes()
    poses = np.array([[1.0, 1.0, 0.3], [3.0, 2.0, 2.0]])
    np.testing.assert_array_equal(graph.predict(poses).mode, again.predict(poses).mode)


def test_no_returns_and_options_are_refused() -> None:
    scans = TrainingScans(
        sensor=SENSOR,
        poses=np.zeros((20, 3)),
        ranges=np.full((20, SENSOR.n_rays), np.inf),
        run=np.zeros(20, dtype=np.intp),
    )
    with pytest.raises(SensorgraphError, match="no ray of the log returned"):
        Faces.fit(scans)
    with pytest.raises(SensorgraphError, match="degree is not known to the model faces"):
        Faces.fit(scans, degree=3)


def test_chosen_views_show_more_surface_than_random_ones() -> None:
    arena, rng = room(BOX), np.random.default_rng(9)
    candidates = somewhere(arena, 300, rng)

    n = 30
    chosen = choose_views(candidates, LaserSurvey(arena, SENSOR), n)
    assert len(set(chosen.tolist())) == n

    def shown(poses: Floats) -> float:
        """Add up 1 + 1/2 + 1/3 ... of the hits in every 2 cm of surface."""
        theta = poses[:, 2, None] + SENSOR.bearings
        ways = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
        ends = poses[:, None, :2] + cast(arena, poses, SENSOR).ranges[..., None] * ways
        _, hits = np.unique(np.floor(ends.reshape(-1, 2) / 0.02), axis=0, return_counts=True)
        return float(sum((1 / np.arange(1, h + 1)).sum() for h in hits))

    at_random = [shown(candidates[rng.choice(300, n, replace=False)]) for _ in range(40)]
    assert shown(candidates[chosen]) > max(at_random)
