"""What a review shows, as plain arrays: scans in the map, coverage, error by place, heading and ray, a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.run import Pairing, Run, pair
from planners.arena import Arena, Floats, wrap
from sensorgraph.build import training_scans
from sensorgraph.errors import GapError
from sensorgraph.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.world.raycast import laser_poses

MOST_SCANS = 5000
"""Scans that a review file holds: enough to look at, small enough to open at once."""
MOST_CELLS = 40_000
HEADINGS = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """(x, y, phi) cells: how often visited, and how wrong the graph is there."""

    origin: Floats
    """(2,) [m] lower left corner."""
    cell: float
    """[m]"""
    counts: NDArray[np.intp]
    """(nx, ny, n_phi) scans; heading bins centred on multiples of 2 pi / n_phi."""
    error: Floats | None
    """(nx, ny, n_phi) [m] mean over scans of the median |residual| of a scan; nan where nothing was scored."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Review:
    """Everything that is drawn."""

    run: Run
    name: str
    """What to call the run."""
    pairing: Pairing
    shown: NDArray[np.intp]
    """(n_shown,) indices of the scans in the review."""
    lasers: Floats
    """(n_shown, 3) [m, m, rad] laser in map."""
    measured: Floats
    """(n_shown, n_rays) [m]"""
    predicted: Floats | None
    """(n_shown, n_rays) [m] where answered, else nan; +inf where no return is predicted."""
    evaluation: Evaluation | None
    """Of the shown scans."""
    held_out: Evaluation | None
    """Of the scans held out, where the graph was built from this run with a split."""
    cells: Cells
    arena: Arena | None
    planned: Floats | None
    """(n, 2) [m] the planned path."""
    plan: Mapping[str, Any] | None
    """plan.json"""
    graph: Sensorgraph | None

    def points(self, ranges: Floats) -> list[Floats]:
        """Return the end points in map of every shown scan, one (n, 2) [m] each."""
        phi = self.lasers[:, 2:] + self.run.sensor.bearings
        ends = self.lasers[:, None, :2] + ranges[..., None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
        return [scan[hit] for scan, hit in zip(ends, np.isfinite(ranges), strict=True)]


def review(
    run: Run,
    *,
    graph: Sensorgraph | None = None,
    arena: Arena | None = None,
    name: str | None = None,
    planned: Floats | None = None,
    plan: Mapping[str, Any] | None = None,
    cell: float | None = None,
    most_scans: int = MOST_SCANS,
) -> Review:
    """Collect what there is to see of a run, and of a graph against it.

    Parameters
    ----------
    arena : walls to draw; None: none
    name : what to call the run; None: the file it says it came from
    planned : (n, 2) [m] path of the plan
    cell : [m] of the maps; None: 0.25, or coarser where that would be too many
    most_scans : more are thinned out evenly
    """
    pairing = pair(run)
    index = np.flatnonzero(pairing.paired)
    if not len(index):
        raise GapError(f"{pairing}; nothing to place in the map: record poses with the scans")
    shown = index[np.linspace(0, len(index) - 1, min(len(index), most_scans)).round().astype(np.intp)]
    part = replace(run, stamps=run.stamps[shown], ranges=run.ranges[shown])
    poses = pairing.poses[shown]
    evaluation = evaluate(graph, part) if graph is not None else None
    held_out = None
    predicted = None
    if graph is not None and evaluation is not None:
        split = graph.origin.get("split")
        if split is not None and training_scans(graph, run) is not None:
            held_out = evaluate(graph, run, split=split)
        predicted = np.full(part.ranges.shape, np.nan)
        said = evaluation.prediction
        predicted[evaluation.scan_indices] = np.where(said.answered, said.ranges, np.nan)
    return Review(
        run=run,
        name=name or run.meta.get("source", "run").rsplit("/", 1)[-1],
        pairing=pairing,
        shown=shown,
        lasers=poses if run.pose_frame == "laser" else laser_poses(poses, run.sensor.mount),
        measured=part.ranges,
        predicted=predicted,
        evaluation=evaluation,
        held_out=held_out,
        cells=_cells(pairing.poses[index], poses, evaluation, cell),
        arena=arena,
        planned=planned,
        plan=plan,
        graph=graph,
    )


def _cells(visited: Floats, shown: Floats, evaluation: Evaluation | None, cell: float | None) -> Cells:
    lower, upper = visited[:, :2].min(axis=0), visited[:, :2].max(axis=0)
    side = cell or 0.25
    while cell is None and np.prod((upper - lower) / side + 2) > MOST_CELLS:
        side *= 2
    origin = np.floor(lower / side) * side
    nx, ny = (np.floor((upper - origin) / side).astype(np.intp) + 1).tolist()

    def bins(poses: Floats) -> NDArray[np.intp]:
        ij = np.floor((poses[:, :2] - origin) / side).astype(np.intp)
        k = np.floor(wrap(poses[:, 2]) / (2 * np.pi / HEADINGS) + 0.5).astype(np.intp) % HEADINGS
        return np.asarray(np.ravel_multi_index((ij[:, 0], ij[:, 1], k), (nx, ny, HEADINGS)), dtype=np.intp)

    n = nx * ny * HEADINGS
    counts = np.bincount(bins(visited), minlength=n).reshape(nx, ny, HEADINGS)
    error = None
    if evaluation is not None:
        scan_error = median_per_scan(evaluation.residual)
        scored = np.isfinite(scan_error)
        where = bins(shown[evaluation.scan_indices][scored])
        total = np.bincount(where, weights=scan_error[scored], minlength=n)
        seen = np.bincount(where, minlength=n)
        with np.errstate(invalid="ignore"):
            error = (total / np.where(seen > 0, seen, np.nan)).reshape(nx, ny, HEADINGS)
    return Cells(origin=origin, cell=side, counts=counts, error=error)


def median_per_scan(residual: Floats) -> Floats:
    """Return the median |residual| of every scan (n_scans,) [m]; nan where no ray was scored."""
    out = np.full(len(residual), np.nan)
    scored = np.isfinite(residual).any(axis=1)
    out[scored] = np.nanmedian(np.abs(residual[scored]), axis=1)
    return out


def report(seen: Review) -> str:
    """Write the report shown beside the pictures, in markdown."""
    run, cells = seen.run, seen.cells
    visited = int((cells.counts > 0).sum())
    lines = [
        f"# {seen.name}",
        f"{seen.pairing}, {run.stamps[-1] - run.stamps[0]:.0f} s, {run.sensor.n_rays} rays. "
        f"Shown: {len(seen.shown):,} scans"
        + (", evenly chosen." if len(seen.shown) < seen.pairing.paired.sum() else ", all of them."),
        "",
        f"**Coverage**: {visited:,} cells of {cells.cell:g} m × {360 / HEADINGS:g}° visited.",
    ]
    if seen.plan is not None and "coverage" in seen.plan:
        lines.append(f"The plan covers {100 * seen.plan['coverage']:.2f} % of the reachable cells.")
    if seen.evaluation is None or seen.graph is None:
        lines += [
            "",
            "No graph given: `sensorgraph build` makes one, `review --graph` shows it against this run.",
        ]
        return "\n".join(lines)
    lines += ["", "| | all rays | answered |", "|---|---|---|", *_rows(seen.held_out or seen.evaluation)]
    lines += ["", f"*{_training(seen, seen.graph)}*"]
    lines += ["", "White: measured. Orange: predicted, where the graph answers.", ""]
    return "\n".join(lines)


def _training(seen: Review, graph: Sensorgraph) -> str:
    """Say whether the scores are of scans that the graph was fitted to."""
    if seen.held_out is not None:
        return (
            f"Scored on the scans held out of the build ({graph.origin['split']}); the maps show all scans."
        )
    if training_scans(graph, seen.run) is None:
        return "Scored on a run that the graph has not seen."
    return "The graph was fitted to this run: on new scans the numbers are worse."


def _rows(evaluation: Evaluation) -> list[str]:
    def row(label: str, name: str, scale: float, unit: str) -> str:
        values = [block[name] for block in (evaluation.all, evaluation.answered_only)]
        return (
            f"| {label} | "
            + " | ".join("–" if v is None else f"{scale * v:.3g} {unit}" for v in values)
            + " |"
        )

    return [
        f"| answered | | {100 * evaluation.answered:.1f} % |",
        row("median error", "median_m", 100, "cm"),
        row("MAE", "mae_m", 100, "cm"),
        row("RMSE", "rmse_m", 100, "cm"),
        row("within 10 cm", "within_0.1m", 100, "%"),
        row("within 3 sigma", "within_3sigma", 100, "%"),
        row("Pearson r", "pearson_r", 1, ""),
    ]
