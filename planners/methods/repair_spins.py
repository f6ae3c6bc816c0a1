"""Complete the drive of a robot that turns in place: OMPL drives to the nearest cell with missing headings.

The straight move is tried first. On arrival the robot turns through all missing headings of the cell. Bins on
the path count too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planners.curve import Curve, CurveBuilder
from planners.joins.paths import connect_nearest
from planners.methods.settings import SPIN_REPAIR
from planners.methods.spins import choose_departure
from planners.methods.stop_and_spin import standing_places
from planners.search.log_phases import missed
from planners.settings import LOG
from planners.task import JoinCounts, Task
from planners.types import Bools, Floats


@dataclass(eq=False)
class SpinRepair:
    """Repair of the drive of a robot that turns in place."""

    task: Task
    missing: Bools
    """(nx, ny, n_phi) bins to cover."""
    here: Floats
    """(3,) pose of the robot."""
    curves: list[Curve] = field(default_factory=list)
    stops: list[tuple[float, float, float, float]] = field(default_factory=list)
    joins: JoinCounts = field(default_factory=JoinCounts)

    def __post_init__(self) -> None:
        self.missing = self.missing.copy()
        self.lost: Bools = np.zeros_like(self.missing)
        """(nx, ny, n_phi) bins to which no path was found."""

    def run(self) -> None:
        """Drive to missing bins until all bins are covered or lost, or their cells have been visited often enough."""
        cells = standing_places(self.task.reach, self.task.barriers, self.missing)
        visits = np.zeros(len(cells.index), dtype=np.int64)
        for round_ in range(SPIN_REPAIR.max_visits * len(visits)):
            wanted = np.flatnonzero(
                self.missing[tuple(cells.index.T)].any(axis=1) & (visits < SPIN_REPAIR.max_visits)
            )
            if not len(wanted):
                break
            path, joins = connect_nearest(
                self.here[:2],
                cells.places[wanted],
                reach=self.task.reach,
                barriers=self.task.barriers,
                seed=self.task.seed + round_,
            )
            self.joins += joins
            if path is None:
                self.lost = self.missing.copy()
                break
            at = wanted[np.hypot(*(cells.places[wanted] - path[-1]).T).argmin()]
            visits[at] += 1
            self._visit(path, self.missing[tuple(cells.index[at])])

    def _visit(self, path: Floats, need: Bools) -> None:
        """Drive along a path (k, 2) [m] and turn through the headings `need` (n_phi,) at its end."""
        task = self.task
        width = 2 * np.pi / task.coverage.headings
        builder = CurveBuilder(self.here, task.vehicle.limits, spin=width * task.rate / LOG.dwell_periods)
        builder.follow(path)
        builder.turn(choose_departure(builder, None, need, (0.0, 0.0)).angle, "spin")
        builder.wait(1.0 / task.rate)
        self.curves.append(builder.curve())
        self.stops += builder.stops
        self.here = builder.pose
        self.missing &= missed(self.curves[-1], self.missing, task.coverage, task.rate)
