"""Metrics of `evaluate`, accumulated piece by piece, so that memory does not grow with the length of the run."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from planners.kernel import outer_kernel
from sensorgraph.models.base import OFF_DISTANCE, Point, Prediction
from sensorgraph.types import Bools, Floats

MATCH_DISTANCE = 0.1
"""[m] End points closer than this match in the f-score."""
RELIABILITY_EDGES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
"""Bin edges of the predicted probability of being off."""
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
"""Default point value of each metric."""

Metrics = dict[str, float | None]


@dataclass(kw_only=True, eq=False)
class MetricSums:
    """Sums from which one block of metrics is computed."""

    bearings: Floats
    """(n_rays,) [rad]"""
    point: Point | None
    """Point value for all metrics; None: the default of each in POINT_OF."""
    sigma: float
    """[m] Noise of the sensor."""
    total: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    """Sums over the rays, by name."""
    chamfer: list[float] = field(default_factory=list)
    f_score: list[float] = field(default_factory=list)
    """One value for each scan with a scored ray."""

    def add(
        self,
        measured: Floats,
        prediction: Prediction,
        scored: Bools,
        valid: Bools,
        stated: Prediction | None = None,
    ) -> None:
        """Add scans (n_scans, n_rays) [m].

        Parameters
        ----------
        scored, valid : (n_scans, n_rays) Masks of the rays that count.
        stated : Prediction whose spread and `p_off` contain the errors of the poses; None: only the spread of `prediction`.
        """
        missing, predicted = np.isposinf(measured) & valid, np.isposinf(prediction.ranges) & valid
        add = self.total
        add["no_return_measured"] += int(missing.sum())
        add["no_return_predicted"] += int(predicted.sum())
        add["no_return_both"] += int((missing & predicted).sum())
        if not scored.any():
            return
        truth = measured[scored]
        off = {
            point: np.abs(prediction.point(point)[scored] - truth)
            for point in {self.point or p for p in POINT_OF.values()}
        }
        error = {name: off[self.point or point] for name, point in POINT_OF.items()}
        add["n"] += len(truth)
        add["mae_m"] += float(error["mae_m"].sum())
        add["rmse_m"] += float((error["rmse_m"] ** 2).sum())
        add["within_0.1m"] += int((error["within_0.1m"] <= 0.1).sum())
        add["within_0.5m"] += int((error["within_0.5m"] <= 0.5).sum())
        add["within_3sigma"] += int((error["within_3sigma"] <= 3 * self.sigma).sum())
        add["within_3sigma_said"] += int(
            (error["within_3sigma"] <= 3 * (stated or prediction).sigma[scored]).sum()
        )
        if stated is not None:
            add["wrong_5cm_expected"] += float(stated.p_off[scored].sum())
        add["wrong_5cm"] += int((error["wrong_5cm"] > OFF_DISTANCE).sum())
        self._add_correlation(truth, prediction.point(self.point or POINT_OF["pearson_r"])[scored])
        self._add_shape(measured, prediction.point(self.point or POINT_OF["chamfer_m"]), scored)

    def _add_correlation(self, a: Floats, b: Floats) -> None:
        """Merge means and co-moments (Chan, Golub and LeVeque 1979), which avoids cancellation."""
        add, n = self.total, len(a)
        before = add["pairs"]
        mean_a, mean_b = float(a.mean()), float(b.mean())
        step_a, step_b = mean_a - add["mean_a"], mean_b - add["mean_b"]
        share = before * n / (before + n)
        add["aa"] += float((a - mean_a) @ (a - mean_a)) + step_a * step_a * share
        add["bb"] += float((b - mean_b) @ (b - mean_b)) + step_b * step_b * share
        add["ab"] += float((a - mean_a) @ (b - mean_b)) + step_a * step_b * share
        add["mean_a"] += step_a * n / (before + n)
        add["mean_b"] += step_b * n / (before + n)
        add["pairs"] += n

    def _add_shape(self, measured: Floats, value: Floats, scored: Bools) -> None:
        """Compare the end points of each scan in the plane.

        Chamfer is half the sum of the mean distances to the nearest end point, measured to predicted and predicted to
        measured. The f-score is the harmonic mean of both shares within 0.1 m. Scans without a scored ray do not count.
        """
        cos, sin = np.cos(self.bearings), np.sin(self.bearings)
        rows = np.full((len(measured), 4), np.nan)
        work = np.empty((6, len(cos)))
        packed = np.ascontiguousarray(value)  # the kernel is compiled for this layout
        _compare_end_points(cos, sin, measured, packed, scored, MATCH_DISTANCE, work, rows)
        there, back, recall, precision = rows[scored.any(axis=1)].T
        self.chamfer += ((there + back) / 2).tolist()
        self.f_score += (2 * recall * precision / np.maximum(recall + precision, 1e-300)).tolist()

    def metrics(self, errors: Floats) -> Metrics:
        """Compute the metrics of the block.

        Parameters
        ----------
        errors : (n,) [m] Absolute errors of all scored rays, by the point value of `median_m`; reordered in place.
        """
        total = self.total
        out: Metrics = dict.fromkeys((*POINT_OF, "no_return_recall", "no_return_precision"))
        out["no_return_recall"] = (
            total["no_return_both"] / total["no_return_measured"] if total["no_return_measured"] else None
        )
        out["no_return_precision"] = (
            total["no_return_both"] / total["no_return_predicted"] if total["no_return_predicted"] else None
        )
        out["within_3sigma_said"] = out["wrong_5cm_expected"] = None
        n = total["n"]
        if not n:
            return out
        out["median_m"] = float(np.median(errors, overwrite_input=True))
        for name in (
            "mae_m",
            "within_0.1m",
            "within_0.5m",
            "within_3sigma",
            "within_3sigma_said",
            "wrong_5cm",
        ):
            out[name] = total[name] / n
        if "wrong_5cm_expected" in total:
            out["wrong_5cm_expected"] = total["wrong_5cm_expected"] / n
        out["rmse_m"] = math.sqrt(total["rmse_m"] / n)
        size = math.sqrt(total["aa"] * total["bb"])
        out["pearson_r"] = total["ab"] / size if size > 0 else None
        out["chamfer_m"], out["f_score"] = float(np.mean(self.chamfer)), float(np.mean(self.f_score))
        return out


@dataclass(kw_only=True, eq=False)
class Reliability:
    """Predicted and observed probability of being off, in bins of the predicted one."""

    sums: Floats = field(default_factory=lambda: np.zeros((3, len(RELIABILITY_EDGES) - 1)))
    """Rows: sum of predicted probabilities, number of rays that were off, number of rays."""

    def add(self, predicted: Floats, wrong: Bools) -> None:
        """Add rays (n,)."""
        last = len(RELIABILITY_EDGES) - 2
        place = np.clip(np.searchsorted(RELIABILITY_EDGES, predicted, side="right") - 1, 0, last)
        for row, weights in zip(
            self.sums, (predicted, wrong.astype(np.float64), np.ones(len(predicted))), strict=True
        ):
            row += np.bincount(place, weights, minlength=last + 1)

    def rows(self) -> list[dict[str, float]]:
        """Return {said, seen, n} of every bin that holds a ray: predicted, observed, number of rays."""
        return [
            {"said": float(predicted / n), "seen": float(wrong / n), "n": int(n)}
            for predicted, wrong, n in self.sums.T.tolist()
            if n
        ]


@outer_kernel
def _compare_end_points(
    cos: Any, sin: Any, measured: Any, predicted: Any, scored: Any, tolerance: Any, work: Any, rows: Any
) -> Any:
    """Fill rows (n_scans, 4): mean distance [m] from measured to predicted end points and back, and both shares within a tolerance.

    Parameters
    ----------
    cos, sin : (n_rays,) of the bearings.
    measured, predicted : (n_scans, n_rays) [m] of the rays that are `scored`.
    work : (6, n_rays) for the end points of one scan and their squared distances.
    """
    x, y, told_x, told_y, there, back = work
    for k in range(len(measured)):
        n = 0
        for i in range(len(cos)):
            if scored[k, i]:
                x[n], y[n] = measured[k, i] * cos[i], measured[k, i] * sin[i]
                told_x[n], told_y[n] = predicted[k, i] * cos[i], predicted[k, i] * sin[i]
                back[n] = np.inf
                n += 1
        for i in range(n):
            least = np.inf
            for j in range(n):
                square = (told_x[j] - x[i]) ** 2 + (told_y[j] - y[i]) ** 2
                least, back[j] = min(least, square), min(back[j], square)
            there[i] = least
        if n == 0:
            continue
        for column in range(2):
            total, within = 0.0, 0
            for i in range(n):
                square = work[4 + column, i]
                total += math.sqrt(square)
                within += square <= tolerance * tolerance
            rows[k, column], rows[k, 2 + column] = total / n, within / n
