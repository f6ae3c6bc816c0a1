"""Odometry whose quaternions have the whole heading, or a quarter of it, instead of half: found by its course, and corrected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conftest import further

from logs.run import Run
from logs.transforms import compose, wrap
from sensorgraph.localization.course import turn_units
from sensorgraph.localization.locate import locate
from tests.localization_samples import Floats, any_times, loop_poses, room_run


def winding(sign: float = 1.0) -> Floats:
    """Return poses (n, 3) of a drive along a winding line, ahead or backwards."""
    t = np.linspace(0.0, 20.0, 400)
    phi = 1.4 * np.sin(0.9 * t) + 0.2 * t
    step = sign * 0.02 * np.column_stack([np.cos(phi), np.sin(phi)])
    return np.column_stack([np.cumsum(step, axis=0), phi])


def factors(poses: Floats) -> list[float]:
    return list(turn_units(poses, {}))


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_factor_of_the_heading_follows_from_the_course(factor: float, sign: float) -> None:
    assert factors(winding(sign) / [1.0, 1.0, factor]) == ([] if factor == 1.0 else [factor])


def test_a_robot_that_drives_sideways_or_straight_on_has_no_factor() -> None:
    poses = winding()
    assert factors(np.column_stack([poses[:, :2], 0.0 * poses[:, 2]])) == []
    straight = np.column_stack([np.linspace(0, 5, 100), np.zeros(100), np.zeros(100)])
    assert factors(straight) == []
    assert factors(np.zeros((10, 3))) == []


def test_wheels_with_a_wrong_base_keep_their_heading() -> None:
    true = winding()
    phi = 2.0 * true[:, 2]  # the positions follow the wrong heading
    wrong = np.column_stack([np.cumsum(0.02 * np.column_stack([np.cos(phi), np.sin(phi)]), axis=0), phi])
    assert factors(wrong) == []


@any_times
@pytest.mark.parametrize(("factor", "turned"), [(2.0, 3.0), *further((2.0, 0.0), (0.5, 0.0))])
def test_locate_corrects_the_heading_and_says_so(
    factor: float, turned: float, times: Callable[[Run], Run]
) -> None:
    """Half of a stated heading is known up to a half turn, and the robot drives ahead."""
    run = room_run(loop_poses(120, laps=1.5))
    turn, start = compose(np.array([0.0, 0.0, turned]), run.odometry), np.unwrap(run.odometry[:, 2]) + turned
    found = locate(times(replace(run, odometry=np.column_stack([turn[:, :2], wrap(factor * start)]))))
    assert any("a quarter of the heading" in note or "the whole heading" in note for note in found.notes)
    assert found.wheels is not None
    assert found.wheels.turn_scale == pytest.approx(1.0, abs=0.05)
    assert found.wheels.way_scale == pytest.approx(1.0, abs=0.05)
