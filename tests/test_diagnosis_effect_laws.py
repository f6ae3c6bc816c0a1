"""Effects that cast doubt on themselves together do so only where each of them is material."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_samples import checked_of, data_of, hall_arena

from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import implausible_combination, object_at_wall, rounded_readings
from sensorgraph.effects import EFFECTS


@pytest.mark.parametrize(("of_map", "is_doubted"), [(0.02, True), (0.0, False)])
def test_a_map_that_is_shifted_and_not_stretched_casts_no_doubt_on_stretched_readings(
    of_map: float, is_doubted: bool
) -> None:
    hall = hall_arena()
    model = (EFFECTS["range_scale"](s=0.03), EFFECTS["map_scale"](s=of_map, dx=0.004, dy=0.0))
    data = data_of(hall, model)
    got = fit(data, model, start_state(data, SCAN.noise), SCAN.noise, outer=2)
    doubts = implausible_combination.find(checked_of(got, gains={0: 1000.0, 1: 100.0}))
    assert ["stretched" in doubt.statement for doubt in doubts] == [True] * is_doubted


def test_what_one_effect_costs_is_told_without_what_others_have_moved_since_the_cast() -> None:
    """A disc of 2 % beside an occlusion was 3.4 % of the readings off by 28 cm: those that the robot hides."""
    hidden = EFFECTS["self_occlusion"](theta1=-1.2, theta2=-0.8, r0=0.23)
    disc = EFFECTS["unmapped_obstacle"](x=2.4, y=-0.03, r=0.1)
    data = data_of(hall_arena(), (hidden, disc))
    fitted = fit(data, (hidden, disc), start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=1)
    moved = replace(fitted, model=(hidden.moved_to({"r0": 0.229}), fitted.model[1]))
    shares = []
    for model in (fitted, moved):
        (doubt,) = object_at_wall.find(checked_of(model))
        assert doubt.size is not None
        shares.append(doubt.size.affected)
    assert shares[0] == pytest.approx(shares[1], rel=1e-6)
    assert np.mean(data.ranges < 0.3) > 2 * shares[0] > 0


@pytest.mark.parametrize("is_rounded", [True, False])
def test_rounding_to_steps_that_grow_with_the_range_is_no_noise_that_does(is_rounded: bool) -> None:
    """Steps of 6 % between readings, or normal noise of the same variance."""
    rng, plain = np.random.default_rng(2), data_of(hall_arena())
    step = 0.06
    ranges = (
        np.where(plain.returned, np.exp(step * np.round(np.log(np.abs(plain.ranges)) / step)), plain.ranges)
        if is_rounded
        else plain.ranges * (1 + step / np.sqrt(12) * rng.normal(size=plain.ranges.shape))
    )
    data, model = replace(plain, ranges=ranges, memo={}), (EFFECTS["range_noise"](k=0.017),)
    got = fit(data, model, start_state(data, SCAN.noise), SCAN.noise, outer=2)
    doubts = rounded_readings.find(checked_of(got))
    assert ["between two limits" in doubt.statement for doubt in doubts] == [True] * is_rounded
