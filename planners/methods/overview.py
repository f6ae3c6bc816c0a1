"""The overview of an anytime plan: rounds through the floor, each as long as a share of all before it.

A round is a tour of views: greedily, the view that adds most to what the drive so far has seen, scans on the way
included, and whose cheapest detour still fits (an orienteering problem with a submodular reward: C. Chekuri and M. Pal, A
recursive greedy algorithm for walks in directed graphs, FOCS 2005). A gain per second of detour would turn on the spot for long.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planners.curve import CurveBuilder
from planners.joins.paths import connect
from planners.methods.settings import OVERVIEW
from planners.methods.stop_and_spin import standing_places
from planners.reach import Reach
from planners.rooms import shortest_sequence
from planners.settings import LOG
from planners.task import JoinCounts, PlannedDrive, Survey, Task
from planners.types import Bools, Floats, Ints


def overview(
    task: Task, survey: Survey, here: Floats | None, *, driven: float, until: float
) -> Iterator[PlannedDrive]:
    """Yield rounds, each from the end of the one before; whoever takes them marks what they show.

    Parameters
    ----------
    survey : what the drive so far has shown
    here : (3,) where that drive ends; None: there is none, and the rounds begin at the view of most gain
    driven : [s] that it takes
    until : [s] that it may take with the rounds
    """
    views = _views(task)
    if here is None:
        here = views.poses[int(views.gains(survey).argmax())]
    survey.mark(here[None])
    while driven < until:
        length = min(max(OVERVIEW.first_round, OVERVIEW.growth * driven), until - driven)
        chosen = views.poses[_choose(views, survey.copy(), views.gains(survey), here, length)]
        drive = _drive(chosen, here, task) if len(chosen) else None
        if drive is None:
            return
        yield drive
        here = drive.curve.sample(np.array([drive.curve.duration]))[0][0]
        driven += drive.curve.duration


def _views(task: Task) -> _Stops:
    """Return random poses to choose from, at which the robot stands still for a scan."""
    rng, reach = np.random.default_rng(task.seed), task.reach
    nodes = np.nonzero(reach.mask)
    pick = rng.integers(len(nodes[0]), size=OVERVIEW.candidates)
    places = reach.nodes((nodes[0][pick], nodes[1][pick]))
    poses = np.column_stack([places, rng.uniform(-np.pi, np.pi, len(places))])
    return _Stops(task, poses, poses[:, None], OVERVIEW.turn)


def choose_spins(
    task: Task, survey: Survey, here: Floats, todo: Bools, seconds: float, rng: np.random.Generator
) -> Bools:
    """Choose cells to complete by a spin each in so many seconds, ways from `here` (3,) included.

    Parameters
    ----------
    survey : what the drive so far has shown; is not marked
    todo : (nx, ny, n_phi) bins; their cells are to choose from

    Returns
    -------
    (nx, ny, 1) cells
    """
    cells = standing_places(task.reach, task.barriers, todo)
    pick = rng.permutation(len(cells.index))[: OVERVIEW.candidates // OVERVIEW.looks]
    turn = np.arange(OVERVIEW.looks) * 2 * np.pi / OVERVIEW.looks
    looks = np.empty((len(pick), len(turn), 3))
    looks[:, :, :2] = cells.places[pick, None]
    looks[:, :, 2] = turn
    stops = _Stops(task, looks[:, 0], looks, 2 * np.pi)
    chosen = cells.index[pick[_choose(stops, survey.copy(), stops.gains(survey), here, seconds)]]
    out = np.zeros((*todo.shape[:2], 1), dtype=np.bool_)
    out[tuple(chosen.T)] = True
    return out


class _Stops:
    """Poses to choose from, what is scanned at each, and the driving time between them."""

    def __init__(self, task: Task, poses: Floats, looks: Floats, turn: float) -> None:
        """Prepare the ways.

        Parameters
        ----------
        poses : (n, 3) [m, m, rad] of the robot on arrival
        looks : (n, k, 3) of its scans at each
        turn : [rad] that it turns there, and on its way there
        """
        reach, limits = task.reach, task.vehicle.limits
        self.poses, self.looks, places = poses, looks, poses[:, :2]
        cells = standing_places(reach, task.barriers, reach.cells()[:, :, None])
        self.places, n = cells.places, len(cells.places)
        number = np.full(reach.shape, -1)
        number[tuple(cells.index.T)] = np.arange(n)
        pairs = np.concatenate([cells.pairs, _narrow_ways(reach, number, cells.pairs)])
        lengths = np.hypot(*(cells.places[pairs[:, 1]] - cells.places[pairs[:, 0]]).T)
        self.graph = sparse.csr_matrix((np.maximum(lengths, 1e-6), tuple(pairs.T)), shape=(n, n))
        at = np.floor((places - reach.origin) / reach.cell).astype(np.int64)
        self.near = number[tuple(at.T)]  # (n,) place of the cell that each pose lies in
        lone = self.near < 0
        self.near[lone] = [((cells.places - place) ** 2).sum(axis=1).argmin() for place in places[lone]]
        self.speed = limits.v
        self.stop = limits.v / limits.a + turn / limits.omega + limits.omega / limits.alpha
        """[s] that a stop adds to the way: to brake, to turn, and to get going."""

    def gains(self, survey: Survey) -> Floats:
        """Return (n,) what a stop at each alone would add."""
        n, k, _ = self.looks.shape
        return np.asarray(survey.gain(self.looks.reshape(-1, 3)).reshape(n, k).sum(axis=1))

    def ways_from(self, place: Floats) -> _Ways:
        """Return the ways from a place (2,) to each view."""
        source = ((self.places - place) ** 2).sum(axis=1).argmin()
        far, before = csgraph.dijkstra(self.graph, directed=False, indices=source, return_predecessors=True)
        return _Ways(far[self.near] / self.speed + self.stop, np.asarray(before, dtype=np.int64))

    def on_the_way(self, ways: _Ways, view: int) -> Floats:
        """Return poses (m, 3) on the way to a view, heading along it."""
        route = [int(self.near[view])]
        while (before := int(ways.before[route[-1]])) >= 0:
            route.append(before)
        places = self.places[route[::-1]]
        step = np.diff(places, axis=0)
        return np.column_stack([places[1:], np.arctan2(step[:, 1], step[:, 0])])


def _narrow_ways(reach: Reach, number: Ints, pairs: Ints) -> Ints:
    """Return pairs (k, 2) of cells, between which no straight way is clear, that join parts of the floor by its finer grid.

    Parameters
    ----------
    number : (nx, ny) of each cell; -1: not to stand in
    pairs : (m, 2) of cells with a straight way between them
    """
    n = int(number.max()) + 1
    ways = sparse.csr_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n))
    part = csgraph.connected_components(ways, directed=False)[1]
    fine = np.where(
        reach.mask, np.kron(number, np.ones((reach.per_cell, reach.per_cell), dtype=np.int64)), -1
    )
    found = []
    for one, other in ((fine[:-1], fine[1:]), (fine[:, :-1], fine[:, 1:])):
        apart = (one >= 0) & (other >= 0) & (part[one] != part[other])
        found.append(np.column_stack([one[apart], other[apart]]))
    return np.unique(np.concatenate(found), axis=0)


@dataclass(frozen=True, eq=False)
class _Ways:
    """Ways from one place to all views."""

    seconds: Floats
    """(n,) [s] to drive to each view, and to look there."""
    before: Ints
    """(n places,) the place before each on the shortest way; negative: none."""


def _choose(views: _Stops, survey: Survey, gains: Floats, here: Floats, seconds: float) -> Ints:
    """Return the views (k,) of one round, in order.

    Parameters
    ----------
    survey : is marked by the views
    gains : (n,) what each view alone would add
    """
    tour: list[int] = []
    bound = gains.copy()
    rows = {-1: views.ways_from(here[:2])}
    for _ in range(2):
        _insert(tour, rows, bound, views, survey, seconds)
        if len(tour) > 1:
            cost = np.array([rows[k].seconds[tour] for k in tour])
            tour = [tour[k] for k in shortest_sequence(cost, rows[-1].seconds[tour]).tolist()]
    return np.array(tour, dtype=np.int64)


def _insert(
    tour: list[int], rows: dict[int, _Ways], bound: Floats, views: _Stops, survey: Survey, seconds: float
) -> None:
    """Insert views into the tour, the one of most gain first, as long as the tour takes no more than `seconds`.

    Gains only fall as others are chosen, so those of earlier on are bounds (Minoux 1978).
    """
    while True:
        path = [-1, *tour]
        to = np.array([rows[k].seconds for k in path])  # (len(path), n) from each stop to each view
        legs = np.array([rows[a].seconds[b] for a, b in zip(path[:-1], tour, strict=True)])
        # views are as far from a stop as it is from them
        detours = np.vstack([to[:-1] + to[1:] - legs[:, None], to[-1:]]) if tour else to
        where = detours.argmin(axis=0)
        extra = np.maximum(detours.min(axis=0), views.stop)
        bound_now = np.where(extra <= seconds - legs.sum(), bound, 0.0)
        while True:
            k = int(bound_now.argmax())
            if bound_now[k] <= 0.0:
                return
            bound[k] = bound_now[k] = survey.gain(views.looks[k]).sum()
            if bound_now[k] >= bound_now.max():
                break
        survey.mark(views.looks[k])
        bound[k] = 0.0
        at = int(where[k])
        tour.insert(at, k)
        rows[k] = views.ways_from(views.poses[k, :2])
        survey.mark(views.on_the_way(rows[path[at]], k))
        if at + 1 < len(tour):
            survey.mark(views.on_the_way(rows[k], tour[at + 1]))


def _drive(views: Floats, here: Floats, task: Task) -> PlannedDrive | None:
    """Drive from `here` (3,) through views (n, 3); those to which no path is found are left out. None: there is no other."""
    ends = np.concatenate([here[None, :2], views[:, :2]])
    paths, joins = connect(ends[:-1], ends[1:], reach=task.reach, barriers=task.barriers, seed=task.seed)
    builder = CurveBuilder(here, task.vehicle.limits)
    for view, leg in zip(views, paths, strict=True):
        path, more = leg, JoinCounts()
        if path is not None and not np.allclose(path[0], builder.pose[:2], atol=1e-9):
            (path,), more = connect(
                builder.pose[None, :2],
                view[None, :2],
                reach=task.reach,
                barriers=task.barriers,
                seed=task.seed,
            )
        joins += more
        if path is not None:
            builder.follow(path)
            builder.face(float(view[2]))
            builder.wait(LOG.dwell_periods / task.rate, "view")
    if builder.clock == 0.0:
        return None
    return PlannedDrive(curve=builder.curve(), stops=np.array(builder.stops).reshape(-1, 4), joins=joins)
