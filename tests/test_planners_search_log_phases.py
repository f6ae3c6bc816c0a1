"""What a log of each phase meets: the compiled count against poses sampled one phase after the other."""

from __future__ import annotations

import numpy as np
import pytest

from planners.coverage import Coverage
from planners.curve import Curve, curve_of_pieces
from planners.search.log_phases import PHASES, met, missed

RATE = 10.0


def curve(kind: str) -> Curve:
    """Return 200 random pieces about (5, 5): straight, spinning, arcs, and blends in which omega changes too."""
    rng = np.random.default_rng(3)
    n = 200
    dt = rng.uniform(0.02, 0.6, n)
    twists = rng.uniform([-0.4, -1.0], [0.4, 1.0], (n, 2))
    rates = rng.uniform([-0.5, -2.0], [0.5, 2.0], (n, 2))
    if kind != "blends":
        rates[:, 1] = 0.0
    if kind == "straight":
        twists[:, 1] = 0.0
    if kind == "spins":
        twists[:, 0], rates[:, 0] = 0.0, 0.0
    if kind == "slow turns":
        twists[:, 1] *= 0.05
    return curve_of_pieces(np.array([5.0, 5.0, 0.3]), dt, twists, rates, np.full(n, "drive"))


def empty(side: float = 10.0, cell: float = 0.1) -> Coverage:
    cells = np.ones((round(side / cell),) * 2, dtype=np.bool_)
    return Coverage.empty(origin=np.zeros(2), cell=cell, cells=cells, headings=24)


@pytest.mark.parametrize("kind", ["straight", "spins", "slow turns", "arcs", "blends"])
@pytest.mark.parametrize("clock", [0.0, 12.345])
def test_each_phase_meets_what_its_poses_are_in(kind: str, clock: float) -> None:
    driven, grid = curve(kind), empty()
    found = met(driven, grid, RATE, clock)
    for phase in range(PHASES):
        first = (phase / PHASES / RATE - clock) % (1 / RATE)
        bins, inside = grid.bins(driven.log(RATE, first))
        plain = np.zeros_like(found[phase])
        plain[tuple(bins[inside].T)] = True
        np.testing.assert_array_equal(found[phase], plain)
    assert found.any(axis=0).sum() >= 10


def test_what_leaves_the_grid_is_not_counted() -> None:
    driven = curve("arcs")
    small = Coverage.empty(
        origin=np.array([4.9, 4.9]), cell=0.1, cells=np.ones((2, 2), dtype=np.bool_), headings=24
    )
    whole = met(driven, empty(), RATE)[:, 49:51, 49:51]
    np.testing.assert_array_equal(met(driven, small, RATE), whole)


def test_a_bin_is_missed_if_one_phase_misses_it() -> None:
    driven, grid = curve("arcs"), empty()
    todo = grid.reachable.copy()
    todo[:50] = False
    seen = met(driven, grid, RATE)
    np.testing.assert_array_equal(missed(driven, todo, grid, RATE), todo & (seen.sum(axis=0) < PHASES))
    assert (seen.any(axis=0) & ~seen.all(axis=0)).any()
