"""Coverage that adapts: rounds of ten minutes, each planned by what the graph so far does not know, against drives planned ahead.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.rounds                         # the office, five rounds
    OPENBLAS_NUM_THREADS=1 python -m benchmarks.rounds --arena office 1001 1002 --ahead anytime views

The first round is an anytime plan. Each later one is what `sensorgraph plan --resume RUNS --graph GRAPH --budget 10` makes: it
starts where the last one ended, what was driven needs no visit, and it looks first where little was seen and the graph of all rounds so far
would not answer or be wrong. `--ahead` are ways of `benchmarks.error_by_minutes`, driven for forty minutes. With
`--thin` n every n-th scan is built from. Said last: after how many minutes the rounds are as good; and of several places or seeds
the means with their 95 % intervals, also of the rounds less the best drive planned ahead.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.arguments import half_interval, heads, parser_of
from benchmarks.error_by_minutes import Place, check_of, place_of, ways
from logs.run import Run, pair
from planners import plan
from planners.types import Floats
from sensorgraph.building.build import build
from sensorgraph.evaluation.evaluate import evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.planning.survey import survey_of
from sensorgraph.world.robot import default_robot

ROUND = 10.0
"""[min]"""
AHEAD = 40.0
"""[min] of the drives planned ahead."""


def main() -> None:
    """Drive the rounds, build, ask; print a table and after how long they are as good."""
    parser = parser_of(__doc__)
    parser.add_argument("--arena", nargs="+", default=["office"])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--ahead", nargs="*", default=["anytime", "views", "wall following"])
    parser.add_argument("--seed", type=int, nargs="+", default=[1])
    parser.add_argument("--thin", type=int, default=1)
    options = parser.parse_args()
    print(heads("arena", "seed", "driven by", "minutes", "wrong by > 5 cm", "answered", text=3))
    found = [
        compared(name, place_of(name, default_robot(), seed, options.thin), options.rounds, options.ahead)
        for name in options.arena
        for seed in options.seed
    ]
    if len(found) > 1:
        summary(found, len(options.ahead))


def summary(found: list[list[float]], n_ahead: int) -> None:
    """Print means of rows of `compared` and their 95 % intervals, of Student's t."""
    wrong = 100 * np.array(found)  # (n, rounds + ways)
    count = wrong.shape[1] - n_ahead
    for k in range(count):
        line = f"rounds, {ROUND * (k + 1):.0f} min: {wrong[:, k].mean():.3f} ± {half_interval(wrong[:, k]):.3f} %"
        if n_ahead:
            less = wrong[:, k] - wrong[:, count:].min(axis=1)
            line += f"; less the best planned ahead {less.mean():+.3f} ± {half_interval(less):.3f} %"
        print(line)


def compared(name: str, place: Place, count: int, ahead: list[str]) -> list[float]:
    """Print the table of one place; return the shares wrong after each round and of each way ahead."""
    check, short = check_of(place), Path(name.partition("@")[0]).name

    def wrong(way: str, minutes: float, graph: Sensorgraph) -> float:
        found = evaluate(graph, check)
        share = found.all["wrong_5cm"]
        assert share is not None
        print(
            f"| {short} | {place.seed} | {way} | {minutes:.0f} | {100 * share:.3f} % | {100 * found.answered:.2f} % |"
        )
        return share

    errors = [wrong("rounds", ROUND * k, graph) for k, graph in enumerate(graphs(place, count), 1)]
    if not ahead:
        return errors
    others = [wrong(way, AHEAD, build(ways(place)[way](AHEAD))) for way in ahead]
    good = [k for k, error in enumerate(errors, 1) if error <= min(others)]
    after = f"after {ROUND * good[0]:.0f} min" if good else f"not in {ROUND * count:.0f} min"
    print(f"{short}, seed {place.seed}: as good as the best of {AHEAD:.0f} min planned ahead {after}")
    return errors + others


def graphs(place: Place, count: int) -> Iterator[Sensorgraph]:
    """Yield the graph after each round."""
    runs: list[Run] = []
    poses: list[Floats] = []
    graph, here = None, place.start
    for k in range(count):
        survey = survey_of(place.arena, place.robot.sensor, graph)
        if poses:
            survey.mark(np.concatenate(poses))
        made = plan(
            place.arena, place.robot, seed=place.seed + k, rate=place.robot.sensor.rate, order="anytime",
            survey=survey, budget=60.0 * ROUND,
            visited=np.concatenate(poses) if poses else None, start=here,
        )  # fmt: skip
        run = replace(place, seed=place.seed + 1000 * k).scanned(made.trajectory, ROUND)
        here = made.trajectory.poses[-1]
        poses.append(pair(run).poses)
        runs.append(place.cut(run, ROUND))
        graph = build(runs)
        yield graph


if __name__ == "__main__":
    main()
