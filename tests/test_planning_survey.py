"""A survey of what a laser has seen: what is seen adds less, and what a sensorgraph knows hardly counts."""

from __future__ import annotations

import numpy as np
import pytest
from planners_samples import door_arena

import sensorgraph as sg
from sensorgraph.cli.messages import with_flags
from sensorgraph.planning.plan import laser_outside_footprint
from sensorgraph.planning.survey import LaserSurvey, survey_of
from sensorgraph.world.robot import default_robot, load_robot, parse_robot

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


@pytest.mark.parametrize(
    "text",
    [
        "{footprint_radius: 0.18, sensor: {mount: [0.2, 0.0, 0.0]}}",
        "{footprint_radius: 0.18, sensors: [{ring: 4, radius: 0.2, cone: 0.2}]}",
    ],
)
def test_a_sensor_outside_the_footprint_is_warned_of(text: str) -> None:
    (line,) = laser_outside_footprint(parse_robot(f"{{name: rover, {text[1:]}", name="robot.yaml"))
    assert "0.20 m from the centre" in line and "footprint_radius of 0.18 m" in line
    assert laser_outside_footprint(load_robot()) == []
