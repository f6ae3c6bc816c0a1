"""Readings that a laser loses at random, and sectors that something covers: each is named as what it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sensorgraph.watching.laser_errors import BlockedSectors, MissingReturns, in_a_block

N = 360
BEARINGS = np.linspace(-np.pi, np.pi, N, endpoint=False)
ASKED = np.ones(N, dtype=np.bool_)


def sectors_after(loss: float, covered: np.ndarray, n_scans: int = 200) -> BlockedSectors:
    """Return the judgement after some scans with random losses and covered rays."""
    rng = np.random.default_rng(0)
    readings = SimpleNamespace(sensor=SimpleNamespace(bearings=BEARINGS), rays=np.arange(N))
    found = BlockedSectors(cast(Any, readings))
    for _ in range(n_scans):
        missing = covered | (rng.random(N) < loss)
        found.add(missing, np.zeros(N), ASKED, 1.0, 0.1)
    return found


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.4, 0.6, 0.8])
def test_readings_lost_at_random_cover_no_sector(loss: float) -> None:
    assert not sectors_after(loss, np.zeros(N, dtype=np.bool_)).blocked().any()


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.4])
@pytest.mark.parametrize("width", [0.4, 2.0, 3.8])
def test_a_covered_sector_is_found_by_a_laser_that_loses_readings(loss: float, width: float) -> None:
    covered = np.abs(BEARINGS) < width / 2
    found = sectors_after(loss, covered)
    assert found.rays()[covered].mean() > 0.8  # all but the sectors at its edges
    assert not found.rays()[np.abs(BEARINGS) > width / 2 + 0.2].any()


@pytest.mark.parametrize("loss", [0.02, 0.1, 0.2, 0.4, 0.6, 0.8])
@pytest.mark.parametrize("has_door", [False, True])
def test_the_share_of_lost_readings_is_recovered(loss: float, has_door: bool) -> None:
    rng = np.random.default_rng(1)
    found = MissingReturns()
    for _ in range(200):
        missing = rng.random(N) < loss
        if has_door:
            missing[100:130] = True
        counted = ~in_a_block(missing, ASKED)
        found.add(float(missing[counted].mean()), 1.0)
    # readings that are lost next to each other by chance, and a door within more losses, bias the share by a few percent
    assert found.estimates()[0][0] == pytest.approx(loss, abs=0.05)
