"""Shortest paths over a grid, a pilot that follows them, turns, stops and backs up, and what the base makes of it."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from shapely.geometry import LineString
from shapely.prepared import prep

from benchmarks.hidden_effects.geometry import largest_part, wrapped
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.blind.base import N_LOGGED, STEP, Base, advance, start_state
from benchmarks.hidden_effects.worlds.blind.robots import Robot

GRID_STEP = 0.08
"""[m]"""
PATH_STEP = 0.04
"""[m] between points of a path."""


def densified(points: Floats) -> Floats:
    """Return a path (n, 2) [m] with a point every PATH_STEP."""
    way = np.r_[0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    if way[-1] < 1e-6:
        return points[:1]
    at = np.linspace(0, way[-1], max(2, int(way[-1] / PATH_STEP) + 1))
    return np.column_stack([np.interp(at, way, points[:, 0]), np.interp(at, way, points[:, 1])])


class Planner:
    """The grid of a free space; paths keep `clearance` [m] off its walls."""

    def __init__(self, free: Any, clearance: float) -> None:
        self.free, self.clearance = free, clearance
        self.passable = prep(free.buffer(-(clearance - 0.02)))
        x0, y0, x1, y1 = free.bounds
        X, Y = np.meshgrid(np.arange(x0, x1, GRID_STEP), np.arange(y0, y1, GRID_STEP), indexing="ij")
        points = shapely.points(X.ravel(), Y.ravel())
        safe = shapely.contains(free.buffer(-clearance), points)
        self.nodes: Floats = np.column_stack([X.ravel(), Y.ravel()])[safe]  # (n_nodes, 2)
        self.room_at: Floats = shapely.distance(free.boundary, points)[safe]
        """(n_nodes,) [m] to the nearest wall."""
        index = -np.ones(safe.size, int)
        index[safe] = np.arange(safe.sum())
        self._graph = self._edges(index.reshape(X.shape))
        _, label = connected_components(self._graph, directed=False)
        self.reachable = np.flatnonzero(label == np.bincount(label).argmax()) if label.size else label

    def _edges(self, index: Any) -> Any:
        rows, columns, costs = [], [], []
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
            low = 1 if dy < 0 else 0
            one = index[: index.shape[0] - dx, low : (index.shape[1] - (1 if dy > 0 else 0))]
            other = index[dx:, (0 if dy < 0 else dy) : (index.shape[1] - 1 if dy < 0 else None)]
            both = (one >= 0) & (other >= 0)
            a, b = one[both], other[both]
            rows.append(a)
            columns.append(b)
            near = np.minimum(self.room_at[a], self.room_at[b])
            costs.append(GRID_STEP * np.hypot(dx, dy) * (1 + 0.12 / near))
        n = len(self.nodes)
        links = (np.concatenate(rows), np.concatenate(columns))
        return coo_matrix((np.concatenate(costs), links), (n, n)).tocsr()

    def near(self, point: Floats) -> int:
        """Return the reachable node nearest to a point (2,) [m]."""
        return int(self.reachable[np.argmin(((self.nodes[self.reachable] - point) ** 2).sum(axis=1))])

    def path(self, start: Floats, goal: Floats) -> Floats:
        """Return a path (n, 2) [m] from start to near the goal, straightened where nothing is in the way."""
        first, last = self.near(start), self.near(goal)
        _, trees = dijkstra(self._graph, directed=False, indices=[last], return_predecessors=True)
        before, nodes = trees[0], [first]
        while nodes[-1] != last and before[nodes[-1]] >= 0:
            nodes.append(before[nodes[-1]])
        points = self.nodes[nodes]
        if np.hypot(*(points[0] - start)) > 0.02:
            points = np.vstack([start, points])
        out, i = [points[0]], 0
        while i < len(points) - 1:
            j = min(len(points) - 1, i + 60)
            while j > i + 1 and not self.passable.covers(LineString([points[i], points[j]])):
                j -= max(1, (j - i) // 6)
            i = max(j, i + 1)
            out.append(points[i])
        return densified(np.array(out))


STYLES = ("wander", "eights", "walls")
SPARE = 0.96
"""Share of the limits that the pilot uses."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Driven:
    """What a drive left."""

    stamps: Floats
    """(n,) [s]"""
    log: Floats
    """(n, N_LOGGED), the columns of `base`."""
    command_stamps: Floats
    """(n_commands,) [s]"""
    commands: Floats
    """(n_commands, 2) [m/s, rad/s] as sent."""

    @property
    def duration(self) -> float:
        """[s]"""
        return len(self.stamps) * STEP

    def at(self, stamps: Floats, column: int) -> Floats:
        """Return a column of the log at stamps [s]."""
        return np.interp(stamps, self.stamps, self.log[:, column])


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """The way of a command to the wheels."""

    delay: float
    """[s]"""
    period: float = 0.0
    """[s] of the base's own loop, which acts at its ticks; 0: at once."""
    jitter: float = 0.0
    """[s] standard deviation of the transport."""
    outages: tuple[tuple[float, float], ...] = ()
    """(begin, end) [s]: nothing arrives, and the base's watchdog stops it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Manoeuvre:
    """One thing that the pilot does."""

    kind: str
    path: Floats | None = None
    amount: float = 0.0
    """[rad] of a spin, [s] of a stop, [m] of backing up."""
    pace: float = 0.0
    """Share of the largest speed."""


def _manoeuvres(
    planner: Planner, rng: np.random.Generator, style: str
) -> Generator[Manoeuvre | None, Floats, None]:
    """Yield one manoeuvre after the other; send the position (2,) [m] for the next."""
    reachable = planner.reachable
    room_at = planner.room_at[reachable]
    centre, radius = planner.nodes[reachable[np.argmax(room_at)]], room_at.max() - planner.clearance
    at = yield None
    count = 0
    while True:
        count += 1
        u = rng.random()
        pace = rng.choice([0.45, 0.7, 1.0, 1.0])
        if count % 4 == 2 and radius > 0.35 and (style == "eights" or u < 0.25):
            figure = _figure_eight(centre, min(radius * 0.95, 1.6), rng)
            at = yield Manoeuvre(kind="path", path=planner.path(at, figure[0]), pace=pace)
            at = yield Manoeuvre(kind="path", path=densified(figure), pace=pace)
        elif count % 4 == 2 and (style == "walls" or u < 0.35):
            ring = _along_walls(planner, at, rng)
            at = yield Manoeuvre(kind="path", path=planner.path(at, ring[0]), pace=pace)
            at = yield Manoeuvre(kind="path", path=ring, pace=pace)
        else:
            for _ in range(30):
                goal = planner.nodes[rng.choice(reachable)]
                if np.hypot(*(goal - at)) > 1.2:
                    break
            at = yield Manoeuvre(kind="path", path=planner.path(at, goal), pace=pace)
        if rng.random() < 0.4:
            turn = rng.choice([-1, 1]) * rng.uniform(1.2, 5.0)
            at = yield Manoeuvre(kind="spin", amount=turn, pace=rng.uniform(0.4, 1.0))
        if rng.random() < 0.35:
            at = yield Manoeuvre(kind="stop", amount=rng.uniform(0.4, 1.8))
        if rng.random() < 0.3:
            at = yield Manoeuvre(kind="back", amount=rng.uniform(0.25, 0.6), pace=rng.uniform(0.4, 0.8))


def _figure_eight(centre: Floats, radius: float, rng: np.random.Generator) -> Floats:
    s = np.linspace(0, 2 * np.pi * rng.choice([1, 2]), 120)
    angle = rng.uniform(0, np.pi)
    x, y = radius * np.cos(s), radius * np.sin(s) * np.cos(s)
    c, sine = np.cos(angle), np.sin(angle)
    return np.asarray(centre + np.column_stack([x * c - y * sine, x * sine + y * c]))


def _along_walls(planner: Planner, at: Floats, rng: np.random.Generator) -> Floats:
    inner = largest_part(planner.free.buffer(-(planner.clearance + 0.03)))
    ring = densified(np.array(inner.exterior.coords))
    if rng.random() < 0.5:
        ring = ring[::-1]
    nearest = int(np.argmin(((ring - at) ** 2).sum(axis=1)))
    ring = np.roll(ring[:-1], -nearest, axis=0)
    return ring[: max(int(len(ring) * rng.uniform(0.4, 1.0)), 3)]


class Pilot:
    """Turns manoeuvres into commands, of the true pose; `period` [s] between commands."""

    def __init__(
        self, robot: Robot, planner: Planner, rng: np.random.Generator, style: str, period: float
    ) -> None:
        self.v_most, self.omega_most, self.a_most, self.alpha_most = (
            SPARE * one for one in (robot.v, robot.omega, robot.a, robot.alpha)
        )
        self.planner, self.period = planner, period
        open_nodes = planner.room_at[planner.reachable] > np.quantile(planner.room_at[planner.reachable], 0.5)
        x, y = planner.nodes[rng.choice(planner.reachable[open_nodes])]
        self.start = (float(x), float(y), float(rng.uniform(-3, 3)))
        self._next = _manoeuvres(planner, rng, style)
        next(self._next)
        self._now = Manoeuvre(kind="stop", amount=1.0)
        self._v = self._omega = 0.0
        self._done_so_far = 0.0  # [rad] of a spin, [m] of backing up
        self._age, self._index, self._last_phi = 0.0, 0, self.start[2]

    def command(self, x: float, y: float, phi: float) -> tuple[float, float]:
        """Return the next command (v, omega) [m/s, rad/s]."""
        self._age += self.period
        ways = {"stop": self._stop, "spin": self._spin, "back": self._back, "path": self._follow}
        v, omega, is_done = ways[self._now.kind](x, y, phi)
        self._last_phi = phi
        if self._v * v < 0:
            v = 0.0
        self._v += np.clip(v - self._v, -self.a_most * self.period, self.a_most * self.period)
        turn_step = self.alpha_most * self.period
        self._omega += np.clip(omega - self._omega, -turn_step, turn_step)
        if is_done:
            self._finish(x, y, phi)
        return self._v, self._omega

    def _finish(self, x: float, y: float, phi: float) -> None:
        """Go on to the next manoeuvre when slow enough, else stop first."""
        was_path = self._now.kind == "path"
        if abs(self._v) < 0.02 + 0.3 * self.v_most * was_path:
            following = self._next.send(np.array([x, y]))
            assert following is not None
            self._now, self._index, self._done_so_far, self._last_phi = following, 0, 0.0, phi
        else:
            self._now = Manoeuvre(kind="stop", amount=0.15 if was_path else 0.2)
        self._age = 0.0

    def _stop(self, x: float, y: float, phi: float) -> tuple[float, float, bool]:
        return 0.0, 0.0, self._age > self._now.amount

    def _spin(self, x: float, y: float, phi: float) -> tuple[float, float, bool]:
        self._done_so_far += phi - self._last_phi
        left = self._now.amount - self._done_so_far
        if abs(left) < 0.12 or left * self._now.amount < 0 or self._age > 20:
            return 0.0, 0.0, True
        return 0.0, np.sign(left) * min(self.omega_most * self._now.pace, max(0.12, 1.6 * abs(left))), False

    def _back(self, x: float, y: float, phi: float) -> tuple[float, float, bool]:
        if self._age <= 1.5 * self.period:
            way = self._now.amount + 0.15
            behind = (x - way * np.cos(phi), y - way * np.sin(phi))
            self._done_so_far = 0.0
            if not self.planner.passable.covers(LineString([(x, y), behind])):
                return 0.0, 0.0, True
        self._done_so_far += abs(self._v) * self.period
        if self._done_so_far > self._now.amount or self._age > 5:
            return 0.0, 0.0, True
        return -self.v_most * self._now.pace * 0.6, 0.0, False

    def _follow(self, x: float, y: float, phi: float) -> tuple[float, float, bool]:
        path = self._now.path
        assert path is not None
        near = ((path[self._index : self._index + 25] - (x, y)) ** 2).sum(axis=1)
        self._index += int(np.argmin(near))
        ahead = 0.18 + 0.35 * abs(self._v)  # [m]
        goal = path[min(len(path) - 1, self._index + int(ahead / PATH_STEP))]
        off = wrapped(np.arctan2(goal[1] - y, goal[0] - x) - phi)
        left = np.hypot(path[-1][0] - x, path[-1][1] - y) if self._index > len(path) - 30 else 9.0
        if left < 0.09 or self._age > 45:
            return 0.0, 0.0, True
        pace = self._now.pace
        if abs(off) > 0.7:
            return 0.0, np.sign(off) * min(self.omega_most * max(pace, 0.5), 1.7 * abs(off)), False
        v = min(self.v_most * pace * np.cos(off) ** 6 * min(1.0, 0.25 + left / 0.7), self.v_most)
        omega = float(np.clip(2.2 * off, -self.omega_most, self.omega_most))
        if abs(omega) > 0.1:
            v = min(v, 0.12 * self.v_most + (1 - abs(omega) / self.omega_most) * self.v_most)
        return v, omega, False


def drive(
    robot: Robot,
    planner: Planner,
    base: Base,
    link: Link,
    *,
    duration: float,
    style: str,
    pilot_rng: np.random.Generator,
    link_rng: np.random.Generator,
) -> Driven:
    """Drive for a duration [s] in a style."""
    period = 1 / robot.command_rate
    per_command, n_steps = round(period / STEP), int(duration / STEP)
    n_most = n_steps // per_command + 6
    log = np.zeros((n_steps + per_command + 5, N_LOGGED))
    stamps, acts = np.zeros((2, n_most))
    sent, acting = np.zeros((2, n_most, 2))
    pilot = Pilot(robot, planner, pilot_rng, style, period)
    state = start_state(*pilot.start)
    phase = link_rng.uniform(0, 1)
    i = k = 0
    while i + per_command <= n_steps:
        sent[k] = pilot.command(state[0], state[1], state[2])
        stamps[k] = i * STEP
        act = stamps[k] + link.delay + (abs(link_rng.normal(0, link.jitter)) if link.jitter else 0.0)
        if link.period:
            act = (np.ceil(act / link.period - phase) + phase) * link.period
        acts[k] = max(act, acts[k - 1]) if k else act
        is_lost = any(begin <= stamps[k] < end for begin, end in link.outages)
        acting[k] = 0.0 if is_lost else sent[k]
        k += 1
        advance(state, i, per_command, acts, acting, k, base, log)
        i += per_command
    return Driven(
        stamps=np.asarray(np.arange(1, i + 1) * STEP, dtype=np.float64),
        log=log[:i],
        command_stamps=stamps[:k],
        commands=sent[:k],
    )
