"""The contents of a review as arrays: scans in the map, coverage, error by place, heading and ray."""

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
"""Maximum number of scans in a review file, so that it opens quickly."""


ARC_POINTS = 9
"""Number of points of the arc of a cone."""


class RayVerdict(IntEnum):
    """Verdict on a measured ray."""

    UNSCORED = 0
    """There is no measurement or no prediction to compare."""
    RIGHT = 1
    """Answered with an error of at most 5 cm."""
    WRONG = 2
    """Answered with a larger error."""
    UNANSWERED = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Review:
    """A run in the map, and the predictions of a sensorgraph for it, as arrays."""

    run: Run
    name: str
    """Name of the run in texts."""
    pairing: Pairing
    shown: NDArray[np.intp]
    """(n_shown,) Indices of the scans in the review."""
    lasers: Floats
    """(n_shown, n_rays, 3) [m, m, rad] Laser in map at the time of each ray; (n_shown, 1, 3) without a sweep."""
    measured: Floats
    """(n_shown, n_rays) [m] Measured ranges."""
    predicted: Floats | None
    """(n_shown, n_rays) [m] Predicted ranges; nan if not answered, +inf if no return is predicted."""
    evaluation: Evaluation | None
    """Evaluation of the shown scans."""
    held_out: Evaluation | None
    """Evaluation of the held-out scans, if the graph was built from this run with a split."""
    cells: ReviewCells
    arena: Arena | None
    planned: Floats | None
    """(n, 2) [m] The planned path."""
    plan: Mapping[str, Any] | None
    """Content of plan.json."""
    graph: Sensorgraph | None
    intensities: Floats | None = None
    """(n_shown, n_rays) Intensities of the measured rays, in the unit of the driver; None: not recorded."""
    deviations: Floats | None = None
    """(n_shown, 3) [m, m, rad] Standard deviations of x, y, phi given in the run; None without covariances."""

    def points(self, ranges: Floats, part: slice = slice(None)) -> list[Floats]:
        """Return the end points (n, 2) [m, map] of each shown scan in `part`, from ranges (n_shown, n_rays) [m]."""
        lasers, ranges = self.lasers[part], ranges[part]
        phi = lasers[..., 2] + self.run.sensor.bearings
        ends = lasers[..., :2] + ranges[..., None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
        return [scan[hit] for scan, hit in zip(ends, np.isfinite(ranges), strict=True)]

    def arcs(self, ranges: Floats, part: slice = slice(None)) -> list[Floats]:
        """Return the arcs (n, ARC_POINTS, 2) [m, map] of each shown scan in `part`, from ranges (n_shown, n_rays) [m].

        The nearest surface of a cone lies on its arc. The arc of a thin ray is a point.
        """
        lasers, ranges, sensor = self.lasers[part], ranges[part], self.run.sensor
        turns = np.linspace(-0.5, 0.5, ARC_POINTS) * (sensor.cones[:, None] if len(sensor.cones) else 0.0)
        phi = (lasers[..., 2] + sensor.bearings)[..., None] + turns  # (n_shown, n_rays, ARC_POINTS)
        ends = lasers[..., None, :2] + ranges[..., None, None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
        return [scan[hit] for scan, hit in zip(ends, np.isfinite(ranges), strict=True)]

    @property
    def robots(self) -> Floats:
        """(n_shown, 3) [m, m, rad] Poses in map of the laser, or of base_link for several sensors."""
        if not self.run.sensor.is_composite:
            return self.lasers[:, 0]
        return self.pairing.poses[self.shown]

    @property
    def verdicts(self) -> NDArray[np.uint8]:
        """(n_shown, n_rays) RayVerdict of each measured ray."""
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
    """Collect the contents of a review of a run, with a sensorgraph or without.

    Parameters
    ----------
    arena : Arena whose walls are drawn. None: no walls are drawn.
    name : Name of the run. None: the name of its source file.
    planned : (n, 2) [m] Path of the plan.
    cell : [m] Side of a cell of the maps. None: 0.25, or larger if there would be too many cells.
    max_scans : Maximum number of scans that are shown, evenly spaced.
    force : Accept a run whose poses jump. False: refuse it, as the commands do.

    Raises
    ------
    SensorgraphError : No scan has a pose, the poses jump, or run and graph have different sensors.
    """
    pairing = pair(run)
    check_jumps(run, pairing, force=force)
    index = np.flatnonzero(pairing.paired)
    if not len(index):
        raise SensorgraphError(f"{pairing}; no scan can be placed in the map: record poses with the scans")
    shown = index[np.linspace(0, len(index) - 1, min(len(index), max_scans)).round().astype(np.intp)]
    part, poses = run.take_scans(shown), pairing.poses[shown]
    if (np.diff(run.stamps) == 0).any():  # scans with equal stamps are paired in order: keep these pairs
        part = replace(part, pose_stamps=part.stamps, poses=poses, pose_covariances=np.zeros((0, 3, 3)))
    evaluation = held_out = predicted = None
    if graph is not None:
        evaluation, held_out, predicted = _evaluated(graph, run, part, progress)
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
        intensities=part.intensities if len(part.intensities) else None,
        deviations=_deviations(run, shown),
    )


def _evaluated(
    graph: Sensorgraph, run: Run, part: Run, progress: ProgressBars
) -> tuple[Evaluation, Evaluation | None, Floats]:
    """Return the evaluation of the shown scans, that of held-out scans, and the answered ranges (n_shown, n_rays) [m].

    Parameters
    ----------
    part : The shown scans of the run.
    """
    with progress("evaluating", "scans") as tick:
        evaluation = evaluate(graph, part, force=True, progress=tick)
    held_out = None
    split = graph.origin.get("split")
    if split is not None and training_scans(graph, run) is not None:
        with progress("evaluating held-out scans", "scans") as tick:
            held_out = evaluate(graph, run, split=split, force=True, progress=tick)
    predicted = np.full(part.ranges.shape, np.nan)
    with progress("predicting", ""):
        prediction = evaluation.prediction
    predicted[evaluation.scan_indices] = np.where(prediction.answered, prediction.ranges, np.nan)
    return evaluation, held_out, predicted


def _deviations(run: Run, shown: NDArray[np.intp]) -> Floats | None:
    """Return the standard deviations (n_shown, 3) given in the run for the poses nearest to the shown scans."""
    if len(run.pose_covariances) == 0:
        return None
    after = np.clip(np.searchsorted(run.pose_stamps, run.stamps[shown]), 0, len(run.pose_stamps) - 1)
    before = np.maximum(after - 1, 0)
    stamps = run.stamps[shown]
    is_before = np.abs(run.pose_stamps[before] - stamps) < np.abs(run.pose_stamps[after] - stamps)
    covariances = run.pose_covariances[np.where(is_before, before, after)]
    return np.asarray(np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0)))
