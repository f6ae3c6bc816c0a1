"""`sensorgraph evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sensorgraph.cli.progress import progress

if TYPE_CHECKING:
    from sensorgraph.evaluate import Evaluation

ROWS = (
    ("median error", "median_m", "m"),
    ("mean error (MAE)", "mae_m", "m"),
    ("RMSE", "rmse_m", "m"),
    ("within 0.1 m", "within_0.1m", "%"),
    ("within 0.5 m", "within_0.5m", "%"),
    ("within 3 sigma", "within_3sigma", "%"),
    ("off by > 5 cm", "wrong_5cm", "%"),
    ("correlation r", "pearson_r", ""),
    ("chamfer distance", "chamfer_m", "m"),
    ("f-score at 0.1 m", "f_score", ""),
    ("no return: recall", "no_return_recall", "%"),
    ("no return: precision", "no_return_precision", "%"),
)


def evaluate(
    graph: Annotated[Path, typer.Argument(metavar="GRAPH", help="A *.sensorgraph file.")],
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A recording with poses.")],
    split: Annotated[
        str | None, typer.Option(help="Score only scans that this split holds out: every10 or block.")
    ] = None,
    cap: Annotated[
        float | None,
        typer.Option(help="Longest return that counts, in m; default: 10, or the sensor's range."),
    ] = None,
    point: Annotated[
        str | None,
        typer.Option(help="Point value for all numbers: mode, median or mean [default: each its own]"),
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all numbers here.")
    ] = None,
    topic: Annotated[
        list[str] | None, typer.Option(metavar="ROLE=NAME", help="Topic of a role: scan, pose, odom, cmd.")
    ] = None,
) -> None:
    """Compare what a sensorgraph predicts with what a run measured.

    Examples:

      sensorgraph evaluate square.sensorgraph other_run.mcap

      sensorgraph evaluate intel.sensorgraph intel.log.gz --split block --json intel.json
    """
    from typing import cast

    from logs import parse_topics, read
    from sensorgraph.cli.inputs import check_output, write_json
    from sensorgraph.errors import GapError
    from sensorgraph.evaluate import evaluate as evaluate_graph
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.models.base import POINTS, Point

    if json is not None:
        check_output(json, graph, run)
    if point is not None and point not in POINTS:
        raise GapError(f"point is {point!r}, expected one of {', '.join(POINTS)}")
    model = Sensorgraph.load(graph)
    with progress("reading", "messages") as tick:
        log = read(run, topics=parse_topics(topic or []), progress=tick)
    with progress("evaluating", "scans") as tick:
        result = evaluate_graph(
            model, log, split=split, point=cast(Point | None, point), cap=cap, progress=tick
        )
    if json is not None:
        write_json(json, result.to_dict())
    for line in table(result):
        typer.echo(line)
    if json is not None:
        typer.echo(f"wrote {json}")


def table(result: Evaluation) -> list[str]:
    """Return the printed lines: both blocks side by side, and which point value each row is of."""
    scored = result.settings["scored"]
    lines = [
        f"{scored['n_scans']} of {scored['of_scans']} scans, {result.n_rays} returns between "
        f"{scored['from_m']:g} and {scored['to_m']:g} m; {result.settings['training']}",
        f"{'':<24}{'all':>10}{'answered':>12}   of",
        f"{'share of the rays':<24}{'100.0 %':>10}{f'{100 * result.answered:.1f} %':>12}",
    ]
    for label, key, unit in ROWS:
        cells = (_cell(block[key], unit) for block in (result.all, result.answered_only))
        left, right = cells
        lines.append(f"{label:<24}{left:>10}{right:>12}   {result.settings['point'].get(key, '')}".rstrip())
    return lines


def _cell(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{100 * value:.1f} %" if unit == "%" else f"{value:.3f} {unit}".rstrip()
