"""The two experiments of the paper that this project starts from, each one command, on the embedded robot.

    python -m benchmarks.paper environment -o docs/pages/pictures
    python -m benchmarks.paper task -o docs/pages/pictures

Environment: a wall-following run in the square arena, logged every 250 ms, one sample in 15; the range of the ray at
67° from (x, y) now and at the two samples before, degree 2; the first half trains, the second validates. Then the
question that the paper could not answer: what does the model say elsewhere? Task: the turn rate from the mean range
between 45° and 90°. Prints markdown; writes one picture each.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.arguments import heads, parser_of
from benchmarks.places import closed_loop, covered, robot_of_the_paper
from logs.run import Run, pair
from planners.arena import Arena
from planners.types import Floats
from robotmodic_ident.validation.score import Score
from sensorgraph.building.build import build
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.identify import IdentificationSpec, IdentifiedSignal, identify, score
from sensorgraph.identification.signals import perceived, rays_of, signals_of_run
from sensorgraph.loading import load_arena
from sensorgraph.show.figures.identified import series
from sensorgraph.show.figures.style import (
    ALARM,
    AMBER,
    INK,
    SOLID,
    TEAL,
    draw_floor,
    new_figure,
    reduce_frame,
    save_figure,
)
from sensorgraph.world.robot import default_robot

SCAN_STRIDE = 15
SHOWN_RAY = "L67"
FULL = 28
PAPER_R = 0.75
LOWEST, HIGHEST = -12.0, 6.0
"""[m] drawn of what is predicted elsewhere."""
PAPER_MINUTES = 60.0
START_POSE = np.array([1.0, 0.5, 0.0])
REPORTED_SEED = 4  # of the reported figures; development used 0 to 3


def said(s: Score) -> str:
    """Return r with its interval and the RMSE."""
    return f"{s.r:.3f} ({s.r_low:.3f} to {s.r_high:.3f}) | {s.rmse:.3f}"


def environment(folder: Path) -> None:
    """Print and draw the first experiment."""
    arena, robot = load_arena("square"), robot_of_the_paper()
    follow = closed_loop("wall_following", arena, robot, START_POSE, PAPER_MINUTES * 60, REPORTED_SEED)
    elsewhere = closed_loop("random_bounce", arena, robot, START_POSE, PAPER_MINUTES * 60, REPORTED_SEED + 1)
    data = signals_of_run(follow, [SHOWN_RAY, "x", "y"], every=SCAN_STRIDE)
    question = IdentificationSpec(output=SHOWN_RAY, inputs=("x", "y"), lags=2)
    full = identify(data, replace(question, n_terms=FULL))
    few = identify(data, question)
    path = [identify(data, replace(question, n_terms=n)) for n in range(1, FULL + 1)]
    enough = next(m for m in path if m.scores["one_step"].r >= full.scores["one_step"].r_low)
    least = next(m for m in path if m.scores["one_step"].r >= PAPER_R)
    print(f"{full.n_train} samples every {data.period:g} s train, {full.scores['one_step'].n} validate\n")
    print(heads("model of L67", "terms", "r on the second half (95 %)", "RMSE [m]"))
    for label, found in (
        ("the paper's full dictionary", full),
        ("chosen on the first half (EBIC)", few),
        (f"the fewest within the interval of the {FULL}", enough),
        (f"the fewest that reach the paper's r of {PAPER_R}", least),
    ):
        print(f"| {label} | {len(found.model.terms)} | {said(found.scores['one_step'])} |")
    print(f"\n```\n{least.model.equation(digits=4)}\n\n{enough.model.equation(digits=4)}\n```\n")
    graphs = _graphs(arena)
    along, other = "along the wall, second half: r (95 %)", "elsewhere: r (95 %)"
    print(heads("asked about L67", along, "RMSE [m]", other, "RMSE [m]"))
    there = signals_of_run(elsewhere, [SHOWN_RAY, "x", "y"], every=SCAN_STRIDE).records
    measured = [r.signals[SHOWN_RAY] for r in there]
    guesses = {"the polynomial of the run along the wall": [few.model.predict_osa(r) for r in there]}
    rows = {next(iter(guesses)): few.scores["one_step"]}
    half = follow.n_scans // (2 * SCAN_STRIDE)
    for name, graph in graphs.items():
        guesses[name] = [_asked(graph, elsewhere)]
        known = _asked(graph, follow)[half:]
        rows[name] = score([data.records[0].signals[SHOWN_RAY][half:]], [known])
    for name, guess in guesses.items():
        print(f"| {name} | {said(rows[name])} | {said(score(measured, guess))} |")
    _draw_environment(
        folder / "paper_environment.png", arena, few, path, follow, elsewhere, measured[0], guesses
    )


def _graphs(arena: Arena) -> dict[str, Sensorgraph]:
    """Drive a coverage plan once, and build both models from it."""
    run = covered(arena, default_robot(), REPORTED_SEED + 2)
    minutes = run.stamps[-1] / 60
    return {
        f"faces, from a coverage run of {minutes:.0f} min": build([run]),
        "one polynomial of x, y, φ per ray, from the same run": build([run], model="polynomial"),
    }


def _asked(graph: Sensorgraph, run: Run) -> Floats:
    """Return what a graph says of the ray (n,) at the poses of every 15th scan."""
    poses = pair(run).poses[::SCAN_STRIDE]
    there = poses_for(graph, "base_link", run.sensor.mount, poses)
    return perceived(graph.predict(there).mode, rays_of(run.sensor, SHOWN_RAY))


def _draw_environment(
    file: Path,
    arena: Arena,
    few: IdentifiedSignal,
    path: list[IdentifiedSignal],
    follow: Run,
    elsewhere: Run,
    measured: Floats,
    guesses: dict[str, list[Floats]],
) -> None:
    figure = new_figure(10.5, 7.4)
    top, bottom = figure.subfigures(2, 1, height_ratios=[1.0, 1.25])
    series(top.subplots(), few, most=150, unit="m")
    left, middle, right = bottom.subplots(1, 3)
    count = [len(m.model.terms) for m in path]
    middle.plot(count, [m.scores["one_step"].r for m in path], "o-", ms=3, lw=1.2, color=TEAL)
    last = path[-1].scores["one_step"]
    middle.axhspan(last.r_low, last.r_high, color=SOLID, zorder=0, linewidth=0, label=f"interval of {FULL}")
    middle.axhline(PAPER_R, color=AMBER, lw=1.0, ls=(0, (4, 2)), label=f"the paper's {PAPER_R}")
    middle.legend(loc="lower right", frameon=False, fontsize=8, labelcolor=INK)
    middle.set(xlabel="terms", ylabel="r on the second half", ylim=(0.0, 1.02))
    middle.set_title("how many terms", fontsize=9.5, color=INK, loc="left")
    middle.grid(color=SOLID, lw=0.6)
    draw_floor(left, arena)
    left.plot(*elsewhere.poses[::30, :2].T, ".", ms=2.0, color=AMBER, mew=0, zorder=2)
    left.plot(*follow.poses[::10, :2].T, color=TEAL, lw=1.0, zorder=3)
    left.set_title("trained along the wall, asked at the dots", fontsize=9.5, color=INK, loc="left")
    right.plot([0, 5], [0, 5], color=INK, lw=0.6)
    names = list(guesses)
    for name, colour, label in ((names[0], ALARM, "polynomial"), (names[1], TEAL, "faces")):
        right.plot(measured, guesses[name][0], ".", ms=4, color=colour, alpha=0.5, mew=0, label=label)
    known = guesses[names[0]][0][np.isfinite(guesses[names[0]][0])]
    beyond = float(np.mean((known < LOWEST) | (known > HIGHEST)))
    right.set(
        xlim=(0, 5), ylim=(LOWEST, HIGHEST), xlabel="measured L67 elsewhere [m]", ylabel="predicted [m]"
    )
    right.legend(loc="upper left", frameon=False, fontsize=8, markerscale=2, labelcolor=INK)
    right.set_title(f"asked elsewhere ({beyond:.0%} of red is off)", fontsize=9.5, color=INK, loc="left")
    for axes in (middle, right):
        reduce_frame(axes)
        for label in (axes.xaxis.label, axes.yaxis.label):
            label.set(size=9, color=INK)
    save_figure(figure, file)


FORMS: dict[str, dict[str, Any]] = {
    "the paper's form: 3 terms, degree 1": {"lags": 1, "degree": 1, "n_terms": 3},
    "degree 2": {"lags": 1, "degree": 2},
    "degree 4": {"lags": 1, "degree": 4},
}


def task(folder: Path) -> None:
    """Print and draw the second experiment."""
    arena, robot = load_arena("square"), robot_of_the_paper()
    follow = closed_loop("wall_following", arena, robot, START_POSE, PAPER_MINUTES * 60, REPORTED_SEED)
    print(
        heads("turn rate from the mean of L45 to L90", "terms", "r on the second half (95 %)", "RMSE [rad/s]")
    )
    found = {}
    for every in (1, SCAN_STRIDE):
        data = signals_of_run(follow, ["cmd_omega", "L45-90"], every=every)
        for label, form in FORMS.items():
            name = f"{label}, every {250 * every / 1000:g} s"
            found[name] = identify(data, IdentificationSpec(output="cmd_omega", inputs=("L45-90",), **form))
            print(f"| {name} | {len(found[name].model.terms)} | {said(found[name].scores['one_step'])} |")
        last = found[name].scores["persistence"]
        print(f"| the last turn rate again, every {250 * every / 1000:g} s | – | {said(last)} |")
    print()
    for name in list(found)[:2]:
        print(f"{name}:\n\n```\n{found[name].model.equation(digits=4)}\n```\n")
    figure = new_figure(10.5, 5.4)
    for axes, name in zip(figure.subplots(2, 1), list(found)[:2], strict=True):
        series(axes, found[name], most=480, unit="rad/s")
        axes.set_title(name, fontsize=9.5, color=INK, loc="right")
    save_figure(figure, folder / "paper_task.png")


def main() -> None:
    """Run one experiment."""
    parser = parser_of(__doc__)
    parser.add_argument("experiment", choices=("environment", "task"))
    parser.add_argument("-o", "--out", type=Path, default=Path("docs"), help="folder of the picture")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    {"environment": environment, "task": task}[options.experiment](options.out)


if __name__ == "__main__":
    main()
