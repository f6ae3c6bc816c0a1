"""`sensorgraph inspect`: what is in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def inspect(
    file: Annotated[Path, typer.Argument(help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV table.")],
    topic: Annotated[
        list[str] | None,
        typer.Option(help="ROLE=NAME for other names than ours; roles scan, pose, odom, cmd. Repeatable."),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the findings there, too.")] = None,
) -> None:
    """Say what is in a file: topics, rates, frames, what is usable, what is missing, what looks wrong.

    Examples:

        sensorgraph inspect run.mcap

        sensorgraph inspect others.bag --topic scan=/front/scan --topic pose=/ground_truth
    """
    from logs import parse_topics
    from logs.inspect import inspect as look
    from sensorgraph.cli.progress import progress

    with progress("reading") as tick:
        found = look(file, parse_topics(topic or []), progress=tick)
    lines = found.lines()
    typer.echo("\n".join(lines))
    if json is not None:
        from json import dumps

        part = json.with_name(json.name + ".part")
        part.write_text(dumps(found.to_json(), indent=2) + "\n")
        part.replace(json)
