"""Progress of a drive along a plan: the share of the plan's bins of (x, y, phi) that contain a pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.errors import MAX_LISTED
from logs.run import Run, pair
from planners.coverage import Coverage
from planners.trajectory import Trajectory, read_csv
from planners.types import Bools
from sensorgraph.errors import SensorgraphError
from sensorgraph.loading import read_plan_report
from sensorgraph.types import Floats


class PlanCoverage:
    """Bins that a plan visits at the rate of the robot's scans, and those that a drive has visited."""

    def __init__(
        self, trajectory: Trajectory, origin: Floats, cell: float, headings: int, rate: float
    ) -> None:
        """Compute the bins of the plan.

        Parameters
        ----------
        origin : (2,) [m] Lower left corner of the grid.
        cell : [m] Side of a cell.
        rate : [Hz] Rate at which the poses of the plan are sampled.
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
        SensorgraphError : The path is not a plan's folder, or its plan.json has no grid.
        """
        if not (plan / "trajectory.csv").is_file() or not (plan / "plan.json").is_file():
            raise SensorgraphError(
                f"{plan} has no trajectory.csv and plan.json, expected a plan's folder (from `sensorgraph plan`)"
            )
        report = read_plan_report(plan / "plan.json")
        try:
            grid = report["grid"]
            origin = np.array(grid["origin"], dtype=np.float64).reshape(2)
            cell, headings, rate = float(grid["cell"]), int(grid["headings"]), float(report["rate"])
            if not (cell > 0 and headings > 0 and rate > 0 and np.isfinite(origin).all()):
                raise ValueError("numbers must be positive")
        except (KeyError, TypeError, ValueError) as exc:
            raise SensorgraphError(
                f"{plan / 'plan.json'}: cannot read the grid or the rate ({exc}); plan again"
            ) from exc
        return cls(read_csv(plan / "trajectory.csv"), origin, cell, headings, rate)

    def add(self, run: Run) -> bool:
        """Count the poses of the scans of a run; False if the run has no poses in map."""
        if run.pose_frame != "base_link" or run.meta.get("pose_source", "").startswith(("odometry", "none")):
            return False
        pairing = pair(run)
        self.driven.add(pairing.poses[pairing.paired])
        return bool(pairing.paired.any())

    @property
    def missing(self) -> Bools:
        """(nx, ny, n_phi) Bins of the plan without a pose."""
        return np.asarray(self.planned & (self.driven.counts == 0))

    @property
    def share(self) -> float:
        """Share of the plan's bins that contain a pose."""
        return 1.0 - float(self.missing.sum() / max(self.planned.sum(), 1))

    def sentence(self) -> str:
        """Return a sentence with the covered share, and the places with the most missing bins."""
        missing, total = self.missing, int(self.planned.sum())
        n_missing = int(missing.sum())
        if n_missing == 0:
            return f"all {total:,} bins of the plan have a pose"
        by_cell = missing.sum(axis=2)
        worst = np.argsort(-by_cell, axis=None, kind="stable")[:MAX_LISTED]
        worst = worst[by_cell.ravel()[worst] > 0]
        cells = np.column_stack(np.unravel_index(worst, by_cell.shape))
        places = self.driven.origin + (cells + 0.5) * self.driven.cell
        named = ", ".join(
            f"({x:.2f}, {y:.2f}) {by_cell.ravel()[k]} of {self.planned.sum(axis=2).ravel()[k]} headings"
            for (x, y), k in zip(places.tolist(), worst.tolist(), strict=True)
        )
        n_cells = int((by_cell > 0).sum())
        return (
            f"{100 * self.share:.1f} % of the plan's {total:,} bins have a pose; {n_missing:,} missing in "
            f"{n_cells:,} cell{'' if n_cells == 1 else 's'}, most at {named}"
        )
