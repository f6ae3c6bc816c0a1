"""Cells on real logs: what is held out, with visibility learned here or only in other buildings; and learning it.

    python -m benchmarks.real_logs LOG [LOG ...] [--split block|every10] [--others] [--learn OUT.json]

Each log is built without what the split holds out, and scored on it. `--others` also learns visibility from the other
logs alone, as a stranger to this building would use it. `--learn` writes the visibility that is shipped: learned
from what the split leaves of all the logs given, five stretches in fifty of each left out of its own evidence.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.arguments import parser_of, timed
from logs import Run, pair, read
from logs.transforms import compose
from planners.types import Floats
from sensorgraph.building.build import build
from sensorgraph.building.split import held_out
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.cells.evidence import CellEvidence
from sensorgraph.models.cells.key_frames import is_key_frame
from sensorgraph.models.cells.learning import fit_logistic, is_set_aside, training_samples
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.cells.ray_march import tabulate
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.cells.visibility import TERMS

LOG_COLUMNS = ("mae_m", "median_m", "within_0.1m", "within_0.5m", "pearson_r", "wrong_5cm", "f_score")
WEIGHT_PER_LOG = 3e5
"""Weight that every log has, however long it is."""
N_SAMPLES = 25_000


@dataclass(frozen=True, kw_only=True)
class TrainingLog:
    """A log and what of it may be learned from."""

    name: str
    run: Run
    poses: Floats
    ranges: Floats

    @classmethod
    def read(cls, path: Path, split: str) -> TrainingLog:
        """Read a log; keep the key frames that the split does not hold out."""
        run = read(path)
        pairing = pair(run)
        train = np.flatnonzero(pairing.paired & ~held_out(run, split))
        keep = train[is_key_frame(pairing.poses[train], np.zeros(len(train), dtype=np.intp))]
        poses = pairing.poses[keep]
        if run.pose_frame == "base_link":
            poses = compose(poses, run.sensor.mount)
        return cls(name=path.name, run=run, poses=poses, ranges=run.ranges[keep])


def learned_from(logs: list[TrainingLog]) -> Floats:
    """Learn visibility (n_terms,) from scratch, in two rounds; every log counts alike."""
    beta: Floats | None = None
    for steps in (10, 4):
        parts = []
        for log in logs:
            aside, bearings = is_set_aside(len(log.poses)), log.run.sensor.bearings
            evidence = CellEvidence.of(log.poses[~aside], log.ranges[~aside], bearings).widened()
            table = tabulate(evidence, beta, (CELLS.first_sigma, 0.0, CELLS.first_sigma))
            phi, label, weight = training_samples(
                evidence, log.poses[aside], log.ranges[aside], bearings, table, N_SAMPLES
            )
            parts.append((phi, label, weight * (WEIGHT_PER_LOG / weight.sum())))
        phi, label, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
        zero = np.zeros(len(TERMS))
        start = np.append(-4.0, zero[1:]) if beta is None else beta
        beta = fit_logistic(phi, label, weight, start, zero, steps=steps)
    assert beta is not None
    return beta


def line(label: str, result: Evaluation, seconds: float) -> str:
    """Format one row."""
    values = "".join(f"{result.all[name] or 0.0:>12.3f}" for name in LOG_COLUMNS)
    near = result.answered_only["within_0.1m"] or 0.0
    return f"{label:<34}{values}{result.answered:>10.3f}{near:>12.3f}{seconds:>8.1f}"


def compare(logs: list[TrainingLog], split: str, *, others: bool) -> None:
    """Print the table."""
    heads = "".join(f"{name:>12}" for name in LOG_COLUMNS)
    print(f"{'log':<34}{heads}{'answered':>10}{'of it <.1m':>12}{'CPU s':>8}")
    for log in logs:
        with timed() as took:
            graph = build([log.run], model="cells", split=split)
        result = evaluate(graph, log.run, split=split, cap=10.0)
        print(line(log.name, result, took.cpu))
        if others:
            beta = learned_from([other for other in logs if other is not log])
            evidence = CellEvidence.of(log.poses, log.ranges, log.run.sensor.bearings).widened()
            sigma = CELLS.first_sigma
            table = tabulate(evidence, beta, (sigma, 0.0, sigma))
            model = CellModel(**{**vars(graph.model), "beta": beta, "table": table})
            stranger = Sensorgraph(
                model=model, sensor=graph.sensor, pose_frame=graph.pose_frame, origin=graph.origin
            )
            print(
                line("  visibility of the other logs", evaluate(stranger, log.run, split=split, cap=10.0), 0)
            )


def write(path: Path, logs: list[TrainingLog], split: str) -> None:
    """Write what is shipped as sensorgraph/data/visibility.json."""
    provenance = (
        f"learned by benchmarks/real_logs.py from {', '.join(log.name for log in logs)} (public 2-D laser logs, "
        f"poses corrected by SLAM), without what split {split} holds out; features and weights only, no scan"
    )
    beta = {name: float(f"{value:.6g}") for name, value in zip(TERMS, learned_from(logs), strict=True)}
    path.write_text(json.dumps({"provenance": provenance, "beta": beta}, indent=1) + "\n")


def main() -> None:
    """Compare on, or learn from, every log given."""
    parser = parser_of(__doc__)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--split", default="block", choices=["block", "every10"])
    parser.add_argument("--others", action="store_true")
    parser.add_argument("--learn", type=Path)
    arguments = parser.parse_args()
    logs = [TrainingLog.read(path, arguments.split) for path in arguments.logs]
    if arguments.learn is not None:
        write(arguments.learn, logs, arguments.split)
    else:
        compare(logs, arguments.split, others=arguments.others)


if __name__ == "__main__":
    main()
