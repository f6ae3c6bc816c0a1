"""What a user would pick instead: an occupancy grid with ray casting, beside our graph, on the same held-out scans.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.occupancy_grid LOG.log.gz [LOG ...] [--split block|every10]

The grid (5 cm) counts hits and passes of the training scans at their given poses; a cell stops a ray where its
share of hits reaches a threshold. Beside it stands a TSDF of the same cells (`tsdf.py`), tuned in the same way. The threshold is tuned on ten stretches of the training scans that the grid
leaves out for this: once for the least MAE, once for the largest share within 10 cm. A ray that meets no such
cell is given the cell with the largest share on its way, because errors are scored given a return.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from benchmarks.arguments import parser_of
from benchmarks.tsdf import Tsdf
from logs import Run, pair, read
from planners.types import Bools, Floats, Ints
from sensorgraph.building.build import build
from sensorgraph.building.split import held_out
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import Point, Prediction

GRID_CELL = 0.05  # [m]
MARCH_STEP = 0.025  # [m] of the march
MAX_HIT = 10.0  # [m] longest return that counts as a hit; rays are followed up to here
THRESHOLDS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
SCORE_COLUMNS = (
    "mae_m", "median_m", "rmse_m", "within_0.1m", "within_0.5m", "pearson_r", "chamfer_m", "f_score",
)  # fmt: skip


class Map(Protocol):
    """What can be tuned and compared: built from scans, and cast with a threshold."""

    name: ClassVar[str]
    thresholds: ClassVar[tuple[float, ...]]

    def __init__(self, poses: Floats, ranges: Floats, bearings: Floats) -> None: ...

    def cast(self, poses: Floats, threshold: float) -> tuple[Floats, Bools]:
        """Return ranges (n, n_rays) [m], and whether they are more than a best guess."""
        ...


class Grid:
    """Share of hits in each cell, and where along a ray it first reaches the threshold."""

    name: ClassVar[str] = "grid"
    thresholds: ClassVar[tuple[float, ...]] = THRESHOLDS

    def __init__(self, poses: Floats, ranges: Floats, bearings: Floats) -> None:
        self.bearings = bearings
        self.low = poses[:, :2].min(axis=0) - MAX_HIT - 2 * GRID_CELL
        high = poses[:, :2].max(axis=0) + MAX_HIT + 2 * GRID_CELL
        self.shape = np.ceil((high - self.low) / GRID_CELL).astype(np.int64)
        n_cells = int(self.shape.prod())
        hits, passes = np.zeros(n_cells), np.zeros(n_cells)
        for start in range(0, len(poses), 32):
            p, r = poses[start : start + 32], ranges[start : start + 32]
            hit = np.isfinite(r) & (r > 0.1) & (r < MAX_HIT)
            hits += np.bincount(self._cells(p, r[:, :, None])[hit].ravel(), minlength=n_cells)
            beyond = np.where(r >= MAX_HIT, MAX_HIT, 0.0)  # +inf passes up to the cap
            reach = np.where(hit, r - GRID_CELL, beyond)
            steps = np.arange(MARCH_STEP / 2, MAX_HIT, MARCH_STEP)
            cells = self._cells(p, np.broadcast_to(steps, (*r.shape, len(steps))))
            seen = steps < np.nan_to_num(reach, posinf=MAX_HIT)[:, :, None]
            passes += np.bincount(cells[seen], minlength=n_cells) * (MARCH_STEP / GRID_CELL)
        self.share = np.where(hits > 0, hits / np.maximum(hits + passes, 1e-9), 0.0)

    def _cells(self, poses: Floats, distance: Floats) -> Ints:
        """Return the cell at distances (n, n_rays, n_steps) along each ray."""
        angle = (poses[:, 2:3] + self.bearings)[:, :, None]
        distance = np.where(np.isfinite(distance), np.clip(distance, 0.0, MAX_HIT), 0.0)
        i = ((poses[:, 0, None, None] + distance * np.cos(angle) - self.low[0]) / GRID_CELL).astype(np.int64)
        j = ((poses[:, 1, None, None] + distance * np.sin(angle) - self.low[1]) / GRID_CELL).astype(np.int64)
        inside = (i >= 0) & (j >= 0) & (i < self.shape[0]) & (j < self.shape[1])
        return np.where(inside, i * self.shape[1] + j, 0)

    def cast(self, poses: Floats, threshold: float) -> tuple[Floats, Bools]:
        """March each ray; return ranges (n, n_rays) [m] and whether a cell reached the threshold."""
        ranges = np.empty((len(poses), len(self.bearings)))
        found = np.empty(ranges.shape, bool)
        steps = np.arange(MARCH_STEP / 2, MAX_HIT, MARCH_STEP)
        for start in range(0, len(poses), 32):
            p = poses[start : start + 32]
            every = np.broadcast_to(steps, (len(p), len(self.bearings), len(steps)))
            share = self.share[self._cells(p, every)]
            stops = share >= threshold
            hit = stops.any(axis=2)
            first = np.where(hit, stops.argmax(axis=2), share.argmax(axis=2))
            last = first + 1  # the middle of the stretch inside the cell: on average half a cell further
            ranges[start : start + 32] = steps[np.minimum(last, len(steps) - 1)]
            found[start : start + 32] = hit
        return ranges, found


class Tuned:
    """A map with its threshold, in the shape of our models, so that the same code scores both."""

    name: ClassVar[str] = "map"

    def __init__(self, made: Map, threshold: float) -> None:
        self.made, self.threshold = made, threshold

    def predict(self, poses: Floats, rays: Ints, point: Point) -> Prediction:
        """Predict; one value stands for median, mode and mean."""
        ranges, found = self.made.cast(poses, self.threshold)
        ranges, found = ranges[:, rays], found[:, rays]
        constant: dict[str, Any] = {
            "sigma": np.full(ranges.shape, GRID_CELL),
            "p_no_return": np.where(found, 0.0, 1.0),
            "p_off": np.full(ranges.shape, 0.5),
            "answered": np.ones(ranges.shape, dtype=np.bool_),
        }
        seen = np.where(found, ranges, np.inf)
        return Prediction(ranges=seen, median=ranges, mode=ranges, mean=ranges, **constant)


def tuned(kind: type[Map], poses: Floats, ranges: Floats, bearings: Floats) -> dict[str, float]:
    """Return the threshold with the least MAE, and that with the largest share within 10 cm."""
    stretch = np.arange(len(poses)) * 50 // len(poses)  # fifty stretches of 2 %, every fifth left out
    left_out = stretch % 5 == 2
    made = kind(poses[~left_out], ranges[~left_out], bearings)
    measured = ranges[left_out]
    scored = np.isfinite(measured) & (measured > 0.1) & (measured < MAX_HIT)
    mae, near = {}, {}
    for threshold in kind.thresholds:
        error = np.abs(made.cast(poses[left_out], threshold)[0] - measured)[scored]
        mae[threshold], near[threshold] = float(error.mean()), float((error <= 0.1).mean())
    return {
        f"{kind.name}, least MAE": min(mae, key=mae.__getitem__),
        f"{kind.name}, most < 10 cm": max(near, key=near.__getitem__),
    }


def line(label: str, result: Evaluation, seconds: float) -> str:
    """Format one row of the table."""
    values = (result.all[name] for name in SCORE_COLUMNS)
    return (
        f"{label:<34}"
        + "".join(f"{value:>13.3f}" for value in values if value is not None)
        + f"{seconds:>9.1f}"
    )


def compare(run: Run, name: str, split: str) -> None:
    """Print our model and the grid on the scans that the split holds out."""
    pairing = pair(run)
    train = pairing.paired & ~held_out(run, split)
    poses, ranges, bearings = pairing.poses[train], run.ranges[train], run.sensor.bearings
    print(f"{name}, {split}: {int(train.sum())} scans to train, {run.sensor.n_rays} rays")
    print(f"{'':<34}" + "".join(f"{column:>13}" for column in SCORE_COLUMNS) + f"{'fit [s]':>9}")
    for model in ("polynomial", "cells"):
        start = time.perf_counter()
        graph = build([run], model=model, split=split)
        took = time.perf_counter() - start
        print(line(model, evaluate(graph, run, split=split, cap=MAX_HIT), took))
    kinds: tuple[type[Map], ...] = (Grid, Tsdf)
    for kind in kinds:
        for label, threshold in tuned(kind, poses, ranges, bearings).items():
            start = time.perf_counter()
            stand_in: Any = Tuned(kind(poses, ranges, bearings), threshold)
            took = time.perf_counter() - start
            origin = {"inputs": [], "split": split}
            wrapped = Sensorgraph(model=stand_in, sensor=run.sensor, pose_frame=run.pose_frame, origin=origin)
            result = evaluate(wrapped, run, split=split, cap=MAX_HIT)
            print(line(f"{label} (threshold {threshold:g})", result, took))


def main() -> None:
    """Compare on every log given."""
    parser = parser_of(__doc__)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--split", default="block", choices=["block", "every10"])
    arguments = parser.parse_args()
    for path in arguments.logs:
        compare(read(path), path.name, arguments.split)


if __name__ == "__main__":
    main()
