"""`sensorgraph fleet`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sensorgraph.cli.options import Topics

FleetLogs = Annotated[
    list[str], typer.Argument(metavar="LOG|FOLDER|PATTERN...", help="Logs, folders with logs, or patterns.")
]
FleetOut = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
FleetGraph = Annotated[
    list[str] | None,
    typer.Option(
        metavar="GRAPH",
        help="Sensorgraph of a place; repeatable. Default: each log is located in a new map.",
    ),
]
FleetArena = Annotated[
    list[str] | None,
    typer.Option(metavar="MAP", help="GeoJSON file or map_server yaml of a place; repeatable."),
]
FleetRobot = Annotated[
    Path | None, typer.Option(help="robot.yaml of all robots; default: the one kept in each log.")
]
FleetPattern = Annotated[
    str | None,
    typer.Option(
        metavar="REGEX",
        help="Robot's name in the path of a log. Default: robot.yaml in the log, the prefix of the laser's frame, or the folder.",
    ),
]
FleetScheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Dask scheduler whose workers read the same paths; default: this machine."
    ),
]
FleetWorkers = Annotated[
    int | None, typer.Option(min=1, help="Logs at a time on this machine; default: one for each processor.")
]
FleetMinutes = Annotated[float, typer.Option(min=0.01, help="Maximum time of a log (min).")]
FleetMemory = Annotated[float, typer.Option(min=100, help="Maximum memory of a log's process (MB).")]


def fleet(
    logs: FleetLogs,
    out: FleetOut,
    graph: FleetGraph = None,
    arena: FleetArena = None,
    robot: FleetRobot = None,
    name: FleetPattern = None,
    scheduler: FleetScheduler = None,
    workers: FleetWorkers = None,
    minutes: FleetMinutes = 15.0,
    memory: FleetMemory = 4000.0,
    topic: Topics = None,
) -> None:
    """Survey many logs: one table, trends of each robot with its changes, and robots that differ.

    Each log is located, and its wheels and its laser's mount are calibrated. A log that fails, hangs or takes too
    much memory costs one line. Results are kept by content: a second call analyses only what is new.

    Examples:

      sensorgraph fleet bags/ --graph lab.sensorgraph -o fleet

      sensorgraph fleet 'bags/*/*.mcap' --graph hall.sensorgraph --graph office.sensorgraph --name '(amr[0-9]+)' -o fleet

      sensorgraph fleet bags/ --arena map.yaml --scheduler tcp://10.0.0.5:8786 -o fleet
    """
    from logs import parse_topics
    from sensorgraph.cli.inputs import check_folder
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.surveying.fleet import fleet as survey_all
    from sensorgraph.surveying.limited import TaskLimits

    check_folder(out)
    with progress("surveying", "logs") as tick:
        found = survey_all(
            logs, out, places=[*(graph or []), *(arena or [])], robot=robot, pattern=name, scheduler=scheduler,
            workers=workers, limits=TaskLimits(seconds=60 * minutes, megabytes=memory), topics=parse_topics(topic or []),
            progress=tick,
        )  # fmt: skip
    for line in found.lines():
        typer.echo(line)
    typer.echo(f"wrote {out}; open {out / 'fleet.html'}")
    if not found.rows:
        raise SensorgraphError("no log could be analysed; the reasons are above and in fleet.html")
