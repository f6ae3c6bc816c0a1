"""What slippery discs take from two points of a body, against the same by numpy."""

from __future__ import annotations

import numpy as np
import pytest

from planners.types import Floats
from sensorgraph.diagnosis.motion.wheel_model import lost_inside

RIM, TRACK = 0.2, 0.4


def share_inside(at: Floats, discs: Floats) -> Floats:
    """Return (n, n_discs): 1 inside, 0 outside, falling over the rim."""
    far = np.hypot(*(at[:, None] - discs[None, :, :2]).transpose(2, 0, 1))
    return np.clip((discs[:, 2] - far) / RIM + 0.5, 0.0, 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_each_point_loses_its_way_where_it_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    left_at, right_at = rng.uniform(0, 5, size=(2, 40, 2))
    left, right = rng.normal(size=(2, 40))
    discs = np.column_stack([rng.uniform(0, 5, size=(30, 2)), rng.uniform(0.2, 2, size=30)])
    of_left, of_right = (
        way[:, None] * share_inside(at, discs) for way, at in ((left, left_at), (right, right_at))
    )
    distance, turn = lost_inside(left_at, right_at, left, right, TRACK, discs, RIM)
    np.testing.assert_allclose(distance, (of_left + of_right) / 2, atol=1e-12)
    np.testing.assert_allclose(turn, (of_right - of_left) / TRACK, atol=1e-12)


def test_a_body_that_slips_as_a_whole_loses_distance_and_turn_alike() -> None:
    rng = np.random.default_rng(7)
    middle, way, turned = rng.uniform(0, 3, size=(20, 2)), rng.normal(size=20), rng.normal(size=20)
    discs = np.array([[1.0, 1.0, 0.8], [2.0, 1.5, 0.4]])
    share = share_inside(middle, discs)
    left, right = way - turned * TRACK / 2, way + turned * TRACK / 2
    distance, turn = lost_inside(middle, middle, left, right, TRACK, discs, RIM)
    np.testing.assert_allclose(distance, way[:, None] * share, atol=1e-12)
    np.testing.assert_allclose(turn, turned[:, None] * share, atol=1e-12)
