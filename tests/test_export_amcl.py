"""Export to Nav2: the map is the arena, and AMCL's parameters from a run hold what was planted, within their intervals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml

from logs.run import Run
from planners.maps import load, no_go
from sensorgraph.exporting import amcl
from sensorgraph.exporting.amcl import (
    DEFAULTS,
    BootstrapEstimate,
    _motion_noise,
    compare_laser_models,
    estimate_amcl,
)
from sensorgraph.exporting.amcl_filter import LASER_MODELS, CellDistances, filtered
from sensorgraph.exporting.export import export
from sensorgraph.exporting.nav2 import amcl_yaml, map_of
from sensorgraph.exporting.world import ExportedWorld
from sensorgraph.loading import load_arena
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.simulate import occupancy_map

ROBOT = parse_robot("sensor: {n_rays: 61, rate: 5.0}\n")


@pytest.fixture(scope="module")
def world() -> ExportedWorld:
    return ExportedWorld.of(load_arena("square"), ROBOT, name="square")


def noisy_run(
    alphas: tuple[float, float, float, float],
    mixture: tuple[float, float, float],
    way: tuple[float, float] = (0.3, 0.4),
) -> Run:
    """Return a run with planted odometry noise (table 5.6) and a planted share of short, lost and random readings."""
    rng = np.random.default_rng(8)
    n, arena = 1500, load_arena("square")
    t = 0.5 * np.arange(n)
    phi, at, odo = 0.0, np.array([1.2, 1.2]), np.zeros(3)
    poses, odometry = [], []
    for _ in range(n):
        first, second = rng.uniform(-0.8, 0.8, 2)
        length = rng.uniform(*way)
        heading = np.arctan2(1.2 - at[1], 1.2 - at[0]) if np.hypot(*(at - 1.2)) > 0.3 else phi + first
        first = float((heading - phi + np.pi) % (2 * np.pi) - np.pi)
        first = float(np.clip(first, -1.0, 1.0))
        second = np.copysign(
            second, first
        )  # each step turns the robot, so that the filter is updated at each
        poses.append([*at, phi])
        odometry.append(odo.copy())
        at = at + length * np.array([np.cos(phi + first), np.sin(phi + first)])
        phi += first + second
        a1, a2, a3, a4 = alphas
        r1 = first + rng.normal() * np.sqrt(a1 * first**2 + a2 * length**2)
        d = length + rng.normal() * np.sqrt(a3 * length**2 + a4 * (first**2 + second**2))
        r2 = second + rng.normal() * np.sqrt(a1 * second**2 + a2 * length**2)
        odo = odo + [d * np.cos(odo[2] + r1), d * np.sin(odo[2] + r1), r1 + r2]
    truth = np.array(poses)
    ranges = cast(arena, truth, ROBOT.sensor).ranges
    ranges = ranges + 0.01 * rng.normal(size=ranges.shape)
    kind = rng.random(ranges.shape)
    short, lost, stray = mixture
    ranges = np.where(kind < short, rng.random(ranges.shape) * ranges, ranges)
    ranges = np.where((kind >= short) & (kind < short + lost), np.inf, ranges)
    uniform = rng.random(ranges.shape) * ROBOT.sensor.range_max
    ranges = np.where((kind >= short + lost) & (kind < short + lost + stray), uniform, ranges)
    return Run(
        sensor=ROBOT.sensor, stamps=t, ranges=ranges, pose_stamps=t, poses=truth, odom_stamps=t,
        odometry=np.array(odometry), odom_twists=np.zeros((n, 2)),
    )  # fmt: skip


def test_amcl_finds_the_planted_noise_of_odometry_and_laser() -> None:
    alphas, mixture = (0.01, 0.004, 0.02, 0.002), (0.0, 0.06, 0.04)
    arena = load_arena("square")
    found = estimate_amcl(noisy_run(alphas, mixture), arena, occupancy_map(arena))
    for name, planted in zip(("alpha1", "alpha2", "alpha3", "alpha4"), alphas, strict=True):
        wide = found[name].high - found[name].low
        assert found[name].low - wide / 2 <= planted <= found[name].high + wide / 2, name
        assert wide < 2 * planted + 1e-3
    assert found["z_max"].value == pytest.approx(0.06, abs=0.006)
    assert found["z_rand"].value + found["z_short"].value == pytest.approx(0.04, abs=0.008)
    assert found["z_hit"].value == pytest.approx(0.90, abs=0.01)
    assert 0.05 / np.sqrt(12) < found["sigma_hit"].value < 0.06  # anywhere in a cell, and the laser's noise
    assert found["laser_max_range"].value == ROBOT.sensor.range_max


def test_noise_of_the_reference_on_short_ways_is_no_noise_of_the_wheels() -> None:
    """The direction of a short way is noise: the two turns are wrong by the same, and cancel."""
    alphas = (0.01, 0.004, 0.02, 0.002)
    run = noisy_run(alphas, (0.0, 0.0, 0.0), way=(0.02, 0.06))
    noise = np.random.default_rng(1).normal(size=run.poses.shape) * [0.005, 0.005, 0.001]
    found = _motion_noise(replace(run, poses=run.poses + noise))
    assert found["alpha1"].value == pytest.approx(alphas[0], rel=0.4)


KNOWN = {
    **DEFAULTS, "alpha1": 0.01, "alpha2": 0.004, "alpha3": 0.02, "alpha4": 0.002,
    "sigma_hit": 0.04, "z_hit": 0.95, "z_rand": 0.05, "laser_max_range": ROBOT.sensor.range_max,
}  # fmt: skip


def test_the_product_of_likelihoods_is_chosen_where_it_follows_the_run_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In the room's own map it does; where readings have nothing to do with it, Nav2's default is left."""
    monkeypatch.setattr(amcl, "N_BLOCKS", 10)
    monkeypatch.setattr(amcl, "N_PARTICLES", 200)
    run, grid = noisy_run((0.01, 0.004, 0.02, 0.002), (0.0, 0.02, 0.02)), map_of(load_arena("square"))
    found = compare_laser_models(run, grid, KNOWN)
    assert found is not None and found.name == "likelihood_field_prob"
    assert found.product_error.high < found.default_error.low
    assert "cm" in str(found) and "Nav2's default is likelihood_field" in str(found)
    strange = replace(run, ranges=np.random.default_rng(0).permuted(run.ranges, axis=1))
    left = compare_laser_models(strange, grid, KNOWN)
    assert left is not None and left.name == "likelihood_field"
    none = {"odom_stamps": np.zeros(0), "odometry": np.zeros((0, 3)), "odom_twists": np.zeros((0, 2))}
    assert compare_laser_models(replace(run, **none), grid, KNOWN) is None


def test_a_filter_in_the_right_map_follows_and_nav2s_weights_are_flat() -> None:
    arena = load_arena("square")
    run, field = (
        noisy_run((0.01, 0.004, 0.02, 0.002), (0.0, 0.0, 0.0)),
        CellDistances.of(occupancy_map(arena)),
    )
    errors = {}
    for model in LASER_MODELS:
        poses = filtered(
            run.odometry[:150], run.ranges[:150], run.sensor, run.poses[0], field, KNOWN,
            rng=np.random.default_rng(1), laser_model=model, n_particles=300,
        )  # fmt: skip
        errors[model] = np.nanmedian(np.hypot(*(poses - run.poses[:150])[:, :2].T))
        assert np.isfinite(poses[:, 0]).sum() > 140
    assert errors["likelihood_field_prob"] < 0.04 < errors["likelihood_field"] < 0.25


def test_the_map_ends_near_the_walls_and_keeps_its_cells() -> None:
    """The free space of a graph goes as far as the laser where nothing stops it: 200 m made cells of 10 cm."""
    square = load_arena("square")
    wide = replace(square, free=square.free.union(shapely.box(-100, -100, 100, 100)))
    grid = map_of(wide)
    ends = square.walls.reshape(-1, 2)
    assert grid.resolution == 0.05
    assert grid.data.shape[1] * 0.05 == pytest.approx(np.ptp(ends[:, 0]) + 20, abs=0.5)
    assert (grid.data == 100).any()


def test_nav2_map_is_read_back_as_the_arena(world: ExportedWorld, tmp_path: Path) -> None:
    zone = no_go.zones("2.9,0.2,3.4,0.2,3.4,0.7,2.9,0.7")
    export(world, "nav2", tmp_path, no_go=zone)
    again = load(tmp_path / "map.yaml")
    ring = again.free.symmetric_difference(world.arena.free)
    assert ring.area < 0.06 * world.arena.free.length  # a cell along every wall
    mask = load(tmp_path / "keepout.yaml")
    assert not mask.contains(np.array([3.1, 0.4]))
    assert mask.contains(np.array([1.2, 1.2]))
    steps = (tmp_path / "README.md").read_text()
    assert steps.index("nav2_amcl amcl") < steps.index(
        "ros2 lifecycle set"
    )  # until then Nav2's nodes do nothing
    assert "recorded here" not in steps  # a map records no run
    parameters = yaml.safe_load((tmp_path / "amcl.yaml").read_text())["amcl"]["ros__parameters"]
    assert parameters["alpha1"] == 0.2 and parameters["z_hit"] == 0.5  # without a run, Nav2's defaults


def test_numbers_of_amcl_are_floats(world: ExportedWorld) -> None:
    """ROS 2 refuses `laser_max_range: 100`, because the parameter is a double."""
    estimates = {
        "z_max": BootstrapEstimate(value=0.0, low=0.0, high=0.0),
        "laser_max_range": BootstrapEstimate(value=8.0, low=8.0, high=8.0),
        "alpha3": BootstrapEstimate(value=1e-5, low=0.0, high=2e-5),
    }
    for found in ({}, estimates):
        parameters = yaml.safe_load(amcl_yaml(found, None, world))["amcl"]["ros__parameters"]
        numbers = {key: value for key, value in parameters.items() if key in DEFAULTS} | parameters[
            "initial_pose"
        ]
        assert {key for key, value in numbers.items() if not isinstance(value, float)} == set()
        assert numbers.keys() >= DEFAULTS.keys() and isinstance(parameters["laser_min_range"], float)
