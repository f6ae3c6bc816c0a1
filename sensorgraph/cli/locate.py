"""`sensorgraph locate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sensorgraph.cli.options import NoReturn, RunFile, RunRobot, Slice, Topics

LocateArena = Annotated[
    str | None,
    typer.Option(
        metavar="MAP|GRAPH",
        help="Known place: GeoJSON file, map_server yaml, log with /map, shipped arena or sensorgraph; default: build a map.",
    ),
]
LocateOut = Annotated[
    Path | None,
    typer.Option("-o", "--out", metavar="OUT.mcap", help="Run to write, with /pose, covariances and /tf."),
]
LocateCsv = Annotated[
    Path | None,
    typer.Option(
        metavar="POSES.csv",
        help="Write t,x,y,phi,sigma_x,sigma_y,sigma_phi,status,map to this file, one row per scan.",
    ),
]
LocateJson = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Write scan counts, located intervals, wheel parameters and loop closures."
    ),
]
LocatePicture = Annotated[
    Path | None,
    typer.Option(metavar="PNG", help="Draw returns, trajectory, and accepted and rejected loop closures."),
]


def locate(
    run: RunFile,
    arena: LocateArena = None,
    out: LocateOut = None,
    csv: LocateCsv = None,
    json: LocateJson = None,
    picture: LocatePicture = None,
    topic: Topics = None,
    no_return: NoReturn = None,
    robot: RunRobot = None,
    heights: Slice = None,
) -> None:
    """Estimate the pose of each scan from scans and wheel odometry, in a known place or in a new map.

    Without --arena, locate builds a map: it closes loops and fits all poses
    and surfaces together. With --arena, it finds the robot in that map
    without an initial pose and tracks it. Each pose has a covariance and a
    status: ok, ambiguous or lost.

    Examples:

      sensorgraph locate raw.mcap -o located.mcap

      sensorgraph locate raw.mcap --arena lab.geojson -o located.mcap --csv poses.csv

      sensorgraph locate monday.clf.bz2 --arena lab.sensorgraph --json monday.json --picture monday.png
    """
    from logs import write
    from logs.files import atomic_file
    from sensorgraph.cli.inputs import (
        check_output,
        noted,
        print_log_notes,
        read_options,
        read_run,
        write_json,
    )
    from sensorgraph.cli.progress import progress
    from sensorgraph.loading import open_place
    from sensorgraph.localization.locate import LocatedRun, poses_csv, summary, summary_lines, walls_of_place
    from sensorgraph.localization.locate import locate as locate_run
    from sensorgraph.show.figures.localization import localization_picture

    for path, suffix in ((out, ".mcap"), (csv, None), (json, None), (picture, ".png")):
        if path is not None:
            check_output(path, run, suffix=suffix)
    place = None if arena is None else open_place(arena)
    log = read_run(run, read_options(topic, no_return, robot, heights), robot)
    found = locate_run(log, place, name=arena or "the map", progress=noted(progress, log))
    print_log_notes(log)
    for line in summary_lines(found):
        typer.echo(line)
    if csv is not None:
        with atomic_file(csv) as part:
            part.write_text(poses_csv(found), encoding="utf-8")
    if json is not None:
        write_json(json, summary(found))
    if picture is not None:
        localization_picture(
            log, found, picture, walls=None if place is None else walls_of_place(place).walls
        )
    if out is not None:
        with progress("writing", "messages") as tick:
            write(LocatedRun.of(log, found).run, out, progress=tick)
        if "ok" not in found.status:
            typer.echo(
                f"{out} holds no pose, since no scan has the status ok; --csv lists the poses of all scans"
            )
    written = [str(path) for path in (csv, json, picture, out) if path is not None]
    typer.echo(
        f"wrote {', '.join(written)}"
        if written
        else "no file written; give -o OUT.mcap, --csv, --json or --picture"
    )
