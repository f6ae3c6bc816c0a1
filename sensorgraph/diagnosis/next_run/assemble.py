"""Motions become one closed-form curve, with the ways between them; and random driving, to compare with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse.csgraph import shortest_path

from planners.arena import wrap
from planners.curve import Curve, CurveBuilder
from planners.errors import PlanError
from planners.joins.paths import connect
from sensorgraph.diagnosis.next_run.candidate_motions import SWEEP, Ground, Step
from sensorgraph.types import Floats

ROUNDS = 2  # times that a plan goes round, so that what changes with time shows
KEPT = (1, 2, 4, 7)  # motions in a plan
WORTH = 4.0  # [s] that must be left to go on to another place
LEAST = 0.05  # share of the time below which a motion is left out


def drawn(
    ground: Ground,
    steps: Sequence[Step],
    times: Sequence[Floats],
    seconds: float,
    start: Floats | None,
    seed: int,
) -> list[tuple[Curve, list[Step]]]:
    """Draw plans of the motions with most time, in several versions: how many, and how often they are gone through."""
    out: list[tuple[Curve, list[Step]]] = []
    seen = set()
    for time in times:
        order = np.argsort(-time)
        order = order[time[order] > LEAST * time.max()]
        for kept in KEPT:
            for rounds in (1, ROUNDS):
                some = order[:kept]
                key = (tuple(sorted(some.tolist())), rounds if len(some) > 1 else 1)
                if key in seen:
                    continue
                seen.add(key)
                artist = Artist(ground, seconds, start, seed)
                used = artist.draw([steps[k] for k in some], time[some] / time[some].sum(), rounds)
                if used:
                    out.append((artist.pen.curve(), used))
    if not out:
        raise PlanError("no motion can be reached from the start; choose another start")
    return out


class Artist:
    """Draw motions one after another, with the ways between them."""

    def __init__(self, ground: Ground, seconds: float, start: Floats | None, seed: int) -> None:
        self.ground, self.seconds, self.start, self.seed = ground, seconds, start, seed
        self.limits = ground.robot.limits
        self.pen = CurveBuilder(np.zeros(3), self.limits)

    def draw(self, steps: Sequence[Step], share: Floats, rounds: int) -> list[Step]:
        """Draw the motions by their shares of the time; return those that were drawn."""
        tour = _tour([s.place for s in steps], self.start)
        first = steps[tour[0]]
        self.pen = CurveBuilder(
            np.array([*first.place, first.heading]) if self.start is None else self.start, self.limits
        )
        visits = [k for turn in range(rounds) for k in (tour if turn % 2 == 0 else tour[::-1])]
        used: list[Step] = []
        left = float(rounds)
        for k in visits:
            far = float(np.hypot(*(np.array(steps[k].place) - self.pen.pose[:2])))
            if used and self.pen.clock + far / self.limits.v > self.seconds - WORTH:
                break
            if self._go(np.array(steps[k].place)):
                self._move(
                    steps[k], self.pen.clock + (self.seconds - self.pen.clock) * float(share[k]) / left
                )
                used += [] if steps[k] in used else [steps[k]]
            left -= float(share[k])
        self.pen.wait(0.2)
        return used

    def _move(self, step: Step, until: float) -> None:
        """Spin, sweep or shuttle until a time, at least once."""
        pen = self.pen
        if step.kind == "spin":
            sign = 1.0
            while True:
                pen.turn(sign * min(2 * np.pi, self._within(self.limits.omega, self.limits.alpha)), "spin")
                sign = -sign
                if pen.clock + np.pi / self.limits.omega > until:
                    return
        if step.kind == "sweep":
            pen.turn(float(wrap(step.heading - SWEEP - pen.pose[2])))
            sign = 1.0
            while True:
                pen.turn(sign * 2 * SWEEP, "sweep")
                sign = -sign
                if pen.clock + SWEEP / self.limits.omega > until:
                    return
        pen.turn(float(wrap(step.heading - pen.pose[2])))
        while True:
            way = min(step.way, self._within(self.limits.v, self.limits.a))
            pen.move(way, "pass")
            if self.seconds - pen.clock > WORTH / 2:
                pen.move(-min(way, self._within(self.limits.v, self.limits.a)), "pass")
            if pen.clock + step.way / self.limits.v > until:
                return

    def _within(self, top: float, rate: float) -> float:
        """Return how far [m, rad] a motion may go in the time that is left; a little, where there is none."""
        return max(top * (self.seconds - self.pen.clock - top / rate), 0.2 * top)

    def _go(self, place: Floats) -> bool:
        """Drive to a place; False if there is no way."""
        pen = self.pen
        if np.hypot(*(place - pen.pose[:2])) < 1e-6:
            return True
        path = self._path(pen.pose[:2].copy(), place)
        if path is None:
            return False
        for corner in path[1:]:
            way = corner - pen.pose[:2]
            far = float(np.hypot(*way))
            if far > 1e-9:
                pen.turn(float(wrap(np.arctan2(way[1], way[0]) - pen.pose[2])))
                pen.move(far)
        return True

    def _path(self, here: Floats, there: Floats) -> Floats | None:
        """Return the shortest way over places that see each other; by OMPL where they do not."""
        ground = self.ground
        if ground.clear(here[None], there[None])[0]:
            return np.array([here, there])
        via = ground.spread(24, np.random.default_rng(self.seed))
        points = np.concatenate([here[None], there[None], via])
        i, j = np.triu_indices(len(points), 1)
        far = np.hypot(*(points[j] - points[i]).T) + 0.5  # a corner costs time
        graph = np.zeros((len(points), len(points)))
        free = ground.clear(points[i], points[j])
        graph[i[free], j[free]] = far[free]
        cost, before = shortest_path(graph, directed=False, indices=0, return_predecessors=True)
        if np.isfinite(cost[1]):
            route = [1]
            while route[-1] != 0:
                route.append(int(before[route[-1]]))
            return points[route[::-1]]
        paths, _ = connect(
            here[None], there[None], reach=ground.reach, barriers=ground.barriers, seed=self.seed
        )
        return paths[0]


def _tour(places: Sequence[tuple[float, float]], start: Floats | None) -> list[int]:
    """Order places by going to the nearest next."""
    here = np.array(places[0] if start is None else start[:2])
    todo, out = list(range(len(places))), []
    while todo:
        near = min(todo, key=lambda k, h=here: float(np.hypot(*(np.array(places[k]) - h))))  # type: ignore[misc]
        out.append(near)
        todo.remove(near)
        here = np.array(places[near])
    return out


def random_run(ground: Ground, rng: np.random.Generator, seconds: float) -> Curve:
    """Drive between random places at random speeds, with a spin or a pause now and then: what one does without a plan."""
    limits = ground.robot.limits
    nodes = ground.nodes
    pen = CurveBuilder(np.array([*nodes[rng.integers(len(nodes))], rng.uniform(-np.pi, np.pi)]), limits)
    while pen.clock < seconds:
        pace = float(rng.uniform(0.4, 1.0))
        pen.limits = replace(limits, v=pace * limits.v)
        pen.spin = pace * limits.omega
        chance = rng.random()
        if chance < 0.26:
            pen.turn(float(rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 4.5)), "spin")
        elif chance < 0.34:
            pen.wait(float(rng.uniform(0.5, 2.0)))
        else:
            some = nodes[rng.integers(len(nodes), size=16)]
            here = np.repeat(pen.pose[None, :2], 16, axis=0)
            open_ = np.flatnonzero(ground.clear(here, some))
            if len(open_):
                way = some[open_[0]] - pen.pose[:2]
                pen.turn(float(wrap(np.arctan2(way[1], way[0]) - pen.pose[2])))
                pen.move(float(np.hypot(*way)))
            else:
                pen.turn(float(rng.uniform(-np.pi, np.pi)))
    return pen.curve()
