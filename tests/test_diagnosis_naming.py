"""A name rests on what its channel compares with: where that is doubted, little evidence is none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sensorgraph.diagnosis.motion.naming import beside_doubted_wheels
from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.effects import EFFECTS

LAG = replace(EFFECTS["actuator_lag"](tau=0.05), evidence=40.0)


@pytest.mark.parametrize(("nats", "is_named"), [(None, True), (39.0, True), (41.0, False)])
def test_an_error_of_the_wheels_with_more_evidence_is_no_lag_of_the_motors(
    nats: float | None, is_named: bool
) -> None:
    doubt = None if nats is None else Unknown(statement="one encoder is late", statistic=nats)
    odometry = ChannelResult(channel="odometry", unknown=doubt)
    told = beside_doubted_wheels(ChannelResult(channel="drive", effects=(LAG,)), odometry)
    assert (told.effects == (LAG,)) is is_named
    assert ("actuator_lag" in told.not_observable) is not is_named
