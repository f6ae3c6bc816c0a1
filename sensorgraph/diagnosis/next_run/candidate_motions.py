"""Drivable space of a robot, and motions that may separate two models: spins, sweeps and shuttles."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from planners.arena import Arena, wrap
from planners.clearance import Barriers
from planners.errors import PlanError
from planners.planning import WALL_MARGIN
from planners.reach import Reach, reach
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

SPARE_CLEARANCE = 0.08
"""[m] additional clearance of places, where available."""
MAX_SPREAD_PLACES = 4000
"""Maximum number of reachable places among which distant ones are chosen."""
N_PLACES = 14
"""Number of places in the whole room at which motions start, or through which the paths between them lead."""
N_SWEEP_HEADINGS = 6
"""Number of headings at each place for sweeps."""
SWEEP_ANGLE = float(np.radians(60.0))
"""[rad] of a sweep to either side."""
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
        nodes = self.nodes[rng.permutation(len(self.nodes))[:MAX_SPREAD_PLACES]]
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
