"""`sensorgraph build`."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sensorgraph.cli.messages import print_warnings
from sensorgraph.cli.options import Force, NoReturn, PosesFrom, RunRobot, Slice, Topics
from sensorgraph.cli.progress import progress, reading_bar

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping
    from pathlib import Path

    from logs.stream import LogStream
    from planners.arena import Arena
    from sensorgraph.graph import Sensorgraph


BuildRuns = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...", help="Runs of one sensor: MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV."
    ),
]
BuildOutput = Annotated[
    Path, typer.Option("-o", "--out", metavar="GRAPH", help="Sensorgraph to write, *.sensorgraph.")
]
BuildArena = Annotated[
    str | None,
    typer.Option(help="GeoJSON file, map_server yaml, or a shipped arena; its bounds scale x and y."),
]
BuildModel = Annotated[
    str, typer.Option(help="faces, cells, polynomial (published in 2004) or narmax (uses past scans).")
]
BuildSplit = Annotated[
    str | None, typer.Option(help="Hold scans out for evaluation: every10 or block; default: none.")
]
BuildDegree = Annotated[
    str,
    typer.Option(help="Degree in x and y (polynomial), or in poses and twist (narmax); or auto."),
]
BuildHarmonics = Annotated[
    str, typer.Option(help="Number of harmonics of the heading (polynomial), or auto.")
]
BuildTerms = Annotated[
    str, typer.Option(help="Number of terms of each ray (polynomial), or their maximum (narmax); or auto.")
]
BuildLags = Annotated[str, typer.Option(help="Number of past scans (narmax), or auto (3).")]
BuildCalibrate = Annotated[
    bool | None,
    typer.Option(
        "--calibrate/--no-calibrate",
        help="Estimate the laser with the faces: mount, ray terms, training poses; default: if it improves the fit.",
    ),
]
BuildMemory = Annotated[
    bool,
    typer.Option("--memory", help="Also identify the correlation of residuals in time and between rays."),
]
BuildUpdate = Annotated[
    Path | None,
    typer.Option(metavar="GRAPH", help="Add the runs to this sensorgraph (model faces or cells)."),
]
BuildDask = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Address of a Dask scheduler that reduces the scans (model faces)."),
]


def build(
    runs: BuildRuns,
    output: BuildOutput,
    arena: BuildArena = None,
    robot: RunRobot = None,
    model: BuildModel = "faces",
    split: BuildSplit = None,
    degree: BuildDegree = "auto",
    harmonics: BuildHarmonics = "auto",
    terms: BuildTerms = "auto",
    lags: BuildLags = "auto",
    calibrate: BuildCalibrate = None,
    memory: BuildMemory = False,
    update: BuildUpdate = None,
    dask: BuildDask = None,
    topic: Topics = None,
    no_return: NoReturn = None,
    force: Force = False,
    poses: PosesFrom = None,
    heights: Slice = None,
) -> None:
    """Build a sensorgraph from runs: equations that predict every ray at each (x, y, phi).

    Examples:

      sensorgraph build run.mcap -o square.sensorgraph

      sensorgraph build intel.log.gz --split block -o intel.sensorgraph

      sensorgraph build raw.clf.bz2 --poses locate -o raw.sensorgraph

      sensorgraph build second.mcap --update lab.sensorgraph -o lab2.sensorgraph

      sensorgraph build run.mcap --model polynomial --degree 4 -o plain.sensorgraph

      sensorgraph build run.mcap --model narmax --lags 3 -o lagged.sensorgraph
    """
    from sensorgraph.building.build import build as build_graph
    from sensorgraph.cli.inputs import check_output, check_runs, print_ray_order, read_options
    from sensorgraph.dask_client import cluster_map
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.loading import load_arena
    from sensorgraph.models import MODELS

    check_output(output, *runs)
    check_runs(runs)
    _check_model(model, MODELS, is_update=update is not None, with_arena=arena is not None)
    options = _options(calibrate, degree=degree, harmonics=harmonics, terms=terms, lags=lags)
    space = None if arena is None else load_arena(arena)
    known = None if update is None else Sensorgraph.load(update)
    place = (space, arena or "") if known is None else (known, str(update))
    reading = read_options(topic, no_return, robot, heights)
    loaded = [_open(path, robot, poses, place, reading, is_alone=len(runs) == 1) for path in runs]
    first = (str(runs[0]), loaded[0].head.sensor) if known is None else (str(update), known.sensor)
    for path, log in zip(runs, loaded, strict=True):
        print_ray_order(str(path), log.head.sensor.bearings, first[0], first[1].bearings)
    _print_before_fit(list(zip(runs, loaded, strict=True)))
    with cluster_map(dask) if dask is not None else nullcontext(map) as map_blocks:
        graph = build_graph(
            loaded,
            arena=space,
            model=model,
            split=split,
            names=[path.name for path in runs],
            map_blocks=map_blocks,
            update=known,
            force=force,
            memory=memory,
            progress=progress,
            **options,
        )
    graph.save(output)
    _report(graph, split)
    typer.echo(f"wrote {output}: {graph.sensor.n_rays} rays, poses of {graph.pose_frame}")


def _check_model(model: str, models: Collection[str], *, is_update: bool, with_arena: bool) -> None:
    from sensorgraph.errors import SensorgraphError

    if is_update and (model != "faces" or with_arena):
        raise SensorgraphError(
            "--update keeps the model and the arena of the graph; leave out --model and --arena"
        )
    if model not in models:
        raise SensorgraphError(f"model is {model!r}, expected one of {', '.join(models)}")


def _open(
    path: Path,
    robot: Path | None,
    poses: str | None,
    place: tuple[Arena | Sensorgraph | None, str],
    reading: Mapping[str, Any],
    *,
    is_alone: bool,
) -> LogStream:
    """Open a log; if it has no reference poses, locate it in `place` (arena or graph, name) or in a new map."""
    from logs.stream import WholeRun, open_log
    from sensorgraph.cli.inputs import with_poses, with_robot
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.localization.kept import needs_locating

    with reading_bar() as tick:
        log = open_log(path, **reading, progress=tick)
    log = replace(log, head=with_robot(log.head, str(path), robot))
    n_scans = None if isinstance(log, WholeRun) else log.n_scans
    if not needs_locating(log.head, log.head.n_scans if n_scans is None else n_scans, poses):
        return log
    if not is_alone and place[0] is None:
        raise SensorgraphError(
            f"{path} has no reference poses, and each run would get a separate map; build the runs one by one: "
            "the first alone, the others with --update GRAPH"
        )
    run = with_poses(log.head, path, poses, place[0], name=place[1], n_scans=n_scans, options=reading)
    return WholeRun(head=run)


def _print_before_fit(logs: list[tuple[Path, LogStream]]) -> None:
    """Print the sweep times and the warnings of the logs before the fit."""
    from logs.run_warnings import warnings_of

    for path, log in logs:
        sensor = log.head.sensor
        if sensor.has_ray_delays:
            sweeps = (
                f"{sensor.interlaced_sweeps} interlaced sweeps" if sensor.interlaced_sweeps > 1 else "sweeps"
            )
            typer.echo(
                f"{path.name}: the laser {sweeps} for {sensor.scan_duration:.3g} s; each ray gets its own pose"
            )
        print_warnings(f"{path.name}: {text}" for text in warnings_of(log.head))


def _report(graph: Sensorgraph, split: str | None) -> None:
    """Print how many scans of each run were used, and the fitted model."""
    for entry in graph.origin["inputs"]:
        dropped = "".join(f", {count:,} {why}" for why, count in entry["dropped"].items())
        held = f", {entry['held_out']:,} held out ({split})" if split else ""
        typer.echo(
            f"{entry['name']}: {entry['paired']:,} of {entry['n_scans']:,} scans paired with poses{dropped}{held}; "
            f"{entry['trained']:,} fitted"
        )
        print_warnings(f"{entry['name']}: {text}" for text in entry.get("warnings", ()))
    for label, text in graph.facts().items():
        typer.echo(f"{label}: {text}")


def _options(calibrate: bool | None, **texts: str) -> dict[str, Any]:
    """Return the options that are not `auto`."""
    numbers = {name: _number(name, text) for name, text in texts.items()}
    chosen = {
        "n_terms" if name == "terms" else name: number
        for name, number in numbers.items()
        if isinstance(number, int)
    }
    return chosen | ({} if calibrate is None else {"calibrate": calibrate})


def _number(name: str, text: str) -> int | str:
    from sensorgraph.errors import SensorgraphError

    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise SensorgraphError(f"{name} is {text!r}, expected a whole number or auto") from None
