"""Returnable sets of Dubins cars, and paths over the whole floor, by a wavefront over the primitives.

Every state of the wavefront is one that the car can be in, and each cell of a fine lattice is entered once. A
path is therefore found through any gap that the lattice resolves; planners with random samples find such gaps
only by chance.

`wavefront` gives all states that a car can reach, or the path to the first bin. The reached set R contains the
lattice cell of the start state. For each state s in R it contains the cell of f(s, j), for every clear branch j
with its end in `allowed`. Each cell keeps the first state that enters it (breadth-first search), so every state
in R is one that the car can be in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.arena import wrap
from planners.cars.entry import EntryArc, curve_of_search, entry_arc
from planners.curve import Curve
from planners.kernel import inner_kernel, kernel
from planners.reach import Reach, ReturnableSet
from planners.search.area import SearchArea, search_area
from planners.search.kernel_world import (
    Scratch,
    SearchWorld,
    end_state,
    find_escape,
    new_scratch,
    trace_back,
    try_primitive,
    wide,
)
from planners.search.motion_primitives import MotionPrimitives, car_primitives
from planners.search.search import RETRY_DWELL, CoverageSearch, SearchResult
from planners.task import Task
from planners.types import Bools, Floats, Int32s, Ints
from planners.vehicle import Limits


class WavefrontQueue(NamedTuple):
    """The states that the wavefront has reached, in order of arrival."""

    at: Floats
    """(n, 2) [m] places; `hs` (n,) heading steps, `parents` (n,), `branches` (n,)."""
    hs: Int32s
    parents: Int32s
    branches: Int32s


@kernel
def new_queue(n: int) -> WavefrontQueue:
    """Return memory for n states."""
    return WavefrontQueue(
        np.empty((n, 2)), np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    )


@kernel
def doubled(queue: WavefrontQueue) -> WavefrontQueue:
    """Return the queue with twice its capacity."""
    n = len(queue.hs)
    more = new_queue(2 * n)
    for k in range(n):
        more.at[k, 0], more.at[k, 1], more.hs[k] = queue.at[k, 0], queue.at[k, 1], queue.hs[k]
        more.parents[k], more.branches[k] = queue.parents[k], queue.branches[k]
    return more


@inner_kernel
def _expand_wavefront(
    head: int,
    tail: int,
    queue: WavefrontQueue,
    allowed: Bools,
    reached: Bools,
    to_first: bool,
    world: SearchWorld,
    primitives: MotionPrimitives,
    lattice: float,
    covered: Ints,
) -> int:
    """Queue the successors of state `head`; return the new end of the queue.

    Parameters
    ----------
    to_first : Whether to look for the first bin: branches that cover a bin are then stored as -1 - branch.
    """
    ny, n_phi = world.need.shape[1], world.need.shape[2]
    x, y, h = queue.at[head, 0], queue.at[head, 1], wide(queue.hs[head])
    for j in range(primitives.next_mode.shape[1]):
        free, n_covered = try_primitive(x, y, h, 0, j, world, primitives, covered)
        if not free:
            continue
        x2, y2, h2, _ = end_state(x, y, h, 0, j, primitives)
        i, k = int((x2 - world.x0) / lattice), int((y2 - world.y0) / lattice)
        if not allowed[i, k, h2]:
            continue
        for c in range(n_covered):
            ci, ck, b = covered[c] // (n_phi * ny), (covered[c] // n_phi) % ny, covered[c] % n_phi
            world.missing[ci, ck] -= world.need[ci, ck, b]
            world.need[ci, ck, b] = False
        is_end = to_first and n_covered > 0
        if is_end or not reached[i, k, h2]:
            reached[i, k, h2] = True
            queue.at[tail, 0], queue.at[tail, 1], queue.hs[tail] = x2, y2, h2
            queue.parents[tail], queue.branches[tail] = head, -1 - j if is_end else j
            tail += 1
    return tail


@kernel
def wavefront(
    state: Floats,
    allowed: Bools,
    reached: Bools,
    depth: int,
    world: SearchWorld,
    primitives: MotionPrimitives,
    lattice: float,
    scratch: Scratch,
) -> Int32s:
    """Visit all states reachable within `allowed`, or stop at the first bin; breadth first over the primitives.

    Bins in which a primitive stays long enough are removed from those that the world needs.

    Parameters
    ----------
    state : (4,) Start state.
    allowed : (n, n, n_headings) Lattice cells that may be entered.
    reached : (n, n, n_headings) Filled with the lattice cells that are entered.
    depth : 0: visit all states. Otherwise: stop at the first bin from which this many branches can follow.
    lattice : [m] Side of a lattice cell.

    Returns
    -------
    The branches (n,) to the first bin; empty if depth is 0, or if no bin is found.
    """
    reached[:] = False
    queue = new_queue(1 << 16)
    queue.at[0, 0], queue.at[0, 1], queue.hs[0], queue.parents[0] = state[0], state[1], int(state[2]), -1
    head, tail = 0, 1
    reached[int((state[0] - world.x0) / lattice), int((state[1] - world.y0) / lattice), queue.hs[0]] = True
    while head < tail:
        if tail + primitives.next_mode.shape[1] > len(queue.hs):
            queue = doubled(queue)
        new = tail
        tail = _expand_wavefront(
            head, tail, queue, allowed, reached, depth > 0, world, primitives, lattice, scratch.covered
        )
        head += 1
        for end in range(new, tail):
            if queue.branches[end] < 0:
                queue.branches[end] = -1 - queue.branches[end]
                x, y, h = queue.at[end, 0], queue.at[end, 1], queue.hs[end]
                if find_escape(x, y, int(h), 0, depth, world, primitives, scratch) >= 0:
                    out = np.empty(end, np.int32)
                    return out[: trace_back(end, queue.parents, queue.branches, out)].copy()
    return np.empty(0, np.int32)


LATTICE = 0.02
"""[m] side of a lattice cell; a path is found through any gap that this resolves."""
EXHAUSTIVE_SHARE = 0.25
"""Share of the returnable states; a wavefront that reached more, and no wanted bin, is not repeated for these bins."""
START_TRIES = 6
"""Number of random poses among which a start is chosen."""
GOOD_START_SHARE = 0.5
"""Share of all bins at which a start is good enough."""


def returnable_set(reach: Reach, limits: Limits, headings: int, rate: float, pose: Floats) -> ReturnableSet:
    """Return the bins that a Dubins car at `pose` (3,) can reach and return from.

    A backward wavefront marks the states B from which the pose can be reached. A forward wavefront within B
    gives the bins. Each wavefront begins at the end of the arc by which the car leaves the pose or arrives at
    it.
    """
    area = search_area(reach)
    wanted = np.repeat(np.asarray(reach.blocks(reach.mask).any(axis=-1))[:, :, None], headings, axis=2)
    begins = [entry_arc(pose, area, limits, headings, rate, (gear,)) for gear in (-1, 1)]
    back = _run_wavefront(begins[0], np.zeros_like(wanted), area, rate)
    there = _run_wavefront(begins[1], wanted, area, rate, within=back.reached)
    return ReturnableSet(np.asarray(wanted & ~there.left), back.reached, begins[0].primitives.first_heading)


class ReachabilityPlanner:
    """Plan paths of a car over the whole floor, each in one gear.

    A car with a reverse gear can return on the same path.
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        self.area = search_area(task.reach)
        self._return_sets: dict[float, Bools] = {}
        """Lattice cells from which a known pose can be reached, by the first heading of the lattice.

        Other poses of the same drive can be reached from there too."""
        if task.returnable is not None:
            self._return_sets[round(task.returnable.first_heading, 9)] = task.returnable.returns
        self._unreached = np.zeros_like(task.coverage.reachable)
        """Bins that an exhaustive wavefront did not reach."""

    def path_to_any(self, wanted: Bools, pose: Floats, *, explore: bool = True) -> Curve | None:
        """Return the quickest drive from `pose` (3,) to one of the bins `wanted` (nx, ny, n_phi).

        It ends where the car can return. None if the wavefront finds no such path.

        Parameters
        ----------
        explore : If no path back is known, compute the states from which this pose can be reached. A car with
            a reverse
            gear needs none.
        """
        wanted = np.asarray(wanted & ~self._unreached)
        if not wanted.any():
            return None
        if self.task.vehicle.drive == "reeds_shepp":
            return self._path_in_one_gear(wanted, pose)
        entered = self._enter(pose, 1)
        branches = self._path_to_first(entered, wanted)
        if not len(branches) and explore:
            self._find_return_set(pose)
            branches = self._path_to_first(entered, wanted)
        if not len(branches):
            return None
        return self._curve(entered, branches, wanted)

    def _path_in_one_gear(self, wanted: Bools, pose: Floats) -> Curve | None:
        """Return a drive to one of the bins `wanted`, all forward or else all backward, or None."""
        everywhere = int(self.task.reach.mask.sum())  # number of nodes, about that of the lattice's positions
        for gear in (1, -1):
            entered = self._enter(pose, gear)
            found = _run_wavefront(entered, wanted, self.area, self.task.rate, to_first=True)
            if len(found.branches):
                return self._curve(entered, found.branches, wanted)
            if found.reached.sum() > EXHAUSTIVE_SHARE * everywhere * found.reached.shape[2]:
                self._unreached |= wanted
                return None
        return None

    def _curve(self, entered: EntryArc, branches: Int32s, wanted: Bools) -> Curve:
        result = SearchResult(start=entered.state, sequence=branches, left=wanted)
        return curve_of_search(result, entered, self.task.vehicle.limits)

    def can_return(self, poses: Floats, here: Floats) -> Bools:
        """Return whether a car at `here` (3,) can return from each pose (n, 3).

        The car first drives an arc to a heading of the lattice.
        """
        if not self._return_sets:
            self._find_return_set(here)
        radius = self.task.vehicle.limits.turning_radius
        x, y, phi = poses.T
        out = np.zeros(len(poses), dtype=np.bool_)
        for first, back in self._return_sets.items():
            n = back.shape[2]
            apart = (phi - first) / (2 * np.pi / n)
            for steps in (np.floor(apart), np.ceil(apart)):
                heading = first + steps * (2 * np.pi / n)
                side = np.sign(heading - phi) * radius
                ends = np.stack(
                    [x + side * (np.sin(heading) - np.sin(phi)), y - side * (np.cos(heading) - np.cos(phi))]
                )
                i, k = np.floor((ends - self.area.origin[:, None]) / LATTICE).astype(np.int64)
                inside = (i >= 0) & (k >= 0) & (i < back.shape[0]) & (k < back.shape[1])
                out |= inside & back[i * inside, k * inside, steps.astype(np.int64) % n]
        return out

    def _enter(self, pose: Floats, gear: int) -> EntryArc:
        task = self.task
        return entry_arc(pose, self.area, task.vehicle.limits, task.coverage.headings, task.rate, (gear,))

    def _find_return_set(self, pose: Floats) -> None:
        """Compute the states from which a pose can be reached."""
        entered = self._enter(pose, -1)
        none = np.zeros_like(self.task.coverage.reachable)
        self._return_sets[round(entered.primitives.first_heading, 9)] = _run_wavefront(
            entered, none, self.area, self.task.rate
        ).reached

    def _path_to_first(self, entered: EntryArc, wanted: Bools) -> Int32s:
        """Return the branches (n,) to the first wanted bin through returnable states; empty if none is found."""
        back = self._return_sets.get(round(entered.primitives.first_heading, 9))
        if back is None:
            return np.empty(0, dtype=np.int32)
        found = _run_wavefront(entered, wanted, self.area, self.task.rate, within=back, to_first=True)
        if not len(found.branches) and found.reached.sum() > EXHAUSTIVE_SHARE * back.sum():
            self._unreached |= wanted
        return found.branches


class _WavefrontResult(NamedTuple):
    """The states and bins that a wavefront reached."""

    reached: Bools
    """(n, n, n_headings) cells of the lattice."""
    left: Bools
    """(nx, ny, n_phi) bins that it did not reach."""
    branches: Int32s
    """(n,) branches to the first bin, if `to_first`."""


def _run_wavefront(
    entered: EntryArc,
    wanted: Bools,
    area: SearchArea,
    rate: float,
    *,
    within: Bools | None = None,
    to_first: bool = False,
) -> _WavefrontResult:
    """Run a wavefront from a car's start state.

    Parameters
    ----------
    wanted : (nx, ny, n_phi) Bins to reach.
    within : Lattice cells that may be entered; None: all.
    to_first : Whether to stop at the first wanted bin.
    """
    search = CoverageSearch(area, entered.primitives, wanted, rate)
    search.want(wanted, RETRY_DWELL[0] if to_first else 1.0, inner=False)
    shape = np.ceil(np.array(area.distance.shape) * area.step / LATTICE - 1e-9).astype(int) + 2
    reached = np.zeros((*shape, entered.primitives.n_headings), dtype=np.bool_)
    allowed = np.ones_like(reached) if within is None else within
    depth = entered.primitives.safe_depth if to_first else 0
    branches = wavefront(
        entered.state,
        allowed,
        reached,
        depth,
        search.world,
        entered.primitives,
        LATTICE,
        new_scratch(abs(depth)),
    )
    return _WavefrontResult(reached, search.world.need, branches)


def best_start(
    reach: Reach, limits: Limits, headings: int, rate: float, seed: int
) -> tuple[Floats, ReturnableSet]:
    """Return the pose (3,) of the largest returnable set among random poses of a Dubins car, and that set."""
    rng = np.random.default_rng([seed, 7])
    free = np.argwhere(reach.blocks(reach.mask).all(axis=-1))
    if not len(free):
        free = np.argwhere(reach.cells())
    best: tuple[Floats, ReturnableSet] | None = None
    for _ in range(START_TRIES):
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
        found = returnable_set(reach, limits, headings, rate, pose)
        if best is None or found.bins.sum() > best[1].bins.sum():
            best = pose, found
        if best[1].bins.sum() > GOOD_START_SHARE * reach.cells().sum() * headings:
            break
    assert best is not None
    return best
