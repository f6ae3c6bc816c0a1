"""`sensorgraph review`."""

from __future__ import annotations

import typer

from sensorgraph.cli.options import (
    Bearing,
    Force,
    NoReturn,
    ReviewArena,
    ReviewGraph,
    ReviewOut,
    ReviewPlan,
    ReviewRay,
    ReviewRun,
    ReviewShow,
    RunRobot,
    TopicsByExample,
)


def review(
    run: ReviewRun,
    out: ReviewOut,
    graph: ReviewGraph = None,
    plan: ReviewPlan = None,
    arena: ReviewArena = None,
    ray: ReviewRay = None,
    bearing: Bearing = None,
    topic: TopicsByExample = None,
    show: ReviewShow = False,
    no_return: NoReturn = None,
    force: Force = False,
    robot: RunRobot = None,
) -> None:
    """Show a run, and a sensorgraph against it: coverage, error by place, heading and ray.

    Examples:

      sensorgraph review run.mcap --graph office.sensorgraph -o review.rrd --show

      sensorgraph review intel.log.gz --graph intel.sensorgraph -o intel.rrd && rerun intel.rrd
    """
    from logs import parse_topics, read
    from sensorgraph.cli.inputs import check_output, mounts_of, with_robot
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.loading import arena_in, load_arena
    from sensorgraph.show.rays import chosen_ray
    from sensorgraph.show.rerun_file import open_viewer
    from sensorgraph.show.review.review import review as write_review

    check_output(out, run, *(path for path in (graph,) if path is not None))
    if out.suffix != ".rrd":
        raise SensorgraphError(f"{out}: a review is written as *.rrd; name it {out.with_suffix('.rrd').name}")
    with progress("reading", "messages") as tick:
        names = parse_topics(topic or [])
        log = read(run, topics=names, no_return=no_return, mounts=mounts_of(robot), progress=tick)
    log = with_robot(log, run.name, robot)
    walls = load_arena(arena) if arena is not None else arena_in(log)
    written = write_review(
        log,
        path=out,
        graph=graph,
        plan=plan,
        arena=walls,
        ray=chosen_ray(log.sensor, ray, bearing),
        name=run.name,
        force=force,
    )
    typer.echo(f"{written.pairing}; {len(written.shown):,} scans shown")
    typer.echo(f"wrote {out}; open it with: rerun {out}")
    if show:
        open_viewer(out)
