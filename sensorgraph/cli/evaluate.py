"""`sensorgraph evaluate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sensorgraph.cli.options import Force, GraphFile, NoReturn, PosesFrom, RunFile, RunRobot, Slice, Topics
from sensorgraph.cli.progress import progress

if TYPE_CHECKING:
    from collections.abc import Iterable

    from logs.run import Run
    from sensorgraph.evaluation.evaluate import Evaluation
    from sensorgraph.evaluation.metrics import Metrics
    from sensorgraph.models.base import Point

ROWS = (
    ("median error", "median_m", "m"),
    ("mean error (MAE)", "mae_m", "m"),
    ("RMSE", "rmse_m", "m"),
    ("within 0.1 m", "within_0.1m", "%"),
    ("within 0.5 m", "within_0.5m", "%"),
    ("within 3 sigma", "within_3sigma", "%"),
    ("off by > 5 cm", "wrong_5cm", "%"),
    ("expected off by > 5 cm", "wrong_5cm_expected", "%"),
    ("correlation r", "pearson_r", ""),
    ("chamfer distance", "chamfer_m", "m"),
    ("f-score at 0.1 m", "f_score", ""),
    ("no return: recall", "no_return_recall", "%"),
    ("no return: precision", "no_return_precision", "%"),
)


EvaluateSplit = Annotated[
    str | None, typer.Option(help="Score only the held-out scans of this split: every10 or block.")
]
EvaluateCap = Annotated[
    float | None,
    typer.Option(help="Longest return that is scored (m); default: 10, or the sensor's range if shorter."),
]
EvaluatePoint = Annotated[
    str | None,
    typer.Option(
        help="Point value for all scores: mode, median or mean; default: the best one for each score."
    ),
]
EvaluateEffects = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="effects.yaml: also score the simulator, without and with these effects."
    ),
]
EvaluateBeside = Annotated[
    list[Path] | None,
    typer.Option(
        "--beside", metavar="GRAPH", help="Also score this sensorgraph on the same rays; repeatable."
    ),
]
EvaluateJson = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Also write all scores to this JSON file.")
]


def evaluate(
    graph: GraphFile,
    run: RunFile,
    split: EvaluateSplit = None,
    cap: EvaluateCap = None,
    point: EvaluatePoint = None,
    effects: EvaluateEffects = None,
    beside: EvaluateBeside = None,
    json: EvaluateJson = None,
    topic: Topics = None,
    no_return: NoReturn = None,
    force: Force = False,
    robot: RunRobot = None,
    poses: PosesFrom = None,
    heights: Slice = None,
) -> None:
    """Compare the predictions of a sensorgraph with the ranges measured in a run.

    Examples:

      sensorgraph evaluate square.sensorgraph other_run.mcap

      sensorgraph evaluate intel.sensorgraph intel.log.gz --split block --json intel.json

      sensorgraph evaluate narmax.sensorgraph other_run.mcap --beside faces.sensorgraph

      sensorgraph evaluate square.sensorgraph other_run.mcap --effects diagnosis/effects.yaml
    """
    from typing import cast

    from sensorgraph.cli.inputs import (
        check_output,
        print_log_notes,
        print_ray_order,
        read_options,
        read_run,
        with_poses_of_graph,
        write_json,
    )
    from sensorgraph.cli.messages import print_warnings
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.evaluation.evaluate import evaluate as evaluate_graph
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.models.base import POINTS

    if json is not None:
        check_output(json, graph, run, effects)
    if point is not None and point not in POINTS:
        raise SensorgraphError(f"point is {point!r}, expected one of {', '.join(POINTS)}")
    value = cast("Point | None", point)
    model, *compared = map(Sensorgraph.load, [graph, *(beside or [])])
    reading = read_options(topic, no_return, robot, heights)
    log = with_poses_of_graph(read_run(run, reading, robot), run, poses, model, str(graph), reading)
    print_ray_order(str(run), log.sensor.bearings, str(graph), model.sensor.bearings)
    with progress("evaluating", "scans") as tick:
        result = evaluate_graph(model, log, split=split, point=value, cap=cap, force=force, progress=tick)
    simulator = None if effects is None else _simulator(result, log, effects, value)
    others: dict[str, Metrics] = {}
    for path, other in zip(beside or [], compared, strict=True):
        with progress(f"evaluating {path.stem}", "scans") as tick:
            others[path.stem] = evaluate_graph(
                other, log, split=split, point=value, cap=cap, force=force, progress=tick
            ).all
    if json is not None:
        extra = ({} if simulator is None else {"simulator": simulator}) | (
            {"beside": others} if others else {}
        )
        write_json(json, result.to_dict() | extra)
    print_log_notes(log)
    print_warnings(result.warnings)
    written = [] if json is None else [f"wrote {json}"]
    typer.echo("\n".join([*table(result, simulator, others), *written]))


def _simulator(result: Evaluation, run: Run, effects: Path, point: Point | None) -> dict[str, Metrics]:
    """Score the simulator of the arena and the robot kept in the run."""
    from sensorgraph.effects.effects_file import read
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.evaluation.raycast_baseline import compare
    from sensorgraph.loading import arena_in, robot_in

    arena, robot = arena_in(run), robot_in(run)
    if arena is None or robot is None:
        raise SensorgraphError(
            "--effects needs a run that keeps arena and robot; this run does not; write one with `sensorgraph record`"
        )
    with progress("simulating", "%") as tick:
        return compare(result, run, arena, robot.sensor, read(effects, arena), point=point, progress=tick)


def table(
    result: Evaluation,
    simulator: dict[str, Metrics] | None = None,
    beside: dict[str, Metrics] | None = None,
) -> list[str]:
    """Return the printed table: one column per block, and the point value used for each row."""
    blocks = {
        "all": result.all,
        "answered": result.answered_only,
        **{k.replace("_", " "): block for k, block in result.in_sequence.items()},
    }
    blocks |= {**(simulator or {}), **(beside or {})}
    scored = result.settings["scored"]
    lines = [
        f"{scored['n_scans']:,} of {scored['of_scans']:,} scans, {result.n_rays:,} returns between "
        f"{scored['from_m']:g} and {scored['to_m']:g} m; {result.settings['training']}",
        f"{'':<24}{_row(blocks)}   point value",
        f"{'share of rays':<24}{_row(['100.0 %', _cell(result.answered, '%')])}",
    ]
    for label, key, unit in ROWS:
        row = _row([_cell(block.get(key), unit) for block in blocks.values()])
        lines.append(f"{label:<24}{row}   {result.settings['point'].get(key, '')}".rstrip())
    if any(errors := list(result.settings["pose_errors"].values())):
        lines.append(
            f"expected: by the graph, for poses with the errors of this run: {1e3 * errors[0]:.1f} mm and "
            f"{math.degrees(errors[1]):.2f}°"
        )
    if result.in_sequence:
        lines.append(
            "all, answered: from the pose alone; one step: from previous scans; free run: from the model's own "
            "predictions; persistence: the last reading; the last three are on the rays of `all`"
        )
    if simulator:
        lines.append("nominal, amended: the simulator without and with the effects, on the rays of `all`")
    return lines


def _row(cells: Iterable[str]) -> str:
    return "".join(f"{cell:>{10 if i == 0 else 12}}" for i, cell in enumerate(cells))


def _cell(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{100 * value:.1f} %" if unit == "%" else f"{value:.3f} {unit}".rstrip()
