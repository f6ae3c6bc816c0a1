"""Every ray with memory: how long the search takes, and how far lags, polynomials and faces see.

    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python -m benchmarks.lagged_rays RUN FRESH

RUN is a log with poses that graphs are built from, FRESH another one of the same place that they are scored on; such as

    sensorgraph plan square -o plan
    sensorgraph record plan -o run.mcap
    sensorgraph record plan --seed 7 -o fresh.mcap

`narmax` is scored one step ahead, in free run and on each pose alone, beside persistence (each ray returns what it
returned last), `polynomial` and `faces`. Seconds are of this process (CPU), reading not counted.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.arguments import parser_of
from benchmarks.measures import timed
from logs import read
from sensorgraph.building.build import build
from sensorgraph.evaluation.evaluate import evaluate
from sensorgraph.evaluation.metrics import Metrics

COLUMNS = ("median_m", "mae_m", "rmse_m", "within_0.1m", "pearson_r")


def main() -> None:
    """Print one row for each way to predict."""
    parser = parser_of(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("fresh", type=Path)
    arguments = parser.parse_args()
    run, fresh = read(arguments.run), read(arguments.fresh)
    rows: dict[str, Metrics] = {}
    for name in ("narmax", "polynomial", "faces"):
        with timed() as took:
            graph = build([run], model=name)
        print(f"{name}: {took.cpu:.1f} s for {run.n_scans:,} scans of {run.sensor.n_rays} rays")
        for label, text in graph.model.summary().items():
            print(f"  {label}: {text}")
        found = evaluate(graph, fresh)
        rows |= {f"{name}, {way.replace('_', ' ')}": block for way, block in found.in_sequence.items()}
        rows[f"{name}, each pose alone" if found.in_sequence else name] = found.all
    print("| | " + " | ".join(COLUMNS) + " |\n|---|" + "---:|" * len(COLUMNS))
    for label, block in rows.items():
        print(f"| {label} | " + " | ".join(f"{block[column]:.3f}" for column in COLUMNS) + " |")


if __name__ == "__main__":
    main()
