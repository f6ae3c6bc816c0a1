"""Motions that may separate two models, and drives that join them into one closed-form curve; random drives for comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.sparse.csgraph import shortest_path

from planners.arena import Arena, wrap
from planners.clearance import Barriers
from planners.curve import Curve, CurveBuilder
from planners.errors import PlanError
from planners.joins.paths import connect
from planners.planning import WALL_MARGIN
from planners.reach import Reach, reach
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

PACE = (0.4, 1.0)
"""Range of the speeds of a random drive, as shares of the robot's limits."""
P_SPIN = 0.26
"""Probability of a spin before the next place."""
RANDOM_SPIN = (0.8, 4.5)
"""[rad] range of a spin."""
COUNTS = (1, 4)
"""Numbers of motions in a drive, one version each."""
ROUNDS = (1, 2)
"""Numbers of passes through the motions, so that changes over time are observable; one version each."""
N_RANDOM_PLACES = 16
"""Number of places that are drawn for a random move; the first with a free straight path is taken."""
SPARE_CLEARANCE = 0.08
"""[m] additional clearance of places, where available."""
N_PLACES = 14
"""Number of places in the whole room at which motions start, or through which the paths between them lead."""
SWEEP_ANGLE = float(np.radians(60.0))
"""[rad] of a sweep to either side."""
N_SWEEP_HEADINGS = round(2 * np.pi / SWEEP_ANGLE)
"""Number of headings at each place for sweeps: each direction is in two of them."""
CELL = 0.25
"""[m] cell size of the grid of reachable places."""


class MotionKind(StrEnum):
    """Motion of the robot at a place."""

    SPIN = "spin"
    """Full turns in both directions."""
    SWEEP = "sweep"
    """Fast turns to either side of a heading."""
    SHUTTLE = "shuttle"
    """Straight back and forth."""


@dataclass(frozen=True, kw_only=True)
class CandidateMotion:
    """One motion that may separate two models."""

    kind: MotionKind
    place: tuple[float, float]
    """[m] start."""
    heading: float
    """[rad] middle of a sweep, or direction of a shuttle."""
    length: float = 0.0
    """[m] of a shuttle."""

    @property
    def end(self) -> tuple[float, float]:
        """[m] turning point of a shuttle."""
        x, y = self.place
        return x + self.length * float(np.cos(self.heading)), y + self.length * float(np.sin(self.heading))


@dataclass(frozen=True, kw_only=True, eq=False)
class DrivableSpace:
    """Places that the robot can reach."""

    arena: Arena
    robot: Robot
    barriers: Barriers
    reach: Reach
    nodes: Floats
    """(n, 2) [m] reachable places; only those with spare clearance, if there are any."""

    @classmethod
    def of(cls, arena: Arena, robot: Robot) -> DrivableSpace:
        """Find the places at which the robot can be.

        Raises
        ------
        PlanError : The robot cannot turn in place.
        """
        if robot.drive != "diff":
            raise PlanError(
                f"robot.yaml: `drive` is {robot.drive!r}; a next run needs a robot that can turn in place (`diff`)"
            )
        barriers = Barriers(arena)
        free = reach(arena, barriers, clearance=robot.footprint_radius + WALL_MARGIN, cell=CELL)
        roomy = free.mask & (free.distance >= free.clearance + SPARE_CLEARANCE)
        index = np.nonzero(roomy if roomy.any() else free.mask)
        return cls(arena=arena, robot=robot, barriers=barriers, reach=free, nodes=free.nodes(index))

    def spread_places(self, rng: np.random.Generator) -> Floats:
        """Return N_PLACES places (n, 2) [m] far from each other, by farthest-point sampling."""
        nodes = self.nodes[rng.permutation(len(self.nodes))]
        chosen = [nodes[0]]
        distance = np.hypot(*(nodes - nodes[0]).T)
        while len(chosen) < min(N_PLACES + 1, len(nodes)):
            chosen.append(nodes[int(distance.argmax())])
            distance = np.minimum(distance, np.hypot(*(nodes - chosen[-1]).T))
        return np.array(chosen[1:] or chosen)

    def are_clear(self, a: Floats, b: Floats) -> Bools:
        """Tell which straight moves (n, 2) -> (n, 2) are free of obstacles."""
        return self.barriers.are_clear(a, b, self.reach.clearance)


def candidate_motions(space: DrivableSpace, rng: np.random.Generator) -> list[CandidateMotion]:
    """List spins and sweeps at places in the whole room, and shuttles between them."""
    places = space.spread_places(rng)
    out = [CandidateMotion(kind=MotionKind.SPIN, place=_xy(p), heading=0.0) for p in places]
    turn = float(rng.uniform(-np.pi, np.pi))
    for p in places:
        for k in range(N_SWEEP_HEADINGS):
            heading = float(wrap(turn + 2 * np.pi * k / N_SWEEP_HEADINGS))
            out.append(CandidateMotion(kind=MotionKind.SWEEP, place=_xy(p), heading=heading))
    i, j = np.triu_indices(len(places), 1)
    length = np.hypot(*(places[j] - places[i]).T)
    for k in np.flatnonzero(space.are_clear(places[i], places[j])).tolist():
        for a, b in ((places[i[k]], places[j[k]]), (places[j[k]], places[i[k]])):
            heading = float(np.arctan2(*(b - a)[::-1]))
            out.append(
                CandidateMotion(
                    kind=MotionKind.SHUTTLE, place=_xy(a), heading=heading, length=float(length[k])
                )
            )
    return out


def _xy(p: Floats) -> tuple[float, float]:
    return float(p[0]), float(p[1])


def build_drives(
    space: DrivableSpace,
    motions: Sequence[CandidateMotion],
    allocations: Sequence[Floats],
    duration: float,
    seed: int,
) -> list[tuple[Curve, list[CandidateMotion]]]:
    """Return drives of the motions with the most time, each with its motions, in versions with different numbers of motions and rounds.

    Parameters
    ----------
    allocations : (n_motions,) each, shares of the time that motions get.
    duration : [s] Of a drive.
    """
    out: list[tuple[Curve, list[CandidateMotion]]] = []
    seen = set()
    for share in allocations:
        order = np.argsort(-share)
        for count in COUNTS:
            for rounds in ROUNDS:
                some = order[:count]
                version = (tuple(sorted(some.tolist())), rounds if len(some) > 1 else 1)
                if version in seen:
                    continue
                seen.add(version)
                builder = DriveBuilder(space, duration, seed)
                used = builder.add(
                    [motions[k] for k in some], (share[some] + 1e-9) / (share[some] + 1e-9).sum(), rounds
                )
                out.append((builder.curve_builder.curve(), used))
    return out


class DriveBuilder:
    """Builds a drive from consecutive motions, with the paths between them."""

    def __init__(self, space: DrivableSpace, duration: float, seed: int) -> None:
        self.space, self.duration, self.seed = space, duration, seed
        self.limits = space.robot.limits
        self.curve_builder = CurveBuilder(np.zeros(3), self.limits)

    def add(self, motions: Sequence[CandidateMotion], share: Floats, rounds: int) -> list[CandidateMotion]:
        """Add motions by their shares (n,) of the time, until no time is left; return those that were added."""
        tour = _nearest_neighbour_tour([m.place for m in motions])
        first = motions[tour[0]]
        self.curve_builder = CurveBuilder(np.array([*first.place, first.heading]), self.limits)
        visits = [k for turn in range(rounds) for k in (tour if turn % 2 == 0 else tour[::-1])]
        used: list[CandidateMotion] = []
        shares_left = float(rounds)
        for k in visits:
            place = np.array(motions[k].place)
            distance = float(np.hypot(*(place - self.curve_builder.pose[:2])))
            arrival = self.curve_builder.clock + distance / self.limits.v
            if used and arrival > self.duration:
                break
            if self._drive_to(place):
                clock = self.curve_builder.clock
                self._move(motions[k], clock + (self.duration - clock) * float(share[k]) / shares_left)
                used += [] if motions[k] in used else [motions[k]]
            shares_left -= float(share[k])
        return used

    def _move(self, motion: CandidateMotion, until: float) -> None:
        """Repeat a motion until a time [s], at least once."""
        if motion.kind is MotionKind.SPIN:
            self._spin(until)
        elif motion.kind is MotionKind.SWEEP:
            self._sweep(motion, until)
        else:
            self._shuttle(motion, until)

    def _spin(self, until: float) -> None:
        sign = 1.0
        while True:
            angle = min(2 * np.pi, self._reach(self.limits.omega, self.limits.alpha))
            self.curve_builder.turn(sign * angle, "spin")
            sign = -sign
            if self.curve_builder.clock + np.pi / self.limits.omega > until:
                return

    def _sweep(self, motion: CandidateMotion, until: float) -> None:
        builder, angle = self.curve_builder, SWEEP_ANGLE
        builder.turn(float(wrap(motion.heading - angle - builder.pose[2])))
        sign = 1.0
        while True:
            builder.turn(sign * 2 * angle, "sweep")
            sign = -sign
            if builder.clock + angle / self.limits.omega > until:
                return

    def _shuttle(self, motion: CandidateMotion, until: float) -> None:
        builder = self.curve_builder
        builder.turn(float(wrap(motion.heading - builder.pose[2])))
        while True:
            distance = min(motion.length, self._reach(self.limits.v, self.limits.a))
            builder.move(distance, "pass")
            if builder.clock < self.duration:
                builder.move(-min(distance, self._reach(self.limits.v, self.limits.a)), "pass")
            if builder.clock + motion.length / self.limits.v > until:
                return

    def _reach(self, speed: float, acceleration: float) -> float:
        """Return the extent [m, rad] of a motion in the remaining time; at least a small one."""
        return max(
            speed * (self.duration - self.curve_builder.clock - speed / acceleration),
            0.2 * speed,  # [s] times speed
        )

    def _drive_to(self, place: Floats) -> bool:
        """Drive to a place (2,) [m]; return False if there is no path."""
        builder = self.curve_builder
        if np.hypot(*(place - builder.pose[:2])) < 1e-6:
            return True
        path = self._path(builder.pose[:2].copy(), place)
        if path is None:
            return False
        for corner in path[1:]:
            step = corner - builder.pose[:2]
            distance = float(np.hypot(*step))
            if distance > 1e-9:
                builder.turn(float(wrap(np.arctan2(step[1], step[0]) - builder.pose[2])))
                builder.move(distance)
        return True

    def _path(self, here: Floats, there: Floats) -> Floats | None:
        """Return the shortest path (n, 2) over mutually visible places; without one, a path of OMPL."""
        space = self.space
        if space.are_clear(here[None], there[None])[0]:
            return np.array([here, there])
        via = space.spread_places(np.random.default_rng(self.seed))
        points = np.concatenate([here[None], there[None], via])
        i, j = np.triu_indices(len(points), 1)
        cost = np.hypot(*(points[j] - points[i]).T)
        graph = np.zeros((len(points), len(points)))
        free = space.are_clear(points[i], points[j])
        graph[i[free], j[free]] = cost[free]
        total, before = shortest_path(graph, directed=False, indices=0, return_predecessors=True)
        if np.isfinite(total[1]):
            route = [1]
            while route[-1] != 0:
                route.append(int(before[route[-1]]))
            return points[route[::-1]]
        paths, _ = connect(
            here[None], there[None], reach=space.reach, barriers=space.barriers, seed=self.seed
        )
        return paths[0]


def _nearest_neighbour_tour(places: Sequence[tuple[float, float]]) -> list[int]:
    """Order places by always going to the nearest one next."""
    here = np.array(places[0])
    left, out = list(range(len(places))), []
    while left:
        nearest = min(left, key=lambda k, h=here: float(np.hypot(*(np.array(places[k]) - h))))  # type: ignore[misc]
        out.append(nearest)
        left.remove(nearest)
        here = np.array(places[nearest])
    return out


def random_drive(space: DrivableSpace, rng: np.random.Generator, duration: float) -> Curve:
    """Drive between random places at random speeds for `duration` [s], with occasional spins."""
    limits, nodes = space.robot.limits, space.nodes
    builder = CurveBuilder(np.array([*nodes[rng.integers(len(nodes))], rng.uniform(-np.pi, np.pi)]), limits)
    while builder.clock < duration:
        pace = float(rng.uniform(*PACE))
        builder.limits = replace(limits, v=pace * limits.v)
        builder.spin = pace * limits.omega
        if rng.random() < P_SPIN:
            builder.turn(float(rng.choice([-1.0, 1.0]) * rng.uniform(*RANDOM_SPIN)), "spin")
        else:
            places = nodes[rng.integers(len(nodes), size=N_RANDOM_PLACES)]
            here = np.repeat(builder.pose[None, :2], N_RANDOM_PLACES, axis=0)
            straight = np.flatnonzero(space.are_clear(here, places))
            if len(straight):
                step = places[straight[0]] - builder.pose[:2]
                builder.turn(float(wrap(np.arctan2(step[1], step[0]) - builder.pose[2])))
                builder.move(float(np.hypot(*step)))
            else:
                builder.turn(float(rng.uniform(-np.pi, np.pi)))
    return builder.curve()
