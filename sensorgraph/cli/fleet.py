"""`sensorgraph fleet`."""

from __future__ import annotations

import typer

from sensorgraph.cli.options import (
    FleetArena,
    FleetGraph,
    FleetLogs,
    FleetMemory,
    FleetMinutes,
    FleetOut,
    FleetPattern,
    FleetRobot,
    FleetScheduler,
    FleetWorkers,
    Topics,
)


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
