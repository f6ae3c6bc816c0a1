"""`sensorgraph inspect`: what is in a file."""

from __future__ import annotations

import typer

from sensorgraph.cli.messages import with_flags
from sensorgraph.cli.options import InspectArena, InspectFile, InspectJson, InspectTopic, NoReturn


def inspect(
    file: InspectFile,
    topic: InspectTopic = None,
    arena: InspectArena = None,
    json: InspectJson = None,
    no_return: NoReturn = None,
) -> None:
    """Say what is in a file: topics, rates, frames, what is usable, what is missing, what looks wrong.

    Examples:

        sensorgraph inspect run.mcap

        sensorgraph inspect run.mcap --arena lab.geojson

        sensorgraph inspect others.bag --topic scan=/front/scan --topic pose=/ground_truth
    """
    from logs import parse_topics
    from logs.inspection import inspect as look
    from sensorgraph.cli.inputs import check_output, write_json
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.loading import arena_in, load_arena
    from sensorgraph.world.orientation import orientation

    if json is not None:
        check_output(json, file)
    with progress("reading") as tick:
        found = look(file, parse_topics(topic or []), no_return=no_return, progress=tick)
    lines = found.lines()
    oriented = None
    if found.run is not None:
        walls = load_arena(arena) if arena is not None else None
        if walls is None:
            try:
                walls = arena_in(found.run)
            except SensorgraphError as exc:
                lines += [f"WARNING: {exc}"]
        oriented = orientation(found.run, walls)
        lines += ["orientation", *(f"  {line}" for line in oriented.lines())] if oriented is not None else []
    if json is not None:
        facts = {**found.to_dict(), "orientation": None}
        if oriented is not None:
            facts["orientation"] = {"best": oriented.best, "against": oriented.against, "fits": oriented.fits}
        write_json(json, facts)
    typer.echo(with_flags("\n".join(lines)))
