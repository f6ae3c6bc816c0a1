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
    from logs import parse_topics, read
    from sensorgraph.cli.inputs import check_output
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.loading import arena_in, load_arena
    from sensorgraph.show.rerun_file import open_viewer
    from sensorgraph.show.review.review import review as write_review

    check_output(out, run, *(path for path in (graph,) if path is not None))
    if out.suffix != ".rrd":
        raise SensorgraphError(f"{out}: a review is written as *.rrd; name it {out.with_suffix('.rrd').name}")
    with progress("reading", "messages") as tick:
        log = read(run, topics=parse_topics(topic or []), progress=tick)
    walls = load_arena(arena) if arena is not None else arena_in(log)
    written = write_review(log, path=out, graph=graph, plan=plan, arena=walls, ray=ray, name=run.name)
    typer.echo(f"{written.pairing}; {len(written.shown):,} scans shown")
    typer.echo(f"wrote {out}; open it with: rerun {out}")
    if show:
        open_viewer(out)
