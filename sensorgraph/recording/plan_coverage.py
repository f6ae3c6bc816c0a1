"""How much of a plan a robot has driven so far: the bins of (x, y, phi) that the plan logs a pose in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.run import Run, pair
from planners.coverage import Coverage
from planners.trajectory import Trajectory, read_csv
from planners.types import Bools
from sensorgraph.errors import SensorgraphError
from sensorgraph.loading import read_plan_report
from sensorgraph.types import Floats

MOST_PLACES = 3
"""Places that a sentence names."""


class PlanCoverage:
    """Bins that a plan meets at the rate of its robot's scans, and which of them a drive has met."""

    def __init__(
        self, trajectory: Trajectory, origin: Floats, cell: float, headings: int, rate: float
    ) -> None:
        """Find the plan's bins.

        Parameters
        ----------
        origin : (2,) [m] lower left corner of the grid
        cell : [m]
        rate : [Hz] at which the plan's poses are taken
        """
        stamps = np.arange(trajectory.stamps[0], trajectory.stamps[-1], 1.0 / rate)
        poses, _ = trajectory.at(stamps)
        size = np.floor((poses[:, :2].max(axis=0) - origin) / cell).astype(np.int64) + 2
        planned = Coverage.empty(
            origin=origin, cell=cell, cells=np.ones(tuple(size.tolist()), dtype=np.bool_), headings=headings
        )
        planned.add(poses)
        self.planned: Bools = planned.covered
        """(nx, ny, n_phi)"""
        self.driven = Coverage.empty(
            origin=origin, cell=cell, cells=np.ones(tuple(size.tolist()), dtype=np.bool_), headings=headings
        )

    @classmethod
    def of(cls, plan: Path) -> PlanCoverage:
        """Read a plan's folder.

        Raises
        ------
        SensorgraphError : it is no plan's folder, or its plan.json says no grid
        """
        if not (plan / "trajectory.csv").is_file() or not (plan / "plan.json").is_file():
            raise SensorgraphError(
                f"{plan} holds no trajectory.csv and plan.json; give a plan's folder (`sensorgraph plan` makes one)"
            )
        report = read_plan_report(plan / "plan.json")
        try:
            grid = report["grid"]
            origin = np.array(grid["origin"], dtype=np.float64).reshape(2)
            cell, headings, rate = float(grid["cell"]), int(grid["headings"]), float(report["rate"])
            if not (cell > 0 and headings > 0 and rate > 0 and np.isfinite(origin).all()):
                raise ValueError("its numbers are not positive")
        except (KeyError, TypeError, ValueError) as exc:
            raise SensorgraphError(
                f"{plan / 'plan.json'}: its grid or rate cannot be read ({exc}); plan again"
            ) from exc
        return cls(read_csv(plan / "trajectory.csv"), origin, cell, headings, rate)

    def add(self, run: Run) -> bool:
        """Count where the scans of a run were taken; False: the run does not say it in map."""
        if run.pose_frame != "base_link" or run.meta.get("pose_source", "").startswith(("odometry", "none")):
            return False
        pairing = pair(run)
        self.driven.add(pairing.poses[pairing.paired])
        return bool(pairing.paired.any())

    @property
    def missing(self) -> Bools:
        """(nx, ny, n_phi) bins of the plan without a pose."""
        return np.asarray(self.planned & (self.driven.counts == 0))

    @property
    def share(self) -> float:
        """Of the plan's bins that have a pose."""
        return 1.0 - float(self.missing.sum() / max(self.planned.sum(), 1))

    def sentence(self) -> str:
        """Say how much is covered, and where most is missing."""
        missing, total = self.missing, int(self.planned.sum())
        n_missing = int(missing.sum())
        if n_missing == 0:
            return f"all {total:,} bins of the plan have a pose"
        by_cell = missing.sum(axis=2)
        worst = np.argsort(-by_cell, axis=None, kind="stable")[:MOST_PLACES]
        worst = worst[by_cell.ravel()[worst] > 0]
        cells = np.column_stack(np.unravel_index(worst, by_cell.shape))
        places = self.driven.origin + (cells + 0.5) * self.driven.cell
        named = ", ".join(
            f"({x:.2f}, {y:.2f}) {by_cell.ravel()[k]} of {self.planned.sum(axis=2).ravel()[k]} headings"
            for (x, y), k in zip(places.tolist(), worst.tolist(), strict=True)
        )
        return (
            f"{100 * self.share:.1f} % of the plan's {total:,} bins have a pose; {n_missing:,} missing in "
            f"{int((by_cell > 0).sum()):,} cells, most at {named}"
        )
