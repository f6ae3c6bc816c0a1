"""Odometry whose quaternions have the whole heading, or a quarter of it, instead of half: found by its course, and corrected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conftest import further

from logs.run import Run
from logs.transforms import wrap
from sensorgraph.localization.course import heading_factor, with_heading
from sensorgraph.localization.locate import locate
from tests.localization_samples import Floats, any_times, loop_poses, room_run


def winding(sign: float = 1.0) -> Floats:
    """Return poses (n, 3) of a drive along a winding line, ahead or backwards."""
    t = np.linspace(0.0, 20.0, 400)
    phi = 1.4 * np.sin(0.9 * t) + 0.2 * t
    step = sign * 0.02 * np.column_stack([np.cos(phi), np.sin(phi)])
    return np.column_stack([np.cumsum(step, axis=0), phi])


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_factor_of_the_heading_follows_from_the_course(factor: float, sign: float) -> None:
    assert heading_factor(winding(sign) / [1.0, 1.0, factor]) == factor


def test_a_robot_that_drives_sideways_or_straight_on_has_no_factor() -> None:
    poses = winding()
    assert heading_factor(np.column_stack([poses[:, :2], 0.0 * poses[:, 2]])) == 1.0
    straight = np.column_stack([np.linspace(0, 5, 100), np.zeros(100), np.zeros(100)])
    assert heading_factor(straight) == 1.0
    assert heading_factor(np.zeros((10, 3))) == 1.0


def test_wheels_with_a_wrong_base_keep_their_heading() -> None:
    true = winding()
    phi = 2.0 * true[:, 2]  # the positions follow the wrong heading
    wrong = np.column_stack([np.cumsum(0.02 * np.column_stack([np.cos(phi), np.sin(phi)]), axis=0), phi])
    assert heading_factor(wrong) == 1.0


def test_half_a_stated_heading_is_known_up_to_a_half_turn_and_the_robot_drives_ahead() -> None:
    true = winding() + [0.0, 0.0, 3.0]
    c, s = np.cos(3.0), np.sin(3.0)
    true[:, :2] = winding()[:, :2] @ np.array([[c, s], [-s, c]])
    stated = true.copy()
    stated[:, 2] = np.unwrap(wrap(2.0 * true[:, 2]))  # as the quaternion (sin(yaw), cos(yaw)) is read
    assert wrap(with_heading(stated, 0.5)[:, 2] - true[:, 2]) == pytest.approx(np.zeros(len(true)), abs=1e-9)


def with_stated_heading(run: Run, factor: float) -> Run:
    return replace(run, odometry=run.odometry * [1.0, 1.0, factor])


@any_times
@pytest.mark.parametrize("factor", [2.0, *further(0.5)])
def test_locate_corrects_the_heading_and_says_so(factor: float, times: Callable[[Run], Run]) -> None:
    found = locate(times(with_stated_heading(room_run(loop_poses(120, laps=1.5)), factor)))
    assert any("instead of half of it; corrected" in note for note in found.notes)
    assert found.wheels is not None
    assert found.wheels.turn_scale == pytest.approx(1.0, abs=0.05)
    assert found.wheels.way_scale == pytest.approx(1.0, abs=0.05)
