"""Faces from cones: what is measured is the nearest surface within each, and its equation says so."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

import sensorgraph as sg
from logs.run import RangeSensor, Run
from planners.arena import Arena
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.cones.readings import ConeReadings, Stretch
from sensorgraph.show.review.contents import collect
from sensorgraph.show.review.review import review
from sensorgraph.types import Floats

pytestmark = pytest.mark.usefixtures("trusted_scans")

SIGMA = 0.01
RANGE_MAX = 6.0


def fan(walls: Floats, x: Floats, y: Floats, theta: Floats, half: Floats | float, n: int = 81) -> Floats:
    """Return the nearest of n thin rays in each cone, by Cramer's rule, every ray against every wall; inf for none."""
    best = np.full(np.broadcast(x, theta).shape, np.inf)
    for share in np.linspace(-1, 1, n):
        ux, uy = np.cos(theta + share * half), np.sin(theta + share * half)
        for (ax, ay), (bx, by) in walls:
            dx, dy = bx - ax, by - ay
            with np.errstate(divide="ignore", invalid="ignore"):
                den = ux * dy - uy * dx
                r = ((ax - x) * dy - (ay - y) * dx) / den
                s = ((ax - x) * uy - (ay - y) * ux) / den
            best = np.where((r > 0) & (s >= 0) & (s <= 1), np.minimum(best, r), best)
    return best


def ring(n: int = 8, cone: float = 0.5) -> RangeSensor:
    bearings = -np.pi + 2 * np.pi * np.arange(n) / n
    return RangeSensor(
        bearings=bearings,
        origins=0.15 * np.stack([np.cos(bearings), np.sin(bearings)], axis=1),
        cones=np.full(n, cone),
        range_max=RANGE_MAX,
        sigma=SIGMA,
    )


def truth(arena: Arena, sensor: RangeSensor, poses: Floats) -> Floats:
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x = poses[:, :1] + c * sensor.origins[:, 0] - s * sensor.origins[:, 1]
    y = poses[:, 1:2] + s * sensor.origins[:, 0] + c * sensor.origins[:, 1]
    return fan(arena.walls, x, y, poses[:, 2:] + sensor.bearings, 0.5 * sensor.cones)


def free_poses(arena: Arena, n: int, rng: np.random.Generator) -> Floats:
    """Draw poses with room for the ring."""
    poses = rng.uniform([0.2, 0.2, -np.pi], [3.8, 2.8, np.pi], size=(3 * n, 3))
    beside = (np.abs(poses[:, 0] - 2.75) > 0.45) | (np.abs(poses[:, 1] - 1.25) > 0.45)
    return poses[beside][:n]


def run_of(arena: Arena, sensor: RangeSensor, n: int, seed: int) -> Run:
    rng = np.random.default_rng(seed)
    poses = free_poses(arena, n, rng)
    ranges = truth(arena, sensor, poses) + SIGMA * rng.normal(size=(len(poses), sensor.n_rays))
    stamps = 0.1 * np.arange(len(poses))
    return Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)


@pytest.fixture(scope="module")
def graph(room: Arena) -> sg.Sensorgraph:
    return sg.build(run_of(room, ring(), 1500, 1))


def test_the_range_to_a_stretch_is_the_least_of_a_fan_of_rays() -> None:
    rng = np.random.default_rng(0)
    n = 400
    origins = rng.uniform(-3, 3, (n, 2))
    theta, halves = rng.uniform(-np.pi, np.pi, n), rng.choice([0.0, 0.1, 0.6], n)
    stretch = Stretch(0.7, 0.4, -1.2, 0.9)
    normal = np.array([math.cos(0.7), math.sin(0.7)])
    tangent = np.array([-normal[1], normal[0]])
    ends = 0.4 * normal + np.array([[-1.2], [0.9]]) * tangent
    readings = ConeReadings(
        origins=origins,
        directions=np.stack([np.cos(theta), np.sin(theta)], axis=1),
        halves=halves,
        ranges=np.ones(n),
        range_max=RANGE_MAX,
    )
    got, t = readings.to(stretch)
    want = fan(ends[None], *origins.T, theta, halves, n=801)
    want[origins @ normal < 0.4] = np.inf  # a face is seen from its front
    grazing = np.isfinite(got) & (got > 4 * (origins @ normal - 0.4))
    both = np.isfinite(got) & np.isfinite(want) & ~grazing
    assert both.sum() > 30
    np.testing.assert_allclose(got[both], want[both], rtol=5e-3)  # 801 rays: within 0.05 degrees of the edge
    assert (got[both] <= want[both] + 1e-9).all()
    assert (np.isfinite(got) != np.isfinite(want))[
        ~grazing
    ].mean() < 0.01  # an end between two rays of the fan
    assert (t[both] >= -1.2 - 1e-9).all() and (t[both] <= 0.9 + 1e-9).all()


def test_the_walls_are_found_from_arcs_and_predict_to_the_noise(graph: sg.Sensorgraph, room: Arena) -> None:
    assert graph.model.faces.n_faces == len(room.walls) == 8
    poses = free_poses(room, 300, np.random.default_rng(2))
    want, found = truth(room, graph.sensor, poses), graph.predict(poses)
    off = np.abs(found.mode - want)
    assert np.median(off) < 0.3 * SIGMA  # 12,000 readings of 8 faces
    assert found.answered.mean() > 0.9
    assert (off[found.answered] < 3 * SIGMA).mean() > 0.98
    assert graph.model.noise.sigma == pytest.approx(SIGMA, rel=0.1)
    assert (
        sg.evaluate(graph, run_of(room, graph.sensor, 200, 3)).all["median_m"] < 0.75 * SIGMA
    )  # 0.67 of a normal


def test_what_nobody_looked_into_is_not_answered(graph: sg.Sensorgraph) -> None:
    inside, outside = graph.predict(np.array([[2.75, 1.25, 0.0]])), graph.predict(np.array([[5.5, 1.5, 0.0]]))
    assert not inside.answered.any() and not outside.answered.any()


def test_the_printed_equation_gives_the_predicted_range(graph: sg.Sensorgraph, room: Arena) -> None:
    """The least of sqrt(h^2 + v^2) over the faces, evaluated from the text alone."""
    ray = 5
    text = graph.equation(ray)
    half = float(re.search(r"tan\(a \+ ([\d.]+)\)", text).group(1))  # type: ignore[union-attr]
    faces = re.findall(
        r"face \d+: h = (.*?); f = (.*?); a = phi ([+-]) ([\d.]+)\n\s+low (\S+), high (\S+) \(", text
    )
    assert len(faces) == 8

    def value(of: str, at: dict[str, float]) -> float:
        terms = re.findall(r"([+-]? ?[\d.]+) ?([xycs]?)", of)
        return sum(float(number.replace(" ", "")) * at[symbol] for number, symbol in terms)

    poses = free_poses(room, 80, np.random.default_rng(4))
    printed = np.full(len(poses), np.inf)
    for i, (x, y, phi) in enumerate(poses):
        at = {"": 1.0, "x": x, "y": y, "c": math.cos(phi), "s": math.sin(phi)}
        for h_text, f_text, sign, turn, low_text, high_text in faces:
            h, f = value(h_text, at), value(f_text, at)
            a = math.remainder(phi + float(sign + turn), 2 * math.pi)
            if h <= 0 or abs(a) - half > 1.5:
                continue
            edges = (-h * math.tan(np.clip(a + d, -1.52, 1.52)) for d in (half, -half))
            low, high = next(edges), next(edges)
            low, high = max(low, float(low_text) - f), min(high, float(high_text) - f)
            if low <= high:
                printed[i] = min(printed[i], math.hypot(h, max(low, min(0.0, high))))
    found = graph.predict(poses, rays=[ray])
    sure = found.answered[:, 0] & (found.p_off[:, 0] < 1e-3)
    assert sure.sum() > 30
    np.testing.assert_allclose(
        printed[sure], found.mode[sure, 0], atol=2e-3
    )  # ends are printed to the millimetre


def test_a_graph_of_cones_is_kept_and_is_not_updated(
    graph: sg.Sensorgraph, room: Arena, tmp_path: Path
) -> None:
    graph.save(tmp_path / "ring.sensorgraph")
    again = sg.Sensorgraph.load(tmp_path / "ring.sensorgraph")
    poses = free_poses(room, 20, np.random.default_rng(5))
    np.testing.assert_array_equal(again.predict(poses).ranges, graph.predict(poses).ranges)
    run = run_of(room, ring(), 50, 6)
    with pytest.raises(SensorgraphError, match="cones, which cannot be updated; build it again"):
        sg.build(run, update=graph)
    with pytest.raises(SensorgraphError, match="cells take thin rays: set `model` faces"):
        sg.build(run, model="cells")
    with pytest.raises(SensorgraphError, match="a calibration takes thin rays: leave `calibrate` out"):
        sg.build(run, calibrate=True)


def test_a_distant_alternative_does_not_widen_the_distribution_of_a_cone(
    graph: sg.Sensorgraph, room: Arena
) -> None:
    rng, poses = np.random.default_rng(9), free_poses(room, 400, np.random.default_rng(10))
    exact = truth(room, graph.sensor, poses)
    measured, said = exact + SIGMA * rng.normal(size=exact.shape), graph.predict(poses)
    known = np.isfinite(exact) & said.answered
    below = said.cdf(np.where(known, measured, 0.0))[known]
    assert (np.abs(below - 0.5) < 0.25).mean() == pytest.approx(0.5, abs=0.03)
    assert (np.abs(below - 0.5) < 0.45).mean() == pytest.approx(0.9, abs=0.02)


def test_a_drawn_reading_is_of_the_nearest_surface_in_the_cone(graph: sg.Sensorgraph, room: Arena) -> None:
    poses = free_poses(room, 200, np.random.default_rng(11))
    exact, drawn = truth(room, graph.sensor, poses), graph.sample(poses, seed=3)[0]
    known = np.isfinite(exact) & graph.predict(poses).answered
    assert (np.abs(drawn - exact)[known] > 0.05).mean() < 0.02  # more than half if a cone is a thin ray


def test_a_polynomial_says_that_it_is_of_the_nearest_surface(room: Arena) -> None:
    run = run_of(room, ring(), 300, 7)
    graph = sg.build(run, model="polynomial", degree=2, harmonics=2, n_terms=12)
    assert "the nearest surface in a cone of 28.65 deg" in graph.equation(0)


def test_a_review_draws_arcs_that_touch_a_wall(graph: sg.Sensorgraph, room: Arena, tmp_path: Path) -> None:
    run = run_of(room, ring(), 40, 8)
    exact = dataclasses.replace(run, ranges=truth(room, run.sensor, run.poses))
    seen = collect(exact, graph=graph, arena=room)
    arcs = np.concatenate(seen.arcs(seen.measured))  # (n, points, 2)
    a, d = room.walls[:, 0], np.diff(room.walls, axis=1)[:, 0]
    share = np.clip(((arcs[..., None, :] - a) * d).sum(-1) / (d**2).sum(-1), 0, 1)
    apart = np.hypot(*np.moveaxis(arcs[..., None, :] - a - share[..., None] * d, -1, 0)).min(axis=(1, 2))
    assert (apart < 0.1).all()  # the points of an arc are up to 19 cm apart
    np.testing.assert_allclose(seen.robots, run.poses, atol=1e-9)
    written = review(exact, path=tmp_path / "ring.rrd", graph=graph, arena=room)
    columns = {
        str(c) for c in rr.chunk.RrdReader(str(tmp_path / "ring.rrd")).store().schema().component_columns()
    }
    assert len(written.shown) == 40
    assert any("/plan/right" in c and "LineStrips2D" in c for c in columns)
    assert not any("/plan/right" in c and "Points2D" in c for c in columns)
