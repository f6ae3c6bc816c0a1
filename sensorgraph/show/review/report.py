"""The report of a review in Markdown: scores, coverage, suggested drives, legend of the colours."""

from __future__ import annotations

import numpy as np

from planners.coverage import HEADINGS
from sensorgraph.building.build import training_scans
from sensorgraph.evaluation.evaluate import Evaluation
from sensorgraph.graph import Sensorgraph
from sensorgraph.show.review.cells import SATURATING_UNANSWERED, WORTH_A_VISIT, ReviewCells
from sensorgraph.show.review.contents import Review


def report(review: Review) -> str:
    """Return the report in Markdown, which is shown next to the pictures."""
    run, cells = review.run, review.cells
    visited = int((cells.counts > 0).sum())
    lines = [
        f"# {review.name}",
        f"{review.pairing}, {run.stamps[-1] - run.stamps[0]:.0f} s, {run.sensor.n_rays} rays. "
        f"Shown: {len(review.shown):,} scans"
        + (", evenly spaced." if len(review.shown) < review.pairing.paired.sum() else ", all of them."),
        "",
        f"**Coverage**: {visited:,} cells of {cells.cell:g} m × {360 / HEADINGS:g}° visited.",
    ]
    if review.plan is not None and "coverage" in review.plan:
        share, grid = f"{100 * review.plan['coverage']:.2f} %", review.plan["grid"]
        lines.append(
            f"The plan covers {share} of its reachable cells of {grid['cell']:g} m × {360 / grid['headings']:g}°."
        )
    if review.deviations is not None:
        lines += ["", _poses(review)]
    if review.evaluation is None or review.graph is None:
        lines += [
            "",
            "No sensorgraph was given. Build one and give it with `--graph` to see its errors on this run.",
        ]
        return "\n".join(lines)
    lines += [f"\n**Warning**: {line}." for line in review.evaluation.warnings]
    lines += ["", "| | all rays | answered |", "|---|---|---|", *_rows(review.held_out or review.evaluation)]
    lines += ["", f"*{_training(review, review.graph)}*"]
    lines += ["", *_cells_and_next_drive(review.cells)]
    lines += ["", *_legend(review), ""]
    return "\n".join(lines)


def _poses(review: Review) -> str:
    """Return a sentence on the standard deviations of the poses and the scans without a pose."""
    assert review.deviations is not None
    place = 100 * np.hypot(*review.deviations[:, :2].T) / np.sqrt(2)
    turn = np.degrees(review.deviations[:, 2])
    text = (
        f"**Poses**: standard deviation {np.median(place):.2g} cm, {np.median(turn):.2g}° (median), "
        f"{np.quantile(place, 0.99):.2g} cm, {np.quantile(turn, 0.99):.2g}° (99 % quantile), from the log."
    )
    missing = int((~review.pairing.paired).sum())
    return text + (
        f" {missing:,} scans have no pose: the robot was lost or its place ambiguous." if missing else ""
    )


def _cells_and_next_drive(cells: ReviewCells) -> list[str]:
    """Return sentences on the numbers of cells with frequent errors, and on suggested drives."""
    lines = []
    if cells.ray_counts is not None:
        places = cells.ray_counts.by_place
        often = 0.5 * places.saturating_wrong
        dark, off = places.share_unanswered > WORTH_A_VISIT, places.share_wrong > often
        lines.append(
            f"**Cells**: {int((places.scored > 0).sum()):,} places were scored. In {int(dark.sum()):,} more than "
            f"{100 * WORTH_A_VISIT:.0f} % of the rays are not answered. In {int(off.sum()):,} more than {100 * often:.0f} % of the "
            f"answered rays are wrong. {int((cells.free & (cells.counts.sum(axis=2) == 0)).sum()):,} free places were "
            "not visited."
        )
    if cells.expected_error_map is not None:
        areas = [f"({x:.1f}, {y:.1f}) m ({area:.1f} m²)" for x, y, area in cells.expected_error_map.places()]
        lines += [""] if lines else []
        if areas:
            lines.append(
                f"**Suggested drives**: the expected error exceeds {100 * WORTH_A_VISIT:.0f} % around "
                + ", ".join(areas)
                + ". Plan the next run with `sensorgraph plan --priority GRAPH`."
            )
        else:
            lines.append(
                f"**Suggested drives**: none; the expected error of every free place is below {100 * WORTH_A_VISIT:.0f} %."
            )
    return lines


def _legend(review: Review) -> list[str]:
    """Return the legend of the colours, because the viewer has no colour bar."""
    cells = review.cells
    if cells.ray_counts is None:
        return []
    pink = 100 * cells.ray_counts.by_place.saturating_wrong
    return [
        "**Rays**: teal is right (error below 5 cm), pink is wrong, violet is not answered, white is not scored. "
        "Orange is the prediction of answered rays.",
        "",
        f"**Cells**: pink saturates at {pink:.0f} % wrong, violet at {100 * SATURATING_UNANSWERED:.0f} % not answered. "
        "Slate is free and not visited, dark is unobserved.",
        "",
        "**Other maps**, from dark to yellow: *expected error* 0 to 100 %, "
        f"*not answered* 0 to {100 * SATURATING_UNANSWERED:.0f} %, *wrong* 0 to {pink:.0f} % of the answered rays, "
        f"*error* 0 to {100 * cells.error_top:.2g} cm, *coverage* 0 to {HEADINGS} headings.",
    ]


def _training(review: Review, graph: Sensorgraph) -> str:
    """Return a sentence that says whether the scored scans are training scans of the graph."""
    if review.held_out is not None:
        return (
            f"Scored on the scans held out of the build ({graph.origin['split']}); the maps show all scans."
        )
    if training_scans(graph, review.run) is None:
        return "Scored on a run that was not used to build the graph."
    return "The graph was built from this run; errors on new scans are larger."


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
        row("error > 5 cm", "wrong_5cm", 100, "%"),
        row("within 3 sigma", "within_3sigma", 100, "%"),
        row("Pearson r", "pearson_r", 1, ""),
    ]
