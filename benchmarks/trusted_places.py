"""The paper's experiment for all rays: which model may be trusted where, by the log that it was built from.

    python -m benchmarks.trusted_places [--minutes 15] [--rays 61]

In the shipped square the robot covers the floor, follows the wall, and bounces at random. From each log every kind of
model is built, and asked at the poses of fresh drives of all three kinds: share of the rays that it answers (its own
support), and the root mean square error there and where it would not answer. For `narmax` also one step ahead and in
free run: what lags add.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.arguments import heads, parser_of
from benchmarks.places import closed_loop, covered, robot_of_the_paper
from logs.run import Run
from planners.arena import Arena
from sensorgraph.building.build import build
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.loading import load_arena
from sensorgraph.world.robot import Robot

TRAIN_SEED, FRESH_SEED = 20, 30
START_POSE = np.array([1.0, 0.5, 0.0])
MODELS = ("polynomial", "narmax", "faces")


def drives(arena: Arena, robot: Robot, minutes: float, seed: int) -> dict[str, Run]:
    """Drive a coverage plan (cut at `minutes`), along the wall, and at random."""
    return {
        "coverage": covered(arena, robot, seed, headings=8),
        "along the wall": closed_loop("wall_following", arena, robot, START_POSE, 60 * minutes, seed + 1),
        "random": closed_loop("random_bounce", arena, robot, START_POSE, 60 * minutes, seed + 2),
    }


def said(found: Evaluation) -> str:
    """Return the share answered, and the error there and elsewhere."""
    known = np.isfinite(found.residual)

    def error(rays: np.ndarray) -> str:
        values = found.residual[rays & known]
        return f"{np.sqrt(np.mean(values**2)):.3f}" if len(values) else "–"

    return f"{found.answered:.0%}: {error(found.answered_rays)} / {error(~found.answered_rays)}"


def main() -> None:
    """Read the command line and print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--rays", type=int, default=61)
    arguments = parser.parse_args()
    arena, robot = load_arena("square"), robot_of_the_paper()
    bearings = np.linspace(-np.pi / 2, np.pi / 2, arguments.rays)
    robot = replace(robot, sensor=replace(robot.sensor, bearings=bearings))
    train = drives(arena, robot, arguments.minutes, TRAIN_SEED)
    fresh = drives(arena, robot, arguments.minutes, FRESH_SEED)
    for name, run in train.items():
        print(f"{name}: {run.n_scans:,} scans of {run.sensor.n_rays} rays, {run.stamps[-1] / 60:.0f} min")
    print("\n" + heads("model, built from", *(f"asked: {name}" for name in fresh)))
    lags = []
    for model in MODELS:
        for name, run in train.items():
            graph = build([run], model=model)
            found = {other: evaluate(graph, log) for other, log in fresh.items()}
            print(f"| {model}, {name} | " + " | ".join(map(said, found.values())) + " |")
            for other, one in found.items():
                if one.in_sequence:
                    ways = " | ".join(
                        f"{one.in_sequence[way]['rmse_m']:.3f}"
                        for way in ("one_step", "persistence", "free_run")
                    )
                    lags.append(f"| {name} | {other} | {ways} | {one.all['rmse_m']:.3f} |")
    shown = "one step", "persistence", "free run", "each pose alone"
    print("\n" + heads("narmax, built from", "asked", *shown, text=2))
    print("\n".join(lags))


if __name__ == "__main__":
    main()
