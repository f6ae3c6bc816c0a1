"""What a planner is asked for (`Task`), and what it answers (`PlannedDrive`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from planners.arena import Arena
from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.curve import Curve
from planners.reach import Reach, ReturnableSet
from planners.types import Bools, Floats, Progress, Status
from planners.vehicle import Vehicle

ORDERS = ("fast", "anytime")
"""Of a coverage plan: the shortest drive as a whole, room by room; or coarse to fine, so that each prefix is worth most."""


class Survey(Protocol):
    """What the sensor has seen so far, as an anytime plan asks for it."""

    def gain(self, poses: Floats) -> Floats:
        """Return (n,) what a scan at each pose (n, 3) [m, m, rad] alone would add."""

    def mark(self, poses: Floats) -> None:
        """Count what scans at poses (n, 3) [m, m, rad] show as seen."""

    def copy(self) -> Survey:
        """Return one that can be marked without marking this one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """One planning job, as `planning.plan` gives it to a planner."""

    arena: Arena
    vehicle: Vehicle
    barriers: Barriers
    reach: Reach
    coverage: Coverage
    """Its reachable bins are to be covered; its counts hold the poses of earlier runs."""
    start: Floats | None
    """(3,) [m, m, rad]; None: wherever the planner likes."""
    seed: int
    rate: float
    """[Hz] of the log."""
    priority: Floats | None
    """(nx, ny, n_phi) higher comes earlier."""
    duration: float | None
    """[s] that planners drive which never finish by themselves (the baselines)."""
    progress: Progress | None
    targets: Floats | None = None
    """(n, 3) [m, m, rad] poses that the planner `views` visits."""
    returnable: ReturnableSet | None = None
    """Bins that a car without a reverse gear can reach from the start and return from; None: not known, or not needed."""
    order: str = "fast"
    """One of `ORDERS`: what the coverage planner drives first."""
    survey: Survey | None = None
    """What an anytime plan looks at first; None: it begins with coarse coverage."""
    budget: float | None = None
    """[s] after which nothing more need be planned; None: all."""
    status: Status | None = None
    """Is told what is being planned and how good it is already."""

    def say(self, text: str) -> None:
        """Tell what is being planned, if anybody listens."""
        if self.status is not None:
            self.status(text)


@dataclass(frozen=True, kw_only=True)
class JoinCounts:
    """How the joins came about: moves that only lead from one part of a drive to the next."""

    direct: int = 0
    """Straight moves (for cars: shortest curves) that are clear."""
    planned: int = 0
    """Joins that OMPL planned around obstacles."""
    failed: int = 0
    """Joins for which OMPL found no path."""
    by_wavefront: int = 0
    """Joins of a Dubins car that OMPL did not find, but the wavefront over its own primitives did."""
    planned_m: float = 0.0
    """[m] of all planned joins."""

    def __add__(self, other: JoinCounts) -> JoinCounts:
        return JoinCounts(
            direct=self.direct + other.direct,
            planned=self.planned + other.planned,
            failed=self.failed + other.failed,
            by_wavefront=self.by_wavefront + other.by_wavefront,
            planned_m=self.planned_m + other.planned_m,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedDrive:
    """A planner's answer."""

    curve: Curve
    stops: Floats
    """(n, 4) [m, m, rad, rad] x, y, phi on arrival, and the turn made there."""
    joins: JoinCounts
    interrupted: bool = False
    """Ctrl-C ended the planning; the drive covers what was planned by then."""
    lost: Bools | None = None
    """(nx, ny, n_phi) bins that OMPL found no way to; None: none."""
