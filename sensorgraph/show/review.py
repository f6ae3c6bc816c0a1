"""What a review shows, as plain arrays: scans in the map, coverage, error by place, heading and ray, a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.run import Pairing, Run, pair
from planners.arena import Arena
from sensorgraph.building.build import training_scans
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import OFF
from sensorgraph.show.review_cells import HEADINGS, MUCH_UNANSWERED, OPEN, Cells, cells_of
from sensorgraph.types import Floats
from sensorgraph.world.raycast import laser_poses

MOST_SCANS = 5000
"""Scans that a review file holds: enough to look at, small enough to open at once."""
UNSCORED, RIGHT, WRONG, UNANSWERED = range(4)
"""Verdicts on a measured ray: nothing to compare, answered within 5 cm, answered and farther off, not answered."""


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

    def points(self, ranges: Floats, part: slice = slice(None)) -> list[Floats]:
        """Return the end points in map of some shown scans, one (n, 2) [m] each; `ranges` are of all."""
        lasers, ranges = self.lasers[part], ranges[part]
        phi = lasers[:, 2:] + self.run.sensor.bearings
        ends = lasers[:, None, :2] + ranges[..., None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
        return [scan[hit] for scan, hit in zip(ends, np.isfinite(ranges), strict=True)]

    @property
    def verdicts(self) -> NDArray[np.uint8]:
        """(n_shown, n_rays) one of UNSCORED, RIGHT, WRONG, UNANSWERED."""
        out = np.full(self.measured.shape, UNSCORED, dtype=np.uint8)
        if self.evaluation is not None:
            residual = self.evaluation.residual
            answered = np.where(np.abs(residual) > OFF, WRONG, RIGHT)
            said = np.where(self.evaluation.prediction.answered, answered, UNANSWERED)
            out[self.evaluation.scan_indices] = np.where(np.isfinite(residual), said, UNSCORED)
        return out


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
        raise SensorgraphError(f"{pairing}; nothing to place in the map: record poses with the scans")
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
    lasers = poses if run.pose_frame == "laser" else laser_poses(poses, run.sensor.mount)
    rays = np.stack([lasers[:, 2:] + run.sensor.bearings, part.ranges], axis=-1)
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
        cells=cells_of(
            pairing.poses[index],
            poses,
            evaluation,
            rays=(lasers, rays),
            arena=arena,
            graph=graph,
            cell=cell,
        ),
        arena=arena,
        planned=planned,
        plan=plan,
        graph=graph,
    )


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
    lines += ["", *_where(seen.cells)]
    lines += ["", *_legend(seen), ""]
    return "\n".join(lines)


def _where(cells: Cells) -> list[str]:
    """Say in how many cells which verdict is frequent, and where to drive next."""
    lines = []
    if cells.tally is not None:
        flat = cells.tally.flat
        often = 0.5 * flat.much_wrong
        dark, off = flat.share_unanswered > OPEN, flat.share_wrong > often
        lines.append(
            f"**Cells**: of {int((flat.scored > 0).sum()):,} places scored, {int(dark.sum()):,} leave more than "
            f"{100 * OPEN:.0f} % of the rays unanswered, in {int(off.sum()):,} more than {100 * often:.0f} % of the "
            f"answered ones are wrong; {int((cells.free & (cells.counts.sum(axis=2) == 0)).sum()):,} free places were "
            "not visited."
        )
    if cells.next is not None:
        places = [f"({x:.1f}, {y:.1f}) and around, {area:.1f} m²" for x, y, area in cells.next.places()]
        lines += [""] if lines else []
        if places:
            lines.append("**Drive next**: " + "; ".join(places) + ": `sensorgraph plan --priority GRAPH`.")
        else:
            lines.append(
                f"**Drive next**: from no free place would more than {100 * OPEN:.0f} % go unanswered."
            )
    return lines


def _legend(seen: Review) -> list[str]:
    """Say what the colours mean; the viewer has no colour bar."""
    cells = seen.cells
    if cells.tally is None:
        return []
    much = 100 * cells.tally.flat.much_wrong
    return [
        "**Colours**: teal right, pink more than 5 cm off, violet not answered, white not scored; orange predicted, "
        "where the graph answers.",
        "",
        f"**Maps**: a cell is all pink from {much:.0f} % wrong, all violet from {100 * MUCH_UNANSWERED:.0f} % not answered; "
        "slate is free and not visited, dark was never looked through. *next*: yellow, from there nothing would be "
        f"answered. *unanswered* 0 to {100 * MUCH_UNANSWERED:.0f} %, *wrong* 0 to {much:.0f} % of the answered rays, *error* 0 "
        f"to {100 * cells.error_top:.2g} cm, *coverage* 0 to {HEADINGS} headings; dark to yellow.",
    ]


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
        f"| rays | 100 % | {100 * evaluation.answered:.1f} % |",
        f"| not answered | {100 * (1 - evaluation.answered):.1f} % | – |",
        row("median error", "median_m", 100, "cm"),
        row("MAE", "mae_m", 100, "cm"),
        row("RMSE", "rmse_m", 100, "cm"),
        row("within 10 cm", "within_0.1m", 100, "%"),
        row("wrong by > 5 cm", "wrong_5cm", 100, "%"),
        row("within 3 sigma", "within_3sigma", 100, "%"),
        row("Pearson r", "pearson_r", 1, ""),
    ]
