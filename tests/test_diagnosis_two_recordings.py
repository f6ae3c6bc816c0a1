"""Two recordings of one place: a graph is built from the first, and a diagnosis of the second says what has changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import polygon_arena

from logs.run import RangeSensor, Run
from planners.arena import Arena
from planners.types import Floats
from sensorgraph.building.build import build
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.graph import Sensorgraph
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.robot import default_robot

HALL = [(0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)]
BOX = [(1.2, 3.4), (1.9, 3.4), (1.9, 3.9), (1.2, 3.9)]
PILLAR = [(4.2, 1.1), (4.6, 1.1), (4.6, 1.5), (4.2, 1.5)]
CRATE = [(4.4, 3.3), (4.7, 3.3), (4.7, 3.6), (4.4, 3.6)]
SENSOR = RangeSensor(bearings=np.linspace(-1.5, 1.5, 91), range_max=8.0, sigma=0.01, resolution=0.001)
ROBOT = replace(default_robot(), sensor=SENSOR)


def moved(ring: list[tuple[float, float]], dx: float, dy: float) -> list[tuple[float, float]]:
    return [(x + dx, y + dy) for x, y in ring]


def nearest(arena: Arena, origins: Floats, angle: Floats) -> Floats:
    """Meet every ray (n_scans, n_rays) with every wall, one wall after the other."""
    best = np.full(angle.shape, np.inf)
    for (ax, ay), (bx, by) in arena.walls:
        normal = np.array([by - ay, ax - bx])
        away = (np.array([ax, ay]) - origins) @ normal  # (n_scans,)
        towards = np.cos(angle) * normal[0] + np.sin(angle) * normal[1]
        with np.errstate(divide="ignore", invalid="ignore"):
            r = away[:, None] / towards
            hit = origins[:, None] + r[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        share = ((hit - [ax, ay]) @ [bx - ax, by - ay]) / ((bx - ax) ** 2 + (by - ay) ** 2)
        best = np.where((r > 0) & (share >= 0) & (share <= 1), np.minimum(best, r), best)
    return best


def scans(arena: Arena, poses: Floats, stamps: Floats, seed: int, *, bias: float = 0.0) -> Run:
    """Scan at exact poses, log them with the reference's noise."""
    rng = np.random.default_rng(seed)
    mount = SENSOR.mount
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    lasers = poses[:, :2] + np.stack(
        [cos * mount[0] - sin * mount[1], sin * mount[0] + cos * mount[1]], axis=1
    )
    exact = nearest(arena, lasers, poses[:, 2:] + mount[2] + SENSOR.bearings)
    said = poses + rng.normal(size=poses.shape) * [0.002, 0.002, 0.0015]
    ranges = np.round(exact + bias + 0.01 * rng.normal(size=exact.shape), 3)
    return Run(sensor=SENSOR, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=said)


@pytest.fixture(scope="module")
def before() -> Sensorgraph:
    """Return a graph of the hall with box and pillar, from 2,500 poses all over it."""
    arena, rng = polygon_arena(HALL, BOX, PILLAR), np.random.default_rng(3)
    poses = rng.uniform([0.25, 0.25, -np.pi], [5.75, 4.75, np.pi], (4000, 3))
    poses = poses[arena.contains(poses[:, :2])][:2500]
    return build([scans(arena, poses, 0.1 * np.arange(len(poses)), 1)])


def later(before: Sensorgraph, arena: Arena, *, bias: float = 0.0) -> Finding:
    """Diagnose a drive through the hall as it is now."""
    t = 0.2 * np.arange(400)
    phase = 0.16 * t
    path = np.stack(
        [3.0 + 1.7 * np.cos(phase), 2.3 + 0.9 * np.sin(phase), phase + 2.5 * np.sin(0.5 * t)], axis=1
    )
    run = scans(arena, path, t, 2, bias=bias)
    return diagnose(run, arena_of(before), ROBOT, plan_next=False)


@pytest.mark.slow
def test_what_changed_since_the_graph_was_built_is_named_with_its_place(before: Sensorgraph) -> None:
    """The box was pushed, the pillar was taken away, a crate was put down, and the laser reads long."""
    found = later(before, polygon_arena(HALL, moved(BOX, 0.06, -0.04), CRATE), bias=0.02)
    by_name = {a.name: a for a in found.effects}
    assert set(by_name) == {"moved_obstacle", "missing_obstacle", "unmapped_obstacle", "range_bias"}
    push = by_name["moved_obstacle"]
    assert np.hypot(push["dx"] - 0.06, push["dy"] + 0.04) < 0.01
    crate = by_name["unmapped_obstacle"]
    assert np.hypot(crate["x"] - 4.55, crate["y"] - 3.45) < 0.08
    assert abs(by_name["range_bias"]["b"] - 0.02) < 0.003


@pytest.mark.slow
def test_a_place_that_has_not_changed_is_silent(before: Sensorgraph) -> None:
    found = later(before, polygon_arena(HALL, BOX, PILLAR))
    assert not found.effects
    assert not found.undecided
    assert all(result.unknown is None for result in found.channels.values())
