"""The search for a drive that fills bins: a receding-horizon beam over closed-form primitives, and its curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.curve import Curve, displace
from planners.reach import Reach
from planners.rooms import SIDES, links
from planners.search.beam import LONGEST_FLOOD, Hunt, Outlook, advance, desk, potential
from planners.search.heuristic import lattice
from planners.search.kernel_world import CREDITS, Moves, World, drive, escape
from planners.search.motion_primitives import Table
from planners.types import Bools, Floats, Ints

INNER = 0.12
"""A cell with at least this share of its inner half in reach is visited there; others anywhere."""
LATTICE = 0.03
"""[m] states closer than this are alike."""
AROUND = 8
"""Cells round a room that the search may use."""
SPREAD = 0.1
"""By how much the values of cells differ from seed to seed."""
SHORT = 0.85
"""Of a log period: enough in the inner half of a cell, since the way out of the cell takes the rest."""
SLICE = 20
"""Decisions between two looks at the clock."""
PASSED_OVER = 16
"""Times that a search goes on after it has come to nothing, at most."""
STOPPED, DONE, OUT_OF_REACH, GAVE_UP = range(4)
"""What a run may come to."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How hard the search thinks."""

    beam: int = 100
    """States kept at each step ahead."""
    ahead: float = 6.3
    """[s] that it looks ahead, about a revolution."""
    executed: float = 1.6
    """[s] that it drives before it looks again."""
    discount: float = 0.19
    """Of a bin's value, lost over the whole look ahead."""
    pull: float = 0.5
    """Value of being one cell nearer to the nearest bin that is missing, at the end of the look ahead."""
    eagerness: float = 6.0
    """Value of a cell's last bin against its first: what is begun is finished."""
    least: int = 3
    """Bins below which a flood for the nearest bin takes over."""
    flood_layers: int = 96
    """Units of time that a flood looks ahead."""
    flood_width: int = 1500
    """States that a flood keeps of each unit."""
    flood_states: int = 300_000
    """States after which a flood gives up."""
    narrow: int = 0
    """States that a flood keeps of each unit if it knows how far what is missing is, before a wide one; 0: it does not."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What the search drives in: a part of the floor."""

    corner: Ints
    """(2,) cell of the whole grid that is cell (0, 0) here."""
    origin: Floats
    """(2,) [m]"""
    step: float
    """[m] between nodes of `distance`."""
    cell: float
    """[m]"""
    least: float
    """[m] distance that the robot's centre keeps."""
    distance: Floats
    """(mx, my) [m]"""
    inner: Bools
    """(nx, ny) cells of which only the inner half counts."""
    links: Ints
    """(nx, ny) bits of `rooms.links`."""

    def part(self, array: np.ndarray) -> np.ndarray:
        """Return the part of an array (whole nx, whole ny, ...) that lies in this scene."""
        (i, k), (nx, ny) = self.corner, self.inner.shape
        return np.ascontiguousarray(array[i : i + nx, k : k + ny])


def scene(reach: Reach, cells: Bools | None = None) -> Scene:
    """Return the scene of the whole floor, or of what lies round `cells` (nx, ny)."""
    (nx, ny), p = reach.shape, reach.per_cell
    low, high = np.zeros(2, dtype=np.int64), np.array([nx, ny])
    if cells is not None:
        at = np.argwhere(cells)
        low, high = np.maximum(at.min(axis=0) - AROUND, 0), np.minimum(at.max(axis=0) + 1 + AROUND, high)
    window = np.s_[low[0] : high[0], low[1] : high[1]]
    nodes = np.s_[low[0] * p : high[0] * p, low[1] * p : high[1] * p]
    linked = links(reach)[window].copy()
    for bit, (i, k) in enumerate(SIDES):  # no way out of the scene
        for axis, side in ((0, i), (1, k)):
            if side:
                edge = linked[-1 if side > 0 else 0] if axis == 0 else linked[:, -1 if side > 0 else 0]
                edge &= ~(1 << bit)
    return Scene(
        corner=low,
        origin=reach.origin + low * reach.cell,
        step=reach.step,
        cell=reach.cell,
        least=reach.clearance,
        distance=np.ascontiguousarray(reach.distance[nodes]),
        inner=np.ascontiguousarray(_inner(reach)[window]),
        links=linked,
    )


def _inner(reach: Reach) -> Bools:
    """Return (nx, ny) cells whose inner half can be reached, at least in part."""
    p = reach.per_cell
    blocks = reach.blocks(reach.mask).reshape(*reach.shape, p, p)
    within = abs((np.arange(p) + 0.5) / p - 0.5) <= 0.25
    return np.asarray(blocks[:, :, within][:, :, :, within].mean(axis=(2, 3)) >= INNER)


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """A drive of the search, from rest to rest."""

    start: Floats
    """(4,) x, y [m], heading step, mode."""
    sequence: NDArray[np.int32]
    """(n,) branches."""
    left: Bools
    """(nx, ny, n_phi) bins of the scene that it did not get."""


class Search:
    """One search in one scene."""

    def __init__(
        self,
        place: Scene,
        table: Table,
        need: Bools,
        rate: float,
        *,
        seed: int = 0,
        value: Floats | None = None,
        settings: Settings | None = None,
    ) -> None:
        """Prepare.

        Parameters
        ----------
        need : (nx, ny, n_phi) bins wanted, of the scene
        rate : [Hz] of the log
        value : (nx, ny) of the cells
        """
        self.place, self.table, self.rate = place, table, rate
        self.settings = settings or Settings()
        self.rng = np.random.default_rng(seed)
        self.value = 1.0 + SPREAD * self.rng.random(need.shape[:2])
        if value is not None:
            self.value *= value
        size = np.ones(3, dtype=np.int64)
        if table.safe_depth > 1:
            size[:] = (
                *np.ceil(np.array(place.distance.shape) * place.step / LATTICE).astype(int) + 1,
                table.n_headings,
            )
        self._trapped = np.zeros(size, dtype=np.bool_)
        self.want(need)
        self.state = np.zeros(4)
        self.start = self.state.copy()
        self._sequence = np.empty(0, dtype=np.int32)
        self._parts: list[NDArray[np.int32]] = []
        self.given_up = np.zeros_like(need)
        self._before = [self._here()]

    def want(self, need: Bools, patience: float = 1.0, *, inner: bool = True) -> None:
        """Set the bins to drive for; `patience` stretches the time to stay in each."""
        where = self.place
        dwell = patience / self.rate
        self.world = World(
            distance=where.distance,
            need=need.copy(),
            missing=need.sum(axis=2).astype(np.int64),
            inner=where.inner if inner else np.zeros_like(where.inner),
            value=self.value,
            links=where.links,
            x0=float(where.origin[0]),
            y0=float(where.origin[1]),
            step=where.step,
            cell=where.cell,
            least=where.least,
            dwell=dwell,
            inner_dwell=SHORT * dwell,
            trapped=self._trapped,
        )

    def begin(self, state: Floats) -> None:
        """Start from (x, y, heading step, mode)."""
        self.state, self.start = state.copy(), state.copy()

    @property
    def left(self) -> int:
        """Count of bins still wanted."""
        return int(self.world.missing.sum())

    def run(self, tick: Callable[[int], bool]) -> int:
        """Drive until all is done or nothing more can be had; `tick` takes the bins left and answers whether to go on.

        Returns DONE, OUT_OF_REACH (of what is left, at this resolution), GAVE_UP, or STOPPED by `tick`.
        """
        hunt, moves = self._hunt(), self.moves()
        room, ahead = desk(hunt, moves), self._outlook()
        counters = np.array([0, self.left, 0, 0])
        sequence = np.empty(SLICE * LONGEST_FLOOD, dtype=np.int32)
        while counters[3] == 0:
            counters[0] = 0
            self._before = [*self._before[-1:], self._here()]
            advance(self.state, SLICE, hunt, self.world, moves, ahead, room, sequence, counters)
            self._parts.append(sequence[: counters[0]].copy())
            if not tick(int(counters[1])):
                break
        return int(counters[3])

    def complete(self, tick: Callable[[int], bool]) -> None:
        """Run until nothing more can be had: pass over cells that nothing leads into, and turn back from traps."""
        for _ in range(PASSED_OVER):
            status = self.run(tick)
            if status in (STOPPED, DONE) or (status == OUT_OF_REACH and not self._is_trapped()):
                return
            if status == OUT_OF_REACH:
                self._turn_back()
            if not self._pass_over():
                return

    def _is_trapped(self) -> bool:
        """Tell whether nothing leads from here back to where the robot began."""
        i, k = ((self.start[:2] - self.place.origin) / self.place.cell).astype(np.int64).tolist()
        home = np.zeros_like(self.world.need)
        home[i, k] = True
        way = Search(self.place, self.table, home, self.rate, settings=self.settings)
        way.want(home, inner=False)
        way.begin(self.state)
        return way.run(lambda _: False) == OUT_OF_REACH

    def _turn_back(self) -> None:
        """Go back to before the last decisions, and want no more of the cell where the robot cannot go on from."""
        i, k = self._cell
        self.state, self.world.need[:], self.world.missing[:], n_parts = self._before.pop(0)
        self._before.clear()
        del self._parts[n_parts:]
        self._give_up(i, k)

    def _pass_over(self) -> bool:
        """Want no more of the nearest cell where something is missing; False if no such cell is in the robot's reach."""
        world = self.world
        far, queue = np.empty(world.missing.shape, np.int64), np.empty(world.missing.size, np.int64)
        potential(world, far, queue)
        i, k = self._cell
        while 0 < far[i, k] <= far.size:
            ways = [(i + a, k + b) for bit, (a, b) in enumerate(SIDES) if world.links[i, k] >> bit & 1]
            i, k = min(ways, key=lambda way: int(far[way]))
        if far[i, k] > 0:
            return False
        self._give_up(i, k)
        return self.left > 0

    def _here(self) -> tuple[Floats, Bools, Ints, int]:
        """Return the state, the bins still wanted, how many of a cell, and how many parts were driven."""
        return self.state.copy(), self.world.need.copy(), self.world.missing.copy(), len(self._parts)

    @property
    def _cell(self) -> tuple[int, int]:
        """Cell of the scene where the robot is."""
        i, k = ((self.state[:2] - self.place.origin) / self.place.cell).astype(np.int64).tolist()
        return i, k

    def _give_up(self, i: int, k: int) -> None:
        """Want no more of a cell."""
        self.given_up[i, k] |= self.world.need[i, k]
        self.world.need[i, k], self.world.missing[i, k] = False, 0

    def rest(self) -> bool:
        """Drive on until the robot stands still but for its spin; False if that is not found."""
        out, credits = np.empty(64, dtype=np.int32), np.empty(CREDITS, dtype=np.int64)
        x, y, h, m = self.state.tolist()
        n = escape(x, y, int(h), int(m), -24, self.world, self.moves(), credits, out)
        for j in out[: max(n, 0)].tolist():
            drive(self.state, j, self.world, self.moves(), credits)
        self._parts.append(out[: max(n, 0)].copy())
        return bool(n >= 0)

    def found(self) -> Found:
        """Return what was driven so far."""
        return Found(
            start=self.start,
            sequence=np.concatenate([np.empty(0, dtype=np.int32), *self._parts]),
            left=self.world.need.copy(),
        )

    def _hunt(self) -> Hunt:
        s, unit = self.settings, self.table.unit
        horizon = max(round(s.ahead / unit), 4)
        return Hunt(
            horizon=horizon,
            executed=max(round(s.executed / unit), 1),
            width=s.beam,
            safe_depth=self.table.safe_depth,
            least=s.least,
            flood_layers=s.flood_layers,
            flood_width=s.flood_width,
            flood_states=s.flood_states,
            discount=s.discount / horizon,
            pull=s.pull,
            eagerness=s.eagerness,
            lattice=LATTICE,
            narrow=s.narrow,
        )

    def _outlook(self) -> Outlook:
        where = self.place
        grid = lattice(self.table, where.distance, where.step, where.cell, where.least)
        side = grid.side if self.settings.narrow > 0 else 1
        value = np.empty(side * side * len(grid.bins) * grid.n_gears, dtype=np.int16)
        room = np.empty((2, 4 * value.size), dtype=np.int32)
        heads = np.empty(int(grid.cost.max()) + grid.pause + 1, dtype=np.int32)
        return Outlook(grid, value, room[0], room[1], heads, np.zeros(2, dtype=np.int64))

    def moves(self) -> Moves:
        """Return the table as the kernels take it."""
        t = self.table
        apart = t.ways - t.ways[..., [(t.ways.shape[3] - 1) // 2], :]
        longest = float(np.hypot(*np.moveaxis(apart, -1, 0)).max()) + 2 * self.place.step
        return Moves(
            t.ways, t.bins, t.core, t.turn, t.then, t.cost, t.period, t.patient, t.stops, t.rests, longest
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Visit:
    """How one room is driven, from rest to rest."""

    curve: Curve
    stops: Floats
    """(n, 4) [m, m, rad, rad] where each revolution begins, and its angle."""
    left: int
    """Bins of the room that it does not get."""

    @property
    def ends(self) -> tuple[Floats, Floats]:
        """Poses (3,) at rest before and after."""
        poses = self.curve.sample(np.array([0.0, self.curve.duration]))[0]
        return poses[0], poses[1]


def spin_curve(found: Found, table: Table, alpha: float) -> Curve:
    """Return the curve of a spinning drive: spin up, the primitives, spin down.

    Parameters
    ----------
    alpha : [rad/s²] of spinning up and down
    """
    omega, sense = table.omega, float(np.sign(table.omega))
    modes = _modes(found, table)
    n = len(found.sequence)
    v = table.speeds[modes]
    ramp = abs(omega) / alpha
    dt = np.concatenate([[ramp], np.full(n, table.unit), [ramp]])
    twists = np.zeros((n + 2, 2))
    twists[1:, 1] = omega
    twists[1:-1, 0] = v[:-1]
    rates = np.zeros((n + 2, 2))
    rates[1:-1, 0] = np.diff(v) / table.unit
    rates[[0, -1], 1] = sense * alpha, -sense * alpha
    heading = table.first + table.step * found.start[2] - sense * 0.5 * abs(omega) * ramp
    labels = np.full(n + 2, "drift")
    labels[[0, -1]] = "turn"
    return chained(np.array([*found.start[:2], heading]), dt, twists, rates, labels)


def _modes(found: Found, table: Table) -> Ints:
    """Return (n + 1,) the mode before each primitive, and after the last."""
    modes = np.empty(len(found.sequence) + 1, dtype=np.int64)
    modes[0] = int(found.start[3])
    then = table.then.tolist()
    mode = int(modes[0])
    for k, j in enumerate(found.sequence.tolist()):
        mode = then[mode][j]
        modes[k + 1] = mode
    return modes


def chained(pose: Floats, dt: Floats, twists: Floats, rates: Floats, labels: NDArray[np.str_]) -> Curve:
    """Return the curve of pieces that start at `pose` (3,) and last `dt` (n,) [s], twists and rates being (n, 2)."""
    turned = twists[:, 1] * dt + 0.5 * rates[:, 1] * dt * dt
    phi = pose[2] + np.concatenate([[0.0], np.cumsum(turned)[:-1]])
    way = np.stack(displace(phi, twists[:, 0], rates[:, 0], twists[:, 1], rates[:, 1], dt), axis=1)
    places = pose[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(way, axis=0)[:-1]])
    starts = np.concatenate([[0.0], np.cumsum(dt)])
    return Curve(
        starts=starts[:-1],
        duration=float(starts[-1]),
        poses=np.column_stack([places, phi]),
        twists=twists,
        rates=rates,
        labels=labels,
    )
