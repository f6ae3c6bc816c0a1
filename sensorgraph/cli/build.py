"""`sensorgraph build`."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from sensorgraph.cli.progress import progress


def build(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Recordings (MCAP, bag, CARMEN log) with poses.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="GRAPH", help="File to write, *.sensorgraph.")
    ],
    arena: Annotated[
        str | None, typer.Option(help="GeoJSON, map yaml, or a shipped one: its bounds set the scale.")
    ] = None,
    robot: Annotated[
        Path | None, typer.Option(help="Robot yaml: its sensor must be the one that recorded.")
    ] = None,
    model: Annotated[
        str, typer.Option(help="What to fit: faces, cells, or polynomial, the form of 2004.")
    ] = "faces",
    split: Annotated[str | None, typer.Option(help="Hold scans out: every10 or block.")] = None,
    degree: Annotated[str, typer.Option(help="Of polynomial: degree in x and y, or auto.")] = "auto",
    harmonics: Annotated[
        str, typer.Option(help="Of polynomial: harmonics of the heading, or auto.")
    ] = "auto",
    terms: Annotated[str, typer.Option(help="Of polynomial: terms kept for each ray, or auto.")] = "auto",
    calibrate: Annotated[
        bool | None,
        typer.Option(
            "--calibrate/--no-calibrate",
            help="Of faces: identify the laser with them (mount, ray terms, training poses); where it pays.",
        ),
    ] = None,
    update: Annotated[
        Path | None, typer.Option(metavar="GRAPH", help="Add the runs to this graph of faces.")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster that reduces the scans of faces."),
    ] = None,
    topic: Annotated[
        list[str] | None, typer.Option(metavar="ROLE=NAME", help="Topic of a role: scan, pose, odom, cmd.")
    ] = None,
) -> None:
    """Identify what every ray perceives at each (x, y, phi).

    Examples:

      sensorgraph build run.mcap -o square.sensorgraph

      sensorgraph build intel.log.gz --split block -o intel.sensorgraph

      sensorgraph build second.mcap --update lab.sensorgraph -o lab2.sensorgraph

      sensorgraph build run.mcap --model polynomial --degree 4 -o plain.sensorgraph
    """
    from logs import parse_topics
    from logs.stream import open_log
    from sensorgraph.building.build import build as build_graph
    from sensorgraph.building.dask_cluster import cluster
    from sensorgraph.cli.inputs import check_output, read_robot_sensor
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.loading import load_arena
    from sensorgraph.models import MODELS

    check_output(output, *runs)
    if update is not None and (model != "faces" or arena is not None):
        raise SensorgraphError(
            "--update adds runs to a graph as it was built; leave --model and --arena away"
        )
    if model not in MODELS:
        raise SensorgraphError(f"model is {model!r}, expected one of {', '.join(MODELS)}")
    options: dict[str, Any] = {
        "n_terms" if name == "terms" else name: value
        for name, text in (("degree", degree), ("harmonics", harmonics), ("terms", terms))
        if (value := _number(name, text)) != "auto"
    }
    if calibrate is not None:
        options["calibrate"] = calibrate
    space = None if arena is None else load_arena(arena)
    names = parse_topics(topic or [])
    known = None if update is None else Sensorgraph.load(update)
    loaded = []
    for path in runs:
        with progress("reading", "bytes") as tick:
            loaded.append(open_log(path, topics=names, progress=tick))
    if robot is not None:
        read_robot_sensor(
            robot, [(str(path), log.head.sensor) for path, log in zip(runs, loaded, strict=True)]
        )
    with (
        cluster(dask) if dask is not None else nullcontext(map) as map_blocks,
        progress("building", "blocks") as tick,
    ):
        graph = build_graph(
            loaded,
            arena=space,
            model=model,
            split=split,
            names=[path.name for path in runs],
            map_blocks=map_blocks,
            update=known,
            progress=tick,
            **options,
        )
    graph.save(output)
    for entry in graph.origin["inputs"]:
        dropped = "".join(f", {count} {why}" for why, count in entry["dropped"].items())
        held = f", {entry['held_out']} held out ({split})" if split else ""
        typer.echo(
            f"{entry['name']}: {entry['paired']} of {entry['n_scans']} scans paired with poses{dropped}{held}; "
            f"{entry['trained']} fitted"
        )
        for text in entry.get("warnings", ()):
            typer.echo(f"warning: {entry['name']}: {text}", err=True)
    for label, text in graph.model.summary().items():
        typer.echo(f"{label}: {text}")
    typer.echo(f"wrote {output}: {graph.sensor.n_rays} rays, poses of {graph.pose_frame}")


def _number(name: str, text: str) -> int | str:
    from sensorgraph.errors import SensorgraphError

    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise SensorgraphError(f"{name} is {text!r}, expected a whole number or auto") from None
