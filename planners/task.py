"""The input of a planner (`Task`) and its result (`PlannedDrive`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planners.arena import Arena
from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.curve import Curve, CurveBuilder
from planners.reach import Reach, ReturnableSet
from planners.types import Bools, Floats, Progress, Status
from planners.vehicle import Vehicle

ORDERS = ("fast", "anytime")
"""Orders of a coverage plan.

`fast`: the shortest drive as a whole, room by room. `anytime`: coarse to fine, so that every prefix is as
valuable as possible."""


class Survey(Protocol):
    """What the sensor has seen so far; used by an anytime plan."""

    def gain(self, poses: Floats) -> Floats:
        """Return the gain (n,) that a scan at each pose (n, 3) [m, m, rad] would add on its own."""

    def mark(self, poses: Floats) -> None:
        """Mark as seen what scans at poses (n, 3) [m, m, rad] show."""

    def copy(self) -> Survey:
        """Return an independent copy."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """The input of a planner, made by `planning.plan`."""

    arena: Arena
    vehicle: Vehicle
    barriers: Barriers
    reach: Reach
    coverage: Coverage
    """Grid whose reachable bins are to be covered; its counts hold the poses of earlier runs."""
    start: Floats | None
    """(3,) [m, m, rad] start pose; None: chosen by the planner."""
    seed: int
    rate: float
    """[Hz] of the log."""
    priority: Floats | None
    """(nx, ny, n_phi) priority of each bin; higher comes earlier."""
    duration: float | None
    """[s] duration of planners that have no end (the baselines)."""
    progress: Progress | None
    targets: Floats | None = None
    """(n, 3) [m, m, rad] poses to visit, for the planner `views`."""
    returnable: ReturnableSet | None = None
    """Bins that a car without a reverse gear can reach from the start and return from; None: unknown or not
needed."""
    order: str = "fast"
    """One of `ORDERS`: what the coverage planner drives first."""
    survey: Survey | None = None
    """What the sensor has seen, for an anytime plan; None: the plan begins with coarse coverage."""
    budget: float | None = None
    """[s] after which the plan may end; None: no limit."""
    status: Status | None = None
    """Called with a text on the current step and the quality of the plan so far."""

    def show_status(self, text: str) -> None:
        """Pass a text on the current step to `status`, if there is one."""
        if self.status is not None:
            self.status(text)


@dataclass(frozen=True, kw_only=True)
class JoinCounts:
    """Counts of joins: moves that only connect one part of a drive to the next."""

    direct: int = 0
    """Straight moves (cars: shortest curves) that are clear."""
    planned: int = 0
    """Joins around obstacles, planned by OMPL."""
    failed: int = 0
    """Joins for which OMPL found no path."""
    by_wavefront: int = 0
    """Joins of a car that OMPL did not find and a wavefront over its own primitives did."""
    planned_m: float = 0.0
    """[m] Total length of all planned joins."""

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
    """The result of a planner."""

    curve: Curve
    stops: Floats
    """(n, 4) [m, m, rad, rad] x, y, phi on arrival, and the angle turned there."""
    joins: JoinCounts
    interrupted: bool = False
    """Whether Ctrl-C ended the planning; the drive then covers what was planned before."""
    lost: Bools | None = None
    """(nx, ny, n_phi) bins to which OMPL found no path; None: no such bin."""

    @classmethod
    def of(cls, builder: CurveBuilder, joins: JoinCounts) -> PlannedDrive:
        """Return the drive of a builder."""
        return cls(curve=builder.curve(), stops=np.array(builder.stops).reshape(-1, 4), joins=joins)
