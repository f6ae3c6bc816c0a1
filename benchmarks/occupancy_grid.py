"""What a user would pick instead: an occupancy grid with ray casting, beside our graph, on the same held-out scans.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.occupancy_grid LOG.log.gz [LOG ...] [--split block|every10] [--placements 5]

The grid (5 cm) counts hits and passes of the training scans at their given poses; a cell stops a ray where its
share of hits reaches a threshold. A truncated signed distance field (TSDF, Curless and Levoy 1996) of the same cells stops it
where the field changes sign; there the threshold is the weight below which a cell counts as unknown. A threshold is tuned on
ten stretches of the training scans that the map leaves out for this: once for the least MAE, once for the largest share
within 10 cm. A ray that meets no surface is given the cell with the largest share on its way, or the place where the field is
least, because errors are scored given a return.

`--split block` holds out five stretches of 2 %, in the middle of each fifth of the log. With `--placements` N they are moved on
by 1/N of a fifth, N times, so that no scan is held out twice; the first placement is that of `--split block`. Printed are the
means of the grid with the least MAE and of the cells over placements, their 95 % intervals by Student's t (which takes
placements as independent; rooms that two of them share make it too narrow), and in how many placements the cells were better.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks.arguments import half_interval, parser_of, timed
from logs import Run, pair, read
from planners.types import Bools, Floats, Ints
from sensorgraph.building.build import build
from sensorgraph.building.split import N_STRETCHES, held_out
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import Point, Prediction

GRID_CELL = 0.05  # [m]
MARCH_STEP = 0.025  # [m] of the march
MAX_HIT = 10.0  # [m] longest return that counts as a hit; rays are followed up to here
AT_ONCE = 16  # scans that are marched together
TRUNCATION = 0.15  # [m] of the TSDF
SCORE_COLUMNS = (
    "mae_m", "median_m", "rmse_m", "within_0.1m", "within_0.5m", "pearson_r", "chamfer_m", "f_score",
)  # fmt: skip

PLACEMENT_COLUMNS = ("mae_m", "median_m", "within_0.1m", "within_0.5m", "pearson_r")
SMALLER_IS_BETTER = np.array([True, True, False, False, False])


class Map:
    """Cells around some poses: made of scans, and cast with a threshold."""

    name: ClassVar[str]
    thresholds: ClassVar[tuple[float, ...]]
    margin: ClassVar[int] = 2
    """Cells beyond the farthest return."""

    def __init__(self, poses: Floats, ranges: Floats, bearings: Floats) -> None:
        self.bearings = bearings
        self.low = poses[:, :2].min(axis=0) - MAX_HIT - self.margin * GRID_CELL
        high = poses[:, :2].max(axis=0) + MAX_HIT + self.margin * GRID_CELL
        self.shape = np.ceil((high - self.low) / GRID_CELL).astype(np.int64)
        self.add(poses, ranges)

    def add(self, poses: Floats, ranges: Floats) -> None:
        """Take the scans."""
        raise NotImplementedError

    def cast(self, poses: Floats, threshold: float) -> tuple[Floats, Bools]:
        """Return ranges (n, n_rays) [m], and whether they are more than a best guess."""
        ranges = np.empty((len(poses), len(self.bearings)))
        found = np.empty(ranges.shape, dtype=np.bool_)
        for start in range(0, len(poses), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            ranges[part], found[part] = self.march(poses[part], threshold)
        return ranges, found

    def march(self, poses: Floats, threshold: float) -> tuple[Floats, Bools]:
        """Return as `cast` what a few scans meet."""
        raise NotImplementedError

    def places(self, poses: Floats, distance: Floats) -> tuple[Floats, Floats]:
        """Return x and y [m] at distances (..., n_steps) along each ray, (n, n_rays, n_steps)."""
        angle = (poses[:, 2:3] + self.bearings)[:, :, None]
        x = poses[:, 0, None, None] + distance * np.cos(angle)
        return x, poses[:, 1, None, None] + distance * np.sin(angle)

    def cells(self, x: Floats, y: Floats) -> tuple[Ints, Ints]:
        """Return the indices of the cells at places."""
        i = ((x - self.low[0]) / GRID_CELL).astype(np.int64)
        return i, ((y - self.low[1]) / GRID_CELL).astype(np.int64)


class Grid(Map):
    """Share of hits in each cell, and where along a ray it first reaches the threshold."""

    name = "grid"
    thresholds = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)

    def add(self, poses: Floats, ranges: Floats) -> None:
        """Count hits and passes."""
        n_cells = int(self.shape.prod())
        hits, passes = np.zeros(n_cells), np.zeros(n_cells)
        steps = np.arange(MARCH_STEP / 2, MAX_HIT, MARCH_STEP)
        for start in range(0, len(poses), AT_ONCE):
            p, r = poses[start : start + AT_ONCE], ranges[start : start + AT_ONCE]
            hit = np.isfinite(r) & (r > 0.1) & (r < MAX_HIT)
            hits += np.bincount(self._flat(p, r[:, :, None])[hit].ravel(), minlength=n_cells)
            beyond = np.where(r >= MAX_HIT, MAX_HIT, 0.0)  # +inf passes up to the cap
            reach = np.where(hit, r - GRID_CELL, beyond)
            seen = steps < np.nan_to_num(reach, posinf=MAX_HIT)[:, :, None]
            passes += np.bincount(self._flat(p, steps)[seen], minlength=n_cells) * (MARCH_STEP / GRID_CELL)
        self.share = np.where(hits > 0, hits / np.maximum(hits + passes, 1e-9), 0.0)

    def _flat(self, poses: Floats, distance: Floats) -> Ints:
        """Return the cell at distances along each ray, 0 outside."""
        distance = np.where(np.isfinite(distance), np.clip(distance, 0.0, MAX_HIT), 0.0)
        i, j = self.cells(*self.places(poses, distance))
        inside = (i >= 0) & (j >= 0) & (i < self.shape[0]) & (j < self.shape[1])
        return np.where(inside, i * self.shape[1] + j, 0)

    def march(self, poses: Floats, threshold: float) -> tuple[Floats, Bools]:
        """Find the first cell that reaches the threshold."""
        steps = np.arange(MARCH_STEP / 2, MAX_HIT, MARCH_STEP)
        share = self.share[self._flat(poses, steps)]
        stops = share >= threshold
        hit = stops.any(axis=2)
        first = np.where(hit, stops.argmax(axis=2), share.argmax(axis=2))
        last = first + 1  # the middle of the stretch inside the cell: on average half a cell further
        return steps[np.minimum(last, len(steps) - 1)], hit


class Tsdf(Map):
    """Mean signed distance to the ends of the rays, positive on the near side, and weight of each cell; cast bilinearly."""

    name = "tsdf"
    thresholds = (0.2, 0.5, 1.0, 2.0, 4.0)
    margin = 3

    def add(self, poses: Floats, ranges: Floats) -> None:
        """Add up the distances of the cells near each ray's end."""
        n_cells = int(self.shape.prod())
        total, weight = np.zeros(n_cells), np.zeros(n_cells)
        steps = np.arange(MARCH_STEP / 2, MAX_HIT + TRUNCATION, MARCH_STEP)
        for start in range(0, len(poses), AT_ONCE):
            p, r = poses[start : start + AT_ONCE], ranges[start : start + AT_ONCE]
            i, j = self.cells(*self.places(p, steps))
            hit = (np.isfinite(r) & (r > 0.1) & (r < MAX_HIT))[:, :, None]
            beyond = np.where(r >= MAX_HIT, MAX_HIT, 0.0)[:, :, None]
            end = np.where(hit, np.nan_to_num(r, posinf=MAX_HIT, neginf=0.0)[:, :, None], beyond)
            angle = (p[:, 2:3] + self.bearings)[:, :, None]
            along = ((i + 0.5) * GRID_CELL + self.low[0] - p[:, 0, None, None]) * np.cos(angle)
            along = along + ((j + 0.5) * GRID_CELL + self.low[1] - p[:, 1, None, None]) * np.sin(angle)
            distance = np.where(hit, np.clip((end - along) / TRUNCATION, -1, 1), 1.0)
            use = (steps < np.where(hit, end + TRUNCATION, end)) & (i < self.shape[0]) & (j < self.shape[1])
            cell = (i * self.shape[1] + j)[use]
            total += np.bincount(cell, weights=distance[use], minlength=n_cells) * (MARCH_STEP / GRID_CELL)
            weight += np.bincount(cell, minlength=n_cells) * (MARCH_STEP / GRID_CELL)
        self.weight = weight.reshape(self.shape)
        self.mean = (total / np.maximum(weight, 1e-9)).reshape(self.shape)

    def march(self, poses: Floats, threshold: float) -> tuple[Floats, Bools]:
        """Find where the field changes sign."""
        steps = np.arange(MARCH_STEP / 2, MAX_HIT, MARCH_STEP)
        field, known = self._at(*self.places(poses, steps), threshold)
        change = (field[..., :-1] > 0) & (field[..., 1:] <= 0) & known[..., :-1] & known[..., 1:]
        hit = change.any(axis=2)
        first = np.where(hit, change.argmax(axis=2), 0)[..., None]
        before, after = (np.take_along_axis(field, k, axis=2)[..., 0] for k in (first, first + 1))
        crossing = steps[first[..., 0]] + MARCH_STEP * before / np.where(hit, before - after, 1.0)
        guess = steps[np.where(known, field, np.inf).argmin(axis=2)]
        return np.where(hit, crossing, np.where(known.any(axis=2), guess, MAX_HIT)), hit

    def _at(self, x: Floats, y: Floats, threshold: float) -> tuple[Floats, Bools]:
        """Interpolate the field at places between the middles of four cells; all four must be known."""
        u, v = (x - self.low[0]) / GRID_CELL - 0.5, (y - self.low[1]) / GRID_CELL - 0.5
        u, v = np.clip(u, 0, self.shape[0] - 2), np.clip(v, 0, self.shape[1] - 2)
        i, j = u.astype(np.int64), v.astype(np.int64)
        value, known = np.zeros(x.shape), np.ones(x.shape, dtype=np.bool_)
        for di in (0, 1):
            for dj in (0, 1):
                share = (u - i if di else 1 - u + i) * (v - j if dj else 1 - v + j)
                value += share * self.mean[i + di, j + dj]
                known &= self.weight[i + di, j + dj] >= threshold
        return value, known


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


def graph_of(kind: type[Map], threshold: float, run: Run, split: str | None = None) -> Sensorgraph:
    """Return a map of a run but for what a split holds out, with a threshold, as a graph."""
    model: Any = Tuned(kind(*scans_of(run, split)), threshold)
    origin = {"inputs": [], "split": split}
    return Sensorgraph(model=model, sensor=run.sensor, pose_frame=run.pose_frame, origin=origin)


def scans_of(run: Run, split: str | None = None) -> tuple[Floats, Floats, Floats]:
    """Return poses, ranges and bearings of the scans that have a pose and that a split does not hold out."""
    pairing = pair(run)
    used = pairing.paired if split is None else pairing.paired & ~held_out(run, split)
    return pairing.poses[used], run.ranges[used], run.sensor.bearings


def line(label: str, result: Evaluation, seconds: float) -> str:
    """Format one row of the table."""
    values = (result.all[name] for name in SCORE_COLUMNS)
    return (
        f"{label:<34}"
        + "".join(f"{value:>13.3f}" for value in values if value is not None)
        + f"{seconds:>9.1f}"
    )


def compare(run: Run, name: str, split: str) -> None:
    """Print the maps on the scans that the split holds out."""
    scans = scans_of(run, split)
    print(f"{name}, {split}: {len(scans[0])} scans to train, {run.sensor.n_rays} rays")
    print(f"{'':<34}" + "".join(f"{column:>13}" for column in SCORE_COLUMNS) + f"{'fit [s]':>9}")
    for kind in (Grid, Tsdf):
        for label, threshold in tuned(kind, *scans).items():
            with timed() as took:
                graph = graph_of(kind, threshold, run, split)
            result = evaluate(graph, run, split=split, cap=MAX_HIT)
            print(line(f"{label} (threshold {threshold:g})", result, took.wall))


def held_placements(run: Run, n: int) -> Iterator[Bools]:
    """Yield n masks (n_scans,) of held-out stretches: those of split block, moved on by 1/n of a fifth of the log."""
    first, fifth = held_out(run, "block"), run.n_scans / N_STRETCHES
    for k in range(n):
        yield np.roll(first, round(k * fifth / n))


def place(run: Run, name: str, placements: int) -> None:
    """Print means over placements of what is held out."""

    def row(result: Evaluation) -> Floats:
        return np.array([result.all[column] for column in PLACEMENT_COLUMNS], dtype=np.float64)

    rows: dict[str, list[Floats]] = {"grid": [], "cells": []}
    answered: list[Floats] = []
    for k, held in enumerate(held_placements(run, placements)):
        train, test = run.take_scans(~held), run.take_scans(held)
        threshold = next(iter(tuned(Grid, *scans_of(train)).values()))
        rows["grid"].append(row(evaluate(graph_of(Grid, threshold, train), test, cap=MAX_HIT)))
        result = evaluate(build([train], model="cells"), test, cap=MAX_HIT)
        rows["cells"].append(row(result))
        answered.append(np.array([result.answered, result.answered_only["within_0.1m"]], dtype=np.float64))
        print(f"  placement {k}: cells " + " ".join(f"{v:.3f}" for v in rows["cells"][-1]))
    grid, cells = (np.array(values) for values in rows.values())
    print(f"{name:<34}" + "".join(f"{column:>16}" for column in PLACEMENT_COLUMNS))
    for model, values in (("grid", grid), ("cells", cells)):
        means = zip(values.mean(axis=0), half_interval(values), strict=True)
        print(f"  {model:<32}" + "".join(f"{m:>9.3f} ±{h:5.3f}" for m, h in means))
    better = np.where(SMALLER_IS_BETTER, cells < grid, cells > grid).sum(axis=0)
    print(f"{'  cells better, of ' + str(placements):<34}" + "".join(f"{count:>16}" for count in better))
    share, near = np.mean(answered, axis=0)
    print(f"  cells answer {share:.3f} of the rays, {near:.3f} of those within 0.1 m")


def main() -> None:
    """Compare on every log given."""
    parser = parser_of(__doc__)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--split", default="block", choices=["block", "every10"])
    parser.add_argument("--placements", type=int, help="of the stretches of split block; means over so many")
    arguments = parser.parse_args()
    for path in arguments.logs:
        if arguments.placements:
            place(read(path), path.name, arguments.placements)
        else:
            compare(read(path), path.name, arguments.split)


if __name__ == "__main__":
    main()
