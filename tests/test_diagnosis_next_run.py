"""Laws of the next run: it can be driven, it is the same again, and it brings more than driving at random."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import further, polygon_arena

from planners.arena import Arena
from planners.check import check
from planners.errors import PlanError
from planners.trajectory import read_csv
from sensorgraph.diagnosis.next_run.design import NextRun, next_run
from sensorgraph.diagnosis.next_run.drives import DrivableSpace, random_drive
from sensorgraph.diagnosis.next_run.forecast import (
    EvidenceForecast,
    MotionSamples,
    OpenQuestion,
    planned_scans,
)
from sensorgraph.diagnosis.next_run.questions import RoomExposure, between, open_questions, typical_effect
from sensorgraph.diagnosis.result import ChannelResult, Rival
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import Robot, default_robot
from tests.effects_samples import arena as sample_arena

MINUTES = 0.7


def effect(name: str, place: str = "", **values: float) -> Amendment:
    return EFFECTS[name](**values).at(place) if place else EFFECTS[name](**values)


QUESTIONS: dict[str, OpenQuestion] = {
    q.text: q
    for q in (
        between([effect("latency", tau=0.015)], [effect("mount_xy", dx=0.0, dy=0.0)]),
        between([effect("latency", tau=0.015)], [effect("scan_skew", T=0.03)]),
        between([effect("range_bias", b=0.015)], [effect("range_scale", s=0.004)]),
        between([effect("range_drift", b1=0.02, tau=0.0)], [effect("range_bias", b=0.01)]),
        between([effect("moved_wall", "room/edge_1", d=0.03)], [effect("range_bias", b=0.004)]),
        between([effect("black_surface", "room/edge_1", a=1.0, b=4.0, r0=1.5)], [effect("max_range", R=4.0)]),
    )
}

LATENCY = "latency between pose and scan or mounting offset"
DRIFT, WALL = "range drift or range bias", "moved wall at room/edge_1 or range bias"
SHOWN = (LATENCY, DRIFT, WALL)
"""Answered by motion, by the way through the whole run (few drives beat random ones), and at a place."""
each_question = pytest.mark.parametrize(
    "words", [*SHOWN, *further(*(words for words in QUESTIONS if words not in SHOWN))]
)


@pytest.fixture(scope="module")
def arena() -> Arena:
    return sample_arena()


@pytest.fixture(scope="module")
def robot() -> Robot:
    return default_robot()


@cache
def chosen(words: str) -> NextRun:
    """Return the run for one question."""
    return next_run([QUESTIONS[words]], sample_arena(), default_robot(), seed=3, minutes=MINUTES)


@each_question
def test_the_run_keeps_the_limits_of_the_robot_and_clear_of_walls(
    words: str, arena: Arena, robot: Robot
) -> None:
    found = check(chosen(words).trajectory, arena, robot)
    assert found.count == 0
    assert found.min_clearance >= robot.footprint_radius


@each_question
def test_the_run_is_expected_to_bring_more_than_random_driving(words: str) -> None:
    run = chosen(words)
    assert run.evidence >= run.median_random_evidence > 0


@each_question
def test_the_run_takes_about_the_time_it_was_given(words: str) -> None:
    assert 0.7 < chosen(words).trajectory.duration / (60 * MINUTES) < 1.06


@each_question
def test_the_reason_is_given_in_sentences_and_places_have_a_unit(words: str) -> None:
    why = chosen(words).why
    assert why.startswith("The robot ") and f"Question: {words}?" in why and why.endswith(".")
    places = re.findall(r"\(\d+\.\d, \d+\.\d\)(..)", why)
    assert places and set(places) == {" m"}


def test_same_seed_same_trajectory(arena: Arena, robot: Robot) -> None:
    one, other = chosen(LATENCY), next_run([QUESTIONS[LATENCY]], arena, robot, seed=3, minutes=MINUTES)
    assert np.array_equal(one.trajectory.poses, other.trajectory.poses)
    assert one.to_dict() == other.to_dict()


def test_a_question_of_latency_is_answered_by_motion() -> None:
    busy = np.abs(chosen(LATENCY).trajectory.twists) / [0.4, 1.0]  # of the limits
    assert busy.max(axis=1).mean() > 0.5


def test_standing_still_brings_nothing_for_latency_and_driving_does(arena: Arena, robot: Robot) -> None:
    question = OpenQuestion(truth=(effect("latency", tau=0.015),), alternative=(), text="")
    poses = np.tile([2.0, 2.0, 0.3], (10, 1))
    when = np.linspace(0.0, 60.0, 10)
    still, turning = (
        MotionSamples(poses=poses, twists=np.tile([0.0, omega], (10, 1)), times=when, duration=60.0)
        for omega in (0.0, 1.0)
    )
    forecast = EvidenceForecast(question, planned_scans([still, turning], arena, robot, 60.0))
    nothing, much = forecast.nats()
    assert nothing < 1e-6 < 100.0 < much


def test_evidence_grows_with_the_size_of_the_effect_and_with_time(arena: Arena, robot: Robot) -> None:
    motion = MotionSamples(
        poses=np.tile([2.0, 2.0, 0.3], (10, 1)),
        twists=np.tile([0.0, 1.0], (10, 1)),
        times=np.linspace(0.0, 60.0, 10),
        duration=60.0,
    )
    got = []
    for tau in (0.01, 0.02):
        question = OpenQuestion(truth=(effect("latency", tau=tau),), alternative=(), text="")
        both = planned_scans([motion, replace(motion, duration=120.0)], arena, robot, 60.0)
        once, twice = EvidenceForecast(question, both).nats()
        assert twice > once
        got.append(once)
    assert got[1] > 3 * got[0]  # at least quadratic: nuisances in their boxes take a constant part


@pytest.mark.usefixtures("no_pictures")
def test_a_folder_is_written_that_record_can_drive(tmp_path: Path, arena: Arena, robot: Robot) -> None:
    run = chosen(LATENCY)
    run.save(tmp_path / "next_run", arena, robot)
    again = read_csv(tmp_path / "next_run" / "trajectory.csv")
    assert np.allclose(again.poses[:, :2], run.trajectory.poses[:, :2], atol=1e-6)  # six decimals
    facts = json.loads((tmp_path / "next_run" / "plan.json").read_text())
    assert facts["planner"] == "next_run"
    assert facts["expected_nats"] == run.evidence


def test_the_rival_is_asked_about_first(arena: Arena) -> None:
    own, other = effect("latency", tau=0.02), effect("mount_xy", dx=0.01, dy=0.0)
    rival = Rival(name="mount_xy", instead_of="latency", evidence_nats=20.0, separates="")
    result = ChannelResult(
        channel="scan", effects=(own,), rivals=(rival,), not_observable={"min_range": "too far"}
    )
    (question,) = open_questions(result, [own], [other])
    assert question.text == "latency between pose and scan or mounting offset"


def test_a_rival_far_behind_is_asked_about_no_more() -> None:
    own, other = effect("latency", tau=0.02), effect("mount_xy", dx=0.01, dy=0.0)
    sure = replace(own, evidence=900.0)
    rival = Rival(name="mount_xy", instead_of="latency", evidence_nats=20.0, separates="")
    hidden = {"mirror": "box/edge_2: hardly met by a ray", "min_range": "no return from nearer than 0.40 m"}
    result = ChannelResult(channel="scan", effects=(sure,), rivals=(rival,), not_observable=hidden)
    assert [q.truth[-1].name for q in open_questions(result, [own], [other])] == ["min_range"]
    result = replace(
        result, not_observable={"mirror": hidden["mirror"]}
    )  # a little wall is little to ask for
    assert open_questions(result, [own], [other])[0].text.startswith("what is the size of the latency")
    near = replace(result, effects=(replace(own, evidence=40.0),))
    assert open_questions(near, [own], [other])[0].text == "latency between pose and scan or mounting offset"


def test_without_a_rival_what_was_not_observable_is_asked_for() -> None:
    hidden = {"glass": "room/edge_2, room/edge_3: hardly met", "latency": "the robot stood still"}
    (question,) = open_questions(ChannelResult(channel="scan", not_observable=hidden), [], [])
    assert question.truth[-1].name == "latency"
    del hidden["latency"]
    (question,) = open_questions(ChannelResult(channel="scan", not_observable=hidden), [], [])
    assert (question.truth[-1].name, question.truth[-1].place) == ("glass", "room/edge_2")


def test_what_no_drive_in_the_room_can_show_is_not_asked_for() -> None:
    """A plane that dips by 3 degrees meets the floor at 5.7 m, which a room of 4 m never shows."""
    hidden = {"tilt": "few rays ahead exceed 5.7 m", "min_range": "no return from nearer than 0.40 m"}
    result = ChannelResult(channel="scan", not_observable=hidden)
    for side, names in ((4.0, ["min_range"]), (20.0, ["tilt", "min_range"])):
        square = polygon_arena([(0, 0), (side, 0), (side, side), (0, side)])
        room = RoomExposure(square, default_robot())
        assert [q.truth[-1].name for q in open_questions(result, [], [], room.can_show)] == names


def test_there_is_always_a_question() -> None:
    assert open_questions(ChannelResult(channel="scan"), [], [])
    assert (
        open_questions(ChannelResult(channel="scan"), [effect("range_bias", b=0.02)], [])[0].text
        == "what is the size of the range bias"
    )


@pytest.mark.parametrize("name", [e.name for e in EFFECTS.values() if e.channel == "scan"])
def test_a_typical_effect_can_be_simulated(name: str) -> None:
    from tests.effects_samples import scene

    why = {"wall": "room/edge_1: unseen", "obstacle": "box: unseen"}.get(EFFECTS[name].place or "", "")
    found = typical_effect(name, why)
    if found is not None:
        scene(box=True).run([found])


def test_a_car_is_refused_in_one_line(arena: Arena) -> None:
    from planners.vehicle import Limits

    robot = default_robot()
    car = replace(robot, drive="dubins", limits=Limits(turning_radius=0.5))
    with pytest.raises(PlanError, match="turn in place"):
        next_run([QUESTIONS["latency between pose and scan or mounting offset"]], arena, car)


def test_random_runs_keep_clear_too(arena: Arena, robot: Robot) -> None:
    space = DrivableSpace.of(arena, robot)
    curve = random_drive(space, np.random.default_rng(1), 60.0)
    assert check(curve.trajectory(), arena, robot).count == 0
