"""What a cut-off leaves at its rim is no people, but people who were there before it was in the model are."""

from __future__ import annotations

import numpy as np
import pytest
from test_diagnosis_commissioning import ARENA, ROBOT, SENSOR, ranges_in
from test_diagnosis_reading_laws import ANGLE, POSES, T, walker

from logs.run import Run
from sensorgraph.diagnosis.diagnose import diagnose


@pytest.mark.parametrize("is_somebody_there", [False, True])
def test_few_people_are_named_beside_a_maximal_range_of_which_they_are_a_hundredth(
    is_somebody_there: bool,
) -> None:
    """Somebody passes for two seconds in every ten; nothing beyond 3 m returns."""
    rng = np.random.default_rng(2)
    z = ranges_in(ARENA, POSES[:, :2], ANGLE) + 0.01 * rng.normal(size=ANGLE.shape)
    passes = is_somebody_there & (T % 10.0 < 2.0 - 1e-9)
    z = np.minimum(z, np.where(passes[:, None], walker(), np.inf))
    z[z > 3.0] = np.inf
    t = T.astype(np.float64)
    run = Run(sensor=SENSOR, stamps=t, ranges=z, pose_stamps=t, poses=POSES)
    found = diagnose(run, ARENA, ROBOT, plan_next=False).channels["scan"]
    assert [a.name for a in found.effects] == ["max_range"] + ["people"] * is_somebody_there
    evidence = [a.evidence or 0.0 for a in found.effects]
    assert not is_somebody_there or evidence[1] < 0.03 * evidence[0]
