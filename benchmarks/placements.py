"""How far the numbers of a real log depend on which stretches of it are held out: several placements, with intervals.

    python -m benchmarks.placements LOG [LOG ...] [--placements 5]

`--split block` holds out five stretches of 2 %, in the middle of each fifth of the log. Here they are moved on by 1/N of
a fifth, N times, so that no scan is held out twice; the first placement is that of `--split block`. For each, the cells are
built and the map is tuned (`benchmarks/occupancy_grid.py`) without them. Told: the mean over placements, its 95 % interval
by Student's t (which takes placements as independent; rooms that two of them share make it too narrow), and in how many
placements the cells were better than the grid with the least MAE.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.arguments import parser_of
from benchmarks.measures import half_interval
from benchmarks.occupancy_grid import MAX_HIT, Grid, graph_of, scans_of, tuned
from logs import Run, read
from planners.types import Floats
from sensorgraph.building.build import build
from sensorgraph.building.split import N_STRETCHES, held_out
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph

PLACEMENT_COLUMNS = ("mae_m", "median_m", "within_0.1m", "within_0.5m", "pearson_r")
SMALLER_IS_BETTER = np.array([True, True, False, False, False])


def grid(train: Run) -> Sensorgraph:
    """Return an occupancy grid of `train`, its threshold tuned within it for the least MAE."""
    (_, threshold), *_ = tuned(Grid, *scans_of(train)).items()
    return graph_of(Grid, threshold, train)


def row(result: Evaluation) -> Floats:
    """Return the PLACEMENT_COLUMNS of an evaluation."""
    return np.array([result.all[name] for name in PLACEMENT_COLUMNS], dtype=np.float64)


def told(name: str, rows: Floats) -> str:
    """Format means with the half widths of their intervals."""
    return f"{name:<34}" + "".join(
        f"{m:>9.3f} ±{h:5.3f}" for m, h in zip(rows.mean(axis=0), half_interval(rows), strict=True)
    )


def compare(run: Run, name: str, placements: int) -> None:
    """Print the table of one log."""
    first, fifth = held_out(run, "block"), run.n_scans / N_STRETCHES
    rows: dict[str, list[Floats]] = {"grid": [], "cells": []}
    answered: list[Floats] = []
    for k in range(placements):
        held = np.roll(first, round(k * fifth / placements))
        train, test = run.take_scans(~held), run.take_scans(held)
        rows["grid"].append(row(evaluate(grid(train), test, cap=MAX_HIT)))
        result = evaluate(build([train], model="cells"), test, cap=MAX_HIT)
        rows["cells"].append(row(result))
        answered.append(np.array([result.answered, result.answered_only["within_0.1m"]], dtype=np.float64))
        print(f"  placement {k}: cells " + " ".join(f"{v:.3f}" for v in rows["cells"][-1]))
    both = {model: np.array(values) for model, values in rows.items()}
    print(f"{name:<34}" + "".join(f"{column:>16}" for column in PLACEMENT_COLUMNS))
    for model, values in both.items():
        print(told(f"  {model}", values))
    better = np.where(SMALLER_IS_BETTER, both["cells"] < both["grid"], both["cells"] > both["grid"]).sum(
        axis=0
    )
    print(f"{'  cells better, of ' + str(placements):<34}" + "".join(f"{count:>16}" for count in better))
    share, near = np.mean(answered, axis=0)
    print(f"  cells answer {share:.3f} of the rays, {near:.3f} of those within 0.1 m")


def main() -> None:
    """Compare on every log given."""
    parser = parser_of(__doc__)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--placements", type=int, default=5)
    arguments = parser.parse_args()
    for path in arguments.logs:
        compare(read(path), path.name, arguments.placements)


if __name__ == "__main__":
    main()
