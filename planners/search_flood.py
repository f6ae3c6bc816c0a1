"""Floods of the whole floor by a Dubins car's primitives: where it can go and come back from, and the way there.

Every state that a flood comes to is one that the car can be in, and each cell of a fine lattice is entered once: so a
way is found through any gap that the lattice resolves, where planners that sample at random need luck.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planners import search_kernels as kernels
from planners.arena import Bools, Floats, wrap
from planners.coverage_planner import Task
from planners.reach import Reach
from planners.robot import Limits
from planners.search import Found, Scene, Search, scene
from planners.search_cars import Entry, begin, car_curve
from planners.search_table import driving
from planners.steering import Curve

FINE = 0.02
"""[m] between the cells of the lattice."""
PATIENCE = 1.3
"""How much longer to stay in the bin that a way leads to: a log of each phase must meet it."""
STARTS = 6
"""Places to begin that are looked at."""
ENOUGH = 0.5
"""Share of the bins of the disc from which on a start is good enough."""


def cycle(reach: Reach, limits: Limits, headings: int, rate: float, pose: Floats) -> Bools:
    """Return the bins (nx, ny, n_phi) that a Dubins car at `pose` (3,) can get to, and come back from.

    A flood backward marks the states from which the pose can be reached; one forward goes only through those. Each
    begins at the end of the arc by which the car leaves the pose, or comes to it.
    """
    place = scene(reach)
    wanted = np.repeat(np.asarray(reach.blocks(reach.mask).any(axis=-1))[:, :, None], headings, axis=2)
    begins = [begin(pose, place, limits, headings, rate, (gear,)) for gear in (-1, 1)]
    back = _flood(begins[0], np.zeros_like(wanted), place, rate)
    there = _flood(begins[1], wanted, place, rate, within=back.met)
    return np.asarray(wanted & ~there.left)


@dataclass(eq=False)
class Ways:
    """Finds ways of a Dubins car over the whole floor."""

    task: Task

    def __post_init__(self) -> None:
        self.place = scene(self.task.reach)
        self._back: dict[float, Bools] = {}
        """Where a pose that was asked about can be reached from, by the first heading of the table: others on the same
        drive can be too."""

    def to_one_of(self, wanted: Bools, pose: Floats, *, anew: bool = True) -> Curve | None:
        """Return the quickest drive from `pose` (3,) to one of the bins `wanted` (nx, ny, n_phi).

        It ends where the car can come back from; None where the flood comes to no such place.

        anew : if there is no way within what is known to lead back, find out what leads back to this pose
        """
        task, limits = self.task, self.task.robot.limits
        begins = [
            begin(pose, self.place, limits, task.coverage.headings, task.rate, (gear,)) for gear in (-1, 1)
        ]
        first = round(begins[0].table.first, 9)
        branches = self._first_within(self._back.get(first), begins[1], wanted)
        if not len(branches) and (anew or first not in self._back):
            self._back[first] = _flood(begins[0], np.zeros_like(wanted), self.place, task.rate).met
            branches = self._first_within(self._back[first], begins[1], wanted)
        if not len(branches):
            return None
        return car_curve(Found(start=begins[1].state, sequence=branches, left=wanted), begins[1], limits)

    def _first_within(self, met: Bools | None, begun: Entry, wanted: Bools) -> kernels.Branches:
        """Return the way (n,) within cells of the lattice to the first bin; none where there is no such way."""
        if met is None:
            return np.empty(0, dtype=np.int32)
        return _flood(begun, wanted, self.place, self.task.rate, within=met, to_first=True).branches


class _Flooded(NamedTuple):
    """What a flood came to."""

    met: Bools
    """(n, n, n_headings) cells of the lattice."""
    left: Bools
    """(nx, ny, n_phi) bins that it did not meet."""
    branches: kernels.Branches
    """(n,) the way to the first one that it met, if that was asked for."""


def _flood(
    begun: Entry,
    wanted: Bools,
    place: Scene,
    rate: float,
    *,
    within: Bools | None = None,
    to_first: bool = False,
) -> _Flooded:
    """Flood from where a car begins, within cells of the lattice; all of it, or up to the first bin `wanted`."""
    search = Search(place, begun.table, wanted, rate)
    search.want(wanted, PATIENCE if to_first else 1.0, inner=False)
    shape = np.ceil(np.array(place.distance.shape) * place.step / FINE - 1e-9).astype(int) + 2
    met = np.zeros((*shape, begun.table.n_headings), dtype=np.bool_)
    allowed = np.ones_like(met) if within is None else within
    depth = begun.table.safe_depth if to_first else 0
    branches = kernels.spread(begun.state, allowed, met, depth, search.world, search.moves(), FINE)
    return _Flooded(met, search.world.need, branches)


def best_start(reach: Reach, limits: Limits, headings: int, rate: float, seed: int) -> tuple[Floats, Bools]:
    """Return the pose (3,) of some random ones from which a Dubins car can go to most bins and come back, and those."""
    rng = np.random.default_rng([seed, 7])
    free = np.argwhere(reach.blocks(reach.mask).all(axis=-1))
    if not len(free):
        free = np.argwhere(reach.cells())
    best: tuple[Floats, Bools] | None = None
    for _ in range(STARTS):
        place = reach.origin + (free[int(rng.integers(len(free)))] + 0.5) * reach.cell
        table = driving(limits, headings, rate, (1,))
        pose = np.array([*place, wrap(table.first + table.step * rng.integers(table.n_headings))])
        bins = cycle(reach, limits, headings, rate, pose)
        if best is None or bins.sum() > best[1].sum():
            best = pose, bins
        if best[1].sum() > ENOUGH * reach.cells().sum() * headings:
            break
    assert best is not None
    return best
