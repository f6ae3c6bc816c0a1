"""Faces that longer ones explain are removed; small real surfaces beside a wall stay."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import polygon_arena

from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.faces.change_points import Crossings
from sensorgraph.models.faces.corners import has_length, join_corners
from sensorgraph.models.faces.equations import _visible_stretches
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.stops import stop_shares
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast

SENSOR = RangeSensor(bearings=np.radians(np.arange(-90.0, 91.0, 2.0)), range_min=0.02, range_max=20.0)
LAB = polygon_arena(
    [(0, 0), (4, 0), (4, 2), (2.5, 2), (2.5, 3), (0, 3)], [(1, 1), (1.8, 1), (1.8, 1.5), (1, 1.5)]
)


def fitted(arena: Arena, n: int, seed: int) -> Faces:
    """Return faces fitted to n scans with a noise of 1 cm, from poses spread over the arena."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform([0.2, 0.2, -np.pi], [3.8, 2.8, np.pi], (3 * n, 3))
    inside = arena.contains(poses[:, :2])
    poses = poses[inside][:n]
    ranges = cast(arena, poses, SENSOR).ranges
    ranges = ranges + 0.01 * rng.normal(size=ranges.shape)
    scans = TrainingScans(sensor=SENSOR, poses=poses, ranges=ranges, run=np.zeros(len(poses), dtype=np.intp))
    return Faces.fit(scans, calibrate=False)


@pytest.fixture(scope="module")
def lab() -> Faces:
    return fitted(LAB, 1500, 1)


def test_lab_of_ten_walls_has_ten_faces(lab: Faces) -> None:
    assert lab.faces.n_faces == 10  # 14 with faces across the corners
    lengths = np.diff(lab.faces.edges)[lab.faces.levels[:-1] > 0.5]
    assert lengths.sum() == pytest.approx(14.0 + 2.6, abs=0.1)  # the outline and the table


def test_pilaster_within_the_noise_of_its_wall_stays() -> None:
    deep = 0.03  # three standard deviations of a return
    outline = [(0, 0), (1.5, 0), (1.5, deep), (2.0, deep), (2.0, 0), (4, 0), (4, 3), (0, 3)]
    model = fitted(polygon_arena(outline), 400, 2)
    poses = np.array([[x, 1.5, -np.pi / 2] for x in np.linspace(1.55, 1.95, 9)])
    ahead = model.predict(poses, np.array([45]), "mode").mode[:, 0]
    assert ahead == pytest.approx(np.full(9, 1.5 - deep), abs=0.005)


def test_stretch_between_two_edges_at_one_corner_is_merged() -> None:
    """Face 0 lies along y = 0 from x = 0 to 1; its stretch from 1 to 1.01, little visible, ends at the corner with face 1."""
    faces = FaceSet(
        normals=np.array([[0.0, 1.0], [-1.0, 0.0]]),
        offsets=np.array([0.0, -1.0]),
        first=np.array([0, 3, 5]),
        edges=np.array([-1.01, -1.0, 0.0, -1.0, 0.0]),
        levels=np.array([0.05, 1.0, 0.0, 1.0, 0.0]),
        blur=np.full(5, 1e-3),
        neighbour=np.full(5, -1),
    )
    none = Crossings(*(np.zeros(0) for _ in range(4)), np.zeros(3, dtype=np.intp))
    joined = join_corners(faces._replace(edges=np.array([-1.0, -1.0, 0.0, -1.0, 0.0])), none)
    assert joined.first.tolist() == [0, 2, 4]
    assert joined.levels.tolist() == [1.0, 0.0, 1.0, 0.0]
    assert joined.edges == pytest.approx([-1.0, 0.0, -1.0, 0.0])
    assert has_length(joined).all()
    assert not has_length(faces._replace(edges=np.array([-1.0, -1.0, -1.0, -1.0, 0.0])))[0]


def test_a_stretch_thinner_than_its_printed_digits_is_left_out() -> None:
    faces = FaceSet(
        normals=np.array([[0.0, 1.0]]),
        offsets=np.zeros(1),
        first=np.array([0, 3]),
        edges=np.array([-1.0, -2e-4, -1e-4]),
        levels=np.array([1.0, 0.95, 0.0]),
        blur=np.full(3, 1e-3),
        neighbour=np.full(3, -1),
    )
    _, along = _visible_stretches(faces, 0, np.array([0.2, 0.1, 0.0]), -1.0)
    assert along == "    stops it where -1.000 < t < 0.000 (probability 1.000); t = -1.00000 x_hit"


def test_shares_of_poses_are_those_of_counted_rays(lab: Faces) -> None:
    rng = np.random.default_rng(7)
    poses = rng.uniform([0.0, 0.0, -np.pi], [4.0, 3.0, np.pi], (6000, 3))
    table = (poses[:, 0] > 1) & (poses[:, 0] < 1.8) & (poses[:, 1] > 1) & (poses[:, 1] < 1.5)
    inside = ~table & ((poses[:, 0] < 2.5) | (poses[:, 1] < 2))
    hits = hit_points(poses[inside], LAB)
    shares = stop_shares(lab.faces, lab.observed, np.zeros(3), 0.0, SENSOR.range_max)
    of_faces = np.add.reduceat(shares, lab.faces.first[:-1])
    assert of_faces.sum() == pytest.approx(1.0, abs=0.01)
    south = int(np.argmin(np.abs(lab.faces.normals - [0, 1]).sum(axis=1) + np.abs(lab.faces.offsets)))
    counted = (np.abs(hits[:, 1]) < 1e-6).mean()
    assert of_faces[south] == pytest.approx(counted, abs=0.02)  # 4,000 rays: 0.7 %; cells of 10 cm


def test_equations_begin_with_the_faces_that_matter(lab: Faces) -> None:
    text = lab.equation(30)
    shares = [float(share) for share in re.findall(r"stops it at ([\d.]+) % of poses", text)]
    assert len(shares) == lab.faces.n_faces
    assert shares == sorted(shares, reverse=True)
    short = lab.equation(30, every=False)
    shown = [float(share) for share in re.findall(r"stops it at ([\d.]+) % of poses", short)]
    assert shown == [share for share in shares if share >= 1.0]
    for low, high in re.findall(r"([-\d.]+) < t < ([-\d.]+)", short):
        assert float(high) - float(low) > 1e-3


def hit_points(poses: Floats, arena: Arena) -> Floats:
    """Return the end points (n, 2) of rays straight ahead."""
    ahead = replace(SENSOR, bearings=np.zeros(1))
    ranges = cast(arena, poses, ahead).ranges[:, :1]
    return poses[:, :2] + ranges * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
