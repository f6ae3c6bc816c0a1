"""The library as a whole: what it says of itself; neutral values change nothing; any subset composes."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest
from effects_samples import SENSOR, STAMPS, STRONG, TURN, neutral, scene, strong
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.run import RangeSensor
from sensorgraph.effects import EFFECTS, Effect
from sensorgraph.effects.effect import size_ratio
from sensorgraph.world.drivetrain import Drivetrain
from sensorgraph.world.robot import default_robot
from sensorgraph.world.scene import STAGES, draw_readings

NAMES = [
    "range_bias", "range_scale", "range_noise", "sector_bias", "mount_yaw", "mount_xy", "latency",
    "scan_skew", "mixed_pixels", "glass", "mirror", "black_surface", "incidence_dropout", "max_range",
    "min_range", "quantisation", "unmapped_obstacle", "moved_obstacle", "missing_obstacle", "moved_wall",
    "map_scale", "people", "range_drift", "wheel_radius", "wheel_radius_diff", "wheel_base",
    "wheel_slip", "actuator_lag", "dead_time", "speed_saturation", "sonar_cone", "self_occlusion",
    "tilt", "random_outliers", "pose_clock_offset",
]  # fmt: skip
SCAN = [name for name, effect in EFFECTS.items() if effect.channel == "scan"]
UNITS = {"m", "rad", "s", "m/s", "m/m", ""}


def test_the_names_are_the_promised_ones() -> None:
    assert list(EFFECTS) == NAMES
    assert len(NAMES) == 35
    drive = {name for name, effect in EFFECTS.items() if effect.channel == "drive"}
    odometry = {name for name, effect in EFFECTS.items() if effect.channel == "odometry"}
    assert drive == {"actuator_lag", "dead_time", "speed_saturation"}
    assert odometry == {n for n in NAMES if n.startswith("wheel_")} | {"pose_clock_offset"}


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS.keys())
def test_an_effect_says_what_it_is(effect: Effect) -> None:
    assert EFFECTS[effect.name] is effect
    assert effect.stage in (STAGES if effect.channel == "scan" else ("wheels", "motors"))
    assert effect.physics.endswith(".")
    for text in (effect.title, effect.source, effect.varies):
        assert text
        assert not text.endswith(".")
    assert effect.rivals
    for rival, separates in effect.rivals.items():
        assert rival in EFFECTS
        assert rival != effect.name
        assert separates
    for p in effect.parameters:
        assert p.unit in UNITS
        assert p.doc
        assert p.materiality is None or p.materiality > 0
        assert p.low < p.high
        assert p.neutral is None or p.low <= p.neutral <= p.high
    assert len({p.name for p in effect.parameters}) == len(effect.parameters)


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS.keys())
def test_size_is_counted_in_materialities(effect: Effect) -> None:
    assert size_ratio(effect, effect.sizes) == pytest.approx(
        np.sqrt(len(effect.sizes)) if effect.sizes else np.inf
    )


@pytest.mark.parametrize("name", [name for name in SCAN if name != "missing_obstacle"])  # it has no half
@pytest.mark.parametrize("sensor", [SENSOR, TURN], ids=["part", "full turn"])
def test_neutral_values_change_no_reading(name: str, sensor: RangeSensor) -> None:
    plain, changed = scene(sensor, box=True, seed=3), scene(sensor, box=True, seed=3)
    plain.run()
    changed.run([neutral(name)])
    np.testing.assert_array_equal(plain.beams.reading, changed.beams.reading)
    np.testing.assert_array_equal(
        draw_readings(plain, np.random.default_rng(0)), draw_readings(changed, np.random.default_rng(0))
    )


@pytest.mark.parametrize("name", [name for name in EFFECTS if name not in SCAN])
def test_neutral_values_leave_the_machine_as_it_is(name: str) -> None:
    plain, changed = Drivetrain.of(default_robot()), Drivetrain.of(default_robot(), [neutral(name)])
    assert (plain.tau, plain.delay, plain.v_max, plain.odometry_lag) == (
        changed.tau, changed.delay, changed.v_max, changed.odometry_lag,
    )  # fmt: skip
    np.testing.assert_array_equal(plain.measured, changed.measured)
    assert changed.grip(1.0, 0.0) == 1.0


@pytest.mark.parametrize("name", SCAN)
def test_a_strong_effect_changes_readings(name: str) -> None:
    plain, changed = scene(box=True, seed=3), scene(box=True, seed=3)
    plain.run()
    changed.run([strong(name)])
    before, after = (draw_readings(s, np.random.default_rng(0)) for s in (plain, changed))
    assert (
        np.abs(np.where(np.isfinite(before) & np.isfinite(after), after - before, 9.0)) > 0.02
    ).mean() > 0.002


@settings(max_examples=60)
@given(
    names=st.lists(st.sampled_from(sorted(STRONG)), unique=True, max_size=8),
    order=st.randoms(use_true_random=False),
)
def test_any_subset_composes_in_any_order(names: list[str], order: Random) -> None:
    shuffled = list(names)
    order.shuffle(shuffled)
    drawn = []
    for some in (names, shuffled):
        there = scene(box=True, seed=3)
        beams = there.run([strong(name) for name in some])
        p = np.asarray(beams.p_return)
        assert beams.reading.shape == (len(STAMPS), SENSOR.n_rays)
        assert not np.isnan(beams.reading).any()
        assert ((p >= 0) & (p <= 1)).all()
        assert (np.asarray(beams.sigma) > 0).all()
        drawn.append(draw_readings(there, np.random.default_rng(1)))
    np.testing.assert_array_equal(drawn[0], drawn[1])
    finite = np.isfinite(drawn[0])
    assert not np.isnan(drawn[0]).any()
    assert (drawn[0][finite] >= SENSOR.range_min).all()
    assert (drawn[0][finite] <= SENSOR.range_max).all()
