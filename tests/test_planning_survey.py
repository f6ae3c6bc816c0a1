"""A survey of what a laser has seen: what is seen adds less, and what a sensorgraph knows hardly counts."""

from __future__ import annotations

import numpy as np
import pytest
from planners_samples import door_arena

import sensorgraph as sg
from sensorgraph.cli.messages import with_flags
from sensorgraph.planning.survey import LaserSurvey, survey_of
from sensorgraph.world.robot import default_robot

POSES = np.array([[1.0, 1.5, 0.0], [1.0, 1.5, np.pi], [3.0, 1.5, 0.0]])


def test_a_scan_that_was_made_adds_less_and_one_in_another_room_as_much() -> None:
    survey = survey_of(door_arena(0.0), default_robot().sensor)
    before = survey.gain(POSES)
    for _ in range(3):
        survey.mark(POSES[:1])
    after = survey.gain(POSES)
    assert after[0] < 0.3 * before[0]
    assert after[2] == before[2]


def test_a_copy_is_marked_alone() -> None:
    survey = survey_of(door_arena(0.0), default_robot().sensor)
    before = survey.gain(POSES)
    survey.copy().mark(POSES)
    np.testing.assert_array_equal(survey.gain(POSES), before)


def test_a_ray_counts_what_it_is_worth() -> None:
    sensor = default_robot().sensor

    def left_only(poses: np.ndarray) -> np.ndarray:
        return np.repeat((poses[:, :1] < 2.0).astype(float), sensor.n_rays, axis=1)

    gain = LaserSurvey(door_arena(0.0), sensor, left_only).gain(POSES)
    assert (gain[:2] > 0).all()
    assert gain[2] == 0


def test_a_graph_and_the_order_fast_contradict_each_other() -> None:
    with pytest.raises(sg.errors.SensorgraphError, match="order anytime") as refused:
        sg.plan("square", order="fast", graph=object.__new__(sg.Sensorgraph))
    assert with_flags(str(refused.value)).startswith(
        "--graph requires the order anytime; use --order anytime"
    )
