"""The lower bound of a plan's time: never above the optimum, near it, and below every plan."""

from __future__ import annotations

import heapq

import numpy as np
import pytest
from conftest import further

from planners import bound
from planners.bound import lower_bound, shortest_steps
from planners.types import Bools
from planners.vehicle import Limits, Vehicle

CELL = 0.25


def optimum(need: Bools, limits: Limits) -> float:
    """Return the least time of a drive of whole moves through all bins, by Dijkstra over (bin, bins visited)."""
    nx, ny, k = need.shape
    wanted = {tuple(at): 1 << n for n, at in enumerate(np.argwhere(need).tolist())}
    width = 2 * np.pi / k
    steps: dict[int, list[tuple[int, int, float]]] = {h: [] for h in range(k)}
    for h in range(k):
        for i in range(-nx + 1, nx):
            for j in range(-ny + 1, ny):
                if not i and not j:
                    continue
                for gear in (0.0, np.pi):
                    off = np.arctan2(j, i) + gear - h * width
                    if abs((off + np.pi) % (2 * np.pi) - np.pi) <= width / 2 + 1e-9:
                        steps[h].append((i, j, float(np.hypot(i, j)) * CELL / limits.v))
    everything = (1 << len(wanted)) - 1
    best = dict.fromkeys(wanted.items(), 0.0)
    queue = [(0.0, at, bit) for at, bit in wanted.items()]
    while queue:
        time, at, seen = heapq.heappop(queue)
        if seen == everything:
            return time
        if time > best[at, seen]:
            continue
        x, y, h = at
        following = [((x, y, (h + turn) % k), width / limits.omega) for turn in (1, -1)]
        following += [
            ((x + i, y + j, h), cost) for i, j, cost in steps[h] if 0 <= x + i < nx and 0 <= y + j < ny
        ]
        for place, cost in following:
            key = place, seen | wanted.get(place, 0)
            if time + cost < best.get(key, np.inf) - 1e-12:
                best[key] = time + cost
                heapq.heappush(queue, (time + cost, *key))
    raise AssertionError("not every bin can be visited")


@pytest.mark.parametrize(
    ("shape", "share"), [((2, 1, 6), 0.9), ((3, 1, 4), 0.9), ((2, 2, 8), 0.3), ((4, 1, 8), 0.25)]
)
@pytest.mark.parametrize("solved", [150, *further(1)])
def test_bound_is_never_above_the_optimum(
    shape: tuple[int, int, int], share: float, solved: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bound, "MAX_PATTERNS", solved)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        limits = Limits(v=float(rng.uniform(0.1, 1.0)), omega=float(rng.uniform(0.3, 3.0)))
        need = rng.random(shape) < share
        need.ravel()[0] = True
        best = optimum(need, limits)
        assert lower_bound(need, Vehicle(limits=limits), CELL, 10.0) <= best + 1e-9


def test_bound_of_many_full_cells_is_a_full_turn_and_a_step_each() -> None:
    """With 16 headings and steps at every second one, 15 turns cannot lead out of a cell."""
    limits = Limits()
    need = np.ones((20, 20, 16), dtype=np.bool_)
    each = 2 * np.pi / limits.omega + CELL / limits.v
    assert 398 * each <= lower_bound(need, Vehicle(limits=limits), CELL, 10.0) <= 400 * each


def test_steps_of_the_grid_are_those_of_its_directions() -> None:
    expected = [1.0, np.sqrt(5), np.sqrt(2), np.sqrt(5)] * 4
    np.testing.assert_allclose(shortest_steps(16), expected)


def test_bound_of_nothing_is_nothing() -> None:
    assert lower_bound(np.zeros((3, 3, 16), dtype=np.bool_), Vehicle(), CELL, 10.0) == 0.0


def test_a_car_needs_a_period_of_the_log_for_each_bin() -> None:
    car = Vehicle(drive="dubins", limits=Limits(turning_radius=0.4))
    assert lower_bound(np.ones((2, 3, 4), dtype=np.bool_), car, CELL, 10.0) == 2.3


def test_a_drive_that_is_shorter_than_whole_moves_is_not_below_its_bound() -> None:
    """Bins that are met in passing take no turn of their own: the bound of whole moves is none of such a drive."""
    need = np.ones((20, 20, 16), dtype=np.bool_)
    whole = lower_bound(need, Vehicle(), CELL, 10.0)
    assert lower_bound(need, Vehicle(), CELL, 10.0, drive_time=whole + 1.0) == whole
    assert lower_bound(need, Vehicle(), CELL, 10.0, drive_time=whole - 1.0) == pytest.approx(639.9)
