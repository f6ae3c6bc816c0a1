"""`sensorgraph record`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sensorgraph.cli.options import Topics
from sensorgraph.cli.record_live import (
    RecordDomain,
    RecordDuration,
    RecordLive,
    RecordRouter,
    RecordShare,
    RecordUntilCovered,
    RecordWait,
    check_options,
    record_live,
)

if TYPE_CHECKING:
    from logs.run import Run
    from planners.arena import Arena
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.recording.closed_loop import ClosedLoopDrive
    from sensorgraph.recording.drive_source import DriveSource
    from sensorgraph.world.robot import Robot


RecordPlan = Annotated[
    Path | None,
    typer.Argument(help="Folder of a plan, its trajectory.csv, or a run whose /cmd_vel is replayed."),
]
RecordOut = Annotated[Path, typer.Option("-o", "--out", help="Run to write, *.mcap.")]
RecordArena = Annotated[
    str | None,
    typer.Option(
        help="GeoJSON file, map_server yaml, or a shipped arena: square, office; default: the arena of the plan."
    ),
]
RecordRobot = Annotated[
    Path | None, typer.Option(help="robot.yaml; default: the robot of the plan, else the shipped robot.")
]
RecordGraph = Annotated[
    Path | None,
    typer.Option(metavar="GRAPH", help="Drive in the identified world of this sensorgraph."),
]
RecordController = Annotated[
    list[str] | None,
    typer.Option(
        help="plan, wall_following, random_bounce, a MODEL.json of `identify`, or TURN.json,SPEED.json; "
        "repeatable, to compare controllers."
    ),
]
RecordStart = Annotated[
    str | None,
    typer.Option(
        help="Start pose X,Y,PHI (m, m, rad, or with units: 90 deg) of a controller or of a replay of commands; "
        "default: that of the plan or of the run."
    ),
]
RecordEffects = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="effects.yaml: effects of robot, sensor and environment to simulate."),
]
RecordSeed = Annotated[int, typer.Option(min=0, help="Random seed of all noise; same seed, same bytes.")]


def record(
    out: RecordOut,
    plan: RecordPlan = None,
    arena: RecordArena = None,
    graph: RecordGraph = None,
    controller: RecordController = None,
    robot: RecordRobot = None,
    start: RecordStart = None,
    effects: RecordEffects = None,
    seed: RecordSeed = 0,
    live: RecordLive = False,
    router: RecordRouter = None,
    domain: RecordDomain = None,
    topic: Topics = None,
    duration: RecordDuration = None,
    wait: RecordWait = None,
    until_covered: RecordUntilCovered = None,
    share: RecordShare = 0.99,
) -> None:
    """Drive a simulated robot along a plan and log it as MCAP, or record your own robot live.

    Examples:

      sensorgraph record runs/plan -o runs/office.mcap

      sensorgraph record old_run.mcap --arena lab.geojson --robot robot.yaml -o again.mcap

      sensorgraph record runs/plan --effects runs/found/effects.yaml -o amended.mcap

      sensorgraph record runs/plan --graph lab.sensorgraph --controller plan --controller wall_following -o race.mcap

      sensorgraph record runs/plan --arena square --controller wall_following --controller turn.json -o copy.mcap

      sensorgraph record --live --router 192.168.0.5 --until-covered runs/plan -o run.mcap
    """
    from sensorgraph.cli.inputs import check_output
    from sensorgraph.errors import SensorgraphError

    check_options(
        live=live,
        of_live={
            "--router": router, "--domain": domain, "--topic": topic, "--duration": duration,
            "--wait": wait, "--until-covered": until_covered,
        },
        of_plan={"PLAN": plan, "--graph": graph, "--controller": controller, "--start": start, "--effects": effects},
    )  # fmt: skip
    if live:
        record_live(
            out, router=router, domain=domain, topics=topic, duration=duration, wait=wait, until_covered=until_covered,
            share=share, arena=arena, robot=robot,
        )  # fmt: skip
        return
    if plan is None:
        raise SensorgraphError("nothing to drive: give a PLAN, or --live to record your own robot")
    check_output(out, plan, effects, suffix=".mcap")
    if graph is None and not controller:
        _record_drive(plan, out, arena, robot, start, effects, seed)
        return
    if effects is not None:
        raise SensorgraphError(
            f"--effects cannot be used with {'--graph' if graph is not None else '--controller'}; "
            "use it with a plan in an arena"
        )
    _record_closed_loop(plan, graph, out, controller or ["plan"], arena, robot, start, seed)


def _record_drive(
    plan: Path,
    out: Path,
    arena: str | None,
    robot: Path | None,
    start: str | None,
    effects: Path | None,
    seed: int,
) -> None:
    """Drive once along a plan or by the commands of a run."""
    from sensorgraph.cli.inputs import parse_pose
    from sensorgraph.cli.progress import progress
    from sensorgraph.effects.effects_file import read as read_effects
    from sensorgraph.recording.drive_source import check_start, open_drive
    from sensorgraph.recording.record import record as record_run

    drive = open_drive(plan, start=None if start is None else parse_pose(start))
    walls, machine = _place(drive, arena, robot)
    amendments = () if effects is None else read_effects(effects, walls)
    check_start(drive.start, walls, machine, arena_name=arena or "the plan's arena")
    run = record_run(
        out, walls, machine, drive.way,
        effects=amendments, seed=seed, attachments=drive.attachments(), progress=progress,
    )  # fmt: skip
    effect_names = f", with {run.meta['effects']}" if amendments else ""
    typer.echo(
        f"{run.n_scans:,} scans of {run.sensor.n_rays} rays in {run.stamps[-1]:,.0f} s{_touched(run)}{effect_names}"
    )
    typer.echo(f"wrote {out}")


def _record_closed_loop(
    plan: Path,
    graph_file: Path | None,
    out: Path,
    controllers: list[str],
    arena: str | None,
    robot: Path | None,
    start: str | None,
    seed: int,
) -> None:
    """Drive in an arena or an identified world, once for each controller, and print a comparison."""
    from planners.trajectory import Trajectory
    from sensorgraph.cli.inputs import check_output, parse_pose
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.identification.behaviour import behaviour, table
    from sensorgraph.recording.closed_loop import drive_closed_loop, files_of_controllers
    from sensorgraph.recording.drive_source import check_start, open_drive
    from sensorgraph.show.figures.drives import tracks_picture
    from sensorgraph.world.identified_arena import arena_of

    files = files_of_controllers(controllers, out)
    source = open_drive(plan)
    trajectory = source.way
    if not isinstance(trajectory, Trajectory):
        raise SensorgraphError(
            f"{plan} is a run; a controller needs a plan, which sets the start pose and the duration"
        )
    graph = None if graph_file is None else Sensorgraph.load(graph_file)
    identified = None if graph is None or arena is not None else arena_of(graph)
    walls, machine = _place(source, arena, robot, identified=identified, graph=graph)
    name = arena or ("the plan's arena" if graph_file is None else str(graph_file))
    begin = None if start is None else parse_pose(start)
    check_start(trajectory.poses[0] if begin is None else begin, walls, machine, arena_name=name)
    for file in files.values():
        check_output(file, plan, graph_file)
    runs = {}
    graph_name = "" if graph_file is None else graph_file.name
    for drive in drive_closed_loop(
        files, trajectory, walls, machine,
        start=begin, graph=graph, graph_name=graph_name, seed=seed, progress=progress,
    ):  # fmt: skip
        runs[drive.label] = drive.run
        typer.echo(f"{drive.label}: {drive.run.n_scans:,} scans{_touched(drive.run)}{_unanswered(drive)}")
    typer.echo("\n" + "\n".join(table({name: behaviour(run, walls) for name, run in runs.items()})) + "\n")
    picture = out.with_suffix(".png")
    tracks_picture({name: run.poses[:, :2] for name, run in runs.items()}, walls, picture)
    typer.echo(f"wrote {', '.join(map(str, [*files.values(), picture]))}")


def _touched(run: Run) -> str:
    """Return the number of wall contacts as text; empty without contacts."""
    contacts = int(run.meta["contacts"])
    return f", touched a wall {contacts:,} time{'s' if contacts > 1 else ''}" if contacts else ""


def _unanswered(drive: ClosedLoopDrive) -> str:
    """Return the number of rays that the graph does not answer as text; empty without a graph."""
    if drive.n_rays is None or drive.n_unanswered is None:
        return ""
    return (
        f"; the graph does not answer {drive.n_unanswered:,} of "
        f"{drive.n_rays:,} rays ({100 * drive.n_unanswered / max(drive.n_rays, 1):.2f} %); their readings are drawn from it anyway"
    )


def _place(
    drive: DriveSource,
    arena: str | None,
    robot: Path | None,
    *,
    identified: Arena | None = None,
    graph: Sensorgraph | None = None,
) -> tuple[Arena, Robot]:
    """Return the arena and the robot that were given, else those of the plan, and warn of a mismatch.

    Parameters
    ----------
    identified : Arena of a graph, used if no arena is given.
    graph : Graph from which readings are drawn; the robot of the plan gets its laser.
    """
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.loading import load_arena, robot_in_graph
    from sensorgraph.world.robot import load_robot

    named = None if arena is None else load_arena(arena)
    machine = None if robot is None else load_robot(robot)
    for line in drive.mismatch(arena=named, robot=machine):
        typer.echo(f"warning: {line}", err=True)
    walls = named or identified or drive.arena()
    if walls is None:
        raise SensorgraphError(
            f"no arena to drive in: {drive.path} keeps no arena; give --arena NAME or --graph GRAPH"
        )
    kept = drive.robot() if machine is None else None
    taken = ["arena"] if named is None and identified is None else []
    taken += ["robot"] if kept is not None else []
    if taken:
        typer.echo(f"{' and '.join(taken)} of {drive.path}" + (f" ({kept.name})" if kept is not None else ""))
    driven = machine or kept or load_robot()
    if graph is not None and machine is None:
        base, driven = driven, robot_in_graph(graph, kept=driven)
        if driven is not base:
            typer.echo(
                f"laser of the graph ({driven.sensor.n_rays} rays); that of {base.name} has {base.sensor.n_rays}"
            )
    return walls, driven
