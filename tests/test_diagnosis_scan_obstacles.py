"""An obstacle moved by centimetres is found by its silhouette, where no ray has met the side that would tell."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import polygon_arena
from scan_samples import drive

from logs.run import Run
from planners.arena import Arena, wrap
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS, Amendment, moved_obstacle
from sensorgraph.effects.proposals import PROPOSAL, strangest_obstacles
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.scene import Scene, draw_readings

ROBOT = parse_robot("sensor: {n_rays: 181}")


@pytest.fixture(scope="module")
def hall() -> Arena:
    """Return a 6 x 5 m hall; before its east wall stands a box, whose west side alone is met head-on."""
    room = [(0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)]
    box = [(4.0, 2.3), (4.6, 2.3), (4.6, 2.8), (4.0, 2.8)]
    names = tuple(f"{feature}/edge_{i}" for feature in ("room", "box") for i in range(4))
    return replace(polygon_arena(room, box), names=names)


def to_and_fro(hall: Arena, effects: tuple[Amendment, ...] = (), seed: int = 0) -> Run:
    """Drive along x towards the box and back, within what the box's north and south sides look along."""
    rng, t = np.random.default_rng(seed), 0.2 * np.arange(150)
    poses = np.column_stack(
        [1.8 + 1.2 * np.sin(0.4 * t), 2.55 + 0.2 * np.sin(0.9 * t), 0.3 * np.sin(1.3 * t)]
    )
    scene = Scene(
        arena=hall,
        sensor=ROBOT.sensor,
        stamps=t,
        motion=lambda times: np.stack([np.interp(times, t, c) for c in poses.T], axis=-1),
        span=float(t[-1]),
    )
    scene.run(effects)
    reference = poses + rng.normal(size=poses.shape) * [0.002, 0.002, 0.001]
    return Run(
        sensor=ROBOT.sensor,
        stamps=t,
        ranges=draw_readings(scene, rng),
        pose_stamps=t,
        poses=np.column_stack([reference[:, :2], wrap(reference[:, 2])]),
    )


def bare(hall: Arena, run: Run) -> tuple[ScanData, Fitted]:
    data = prepare_scans(run, hall, ROBOT)[0]
    return data, fit(data, (), start_state(data, NoiseBounds()), NoiseBounds())


def moved(dx: float, dy: float) -> Amendment:
    return EFFECTS["moved_obstacle"](dx=dx, dy=dy).at("box", np.array([4.3, 2.55]))


@pytest.mark.parametrize("dy", [0.04, -0.03])
def test_a_small_move_across_the_view_is_proposed_where_it_went(hall: Arena, dy: float) -> None:
    """Along the view the box's west side tells, and the freedom of the map takes that up to first order."""
    (found,) = moved_obstacle.nudged(FitResiduals(*bare(hall, to_and_fro(hall, (moved(0.0, dy),)))))
    assert found.values["dx"] == pytest.approx(0.0, abs=0.005)
    assert found.values["dy"] == pytest.approx(dy, abs=0.008)
    assert found.gain > 20


def test_a_move_along_the_one_side_that_was_seen_is_proposed() -> None:
    """A wedge of which the long slanted side alone was met: its readings stay, rays pass where its corner was."""
    room = [(0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)]
    wedge = [(4.0, 1.6), (4.9, 2.5), (4.4, 3.3)]
    names = tuple(f"{f}/edge_{i}" for f, n in (("room", 4), ("wedge", 3)) for i in range(n))
    arena = replace(polygon_arena(room, wedge), names=names)
    side = np.array([0.4, 1.7]) / np.hypot(0.4, 1.7)
    step = -0.035 * side
    there = EFFECTS["moved_obstacle"](dx=step[0], dy=step[1]).at("wedge", np.array([4.4, 2.5]))
    (found,) = moved_obstacle.nudged(FitResiduals(*bare(arena, to_and_fro(arena, (there,)))))
    assert np.hypot(found.values["dx"] - step[0], found.values["dy"] - step[1]) < 0.012


def test_of_a_box_that_stands_where_the_map_has_it_nothing_is_proposed(hall: Arena) -> None:
    assert moved_obstacle.nudged(FitResiduals(*bare(hall, to_and_fro(hall)))) == []


@pytest.mark.slow
def test_a_move_across_the_view_gets_its_name_and_an_error_from_the_silhouette(hall: Arena) -> None:
    finding = diagnose(to_and_fro(hall, (moved(0.0, 0.04),)), hall, ROBOT, plan_next=False)
    (named,) = finding.effects
    assert named.name == "moved_obstacle"
    assert 0.002 < named.stderr["dy"] < 0.02
    assert abs(named["dy"] - 0.04) < 3 * named.stderr["dy"]


@pytest.mark.parametrize(("dx", "dy", "names"), [(0.013, 0.005, []), (0.045, 0.02, ["moved_obstacle"])])
def test_the_tolerance_of_the_map_holds_for_an_obstacle_as_a_whole(
    dx: float, dy: float, names: list[str]
) -> None:
    """A round pillar has many corners; one error of its place shifts all of them."""
    angle = 2 * np.pi * np.arange(24) / 24
    ring = [(3.0 + 0.3 * np.cos(a), 2.3 + 0.3 * np.sin(a)) for a in angle]
    arena = polygon_arena([(0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)], ring)
    arena = replace(
        arena, names=tuple(f"{f}/edge_{i}" for f, n in (("room", 4), ("pillar", 24)) for i in range(n))
    )
    robot = parse_robot("{sensor: {n_rays: 61}, tolerances: {map: 0.006}}")
    there = EFFECTS["moved_obstacle"](dx=dx, dy=dy).at("pillar", np.array([3.0, 2.3]))
    finding = diagnose(drive(arena, (there,), n=400), arena, robot, plan_next=False)
    assert [a.name for a in finding.effects] == names and finding.unknown is None
    for named in finding.effects:
        assert (
            abs(named["dx"] - dx) < 3 * named.stderr["dx"] and abs(named["dy"] - dy) < 3 * named.stderr["dy"]
        )


def test_a_move_is_looked_for_where_most_rays_are_strange() -> None:
    """A building has hundreds of things; each move that is tried is cast."""
    n = 30
    names = ("room/edge_0", *(f"thing_{k}/edge_0" for k in range(n)))
    wall = np.repeat(np.arange(n + 1), np.arange(n + 1) + 1)[None]  # thing k is met by k + 2 rays
    residuals = SimpleNamespace(
        arena=SimpleNamespace(names=names),
        model=(EFFECTS["moved_obstacle"](dx=0.1, dy=0.0).at(f"thing_{n - 1}"),),
        walls=np.zeros((n + 1, 2, 2)),
        beams=SimpleNamespace(wall=wall),
        strange=np.ones(wall.shape, dtype=np.bool_),
    )
    found = strangest_obstacles(residuals)  # type: ignore[arg-type]
    assert found == [f"thing_{n - 2 - k}" for k in range(PROPOSAL.max_obstacles)]


@pytest.mark.slow
def test_what_bulges_from_a_wall_is_no_round_thing_that_stands_there(hall: Arena) -> None:
    inside, before = (
        diagnose(
            to_and_fro(hall, (EFFECTS["unmapped_obstacle"](x=3.0, y=y, r=0.3),)), hall, ROBOT, plan_next=False
        )
        for y in (5.12, 4.5)
    )
    assert [a.name for a in before.effects] == ["unmapped_obstacle"] and before.unknown is None
    assert inside.effects == ()
    assert inside.unknown is not None and "in front of room/edge_2" in inside.unknown.statement
