"""Rays numbered from 0 to 2 pi, as of an LDS-01, are those numbered from -pi to pi, and keep the index of their log."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_building_sweep import N_RAYS, ROOM, SIGMA, run_of

import logs
from logs.run import RangeSensor, Run
from planners.arena import Arena
from planners.maps import geojson
from sensorgraph.building.build import build
from sensorgraph.cli import run as command
from sensorgraph.diagnosis.scan.depth_edges import find_edges
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.effects import mixed_pixels, sector_bias, self_occlusion, tilt
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.evaluate import evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.world.ray_order import ray_order, with_rays_like
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import Robot, parse_robot

pytestmark = pytest.mark.usefixtures("trusted_scans")

HALF = N_RAYS // 2
ROBOT_TEXT = (
    f"sensor: {{n_rays: {N_RAYS}, fov: 6.283185307179586, range_min: 0.12, range_max: 3.5, sigma: {SIGMA}, rate: 5.0, "
    "mount: [-0.03, 0.0, 0.0], sweep_time: SWEEP}"
)
POSES = np.array([[1.0, 0.8, 0.3], [1.6, 1.2, -2.0]])


def robot(sweep_time: float) -> Robot:
    return parse_robot(ROBOT_TEXT.replace("SWEEP", str(sweep_time)))


def from_zero(run: Run) -> Run:
    """Number the rays of a laser without a sweep from straight ahead, 0 to 2 pi."""
    bearings = run.sensor.bearings[HALF:], run.sensor.bearings[:HALF] + 2 * np.pi
    sensor = replace(run.sensor, bearings=np.concatenate(bearings))
    return replace(run, sensor=sensor, ranges=np.concatenate([run.ranges[:, HALF:], run.ranges[:, :HALF]], 1))


def behind(seed: int) -> Run:
    return run_of(seed, sweep_time=0.0, duration=20.0)


@pytest.fixture(scope="module")
def graph() -> Sensorgraph:
    return build([behind(0)])


def room() -> Arena:
    corners = [list(corner) for corner in [*ROOM, ROOM[0]]]
    geometry = {"type": "Polygon", "coordinates": [corners]}
    properties = {"kind": "arena", "name": "room"}
    return geojson.loads(
        json.dumps(
            {
                "type": "FeatureCollection",
                "features": [{"type": "Feature", "properties": properties, "geometry": geometry}],
            }
        )
    )


def test_order_of_one_ray_and_of_other_counts() -> None:
    assert ray_order(np.array([np.pi]), np.array([-np.pi])) is not None
    assert ray_order(np.zeros(1), np.array([0.1])) is None
    assert ray_order(np.arange(3.0), np.arange(2.0)) is None


def test_nearest_shift_is_taken_where_several_are_within_the_tolerance() -> None:
    step = 2 * np.pi / 360
    late = -np.pi + step * np.arange(1, 361)
    order = ray_order(late - step, late, tolerance=0.02)
    assert order is not None
    np.testing.assert_array_equal(order, np.roll(np.arange(360), -1))


def test_origins_and_cones_go_with_their_rays() -> None:
    bearings = -np.pi + np.pi / 2 * np.arange(4)
    sensor = RangeSensor(bearings=bearings, origins=np.eye(4)[:, :2], cones=0.1 * np.arange(4))
    turned = with_rays_like(sensor, bearings + np.pi)
    assert turned is not None
    np.testing.assert_allclose(turned.bearings, bearings + np.pi)
    np.testing.assert_array_equal(turned.origins, np.roll(sensor.origins, -2, axis=0))
    np.testing.assert_array_equal(turned.cones, np.roll(sensor.cones, -2))


def test_evaluate_leaves_each_ray_at_its_index_in_the_log(graph: Sensorgraph) -> None:
    run = behind(1)
    want, got = evaluate(graph, run), evaluate(graph, from_zero(run))
    np.testing.assert_allclose(got.residual, np.roll(want.residual, -HALF, axis=1), atol=1e-9)
    assert got.all["median_m"] == pytest.approx(want.all["median_m"], abs=1e-9)


def test_evaluate_times_the_rays_of_a_sweep_by_their_index(graph: Sensorgraph) -> None:
    """The sweep starts straight ahead: were time counted from behind, half the rays would be 0.1 s off."""
    still = evaluate(graph, behind(1)).all["median_m"]
    swept = evaluate(graph, run_of(1, duration=20.0, first=0.0)).all["median_m"]
    assert swept < 1.3 * still


def test_runs_of_both_numberings_are_built_together(graph: Sensorgraph) -> None:
    first, second = behind(0), behind(1)
    want = build([first, second], calibrate=False).predict(POSES)
    np.testing.assert_allclose(
        build([first, from_zero(second)], calibrate=False).predict(POSES).ranges, want.ranges, atol=1e-9
    )
    np.testing.assert_allclose(
        build([from_zero(first), second], calibrate=False).predict(POSES).ranges,
        np.roll(want.ranges, -HALF, axis=1),
        atol=1e-6,
    )
    plain, shifted = build([second], update=graph), build([from_zero(second)], update=graph)
    np.testing.assert_allclose(shifted.predict(POSES).ranges, plain.predict(POSES).ranges, atol=1e-9)


def test_diagnosis_compares_with_the_robot_at_the_index_of_the_log() -> None:
    arena = room()
    run = run_of(0, duration=20.0, first=0.0)
    data, _ = prepare_scans(run, arena, robot(0.2))
    np.testing.assert_allclose(data.sensor.bearings, run.sensor.bearings, atol=1e-9)
    assert data.sensor.sweep_time == 0.2
    still = from_zero(behind(0))
    data, _ = prepare_scans(still, arena, robot(0.0))
    ideal = cast(arena, data.poses, data.sensor).ranges
    returned = np.isfinite(data.ranges) & np.isfinite(ideal)
    assert np.median(np.abs(data.ranges - ideal)[returned]) < 2 * SIGMA


def test_other_bearings_are_refused_in_one_line_that_says_both(graph: Sensorgraph) -> None:
    run = behind(1)
    turned = replace(run, sensor=replace(run.sensor, bearings=run.sensor.bearings + 0.03))
    both = r"90 rays from -178\.3° to 177\.7°, expected 90 from -180° to 176°"
    for attempt in (
        lambda: evaluate(graph, turned),
        lambda: build([run, turned]),
        lambda: build([turned], update=graph),
        lambda: prepare_scans(turned, room(), robot(0.0)),
    ):
        with pytest.raises(SensorgraphError, match=both) as caught:
            attempt()
        assert "\n" not in str(caught.value)


def test_commands_say_the_numbering_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, run in (("behind", behind(0)), ("zero", from_zero(behind(1)))):
        logs.write(run, tmp_path / f"{name}.mcap")
    graph, log = str(tmp_path / "room.sensorgraph"), str(tmp_path / "zero.mcap")
    assert command(["build", str(tmp_path / "behind.mcap"), "-o", graph]) == 0
    assert "modulo" not in capsys.readouterr().out
    assert command(["evaluate", graph, log]) == 0
    line = f"{log}: ray 0 points to 0°, that of {graph} to -180°: the same rays modulo 360°; each log keeps its ray"
    assert capsys.readouterr().out.count(line) == 1


def residuals(first: float) -> Any:
    """Residuals of a full turn whose rays from -12° to 16° read 0.3 m, 0.2 m too much of what is expected."""
    bearings = first + 2 * np.pi * np.arange(N_RAYS) / N_RAYS
    odd = (np.degrees(bearings) + 12.5) % 360 < 28.6
    shape = (50, N_RAYS)
    short, every = np.broadcast_to(odd, shape), np.ones(shape, dtype=np.bool_)
    noise = 0.001 * np.random.default_rng(0).normal(size=shape)
    z = np.where(short, 0.3, 2.0)
    return SimpleNamespace(
        sensor=RangeSensor(bearings=bearings), short=short, aimed=every, valid=every, returned=every,
        z=z, mu=np.full(shape, 2.0), residual=0.2 * short + noise, log_p=np.zeros(shape),
        weight=np.full(shape, 1e4), sigma=np.full(shape, 0.01), likely=lambda mu, some: np.where(np.abs(z[some] - mu) < 0.1, 3.0, -3.0),
    )  # fmt: skip


@pytest.mark.parametrize("effect", [self_occlusion, sector_bias], ids=["self_occlusion", "sector_bias"])
@pytest.mark.parametrize("first", [-np.pi, 0.0], ids=["seam behind", "seam ahead"])
def test_a_sector_astride_the_seam_is_one_sector(effect: Any, first: float) -> None:
    (found,) = effect.propose(residuals(first))
    ends = [np.degrees(found.values[name]) for name in ("theta1", "theta2")]
    np.testing.assert_allclose(
        np.exp(1j * np.radians(ends)), np.exp(1j * np.radians([-14.0, 18.0])), atol=1e-6
    )


@pytest.mark.parametrize("first", [-np.pi, 0.0], ids=["seam behind", "seam ahead"])
def test_a_dip_ahead_is_looked_for_ahead_wherever_the_first_ray_points(first: float) -> None:
    """Rays are long ahead only: a tilt shows there."""
    bearings = first + 2 * np.pi * np.arange(N_RAYS) / N_RAYS
    reading = np.broadcast_to(np.where(np.cos(bearings) > 0.5, 8.0, 0.5), (50, N_RAYS))
    exposure: Any = SimpleNamespace(
        sensor=RangeSensor(bearings=bearings, height=0.2), seen=np.isfinite(reading), reading=reading
    )
    assert tilt.unobservable(exposure, {"beta": 0.05}, 10.0) == ""


def test_edges_in_depth_are_the_same_wherever_the_first_ray_points() -> None:
    """Also between the last ray and the first: as many pairs astride the seam as anywhere else."""
    found = []
    for run, machine in ((behind(0), robot(0.0)), (from_zero(behind(0)), robot(0.0))):
        data, _ = prepare_scans(run, room(), machine)
        edges = find_edges(data, data.scene().shoot(), data.arena.walls)
        assert edges is not None
        scan, ray = edges.index
        direction = np.round(np.degrees(data.sensor.bearings[ray]), 3) % 360
        order = np.lexsort((edges.other, direction, scan))
        found.append((scan[order], direction[order], edges.other[order], edges.chance[order]))
    assert len(found[0][0]) > 50
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)
    assert {0.0, 180.0} <= set(found[0][1])  # rays at the seams of both numberings


@pytest.mark.parametrize("first", [-np.pi, 0.0], ids=["seam behind", "seam ahead"])
def test_what_neighbours_tell_does_not_depend_on_the_first_ray(first: float) -> None:
    """Pairs of like strays, and readings between both sides of a step in depth, straight ahead and straight behind."""
    bearings = first + 2 * np.pi * np.arange(N_RAYS) / N_RAYS
    far = np.sin(bearings + 1e-6) > 0  # steps between the rays at 0 and before, and at 180 degrees and before
    mu = np.broadcast_to(np.where(far, 3.0, 1.0), (50, N_RAYS)).copy()
    z, at_step = mu.copy(), np.isin(np.round(np.degrees(bearings)) % 360, (0, 180))
    z[:, at_step] = 2.0
    every = np.ones(z.shape, dtype=np.bool_)
    view: Any = SimpleNamespace(
        sensor=RangeSensor(bearings=bearings, range_max=8.0),
        z=z,
        mu=mu,
        aimed=every,
        returned=every,
        sigma=0.01,
    )
    assert mixed_pixels._between(view) == 100
