"""Rays that are lost towards one side of the room: light, and no black part of a wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_samples import checked_of, data_of, hall_arena

from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import Checked
from sensorgraph.diagnosis.scan.unnamed.missing_by_direction import find
from sensorgraph.effects import EFFECTS, Amendment


def checked(data: ScanData, model: tuple[Amendment, ...]) -> Checked:
    return checked_of(fit(data, model, start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=5))


def black(low: float, high: float) -> Amendment:
    hall = hall_arena()
    east = next(k for k, wall in enumerate(hall.walls) if (wall[:, 0] == 6.0).all())
    return EFFECTS["black_surface"](a=low, b=high, r0=0.3).at(hall.names[east])


@pytest.mark.parametrize("half_width", [0.35, 0.26, 0.22])
def test_light_from_one_side_is_no_black_part_of_the_wall_there(half_width: float) -> None:
    """Also where the light begins within a direction of the test, of 10 degrees."""
    data = data_of(hall_arena(), n=400)
    rng = np.random.default_rng(1)
    towards = data.poses[:, 2:] + data.sensor.mount[2] + data.sensor.bearings
    off = np.angle(np.exp(1j * towards))
    blinded = (np.abs(off) < half_width) & (rng.random(off.shape) < 0.8)
    dark = replace(data, ranges=np.where(blinded, np.inf, data.ranges), memo={})
    model = (black(1.0, 4.0),)
    (doubt,) = find(checked(dark, model))
    assert "towards one side of the room (0" in doubt.statement.replace("-0", "0")
    assert doubt.failed == {0} and doubt.size is not None and doubt.size.wrong > 0.02


def test_where_rays_are_lost_in_every_direction_no_side_is_told() -> None:
    model = (black(1.0, 4.0),)
    data = data_of(hall_arena(), model, n=400)
    lost = np.random.default_rng(2).random(data.ranges.shape) < 0.5
    poor = replace(data, ranges=np.where(lost, np.inf, data.ranges), memo={})
    assert find(checked(poor, model)) == []


def test_a_black_part_of_a_wall_keeps_its_name() -> None:
    model = (black(1.0, 4.0),)
    data = data_of(hall_arena(), model, n=400)
    assert find(checked(data, model)) == []
