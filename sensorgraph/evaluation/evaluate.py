"""Evaluate a sensorgraph on a run: errors, shares, shape of the scan, calibration; numbers as INTERFACE names them."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from logs.html_table import html_table
from logs.motion import motion_of, ray_poses
from logs.run import Pairing, PoseFrame, Run, pair
from sensorgraph.building.build import is_same_sensor, training_scans
from sensorgraph.building.split import held_out
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.intake import check_jumps
from sensorgraph.models.base import OFF_DISTANCE, Point, Prediction
from sensorgraph.types import Bools, Floats, Ints, Progress
from sensorgraph.world.raycast import laser_poses
from sensorgraph.world.simulate import SCANS_PER_STEP

MIN_SCORED_RANGE = 0.1
"""[m] a shorter return does not count: the robot's own body, or a broken reading."""
MAX_SCORED_RANGE = 10.0
"""[m] a longer return does not count, unless another cap is asked for."""
MATCH_DISTANCE = 0.1
"""[m] end points closer than this match in the f-score."""
RELIABILITY_EDGES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
"""Bins of the said chance of being off."""
POINT_OF: dict[str, Point] = {
    "median_m": "mode",
    "mae_m": "median",
    "rmse_m": "mean",
    "within_0.1m": "mode",
    "within_0.5m": "mode",
    "within_3sigma": "mode",
    "wrong_5cm": "mode",
    "pearson_r": "mean",
    "chamfer_m": "mode",
    "f_score": "mode",
}
"""Which point value a number belongs to, unless one is asked for."""

Metrics = dict[str, float | None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation:
    """How well a graph predicts a run."""

    scan_indices: NDArray[np.intp]
    """(n_scans,) which scans of the run were evaluated."""
    prediction: Prediction
    """(n_scans, n_rays) what the graph says of them."""
    residual: Floats
    """(n_scans, n_rays) [m] measured - predicted (mode, or the point asked for); nan where not scored."""
    all: Metrics
    answered_only: Metrics
    calibration: list[dict[str, float]]
    """Bins {said, seen, n}: said and seen chance of being more than 5 cm off."""
    answered: float
    """Share of the scored rays that the graph answers."""
    settings: dict[str, Any]
    """`scored`, `point`, `split`, `sigma_m`, `training`, counts."""

    @property
    def n_rays(self) -> int:
        """Count of scored rays."""
        return int(np.isfinite(self.residual).sum())

    @property
    def rmse_per_ray(self) -> Floats:
        """(n_rays,) [m] root mean square of the residual of each ray; nan where none was scored."""
        square = np.where(np.isfinite(self.residual), self.residual**2, 0.0).sum(axis=0)
        count = np.isfinite(self.residual).sum(axis=0)
        return np.sqrt(np.where(count > 0, square / np.maximum(count, 1), np.nan))

    def __repr__(self) -> str:
        """Say how many rays were scored, and how well."""

        def line(label: str, metrics: Metrics) -> str:
            shown = [f"{name} {value:.3g}" for name, value in metrics.items() if value is not None]
            return textwrap.shorten(f"{label}: {', '.join(shown)}", 160, placeholder=" ...")

        scored = f"Evaluation of {self.n_rays} rays in {len(self.scan_indices)} scans, {100 * self.answered:.1f} % answered"
        return "\n".join([scored, line("all", self.all), line("answered only", self.answered_only)])

    def _repr_html_(self) -> str:
        """Return what a notebook shows: every metric of all rays, and of the answered ones."""

        def cell(value: float | None) -> str:
            return "–" if value is None else f"{value:.3g}"

        rows = [(name, cell(self.all[name]), cell(self.answered_only.get(name))) for name in self.all]
        caption = (
            f"{self.n_rays:,} rays in {len(self.scan_indices):,} scans, {100 * self.answered:.1f} % answered"
        )
        return html_table(caption, rows, head=("", "all", "answered only"))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; a number that is not defined is None."""
        return {
            "n_rays": self.n_rays,
            "answered": self.answered,
            "all": self.all,
            "answered_only": self.answered_only,
            "calibration": self.calibration,
            **self.settings,
        }


def evaluate(
    graph: Sensorgraph,
    run: Run,
    *,
    split: str | None = None,
    point: Point | None = None,
    cap: float | None = None,
    force: bool = True,
    progress: Progress | None = None,
) -> Evaluation:
    """Predict the scans of a run that have a pose, and compare.

    A ray is scored where a return between 0.1 m and `cap` was measured (default: 10 m, or range_max if that
    is smaller). Errors compare it with the value predicted given a return; whether a return was predicted
    at all is scored by `no_return_recall` and `no_return_precision`, over all rays that are not broken.
    Without `force`, a run whose poses jump is refused, as the commands do.

    Raises
    ------
    SensorgraphError : another sensor, poses that jump, nothing to evaluate, or no ray that can be scored
    """
    cap = min(MAX_SCORED_RANGE, run.sensor.range_max) if cap is None else cap
    if not cap > MIN_SCORED_RANGE:
        raise SensorgraphError(f"cap is {cap:g} m, expected more than {MIN_SCORED_RANGE} m")
    if not is_same_sensor(graph.sensor.bearings, run.sensor.bearings):
        raise SensorgraphError(
            f"the run has {run.sensor.n_rays} rays at other bearings than the {graph.sensor.n_rays} of the graph; "
            "evaluate with a run of the same sensor"
        )
    pairing = pair(run)
    check_jumps(run, pairing, force=force)
    use = pairing.paired & (held_out(run, split) if split is not None else True)
    index = np.flatnonzero(use)
    if len(index) == 0:
        held = "" if split is None else f", none of them in split {split}"
        raise SensorgraphError(f"nothing to evaluate: {pairing}{held}")
    measured = run.ranges[index]
    prediction = predict_scans(graph, run, pairing, index, point=point or "mode")
    scored = np.isfinite(measured) & (measured > MIN_SCORED_RANGE) & (measured < cap)
    if not scored.any():
        raise SensorgraphError(
            f"no ray of the run returned between {MIN_SCORED_RANGE} m and {cap:g} m; nothing to score"
        )
    sigma = run.sensor.sigma if run.sensor.sigma > 0 else 0.01
    residual = np.where(scored, measured - prediction.point(point or "mode"), np.nan)
    job = Comparison(
        measured=measured, prediction=prediction, bearings=run.sensor.bearings, point=point, sigma=sigma
    )
    return Evaluation(
        scan_indices=index,
        prediction=prediction,
        residual=residual,
        all=job.metrics(scored, ~np.isnan(measured), progress),
        answered_only=job.metrics(scored & prediction.answered, ~np.isnan(measured) & prediction.answered),
        calibration=_reliability(prediction.p_off[scored], np.abs(residual[scored]) > OFF_DISTANCE),
        answered=float(prediction.answered[scored].mean()),
        settings={
            "scored": {
                "from_m": MIN_SCORED_RANGE,
                "to_m": cap,
                "n_scans": len(index),
                "of_scans": run.n_scans,
            },
            "point": {name: point or default for name, default in POINT_OF.items()},
            "split": split,
            "sigma_m": sigma,
            "training": _training_overlap(graph, run, index, split),
        },
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """What all metrics are computed from."""

    measured: Floats
    prediction: Prediction
    bearings: Floats
    point: Point | None
    sigma: float

    def value(self, name: str) -> Floats:
        return self.prediction.point(self.point or POINT_OF[name])

    def metrics(self, scored: Bools, valid: Bools, progress: Progress | None = None) -> Metrics:
        """Compute one block; `scored` and `valid` (n_scans, n_rays) say which rays count."""
        out: Metrics = dict.fromkeys((*POINT_OF, "no_return_recall", "no_return_precision"))
        nothing = np.isposinf(self.measured) & valid
        said = np.isposinf(self.prediction.ranges) & valid
        both = int((nothing & said).sum())
        out["no_return_recall"] = both / int(nothing.sum()) if nothing.any() else None
        out["no_return_precision"] = both / int(said.sum()) if said.any() else None
        out["within_3sigma_said"] = None
        if not scored.any():
            return out
        truth = self.measured[scored]
        off = {name: np.abs(self.value(name)[scored] - truth) for name in POINT_OF}
        out["median_m"] = float(np.median(off["median_m"]))
        out["mae_m"] = float(off["mae_m"].mean())
        out["rmse_m"] = float(np.sqrt((off["rmse_m"] ** 2).mean()))
        out["within_0.1m"] = float((off["within_0.1m"] <= 0.1).mean())
        out["within_0.5m"] = float((off["within_0.5m"] <= 0.5).mean())
        out["within_3sigma"] = float((off["within_3sigma"] <= 3 * self.sigma).mean())
        out["within_3sigma_said"] = float((off["within_3sigma"] <= 3 * self.prediction.sigma[scored]).mean())
        out["wrong_5cm"] = float((off["wrong_5cm"] > OFF_DISTANCE).mean())
        out["pearson_r"] = _pearson(truth, self.value("pearson_r")[scored])
        out["chamfer_m"], out["f_score"] = self.shape(scored, progress)
        return out

    def shape(self, scored: Bools, progress: Progress | None) -> tuple[float, float]:
        """Compare the end points of each scan in the plane; return mean chamfer distance [m] and f-score.

        Chamfer is half the sum of the mean distances to the nearest end point, measured to predicted and
        back; the f-score is the harmonic mean of both shares within 0.1 m. Scans without a scored ray do not count.
        """
        directions = np.column_stack([np.cos(self.bearings), np.sin(self.bearings)])
        value = self.value("chamfer_m")
        chamfer, f_score = [], []
        for i in range(len(scored)):
            if progress is not None and i % 100 == 0:
                progress(i, len(scored))
            rays = np.flatnonzero(scored[i])
            if len(rays) == 0:
                continue
            seen = self.measured[i, rays, None] * directions[rays]
            said = value[i, rays, None] * directions[rays]
            there = np.asarray(cKDTree(said).query(seen)[0])
            back = np.asarray(cKDTree(seen).query(said)[0])
            chamfer.append((there.mean() + back.mean()) / 2)
            recall, precision = (there <= MATCH_DISTANCE).mean(), (back <= MATCH_DISTANCE).mean()
            both = recall + precision
            f_score.append(2 * recall * precision / both if both > 0 else 0.0)
        return float(np.mean(chamfer)), float(np.mean(f_score))


def _pearson(a: Floats, b: Floats) -> float | None:
    a, b = a - a.mean(), b - b.mean()
    size = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / size if size > 0 else None


def _reliability(said: Floats, wrong: Bools) -> list[dict[str, float]]:
    """Compare the said chance with the seen share in every bin that holds a ray."""
    place = np.clip(np.searchsorted(RELIABILITY_EDGES, said, side="right") - 1, 0, len(RELIABILITY_EDGES) - 2)
    rows = []
    for i in range(len(RELIABILITY_EDGES) - 1):
        here = place == i
        if here.any():
            rows.append(
                {"said": float(said[here].mean()), "seen": float(wrong[here].mean()), "n": int(here.sum())}
            )
    return rows


def predict_scans(
    graph: Sensorgraph, run: Run, pairing: Pairing, scans: Ints, *, point: Point = "mode"
) -> Prediction:
    """Predict paired scans (n,) of a run, each ray of a sweep from where the robot was at its time."""
    mount = run.sensor.mount
    if run.sensor.sweep_time == 0:  # where the rays of several sensors start knows the graph
        return graph.predict(poses_for(graph, run.pose_frame, mount, pairing.poses[scans]), point=point)
    motion, parts = motion_of(run), []
    for start in range(0, len(scans), SCANS_PER_STEP):
        poses = ray_poses(run, pairing, scans[start : start + SCANS_PER_STEP], motion=motion)
        parts.append(graph.predict(poses_for(graph, run.pose_frame, mount, poses), point=point))
    return Prediction.concatenate(parts)


def poses_for(graph: Sensorgraph, frame: PoseFrame, mount: Floats, poses: Floats) -> Floats:
    """Express poses (..., 3) of a frame in the frame that the graph was built from; `mount` (3,): T_base_laser."""
    if frame == graph.pose_frame:
        return poses
    x, y, yaw = map(float, mount)
    if graph.pose_frame == "base_link":  # T_map_base = T_map_laser @ inverse(T_base_laser)
        c, s = math.cos(yaw), math.sin(yaw)
        x, y, yaw = -(c * x + s * y), -(c * y - s * x), -yaw
    moved = laser_poses(poses, np.array([x, y, yaw]))
    moved[..., 2] = np.pi - (np.pi - moved[..., 2]) % (2 * np.pi)
    return moved


def _training_overlap(graph: Sensorgraph, run: Run, index: NDArray[np.intp], split: str | None) -> str:
    """Say whether the evaluated scans were seen in training."""
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
