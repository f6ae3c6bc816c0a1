"""Evaluate a sensorgraph on a run: errors, shares, scan shape and calibration, with the names of INTERFACE."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.html_table import html_table
from logs.motion import motion_of, ray_poses
from logs.run import Pairing, PoseFrame, Run, pair
from logs.transforms import compose, invert
from sensorgraph.building.build import training_scans
from sensorgraph.building.split import held_out
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.in_sequence import sequence_metrics, sequence_predictions
from sensorgraph.evaluation.metrics import POINT_OF, Metrics, MetricSums, Reliability
from sensorgraph.evaluation.pose_errors import pose_errors_of
from sensorgraph.graph import POSES_AT_A_TIME, Sensorgraph
from sensorgraph.intake import check_jumps
from sensorgraph.models.base import OFF_DISTANCE, Point, Prediction, TrainingScans
from sensorgraph.models.faces.model import Faces
from sensorgraph.types import Bools, Floats, Ints, Progress
from sensorgraph.world.orientation import MAX_MEDIAN_ERROR
from sensorgraph.world.ray_order import bearings_text, ray_order
from sensorgraph.world.simulate import SCANS_PER_STEP

MIN_SCORED_RANGE = 0.1
"""[m] Shorter returns are not scored: they are the robot's own body or broken readings."""
MAX_READINGS = 250_000
"""Number of readings, in whole scans, by which the errors of the poses are estimated."""
MAX_SCORED_RANGE = 10.0
"""[m] Longer returns are not scored, unless another cap is given."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation:
    """The evaluation of a graph on a run."""

    scan_indices: NDArray[np.intp]
    """(n_scans,) indices of the evaluated scans in the run."""
    graph: Sensorgraph
    run: Run
    point: Point
    """Point value of the mixture used for `residual` and `prediction.ranges`."""
    answered_rays: Bools
    """(n_scans, n_rays) whether the graph answers."""
    residual: Floats
    """(n_scans, n_rays) [m] measured - predicted (mode, or the chosen point value); nan where not scored."""
    all: Metrics
    answered_only: Metrics
    calibration: list[dict[str, float]]
    """Bins {said, seen, n}: predicted and observed probability of an error above 5 cm, and the number of rays.

    Both are of the predictions for poses with the errors that the run's poses have (`pose_errors` in `settings`).
    """
    in_sequence: Mapping[str, Metrics]
    """`one_step`, `free_run` and `persistence` of a model with memory, on the rays of `all`; otherwise empty."""
    answered: float
    """Share of the scored rays that the graph answers."""
    settings: dict[str, Any]
    """`scored`, `point`, `split`, `sigma_m`, `pose_errors` [m, rad], `training` and counts."""

    @cached_property
    def prediction(self) -> Prediction:
        """(n_scans, n_rays) prediction of the scans; computed again on access, since it is large and seldom needed."""
        return predict_scans(self.graph, self.run, pair(self.run), self.scan_indices, point=self.point)

    @property
    def n_rays(self) -> int:
        """Number of scored rays."""
        return int(np.isfinite(self.residual).sum())

    @property
    def rmse_per_ray(self) -> Floats:
        """(n_rays,) [m] root mean square residual of each ray; nan where no reading was scored."""
        square = np.where(np.isfinite(self.residual), self.residual**2, 0.0).sum(axis=0)
        count = np.isfinite(self.residual).sum(axis=0)
        return np.sqrt(np.where(count > 0, square / np.maximum(count, 1), np.nan))

    @property
    def warnings(self) -> list[str]:
        """A warning if the surfaces of the graph and the readings of the run do not belong together; otherwise nothing."""
        median = self.answered_only["median_m"]
        if not isinstance(self.graph.model, Faces) or median is None or median <= MAX_MEDIAN_ERROR:
            return []
        return [
            f"the graph fits the run badly (median error {median:.2f} m): check that it is the graph of this place, that the "
            "poses are in its frame, and that poses and scans share a clock"
        ]

    def __repr__(self) -> str:
        """Summarise the number of scored rays and the metrics in a few lines."""

        def line(label: str, metrics: Metrics) -> str:
            shown = [f"{name} {value:.3g}" for name, value in metrics.items() if value is not None]
            return textwrap.shorten(f"{label}: {', '.join(shown)}", 160, placeholder=" ...")

        scored = f"Evaluation of {self.n_rays} rays in {len(self.scan_indices)} scans, {100 * self.answered:.1f} % answered"
        return "\n".join([scored, line("all", self.all), line("answered only", self.answered_only)])

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows: every metric of all rays and of the answered rays."""

        def cell(value: float | None) -> str:
            return "–" if value is None else f"{value:.3g}"

        rows = [(name, cell(self.all[name]), cell(self.answered_only.get(name))) for name in self.all]
        caption = (
            f"{self.n_rays:,} rays in {len(self.scan_indices):,} scans, {100 * self.answered:.1f} % answered"
        )
        return html_table(caption, rows, head=("", "all", "answered only"))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; an undefined number is None."""
        return {
            "n_rays": self.n_rays,
            "answered": self.answered,
            "all": self.all,
            "answered_only": self.answered_only,
            **self.in_sequence,
            "calibration": self.calibration,
            **self.settings,
        }


def evaluate(
    graph: Sensorgraph, run: Run, *, split: str | None = None, point: Point | None = None,
    cap: float | None = None, force: bool = True, progress: Progress | None = None,
) -> Evaluation:  # fmt: skip
    """Predict the scans of a run that have a pose, and score the predictions.

    A ray is scored if its measured return lies between 0.1 m and `cap` (default: 10 m, or range_max if that is
    smaller). Errors compare the return with the value predicted given a return. `no_return_recall` and
    `no_return_precision` score the prediction of missing returns over all valid rays. `wrong_5cm_expected` is the share of
    errors above 5 cm that the graph expects, given the errors of the run's poses, which the readings show.
    Without `force`, a run whose poses jump is refused, as the commands do.

    Raises
    ------
    SensorgraphError : The sensor differs, the poses jump, or no scan or ray can be scored.
    """
    cap = min(MAX_SCORED_RANGE, run.sensor.range_max) if cap is None else cap
    if not cap > MIN_SCORED_RANGE:
        raise SensorgraphError(f"cap is {cap:g} m, expected more than {MIN_SCORED_RANGE} m")
    rays = _rays_of(graph, run)
    pairing = pair(run)
    check_jumps(run, pairing, force=force)
    index = np.flatnonzero(pairing.paired & (held_out(run, split) if split is not None else True))
    if len(index) == 0:
        held = "" if split is None else f", none of them in split {split}"
        raise SensorgraphError(f"nothing to evaluate: {pairing}{held}")
    sigma = run.sensor.sigma if run.sensor.sigma > 0 else 0.01
    all_rays, answered = (
        MetricSums(bearings=run.sensor.bearings, point=point, sigma=sigma) for _ in range(2)
    )
    calibration, errors = Reliability(), _pose_errors(graph, run, pairing, index, rays)
    uncertain = graph.with_pose_errors(*errors) if any(errors) else graph
    residual = np.full((len(index), run.sensor.n_rays), np.nan)
    answered_rays = np.zeros(residual.shape, dtype=np.bool_)
    for first in range(0, len(index), POSES_AT_A_TIME):
        if progress is not None:
            progress(first, len(index))
        some = slice(first, first + POSES_AT_A_TIME)
        measured = run.ranges[index[some]]
        prediction = predict_scans(graph, run, pairing, index[some], point=point or "mode")
        scored = np.isfinite(measured) & (measured > MIN_SCORED_RANGE) & (measured < cap)
        off = np.where(scored, measured - prediction.point(point or "mode"), np.nan)
        residual[some], answered_rays[some] = off, prediction.answered
        valid, stated = ~np.isnan(measured), prediction
        if uncertain is not graph:
            stated = predict_scans(uncertain, run, pairing, index[some], point=point or "mode")
            off = np.where(scored, measured - stated.point(point or "mode"), np.nan)
        all_rays.add(measured, prediction, scored, valid, stated)
        answered.add(measured, prediction, scored & prediction.answered, valid & prediction.answered, stated)
        calibration.add(stated.p_off[scored], np.abs(off[scored]) > OFF_DISTANCE)
    if not all_rays.total["n"]:
        raise SensorgraphError(
            f"no ray of the run returned between {MIN_SCORED_RANGE} m and {cap:g} m; nothing to score"
        )
    there = poses_for(graph, run.pose_frame, run.sensor.mount, pairing.poses)
    in_sequence = sequence_metrics(
        sequence_predictions(graph, run, pairing, there, rays),
        (np.cumsum(pairing.paired) - 1)[index], run.ranges[index], np.isfinite(residual), point=point,
        bearings=run.sensor.bearings, sigma=sigma,
    )  # fmt: skip
    return Evaluation(
        scan_indices=index,
        graph=graph,
        run=run,
        point=point or "mode",
        answered_rays=answered_rays,
        residual=residual,
        all=all_rays.metrics(np.abs(residual[np.isfinite(residual)])),
        answered_only=answered.metrics(np.abs(residual[np.isfinite(residual) & answered_rays])),
        calibration=calibration.rows(),
        in_sequence=in_sequence,
        answered=answered.total["n"] / all_rays.total["n"],
        settings={
            "scored": {"from_m": MIN_SCORED_RANGE, "to_m": cap, "n_scans": len(index), "of_scans": run.n_scans},
            "point": {name: point or default for name, default in POINT_OF.items()},
            "split": split, "sigma_m": sigma, "pose_errors": dict(zip(("xy_m", "yaw_rad"), errors, strict=True)),
            "training": _training_overlap(graph, run, index, split),
        },
    )  # fmt: skip


def _rays_of(graph: Sensorgraph, run: Run) -> Ints:
    """Return the index (n_rays,) of the graph's ray for each ray of the run."""
    rays = ray_order(graph.sensor.bearings, run.sensor.bearings)
    if rays is None:
        raise SensorgraphError(
            f"the run has {run.sensor.n_rays} rays at other bearings than the {graph.sensor.n_rays} of the graph "
            f"({bearings_text(run.sensor.bearings, graph.sensor.bearings)}); evaluate with a run of the same sensor"
        )
    return rays


def predict_scans(
    graph: Sensorgraph, run: Run, pairing: Pairing, scans: Ints, *, point: Point = "mode"
) -> Prediction:
    """Predict paired scans (n,) of a run; for a sweep, each ray starts from the robot's pose at the time of the ray.

    The rays are numbered as in the run.

    Raises
    ------
    SensorgraphError : The run is of another sensor.
    """
    mount, rays = run.sensor.mount, _rays_of(graph, run)
    if not run.sensor.has_ray_delays:  # the graph stores the origins of the rays of several sensors
        return graph.predict(
            poses_for(graph, run.pose_frame, mount, pairing.poses[scans]), rays=rays, point=point
        )
    motion, parts = motion_of(run), []
    for start in range(0, len(scans), SCANS_PER_STEP):
        poses = ray_poses(run, pairing, scans[start : start + SCANS_PER_STEP], motion=motion)
        parts.append(graph.predict(poses_for(graph, run.pose_frame, mount, poses), rays=rays, point=point))
    return Prediction.concatenate(parts)


def poses_for(graph: Sensorgraph, frame: PoseFrame, mount: Floats, poses: Floats) -> Floats:
    """Convert poses (..., 3) to the frame of the graph's training poses; `mount` (3,) is T_base_laser."""
    if frame == graph.pose_frame:
        return poses
    return compose(poses, mount if graph.pose_frame == "laser" else invert(mount))


def _pose_errors(
    graph: Sensorgraph, run: Run, pairing: Pairing, scans: Ints, rays: Ints
) -> tuple[float, float]:
    """Return the errors [m, rad] of the poses of paired scans (n,), by scans spread evenly over the run."""
    some = scans[:: -(-len(scans) * len(rays) // MAX_READINGS)]
    order, mount, of_rays = np.argsort(rays), run.sensor.mount, None
    if run.sensor.has_ray_poses:
        of_rays = ray_poses(run, pairing, some, motion=motion_of(run))[:, order]
        of_rays = poses_for(graph, run.pose_frame, mount, of_rays)
    scans_there = TrainingScans(
        sensor=graph.sensor, poses=poses_for(graph, run.pose_frame, mount, pairing.poses[some]),
        ranges=run.ranges[np.ix_(some, order)], run=np.zeros(len(some), dtype=np.intp),
        pose_frame=graph.pose_frame, ray_poses=of_rays,
    )  # fmt: skip
    return pose_errors_of(graph.model, scans_there)


def _training_overlap(graph: Sensorgraph, run: Run, index: NDArray[np.intp], split: str | None) -> str:
    """Return a sentence on whether the evaluated scans were used for training."""
    trained = training_scans(graph, run)
    if trained is None:
        return "the graph has not seen this run"
    seen = int(trained[index].sum())
    if seen == 0:
        return f"held out: none of these scans was trained on (split {split})"
    built = graph.origin["split"]
    how = f"built {_split_text(built)}, evaluated {_split_text(split)}"
    return f"{seen} of {len(index)} scans were trained on ({how}): the numbers are better than on new scans"


def _split_text(split: str | None) -> str:
    return "without a split" if split is None else f"with split {split}"
