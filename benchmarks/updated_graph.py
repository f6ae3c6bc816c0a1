"""A graph of the first half of a log, updated with the second half, against a graph of both.

    python -m benchmarks.updated_graph LOG

`split="block"` holds out a tenth of each half. Errors are those on the held-out scans of the second half, up to 10 m.
"""

from __future__ import annotations

from pathlib import Path

import logs
from benchmarks.arguments import parser_of
from benchmarks.measures import timed
from sensorgraph.building.build import build
from sensorgraph.evaluation.evaluate import evaluate


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("log", type=Path, metavar="LOG")
    run = logs.read(parser.parse_args().log)
    middle = run.n_scans // 2
    halves = [run.take_scans(slice(0, middle)), run.take_scans(slice(middle, None))]
    columns = f"{'CPU s':>8}{'answered':>10}{'of it <.1m':>12}{'< 0.1 m':>9}{'MAE m':>8}"
    print(f"{'graph of':<32}{columns}")
    first = None
    for name, runs in (
        ("first half", halves[:1]),
        ("first half, updated with second", halves[1:]),
        ("both halves", halves),
    ):
        with timed() as took:
            graph = build(runs, split="block", update=first if "updated" in name else None)
        first = graph if first is None else first
        found = evaluate(graph, halves[1], split="block", cap=10.0)
        every, answered = found.all, found.answered_only
        print(
            f"{name:<32}{took.cpu:>8.0f}{found.answered:>10.1%}{answered['within_0.1m']:>12.1%}"
            f"{every['within_0.1m']:>9.1%}{every['mae_m']:>8.3f}"
        )


if __name__ == "__main__":
    main()
