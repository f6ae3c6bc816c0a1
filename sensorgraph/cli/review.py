"""`sensorgraph review`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def review(
    run: Annotated[Path, typer.Argument(help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The review to write, *.rrd.")],
    graph: Annotated[Path | None, typer.Option(help="A sensorgraph to hold against the run.")] = None,
    plan: Annotated[Path | None, typer.Option(help="The plan's folder: its path is drawn too.")] = None,
    arena: Annotated[
        str | None, typer.Option(help="Walls to draw; default: the arena kept in the run.")
    ] = None,
    ray: Annotated[
        int | None, typer.Option(help="The ray whose series is shown; default: straight ahead.")
    ] = None,
    topic: Annotated[list[str] | None, typer.Option(help="ROLE=NAME, for example scan=/front/scan.")] = None,
    show: Annotated[bool, typer.Option("--show", help="Open it in rerun's viewer when done.")] = False,
) -> None:
    """Show a run, and a sensorgraph against it: coverage, error by place, heading and ray.

    Examples:

      sensorgraph review run.mcap --graph office.sensorgraph -o review.rrd --show

      sensorgraph review intel.log.gz --graph intel.sensorgraph -o intel.rrd && rerun intel.rrd
    """
    import json

    from logs import parse_topics, read
    from planners.trajectory import read_csv
    from sensorgraph.cli.inputs import check_output, kept_arena, named_arena
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.show import rerun_view as view
    from sensorgraph.show.review import review as collect

    check_output(out, run, *(path for path in (graph,) if path is not None))
    if out.suffix != ".rrd":
        raise SensorgraphError(f"{out}: a review is written as *.rrd; name it {out.with_suffix('.rrd').name}")
    with progress("reading", "messages") as tick:
        log = read(run, topics=parse_topics(topic or []), progress=tick)
    walls = named_arena(arena) if arena is not None else kept_arena(log)
    planned = read_csv(plan / "trajectory.csv").poses[::10, :2] if plan is not None else None
    facts = json.loads((plan / "plan.json").read_text()) if plan is not None else None
    loaded = Sensorgraph.load(graph) if graph is not None else None
    seen = collect(log, graph=loaded, arena=walls, name=run.name, planned=planned, plan=facts)
    view.write(seen, out, ray=ray)
    typer.echo(f"{seen.pairing}; {len(seen.shown):,} scans shown")
    typer.echo(f"wrote {out}; open it with: rerun {out}")
    if show:
        view.show(out)
