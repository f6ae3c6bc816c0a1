"""`sensorgraph review`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sensorgraph.cli.options import (
    Bearing,
    Force,
    NoReturn,
    PosesFrom,
    RunFile,
    RunRobot,
    Slice,
    TopicsByExample,
)

ReviewOut = Annotated[Path, typer.Option("-o", "--out", help="Rerun file to write, *.rrd.")]
ReviewGraph = Annotated[Path | None, typer.Option(help="Sensorgraph to compare with the run.")]
ReviewPlan = Annotated[Path | None, typer.Option(help="Folder of a plan whose path is drawn.")]
ReviewArena = Annotated[
    str | None, typer.Option(help="Arena whose walls are drawn; default: the arena kept in the run.")
]
ReviewRay = Annotated[
    int | None,
    typer.Option(metavar="INDEX", help="Ray whose time series is shown; default: straight ahead."),
]
ReviewShow = Annotated[bool, typer.Option("--show", help="Open the review in rerun's viewer.")]
ReviewServe = Annotated[
    bool, typer.Option("--serve", help="Serve the review to a browser on this machine until Ctrl-C.")
]


def review(
    run: RunFile,
    out: ReviewOut,
    graph: ReviewGraph = None,
    plan: ReviewPlan = None,
    arena: ReviewArena = None,
    ray: ReviewRay = None,
    bearing: Bearing = None,
    topic: TopicsByExample = None,
    show: ReviewShow = False,
    serve: ReviewServe = False,
    no_return: NoReturn = None,
    force: Force = False,
    robot: RunRobot = None,
    poses: PosesFrom = None,
    heights: Slice = None,
) -> None:
    """Show a run, and the errors of a sensorgraph on it by place, heading and ray, as a rerun file.

    Examples:

      sensorgraph review run.mcap --graph office.sensorgraph -o review.rrd --show

      sensorgraph review run.mcap --graph office.sensorgraph -o review.rrd --serve

      sensorgraph review intel.log.gz --graph intel.sensorgraph -o intel.rrd && rerun intel.rrd
    """
    from sensorgraph.cli.inputs import (
        check_output,
        noted,
        print_log_notes,
        read_options,
        read_run,
        with_poses,
        with_poses_of_graph,
    )
    from sensorgraph.cli.messages import print_warnings
    from sensorgraph.cli.progress import progress
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.loading import arena_in, load_arena
    from sensorgraph.show.rays import chosen_ray
    from sensorgraph.show.rerun_file import open_viewer
    from sensorgraph.show.review.review import review as write_review

    check_output(out, run, graph, suffix=".rrd")
    reading = read_options(topic, no_return, robot, heights)
    log = read_run(run, reading, robot, name=run.name)
    walls = load_arena(arena) if arena is not None else arena_in(log)
    model = None if graph is None else Sensorgraph.load(graph)
    if model is not None:
        log = with_poses_of_graph(log, run, poses, model, str(graph), reading)
    else:
        log = with_poses(log, run, poses, walls, name=arena or "the arena kept in the run", options=reading)
    written = write_review(
        log,
        path=out,
        graph=model,
        plan=plan,
        arena=walls,
        ray=chosen_ray(log.sensor, ray, bearing),
        name=run.name,
        force=force,
        progress=noted(progress, log),
    )
    print_log_notes(log)
    print_warnings([] if written.evaluation is None else written.evaluation.warnings)
    typer.echo(f"{written.pairing}; {len(written.shown):,} scans shown")
    typer.echo(f"wrote {out}; open it with: rerun {out}")
    if show:
        open_viewer(out)
    if serve:
        _serve(out)


def _serve(review: Path) -> None:
    """Serve a review to a browser until Ctrl-C."""
    from contextlib import suppress
    from threading import Event

    from sensorgraph.show.rerun_file import served

    with suppress(KeyboardInterrupt), served(review) as address:
        typer.echo(f"serving {address}\nstop with Ctrl-C")
        Event().wait()
