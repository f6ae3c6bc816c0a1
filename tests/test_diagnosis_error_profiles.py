"""Errors over bearing and range: what was planted is found, and nothing where the laser is as it should be."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scan_samples import checked_of, data_of, hall_arena

from planners.types import Floats
from sensorgraph.diagnosis.report.data import unknown_dict
from sensorgraph.diagnosis.report.residual_figures import profile_picture
from sensorgraph.diagnosis.result import Unknown
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.goodness_of_fit import check
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import Doubt, sure
from sensorgraph.diagnosis.scan.unnamed.columns import estimated
from sensorgraph.diagnosis.scan.unnamed.error_profiles import BIAS_BY_BEARING, ProfileColumns, find, profiles
from sensorgraph.effects import EFFECTS, Amendment


def null_of(data: ScanData, model: tuple[Amendment, ...] = ()) -> Fitted:
    return fit(data, model, start_state(data, SCAN.noise), SCAN.noise)


def told(error: Floats | float, *effects: Amendment) -> tuple[ScanData, Floats]:
    """Drive with a laser whose rays point further left than its description says, by errors (n_rays,) [rad]."""
    data = data_of(hall_arena(), effects)
    bearings = data.sensor.bearings - error
    return replace(data, sensor=replace(data.sensor, bearings=bearings), memo={}), bearings


def shown(data: ScanData) -> tuple[Doubt, Floats, Floats]:
    """Return the profile that a run surely shows, with its knots and its errors."""
    (doubt,) = sure(find(checked_of(null_of(data))))
    assert doubt.profile is not None
    return doubt, np.array(doubt.profile.at), np.array(doubt.profile.error)


def test_a_ripple_of_the_bearings_is_found_and_its_shape_told() -> None:
    true = data_of(hall_arena()).sensor.bearings
    ripple = np.radians(1.0) * np.sin(2 * true + 0.4)
    data, bearings = told(ripple)
    doubt, knots, errors = shown(data)
    assert doubt.family == "bearing_error"
    expected = np.interp(knots, bearings, ripple - ripple.mean())
    np.testing.assert_allclose(errors, expected, atol=np.radians(0.15))
    assert "bearings are off by up to" in doubt.statement and doubt.size is not None
    assert doubt.size.is_material(data.sensor.sigma)


@pytest.mark.parametrize("stretch", [0.02, -0.015])
def test_a_field_of_view_other_than_stated_is_told_in_degrees(stretch: float) -> None:
    true = data_of(hall_arena()).sensor.bearings
    data, bearings = told(true - true / (1 + stretch))
    doubt, knots, errors = shown(data)
    assert doubt.family == "bearing_error" and doubt.statement.startswith("the field of view is")
    assert np.polyfit(knots, errors, 1)[0] == pytest.approx(stretch, abs=0.003)
    widths = [float(w) for w in re.findall(r"([\d.]+)°", doubt.statement)]
    assert widths == pytest.approx([np.degrees(np.ptp(true)), np.degrees(np.ptp(bearings))], abs=0.3)
    assert ("wider" in doubt.statement) is (stretch > 0)


@pytest.mark.parametrize("s", [0.015, -0.02])
def test_a_scale_is_no_error_that_no_scale_explains(s: float) -> None:
    """Also where the fit knows of no scale, whose evidence the profile would take."""
    data = data_of(hall_arena(), (EFFECTS["range_scale"](s=s),))
    assert not any(doubt.family == "bias_by_range" for doubt in sure(find(checked_of(null_of(data)))))


@pytest.mark.parametrize(
    "effects",
    [
        (),
        (EFFECTS["mount_yaw"](delta=0.02),),
        (EFFECTS["scan_skew"](T=0.05),),
        (EFFECTS["map_scale"](s=0.01, dx=0.0, dy=0.0),),
    ],
)
def test_true_bearings_are_not_doubted(effects: tuple[Amendment, ...]) -> None:
    data = data_of(hall_arena(), effects)
    sizes = [d.size for d in sure(find(checked_of(null_of(data, effects), null_of(data))))]
    assert not any(size is None or size.is_material(data.sensor.sigma) for size in sizes)


def test_effects_that_only_stand_for_wrong_bearings_lose_their_names() -> None:
    true = data_of(hall_arena()).sensor.bearings
    data, _ = told(np.radians(1.0) * np.sin(2 * true))
    (doubt,) = sure(find(checked_of(null_of(data, (EFFECTS["range_noise"](k=0.01),)), null_of(data))))
    assert doubt.failed == {0}
    # what a profile holds, too, is not taken for its echo
    (doubt,) = sure(find(checked_of(null_of(data, (EFFECTS["mount_yaw"](delta=0.002),)), null_of(data))))
    assert not doubt.failed


def test_a_bias_that_grows_with_the_square_of_the_range_is_told_by_range() -> None:
    data = data_of(hall_arena())
    z = np.where(data.returned, data.ranges, 2.0)
    data = replace(data, ranges=data.ranges + 0.004 * (z - 2.0) ** 2, memo={})
    doubt, knots, errors = shown(data)
    assert doubt.family == "bias_by_range"
    curve = 0.004 * (knots - 2.0) ** 2
    np.testing.assert_allclose(np.diff(errors), np.diff(curve), atol=0.006)
    assert "depends on the range" in doubt.statement


def test_a_bias_that_waves_over_the_bearing_is_no_bearing_error() -> None:
    data = data_of(hall_arena())
    wave = 0.02 * np.sin(4 * data.sensor.bearings)
    doubt, _, _ = shown(replace(data, ranges=data.ranges + wave, memo={}))
    assert doubt.family == "bias_by_bearing"
    assert doubt.size is not None and 0.012 < doubt.size.offset < 0.018


def test_a_profile_is_told_in_numbers_and_as_a_picture(tmp_path: Path) -> None:
    true = data_of(hall_arena()).sensor.bearings
    data, _ = told(np.radians(1.0) * np.sin(2 * true))
    doubt, knots, errors = shown(data)
    assert doubt.profile is not None and len(knots) == len(errors)
    assert max(doubt.profile.stderr) < 0.2 * max(doubt.profile.error)
    written = unknown_dict(Unknown(statement=doubt.statement, profile=doubt.profile))["profile"]
    assert (written["of"], written["over"]) == ("bearing", "bearing")
    profile_picture(doubt.profile, tmp_path / "profile.png")
    assert (tmp_path / "profile.png").stat().st_size > 5000


def test_beside_a_bias_the_mean_of_a_profile_over_bearing_is_nobodys() -> None:
    """The bias does what all knots do together: no covariance, but an information, of which that has none."""
    data = data_of(hall_arena(), (EFFECTS["range_bias"](b=0.04),))
    fitted = null_of(data, (EFFECTS["range_bias"](b=0.04),))
    bearings = data.sensor.bearings
    knots = np.linspace(bearings.min(), bearings.max(), 9)
    hats = np.array([np.interp(bearings, knots, one) for one in np.eye(len(knots))])
    columns = np.where(fitted.solver.jacobian.valid[:, None], hats, 0.0)
    got = estimated(fitted, ProfileColumns.of(BIAS_BY_BEARING, knots, columns))
    alone = np.diag(got.information)
    assert (alone > 0).all()
    assert np.abs(got.information.sum(axis=1) / alone).max() < 1e-6
    assert all(np.isfinite(estimated(fitted, one).amplitude_z) for one in profiles(fitted))


@pytest.mark.parametrize(("people", "is_doubted"), [(0.1, True), (25.0, False)])
def test_a_coarse_effect_excuses_what_is_left_by_its_own_evidence_alone(
    people: float, is_doubted: bool
) -> None:
    """A few people in the model are no reason to let an error of the bearings pass; many, of as much evidence, are one."""
    true = data_of(hall_arena()).sensor.bearings
    data, _ = told(np.radians(1.0) * np.sin(2 * true))
    found = null_of(data, (EFFECTS["latency"](tau=0.01), EFFECTS["people"](p=0.001)))
    (doubt,) = sure(find(checked_of(found)))
    gains = {0: 25 * doubt.misfit, 1: people * doubt.misfit}  # of the latency the error is 4 %
    got = check(data, found, gains[0], gains, rng=np.random.default_rng(0))
    assert (got.told is not None and got.told.family == "bearing_error") == is_doubted
