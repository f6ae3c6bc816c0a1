"""A name rests on what its channel compares with: where that is doubted, little evidence is none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sensorgraph.diagnosis.motion.naming import (
    beside_shown_reference,
    name_motion_effects,
    without_echoes_of_doubted_wheels,
)
from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.effects import EFFECTS, Amendment

BASE = replace(EFFECTS["wheel_base"](s=-0.03), evidence=40.0)
LAG = replace(EFFECTS["actuator_lag"](tau=0.05), evidence=40.0)


@pytest.mark.parametrize(("scale", "is_named"), [(1.0, True), (1.7, True), (2.5, False)])
def test_evidence_of_wheels_falls_with_the_square_of_how_bad_the_reference_is(
    scale: float, is_named: bool
) -> None:
    told = beside_shown_reference(ChannelResult(channel="odometry", effects=(BASE,)), scale)
    assert (told.effects == (BASE,)) is is_named
    assert ("wheel_base" in told.not_observable) is not is_named


@pytest.mark.parametrize(("nats", "is_named"), [(None, True), (13.0, True), (14.0, False)])
def test_what_is_doubted_of_the_wheels_with_a_third_of_the_evidence_is_no_lag_of_the_motors(
    nats: float | None, is_named: bool
) -> None:
    doubt = None if nats is None else Unknown(statement="one encoder is late", statistic=nats)
    odometry = ChannelResult(channel="odometry", unknown=doubt)
    told = without_echoes_of_doubted_wheels(ChannelResult(channel="drive", effects=(LAG,)), odometry)
    assert (told.effects == (LAG,)) is is_named
    assert ("actuator_lag" in told.not_observable) is not is_named


@pytest.mark.parametrize(
    ("effect", "is_named"),
    [
        (EFFECTS["wheel_base"](s=0.6), False),
        (EFFECTS["wheel_base"](s=0.4), True),
        (EFFECTS["wheel_slip"](x=1.0, y=1.0, r=0.5, s=0.7), True),
    ],
)
def test_only_a_scale_of_the_whole_run_shows_that_poses_and_odometry_do_not_belong_together(
    effect: Amendment, is_named: bool
) -> None:
    told = name_motion_effects(
        ChannelResult(channel="odometry", effects=(replace(effect, evidence=40.0),)), known=()
    )
    assert bool(told.effects) is is_named
    assert (told.unknown is None) is is_named
