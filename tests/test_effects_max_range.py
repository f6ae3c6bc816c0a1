"""A range beyond which nothing returns is one only if nothing does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sensorgraph.effects.max_range import is_limit


@pytest.mark.parametrize(("share_lost", "is_one"), [(1.0, True), (0.9, True), (0.5, False)])
def test_returns_from_beyond_show_that_a_range_is_no_limit(share_lost: float, is_one: bool) -> None:
    rng = np.random.default_rng(0)
    mu = rng.uniform(1.0, 30.0, (50, 40))
    lost = (mu > 20.0) & (rng.random(mu.shape) < share_lost)
    z = np.where(lost, np.inf, mu + 0.01 * rng.normal(size=mu.shape))
    residuals: Any = SimpleNamespace(mu=mu, z=z, lost=lost, returned=~lost, sigma=np.full(mu.shape, 0.01))
    assert is_limit(residuals, 20.0) is is_one
