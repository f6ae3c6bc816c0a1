"""Where a robot can move, and the motions that may tell something: spins, sweeps and shuttles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.arena import Arena, wrap
from planners.clearance import Barriers
from planners.errors import PlanError
from planners.planning import MARGIN
from planners.reach import Reach, reach
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

PLACES = 14  # that motions start from
PASSES = 16  # ways between them that are driven to and fro
HEADINGS = 6  # that sweeps look at
ROOM = 0.08  # [m] beyond the clearance that places keep, where there is that much
SHORTEST = 0.6  # [m] of a shuttle
SWEEP = np.radians(60.0)  # [rad] to either side


@dataclass(frozen=True, kw_only=True)
class Step:
    """One motion that may tell something."""

    kind: str
    """`spin`, `sweep` or `shuttle`."""
    place: tuple[float, float]
    """[m] where it starts."""
    heading: float
    """[rad] of a sweep's middle, or of the drive."""
    way: float = 0.0
    """[m] of a shuttle."""

    @property
    def end(self) -> tuple[float, float]:
        """[m] where a shuttle turns back."""
        x, y = self.place
        return x + self.way * float(np.cos(self.heading)), y + self.way * float(np.sin(self.heading))


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """Where the robot can go."""

    arena: Arena
    robot: Robot
    barriers: Barriers
    reach: Reach
    nodes: Floats
    """(n, 2) [m] places that can be reached, with room to spare where there is some."""

    @classmethod
    def of(cls, arena: Arena, robot: Robot, *, start: Floats | None = None) -> Ground:
        """Flood the reachable places."""
        if robot.drive != "diff":
            raise PlanError(
                f"a next run is planned for robots that turn in place (drive: diff), not for {robot.drive!r}"
            )
        barriers = Barriers(arena)
        free = reach(arena, barriers, clearance=robot.footprint_radius + MARGIN, cell=0.25, start=start)
        roomy = free.mask & (free.distance >= free.clearance + ROOM)
        index = np.nonzero(roomy if roomy.any() else free.mask)
        return cls(arena=arena, robot=robot, barriers=barriers, reach=free, nodes=free.nodes(index))

    def spread(self, n: int, rng: np.random.Generator) -> Floats:
        """Return n places (n, 2) [m] far from each other."""
        nodes = self.nodes[rng.permutation(len(self.nodes))[:4000]]
        chosen = [nodes[0]]
        away = np.hypot(*(nodes - nodes[0]).T)
        while len(chosen) < min(n + 1, len(nodes)):
            chosen.append(nodes[int(away.argmax())])
            away = np.minimum(away, np.hypot(*(nodes - chosen[-1]).T))
        return np.array(chosen[1:] or chosen)

    def clear(self, a: Floats, b: Floats) -> Bools:
        """Tell which straight moves (n, 2) -> (n, 2) are free."""
        return self.barriers.are_clear(a, b, self.reach.clearance)


def motions(ground: Ground, rng: np.random.Generator) -> list[Step]:
    """List spins and sweeps at places all over the room, and shuttles between them."""
    places = ground.spread(PLACES, rng)
    out = [Step(kind="spin", place=_xy(p), heading=0.0) for p in places]
    turn = float(rng.uniform(-np.pi, np.pi))
    for p in places:
        for k in range(HEADINGS):
            out.append(Step(kind="sweep", place=_xy(p), heading=float(wrap(turn + 2 * np.pi * k / HEADINGS))))
    i, j = np.triu_indices(len(places), 1)
    way = np.hypot(*(places[j] - places[i]).T)
    fine = ground.clear(places[i], places[j]) & (way > SHORTEST)
    pairs = np.flatnonzero(fine)
    for k in rng.permutation(pairs)[:PASSES].tolist():
        for a, b in ((places[i[k]], places[j[k]]), (places[j[k]], places[i[k]])):
            heading = float(np.arctan2(*(b - a)[::-1]))
            out.append(Step(kind="shuttle", place=_xy(a), heading=heading, way=float(way[k])))
    return out


def _xy(p: Floats) -> tuple[float, float]:
    return float(p[0]), float(p[1])
