"""Floods of the whole floor by a Dubins car's primitives: where it can go and come back from, and the way there.

Every state that a flood comes to is one that the car can be in, and each cell of a fine lattice is entered once: so a
way is found through any gap that the lattice resolves, where planners that sample at random need luck.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.arena import wrap
from planners.cars.search import Entry, begin, car_curve
from planners.curve import Curve
from planners.reach import Cycle, Reach
from planners.search.area import SearchArea, search_area
from planners.search.motion_primitives import car_primitives
from planners.search.search import CoverageSearch, SearchResult
from planners.search.wavefront import wavefront
from planners.task import Task
from planners.types import Bools, Floats, Int32s
from planners.vehicle import Limits

FINE = 0.02
"""[m] between the cells of the lattice."""
PATIENCE = 1.3
"""How much longer to stay in the bin that a way leads to: a log of each phase must meet it."""
FAR = 0.25
"""Of what leads back: a flood that came over so much came to all bins that a flood can."""
STARTS = 6
"""Places to begin that are looked at."""
ENOUGH = 0.5
"""Share of the bins of the disc from which on a start is good enough."""


def cycle(reach: Reach, limits: Limits, headings: int, rate: float, pose: Floats) -> Cycle:
    """Return what a Dubins car at `pose` (3,) can get to, and come back from.

    A flood backward marks the states from which the pose can be reached; one forward goes only through those. Each
    begins at the end of the arc by which the car leaves the pose, or comes to it.
    """
    area = search_area(reach)
    wanted = np.repeat(np.asarray(reach.blocks(reach.mask).any(axis=-1))[:, :, None], headings, axis=2)
    begins = [begin(pose, area, limits, headings, rate, (gear,)) for gear in (-1, 1)]
    back = _flood(begins[0], np.zeros_like(wanted), area, rate)
    there = _flood(begins[1], wanted, area, rate, within=back.met)
    return Cycle(np.asarray(wanted & ~there.left), back.met, begins[0].primitives.first_heading)


class Ways:
    """Finds ways of a Dubins car over the whole floor."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.area = search_area(task.reach)
        self._back: dict[float, Bools] = {}
        """Where a pose that was asked about can be reached from, by the first heading of the table: others on the same
        drive can be too."""
        if task.cycle is not None:
            self._back[round(task.cycle.first, 9)] = task.cycle.back
        self._vain = np.zeros_like(task.coverage.reachable)
        """Bins that a flood of all that leads back did not come to."""

    def to_one_of(self, wanted: Bools, pose: Floats, *, anew: bool = True) -> Curve | None:
        """Return the quickest drive from `pose` (3,) to one of the bins `wanted` (nx, ny, n_phi).

        It ends where the car can come back from; None where the flood comes to no such place.

        anew : if there is no way within what is known to lead back, find out what leads back to this pose
        """
        wanted = np.asarray(wanted & ~self._vain)
        if not wanted.any():
            return None
        begun = self._begin(pose, 1)
        branches = self._first_within(begun, wanted)
        if not len(branches) and anew:
            self._learn(pose)
            branches = self._first_within(begun, wanted)
        if not len(branches):
            return None
        return car_curve(
            SearchResult(start=begun.state, sequence=branches, left=wanted), begun, self.task.vehicle.limits
        )

    def leads_back(self, poses: Floats, here: Floats) -> Bools:
        """Tell from which poses (n, 3) a car that is at `here` (3,) comes back: by an arc to a heading of the lattice."""
        if not self._back:
            self._learn(here)
        radius = self.task.vehicle.limits.turning_radius
        x, y, phi = poses.T
        out = np.zeros(len(poses), dtype=np.bool_)
        for first, back in self._back.items():
            n = back.shape[2]
            apart = (phi - first) / (2 * np.pi / n)
            for steps in (np.floor(apart), np.ceil(apart)):
                heading = first + steps * (2 * np.pi / n)
                side = np.sign(heading - phi) * radius
                ends = np.stack(
                    [x + side * (np.sin(heading) - np.sin(phi)), y - side * (np.cos(heading) - np.cos(phi))]
                )
                i, k = np.floor((ends - self.area.origin[:, None]) / FINE).astype(np.int64)
                inside = (i >= 0) & (k >= 0) & (i < back.shape[0]) & (k < back.shape[1])
                out |= inside & back[i * inside, k * inside, steps.astype(np.int64) % n]
        return out

    def _begin(self, pose: Floats, gear: int) -> Entry:
        task = self.task
        return begin(pose, self.area, task.vehicle.limits, task.coverage.headings, task.rate, (gear,))

    def _learn(self, pose: Floats) -> None:
        """Find out what leads back to a pose."""
        begun = self._begin(pose, -1)
        none = np.zeros_like(self.task.coverage.reachable)
        self._back[round(begun.primitives.first_heading, 9)] = _flood(
            begun, none, self.area, self.task.rate
        ).met

    def _first_within(self, begun: Entry, wanted: Bools) -> Int32s:
        """Return the way (n,) within what leads back to the first bin; none where there is no such way."""
        back = self._back.get(round(begun.primitives.first_heading, 9))
        if back is None:
            return np.empty(0, dtype=np.int32)
        found = _flood(begun, wanted, self.area, self.task.rate, within=back, to_first=True)
        if not len(found.branches) and found.met.sum() > FAR * back.sum():
            self._vain |= wanted
        return found.branches


class _Flooded(NamedTuple):
    """What a flood came to."""

    met: Bools
    """(n, n, n_headings) cells of the lattice."""
    left: Bools
    """(nx, ny, n_phi) bins that it did not meet."""
    branches: Int32s
    """(n,) the way to the first one that it met, if that was asked for."""


def _flood(
    begun: Entry,
    wanted: Bools,
    area: SearchArea,
    rate: float,
    *,
    within: Bools | None = None,
    to_first: bool = False,
) -> _Flooded:
    """Flood from where a car begins, within cells of the lattice; all of it, or up to the first bin `wanted`."""
    search = CoverageSearch(area, begun.primitives, wanted, rate)
    search.want(wanted, PATIENCE if to_first else 1.0, inner=False)
    shape = np.ceil(np.array(area.distance.shape) * area.step / FINE - 1e-9).astype(int) + 2
    met = np.zeros((*shape, begun.primitives.n_headings), dtype=np.bool_)
    allowed = np.ones_like(met) if within is None else within
    depth = begun.primitives.safe_depth if to_first else 0
    branches = wavefront(begun.state, allowed, met, depth, search.world, search.primitive_arrays(), FINE)
    return _Flooded(met, search.world.need, branches)


def best_start(reach: Reach, limits: Limits, headings: int, rate: float, seed: int) -> tuple[Floats, Cycle]:
    """Return the pose (3,) of some random ones from which a Dubins car can go to most bins and come back, and what to."""
    rng = np.random.default_rng([seed, 7])
    free = np.argwhere(reach.blocks(reach.mask).all(axis=-1))
    if not len(free):
        free = np.argwhere(reach.cells())
    best: tuple[Floats, Cycle] | None = None
    for _ in range(STARTS):
        place = reach.origin + (free[int(rng.integers(len(free)))] + 0.5) * reach.cell
        primitives = car_primitives(limits, headings, rate, (1,))
        pose = np.array(
            [
                *place,
                wrap(
                    primitives.first_heading + primitives.heading_step * rng.integers(primitives.n_headings)
                ),
            ]
        )
        found = cycle(reach, limits, headings, rate, pose)
        if best is None or found.bins.sum() > best[1].bins.sum():
            best = pose, found
        if best[1].bins.sum() > ENOUGH * reach.cells().sum() * headings:
            break
    assert best is not None
    return best
