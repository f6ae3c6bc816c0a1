"""A run against a log of the user's own simulator: what differs is told, what both share is not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import polygon_arena

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis import scan_channel
from sensorgraph.diagnosis.report.data import to_dict
from sensorgraph.diagnosis.report.summary import summarise
from sensorgraph.diagnosis.result import counterpart, is_same_size
from sensorgraph.diagnosis.scan.model_selection import Explained
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.simulation import diagnose_against_simulation
from sensorgraph.effects import EFFECTS
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import parse_robot

ROBOT = parse_robot("sensor: {n_rays: 61}")


@pytest.fixture(scope="module")
def room() -> Arena:
    return polygon_arena([(0, 0), (5, 0), (5, 4), (0, 4)], [(1.5, 2.4), (2.1, 2.4), (2.1, 2.9), (1.5, 2.9)])


def scanned(room: Arena, seed: int, *, bias: float = 0.0, yaw: float = 0.0, scatter: float = 0.01) -> Run:
    """Scan along a wavy circle; the laser reads `bias` too long and is turned by `yaw`."""
    rng = np.random.default_rng(seed)
    t = 0.2 * np.arange(80)
    phase = 0.4 * t + seed
    poses = np.column_stack(
        [2.6 + 1.2 * np.cos(phase), 1.5 + 0.6 * np.sin(phase), phase + 1.5 * np.sin(0.9 * t)]
    )
    lasers = laser_poses(poses, ROBOT.sensor.mount) + [0.0, 0.0, yaw]
    ranges, _ = cast_laser(room.walls, lasers, ROBOT.sensor.bearings, ROBOT.sensor.range_max)
    noisy = ranges + bias + scatter * rng.normal(size=ranges.shape)
    return Run(sensor=ROBOT.sensor, stamps=t, ranges=noisy, pose_stamps=t, poses=poses)


@pytest.mark.slow
def test_what_both_show_is_no_difference_and_what_one_shows_is(room: Arena) -> None:
    robot_run = scanned(room, 0, bias=0.04, yaw=0.02)
    simulated = scanned(room, 1, bias=0.04, scatter=0.005)
    options = {"plan_next": False}
    finding = diagnose_against_simulation(robot_run, room, ROBOT, simulation=simulated, name="sim", **options)
    assert [a.name for a in finding.effects] == ["mount_yaw"]
    assert abs(finding.effects[0]["delta"] - 0.02) < 0.003
    assert finding.simulation is not None
    assert [a.name for a in finding.simulation.shared] == ["range_bias"]
    noise = to_dict(finding)["simulation"]["laser"]
    assert noise["robot"]["scatter"] == pytest.approx(0.01, rel=0.15)
    assert noise["simulation"]["scatter"] == pytest.approx(0.005, rel=0.15)
    said = summarise(finding)
    assert "simulation lacks" in said.headline and any("laser scatters by" in text for text in said.details)


def test_what_only_the_simulation_shows_is_said(room: Arena) -> None:
    simulated = scanned(room, 1, bias=0.04)
    finding = diagnose_against_simulation(
        scanned(room, 0), room, ROBOT, simulation=simulated, plan_next=False
    )
    assert not finding.effects and finding.simulation is not None
    assert [a.name for a in finding.simulation.only_in_simulation] == ["range_bias"]
    assert "Only the simulation shows" in summarise(finding).headline


def test_the_run_is_searched_once_though_both_share_an_effect(
    room: Arena, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[int] = []
    explain = scan_channel.explain

    def counted(data: ScanData, *args: Any, **options: Any) -> Explained:
        searched.append(data.n_scans)
        return explain(data, *args, **options)

    monkeypatch.setattr(scan_channel, "explain", counted)
    robot_run, simulated = scanned(room, 0, bias=0.04), scanned(room, 1, bias=0.04)
    finding = diagnose_against_simulation(robot_run, room, ROBOT, simulation=simulated, plan_next=False)
    assert len(searched) == 2  # the simulation, the run
    assert not finding.effects
    assert [a.name for a in finding.shared] == ["range_bias"]
    gap = finding.channels["scan"].gap
    assert gap is not None  # of a simulator that has the bias already
    assert gap.before.normalised == pytest.approx(gap.noise_floor.normalised, rel=0.1)


def test_effects_are_the_same_by_name_place_and_size() -> None:
    bias, wall = EFFECTS["range_bias"], EFFECTS["moved_wall"]
    one = replace(bias(b=0.030), stderr={"b": 0.0003})
    assert is_same_size(one, bias(b=0.034))  # less than its materiality of 5 mm
    assert not is_same_size(one, bias(b=0.036))
    assert is_same_size(replace(one, stderr={"b": 0.01}), bias(b=0.036))  # nobody can tell
    assert counterpart(one, [EFFECTS["range_scale"](s=0.03)]) is None
    here = wall(d=0.05).at("arena/edge_0")
    assert counterpart(here, [wall(d=0.05).at("arena/edge_1")]) is None
    assert counterpart(here, [wall(d=0.02).at("arena/edge_0")]) is not None
    spot = EFFECTS["unmapped_obstacle"]
    assert counterpart(spot(x=1.0, y=1.0, r=0.2), [spot(x=1.1, y=1.0, r=0.2)]) is not None
    assert counterpart(spot(x=1.0, y=1.0, r=0.2), [spot(x=2.0, y=1.0, r=0.2)]) is None
