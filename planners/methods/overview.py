"""Overview of an anytime plan: rounds through the floor, each with a length proportional to the drive so far.

A round is a tour of views V that maximises the gain g(V) with a driving time of at most `seconds`. The gain
is what the scans at V and on the path show beyond what has been seen. This is an orienteering problem with a
submodular reward (C. Chekuri and M. Pal, A recursive greedy algorithm for walks in directed graphs, FOCS
2005). It is solved greedily: insert the view of the largest gain whose cheapest detour still fits. The gain
per second of detour is no alternative: it makes the robot turn on the spot for long. The constants were set
with `python -m benchmarks.error_by_minutes --arena office` (seed 1).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planners import order
from planners.methods.stop_and_spin import standing_places
from planners.methods.views import drive_views
from planners.reach import Reach
from planners.task import PlannedDrive, Survey, Task
from planners.types import Bools, Floats, Ints

FIRST_ROUND = 100.0
"""[s] duration of the first round; each later one lasts as long as the drive before it."""
N_CANDIDATES = 2500
"""Number of candidate scans."""
N_LOOKS = 4
"""Number of scans of a spin that are evaluated when it is chosen."""
VIEW_TURN = 3.0
"""[rad] mean angle that a robot turns at a view and on the route to it."""


def overview(
    task: Task, survey: Survey, here: Floats | None, *, driven: float, until: float
) -> Iterator[PlannedDrive]:
    """Yield rounds, each from the end of the one before; the caller marks in the survey what a round shows.

    Parameters
    ----------
    survey : What the drive so far has shown.
    here : (3,) End pose of the drive so far; None: the rounds begin at the view of largest gain.
    driven : [s] Duration of the drive so far.
    until : [s] Maximum duration including the rounds.
    """
    views = _views(task)
    if here is None:
        here = views.poses[int(views.gains(survey).argmax())]
    survey.mark(here[None])
    while driven < until:
        length = min(max(FIRST_ROUND, driven), until - driven)
        chosen = views.poses[_choose(views, survey.copy(), views.gains(survey), here, length)]
        drive = drive_views(chosen, here, task) if len(chosen) else None
        if drive is None:
            return
        yield drive
        here = drive.curve.end
        driven += drive.curve.duration


def _views(task: Task) -> _Stops:
    """Return random candidate poses at which the robot stands still for a scan."""
    rng, reach = np.random.default_rng(task.seed), task.reach
    nodes = np.nonzero(reach.mask)
    pick = rng.integers(len(nodes[0]), size=N_CANDIDATES)
    places = reach.nodes((nodes[0][pick], nodes[1][pick]))
    poses = np.column_stack([places, rng.uniform(-np.pi, np.pi, len(places))])
    return _Stops(task, poses, poses[:, None], VIEW_TURN)


def choose_spins(
    task: Task, survey: Survey, here: Floats, todo: Bools, seconds: float, rng: np.random.Generator
) -> Bools:
    """Choose cells to complete with one spin each within `seconds`, including the transits from `here` (3,).

    Parameters
    ----------
    survey : What the drive so far has shown; it is not marked.
    todo : (nx, ny, n_phi) Bins; their cells are the candidates.

    Returns
    -------
    The chosen cells (nx, ny, 1).
    """
    cells = standing_places(task.reach, task.barriers, todo)
    pick = rng.permutation(len(cells.index))[: N_CANDIDATES // N_LOOKS]
    turn = np.arange(N_LOOKS) * 2 * np.pi / N_LOOKS
    looks = np.empty((len(pick), len(turn), 3))
    looks[:, :, :2] = cells.places[pick, None]
    looks[:, :, 2] = turn
    stops = _Stops(task, looks[:, 0], looks, 2 * np.pi)
    chosen = cells.index[pick[_choose(stops, survey.copy(), stops.gains(survey), here, seconds)]]
    out = np.zeros((*todo.shape[:2], 1), dtype=np.bool_)
    out[tuple(chosen.T)] = True
    return out


class _Stops:
    """Candidate stops: their poses, the scans at each, and the driving times between them."""

    def __init__(self, task: Task, poses: Floats, looks: Floats, turn: float) -> None:
        """Prepare the graph of routes.

        Parameters
        ----------
        poses : (n, 3) [m, m, rad] Pose of the robot on arrival.
        looks : (n, k, 3) [m, m, rad] Poses of the scans at each stop.
        turn : [rad] Angle turned at a stop and on the route to it.
        """
        reach, limits = task.reach, task.vehicle.limits
        self.poses, self.looks, places = poses, looks, poses[:, :2]
        cells = standing_places(reach, task.barriers, reach.cells()[:, :, None])
        self.places, n = cells.places, len(cells.places)
        number = np.full(reach.shape, -1)
        number[tuple(cells.index.T)] = np.arange(n)
        pairs = np.concatenate([cells.pairs, _narrow_passages(reach, number, cells.pairs)])
        lengths = np.hypot(*(cells.places[pairs[:, 1]] - cells.places[pairs[:, 0]]).T)
        self.graph = sparse.csr_matrix((np.maximum(lengths, 1e-6), tuple(pairs.T)), shape=(n, n))
        at = np.floor((places - reach.origin) / reach.cell).astype(np.int64)
        self.near = number[tuple(at.T)]  # (n,) place in the cell of each pose
        lone = self.near < 0
        self.near[lone] = [((cells.places - place) ** 2).sum(axis=1).argmin() for place in places[lone]]
        self.speed = limits.v
        self.stop = limits.v / limits.a + turn / limits.omega + limits.omega / limits.alpha
        """[s] added by a stop: braking, turning, and accelerating."""

    def gains(self, survey: Survey) -> Floats:
        """Return the gain (n,) of each stop on its own."""
        n, k, _ = self.looks.shape
        return np.asarray(survey.gain(self.looks.reshape(-1, 3)).reshape(n, k).sum(axis=1))

    def routes_from(self, place: Floats) -> _Routes:
        """Return the routes from a place (2,) to each stop."""
        source = ((self.places - place) ** 2).sum(axis=1).argmin()
        far, before = csgraph.dijkstra(self.graph, directed=False, indices=source, return_predecessors=True)
        return _Routes(far[self.near] / self.speed + self.stop, np.asarray(before, dtype=np.int64))

    def poses_along(self, routes: _Routes, view: int) -> Floats:
        """Return poses (m, 3) on the route to a stop, heading along it."""
        route = [int(self.near[view])]
        while (before := int(routes.before[route[-1]])) >= 0:
            route.append(before)
        places = self.places[route[::-1]]
        step = np.diff(places, axis=0)
        return np.column_stack([places[1:], np.arctan2(step[:, 1], step[:, 0])])


def _narrow_passages(reach: Reach, number: Ints, pairs: Ints) -> Ints:
    """Return pairs (k, 2) of cells without a clear straight move that connect parts of the floor on its finer raster.

    Parameters
    ----------
    number : (nx, ny) Index of each cell's place; -1: no place.
    pairs : (m, 2) Pairs of cells with a clear straight move.
    """
    n = int(number.max()) + 1
    links = sparse.csr_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n))
    part = csgraph.connected_components(links, directed=False)[1]
    fine = np.where(
        reach.mask, np.kron(number, np.ones((reach.per_cell, reach.per_cell), dtype=np.int64)), -1
    )
    found = []
    for one, other in ((fine[:-1], fine[1:]), (fine[:, :-1], fine[:, 1:])):
        apart = (one >= 0) & (other >= 0) & (part[one] != part[other])
        found.append(np.column_stack([one[apart], other[apart]]))
    return np.unique(np.concatenate(found), axis=0)


@dataclass(frozen=True, eq=False)
class _Routes:
    """Shortest routes from one place to all stops."""

    seconds: Floats
    """(n,) [s] to drive to each stop, including the stop."""
    before: Ints
    """(n places,) predecessor of each place on its shortest route; negative: none."""


def _choose(views: _Stops, survey: Survey, gains: Floats, here: Floats, seconds: float) -> Ints:
    """Return the views (k,) of one round, in order.

    Parameters
    ----------
    survey : Marked with the views of the round.
    gains : (n,) Gain of each view on its own.
    """
    tour: list[int] = []
    bound = gains.copy()
    rows = {-1: views.routes_from(here[:2])}
    for _ in range(2):
        _insert(tour, rows, bound, views, survey, seconds)
        if len(tour) > 1:
            cost = np.array([rows[k].seconds[tour] for k in tour])
            tour = [tour[k] for k in order.sequence(cost, rows[-1].seconds[tour]).tolist()]
    return np.array(tour, dtype=np.int64)


def _insert(
    tour: list[int], rows: dict[int, _Routes], bound: Floats, views: _Stops, survey: Survey, seconds: float
) -> None:
    """Insert views into the tour, largest gain first, while the tour takes at most `seconds`.

    Gains never increase as other views are chosen, so earlier gains are upper bounds (lazy greedy algorithm,
    Minoux 1978).
    """
    while True:
        path = [-1, *tour]
        to = np.array([rows[k].seconds for k in path])  # (len(path), n) from each stop to each view
        legs = np.array([rows[a].seconds[b] for a, b in zip(path[:-1], tour, strict=True)])
        # the driving time between a stop and a view is the same in both directions
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
        rows[k] = views.routes_from(views.poses[k, :2])
        survey.mark(views.poses_along(rows[path[at]], k))
        if at + 1 < len(tour):
            survey.mark(views.poses_along(rows[k], tour[at + 1]))
