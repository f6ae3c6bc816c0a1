"""What a review shows, as plain arrays: scans in the map, coverage, error by place, heading and ray."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.motion import ray_poses
from logs.run import Pairing, Run, pair
from planners.arena import Arena
from sensorgraph.building.build import training_scans
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.intake import check_jumps
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.show.review.cells import ReviewCells, count_cells
from sensorgraph.types import Floats, ProgressBars, no_progress
from sensorgraph.world.raycast import laser_poses

MAX_SCANS = 5000
"""Scans that a review file holds: enough to look at, small enough to open at once."""


ARC_POINTS = 9
"""Points of the arc of a cone."""


class RayVerdict(IntEnum):
    """What came of a measured ray."""

    UNSCORED = 0
    """Nothing to compare."""
    RIGHT = 1
    """Answered, and within 5 cm."""
    WRONG = 2
    """Answered, and farther off."""
    UNANSWERED = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Review:
    """A run in the map, and what a sensorgraph predicts of it: everything that is drawn."""

    run: Run
    name: str
    """What to call the run."""
    pairing: Pairing
    shown: NDArray[np.intp]
    """(n_shown,) indices of the scans in the review."""
    lasers: Floats
    """(n_shown, n_rays, 3) [m, m, rad] laser in map when each ray was taken; (n_shown, 1, 3) without a sweep."""
    measured: Floats
    """(n_shown, n_rays) [m]"""
    predicted: Floats | None
    """(n_shown, n_rays) [m] where answered, else nan; +inf where no return is predicted."""
    evaluation: Evaluation | None
    """Of the shown scans."""
    held_out: Evaluation | None
    """Of the held-out scans, if the graph was built from this run with a split."""
    cells: ReviewCells
    arena: Arena | None
    planned: Floats | None
    """(n, 2) [m] the planned path."""
    plan: Mapping[str, Any] | None
    """plan.json"""
    graph: Sensorgraph | None
    deviations: Floats | None = None
    """(n_shown, 3) [m, m, rad] standard deviations of x, y, phi as the run states them; None: it does not."""

    def points(self, ranges: Floats, part: slice = slice(None)) -> list[Floats]:
        """Return the end points (n, 2) [m, map] of each shown scan in `part`; `ranges` (n_shown, n_rays) [m]."""
        lasers, ranges = self.lasers[part], ranges[part]
        phi = lasers[..., 2] + self.run.sensor.bearings
        ends = lasers[..., :2] + ranges[..., None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
        return [scan[hit] for scan, hit in zip(ends, np.isfinite(ranges), strict=True)]

    def arcs(self, ranges: Floats, part: slice = slice(None)) -> list[Floats]:
        """Return the arcs (n, ARC_POINTS, 2) [m, map] on which the nearest surfaces of cones lie, of each shown scan in `part`.

        `ranges` (n_shown, n_rays) [m]; of a thin ray the arc is a point.
        """
        lasers, ranges, sensor = self.lasers[part], ranges[part], self.run.sensor
        turns = np.linspace(-0.5, 0.5, ARC_POINTS) * (sensor.cones[:, None] if len(sensor.cones) else 0.0)
        phi = (lasers[..., 2] + sensor.bearings)[..., None] + turns  # (n_shown, n_rays, ARC_POINTS)
        ends = lasers[..., None, :2] + ranges[..., None, None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
        return [scan[hit] for scan, hit in zip(ends, np.isfinite(ranges), strict=True)]

    @property
    def robots(self) -> Floats:
        """(n_shown, 3) [m, m, rad] in map: the laser, or base_link where several sensors are read as one."""
        if not self.run.sensor.is_composite:
            return self.lasers[:, 0]
        return self.pairing.poses[self.shown]

    @property
    def verdicts(self) -> NDArray[np.uint8]:
        """(n_shown, n_rays) the RayVerdict of each measured ray."""
        out = np.full(self.measured.shape, RayVerdict.UNSCORED, dtype=np.uint8)
        if self.evaluation is not None:
            residual = self.evaluation.residual
            answered = np.where(np.abs(residual) > OFF_DISTANCE, RayVerdict.WRONG, RayVerdict.RIGHT)
            verdict = np.where(self.evaluation.prediction.answered, answered, RayVerdict.UNANSWERED)
            out[self.evaluation.scan_indices] = np.where(np.isfinite(residual), verdict, RayVerdict.UNSCORED)
        return out

    def __repr__(self) -> str:
        graph = "no graph" if self.graph is None else f"against a graph of {self.graph.model.name}"
        return f"Review of {self.name}: {self.pairing}; {len(self.shown):,} scans shown, {graph}"


def collect(
    run: Run,
    *,
    graph: Sensorgraph | None = None,
    arena: Arena | None = None,
    name: str | None = None,
    planned: Floats | None = None,
    plan: Mapping[str, Any] | None = None,
    cell: float | None = None,
    max_scans: int = MAX_SCANS,
    force: bool = True,
    progress: ProgressBars = no_progress,
) -> Review:
    """Collect what there is to see of a run, and of a sensorgraph against it.

    Parameters
    ----------
    arena : walls to draw; None: none
    name : what to call the run; None: the file it says it came from
    planned : (n, 2) [m] path of the plan
    cell : [m] of the maps; None: 0.25, or coarser where that would be too many
    max_scans : of a longer run, so many are shown, evenly chosen
    force : take a run whose poses jump, too; False: refuse it, as the commands do

    Raises
    ------
    SensorgraphError : no scan has a pose, the poses jump, or the sensor of the run is not that of the graph
    """
    pairing = pair(run)
    check_jumps(run, pairing, force=force)
    index = np.flatnonzero(pairing.paired)
    if not len(index):
        raise SensorgraphError(f"{pairing}; nothing to place in the map: record poses with the scans")
    shown = index[np.linspace(0, len(index) - 1, min(len(index), max_scans)).round().astype(np.intp)]
    part, poses = replace(run, stamps=run.stamps[shown], ranges=run.ranges[shown]), pairing.poses[shown]
    if (np.diff(run.stamps) == 0).any():  # scans that share a stamp are paired in their order: keep the pairs
        part = replace(part, pose_stamps=part.stamps, poses=poses, pose_covariances=np.zeros((0, 3, 3)))
    evaluation = held_out = predicted = None
    if graph is not None:
        with progress("evaluating", "scans") as tick:
            evaluation = evaluate(graph, part, force=True, progress=tick)
    if graph is not None and evaluation is not None:
        split = graph.origin.get("split")
        if split is not None and training_scans(graph, run) is not None:
            with progress("evaluating what was held out", "scans") as tick:
                held_out = evaluate(graph, run, split=split, force=True, progress=tick)
        predicted = np.full(part.ranges.shape, np.nan)
        with progress("predicting", ""):
            prediction = evaluation.prediction
        predicted[evaluation.scan_indices] = np.where(prediction.answered, prediction.ranges, np.nan)
    lasers = ray_poses(run, pairing, shown)
    lasers = lasers if run.pose_frame == "laser" else laser_poses(lasers, run.sensor.mount)
    rays = np.stack([lasers[..., 2] + run.sensor.bearings, part.ranges], axis=-1)
    with progress("counting by place and heading", ""):
        cells = count_cells(
            pairing.poses[index],
            poses,
            evaluation,
            rays=(lasers, rays),
            arena=arena,
            graph=graph,
            cell=cell,
        )
    return Review(
        run=run,
        name=name or run.meta.get("source", "run").rsplit("/", 1)[-1],
        pairing=pairing,
        shown=shown,
        lasers=lasers,
        measured=part.ranges,
        predicted=predicted,
        evaluation=evaluation,
        held_out=held_out,
        cells=cells,
        arena=arena,
        planned=planned,
        plan=plan,
        graph=graph,
        deviations=_deviations(run, shown),
    )


def _deviations(run: Run, shown: NDArray[np.intp]) -> Floats | None:
    """Return the stated standard deviations (n_shown, 3) of the poses nearest to some scans."""
    if len(run.pose_covariances) == 0:
        return None
    after = np.clip(np.searchsorted(run.pose_stamps, run.stamps[shown]), 0, len(run.pose_stamps) - 1)
    before = np.maximum(after - 1, 0)
    stamps = run.stamps[shown]
    is_before = np.abs(run.pose_stamps[before] - stamps) < np.abs(run.pose_stamps[after] - stamps)
    covariances = run.pose_covariances[np.where(is_before, before, after)]
    return np.asarray(np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0)))
