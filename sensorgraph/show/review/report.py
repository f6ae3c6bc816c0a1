"""The report of a review, in markdown: scores, coverage, where to drive next, what the colours mean."""

from __future__ import annotations

import numpy as np

from sensorgraph.building.build import training_scans
from sensorgraph.evaluation.evaluate import Evaluation
from sensorgraph.graph import Sensorgraph
from sensorgraph.show.review.cells import N_HEADINGS, SATURATING_UNANSWERED, WORTH_A_VISIT, ReviewCells
from sensorgraph.show.review.contents import Review


def report(review: Review) -> str:
    """Return the report that is shown beside the pictures, in markdown."""
    run, cells = review.run, review.cells
    visited = int((cells.counts > 0).sum())
    lines = [
        f"# {review.name}",
        f"{review.pairing}, {run.stamps[-1] - run.stamps[0]:.0f} s, {run.sensor.n_rays} rays. "
        f"Shown: {len(review.shown):,} scans"
        + (", evenly chosen." if len(review.shown) < review.pairing.paired.sum() else ", all of them."),
        "",
        f"**Coverage**: {visited:,} cells of {cells.cell:g} m × {360 / N_HEADINGS:g}° visited.",
    ]
    if review.plan is not None and "coverage" in review.plan:
        lines.append(f"The plan covers {100 * review.plan['coverage']:.2f} % of the reachable cells.")
    if review.deviations is not None:
        lines += ["", _poses(review)]
    if review.evaluation is None or review.graph is None:
        lines += [
            "",
            "No graph given: build one, and review this run against it.",
        ]
        return "\n".join(lines)
    lines += ["", "| | all rays | answered |", "|---|---|---|", *_rows(review.held_out or review.evaluation)]
    lines += ["", f"*{_training(review, review.graph)}*"]
    lines += ["", *_cells_and_next_drive(review.cells)]
    lines += ["", *_legend(review), ""]
    return "\n".join(lines)


def _poses(review: Review) -> str:
    """Say how well the poses are known, and where the robot was lost."""
    assert review.deviations is not None
    place = 100 * np.hypot(*review.deviations[:, :2].T) / np.sqrt(2)
    turn = np.degrees(review.deviations[:, 2])
    said = (
        f"**Poses**: standard deviation {np.median(place):.2g} cm, {np.median(turn):.2g}° (median), "
        f"{np.quantile(place, 0.99):.2g} cm, {np.quantile(turn, 0.99):.2g}° (99 %), as the log states."
    )
    missing = int((~review.pairing.paired).sum())
    return said + (f" {missing:,} scans have no pose: lost, or not sure." if missing else "")


def _cells_and_next_drive(cells: ReviewCells) -> list[str]:
    """Say in how many cells which verdict is frequent, and where to drive next."""
    lines = []
    if cells.ray_counts is not None:
        places = cells.ray_counts.by_place
        often = 0.5 * places.saturating_wrong
        dark, off = places.share_unanswered > WORTH_A_VISIT, places.share_wrong > often
        lines.append(
            f"**Cells**: of {int((places.scored > 0).sum()):,} places scored, {int(dark.sum()):,} leave more than "
            f"{100 * WORTH_A_VISIT:.0f} % of the rays unanswered, in {int(off.sum()):,} more than {100 * often:.0f} % of the "
            f"answered ones are wrong; {int((cells.free & (cells.counts.sum(axis=2) == 0)).sum()):,} free places were "
            "not visited."
        )
    if cells.doubt_map is not None:
        stretches = [
            f"({x:.1f}, {y:.1f}) and around, {area:.1f} m²" for x, y, area in cells.doubt_map.places()
        ]
        lines += [""] if lines else []
        if stretches:
            lines.append(
                "**Drive next**: " + "; ".join(stretches) + ": plan with this graph as the priority."
            )
        else:
            lines.append(
                f"**Drive next**: from no free place would more than {100 * WORTH_A_VISIT:.0f} % go unanswered."
            )
    return lines


def _legend(review: Review) -> list[str]:
    """Say what the colours mean; the viewer has no colour bar."""
    cells = review.cells
    if cells.ray_counts is None:
        return []
    pink = 100 * cells.ray_counts.by_place.saturating_wrong
    return [
        "**Colours**: teal right, pink more than 5 cm off, violet not answered, white not scored; orange predicted, "
        "where the graph answers.",
        "",
        f"**Maps**: a cell is all pink from {pink:.0f} % wrong, all violet from {100 * SATURATING_UNANSWERED:.0f} % not answered; "
        "slate is free and not visited, dark was never looked through. *next*: yellow, from there nothing would be "
        f"answered. *unanswered* 0 to {100 * SATURATING_UNANSWERED:.0f} %, *wrong* 0 to {pink:.0f} % of the answered rays, *error* 0 "
        f"to {100 * cells.error_top:.2g} cm, *coverage* 0 to {N_HEADINGS} headings; dark to yellow.",
    ]


def _training(review: Review, graph: Sensorgraph) -> str:
    """Say whether the scores are of scans that the graph was fitted to."""
    if review.held_out is not None:
        return (
            f"Scored on the scans held out of the build ({graph.origin['split']}); the maps show all scans."
        )
    if training_scans(graph, review.run) is None:
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
