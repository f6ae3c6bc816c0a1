"""`sensorgraph record`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from logs.run import Run
    from planners.arena import Arena
    from planners.trajectory import Trajectory
    from sensorgraph.types import Floats


def record(
    plan: Annotated[
        Path,
        typer.Argument(help="A plan's folder, its trajectory.csv, or a run whose /cmd_vel is driven again."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The run to write, *.mcap.")],
    arena: Annotated[
        str | None, typer.Option(help="GeoJSON, map_server yaml, or a shipped one: square, office.")
    ] = None,
    graph: Annotated[
        Path | None,
        typer.Option(metavar="GRAPH", help="Drive in the world that a sensorgraph has identified."),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            help="plan, wall_following, random_bounce, a MODEL.json of `identify`, or TURN.json,SPEED.json; "
            "several are compared."
        ),
    ] = None,
    robot: Annotated[Path | None, typer.Option(help="robot.yaml; default: the shipped robot.")] = None,
    start: Annotated[
        str | None, typer.Option(help="X,Y,PHI in m, m, rad: where a replay of commands begins.")
    ] = None,
    effects: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="effects.yaml: what robot, sensor and room have beyond the map."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all noise: same seed, same bytes.")] = 0,
) -> None:
    """Drive the embedded robot along a plan, with its lag, drift and noise, and log it as MCAP.

    Examples:

      sensorgraph record runs/plan --arena office -o runs/office.mcap

      sensorgraph record old_run.mcap --arena lab.geojson --robot robot.yaml -o again.mcap

      sensorgraph record runs/plan --arena office --effects runs/found/effects.yaml -o amended.mcap

      sensorgraph record runs/plan --graph lab.sensorgraph --controller plan --controller wall_following -o race.mcap

      sensorgraph record runs/plan --arena square --controller wall_following --controller turn.json -o copy.mcap
    """
    from sensorgraph.cli.inputs import check_output
    from sensorgraph.cli.progress import progress
    from sensorgraph.effects.effects_file import read as read_effects
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.loading import load_arena
    from sensorgraph.recording.record import Commands
    from sensorgraph.recording.record import record as record_run
    from sensorgraph.world.robot import load_robot
    from sensorgraph.world.wall_distance import WallDistance

    check_output(out, plan, *([effects] if effects is not None else []))
    if out.suffix != ".mcap":
        raise SensorgraphError(f"{out}: a run is written as *.mcap; name it {out.with_suffix('.mcap').name}")
    if graph is not None:
        if effects is not None or start is not None:
            raise SensorgraphError("--graph holds what was perceived; --effects and --start go with --arena")
        _record_closed_loop(plan, graph, out, controller or ["plan"], arena, robot, seed)
        return
    if controller:
        if effects is not None or start is not None or arena is None:
            raise SensorgraphError(
                "--controller goes with --arena or --graph alone, and starts where the plan starts"
            )
        _record_closed_loop(plan, None, out, controller, arena, robot, seed)
        return
    if arena is None:
        raise SensorgraphError("nowhere to drive; give --arena NAME or --graph GRAPH")
    walls, machine = load_arena(arena), load_robot(robot)
    amendments = () if effects is None else read_effects(effects, walls)
    trajectory, commands = _read(plan)
    if trajectory is not None and start is not None:
        raise SensorgraphError(
            "--start is where a replay of commands begins; a plan begins where it was planned"
        )
    _warn_of_other_arena(plan, walls)
    way: Trajectory | Commands
    if trajectory is not None:
        way, begin = trajectory, trajectory.poses[0]
    else:
        assert commands is not None
        begin = _start(start, commands)
        way = Commands(stamps=commands.cmd_stamps, twists=commands.commands, start=begin)
    _check_start(begin, WallDistance(walls), machine.footprint_radius, arena)
    facts = plan / "plan.json" if plan.is_dir() else plan.with_name("plan.json")
    attachments = {"plan.json": _timeless(facts)} if trajectory is not None and facts.is_file() else {}
    run = record_run(
        out, walls, machine, way,
        effects=amendments, seed=seed, attachments=attachments, progress=progress,
    )  # fmt: skip
    contacts = int(run.meta["contacts"])
    touched = f", touched a wall {contacts} times" if contacts else ""
    said = f", with {run.meta['effects']}" if amendments else ""
    typer.echo(f"{run.n_scans:,} scans of {run.sensor.n_rays} rays in {run.stamps[-1]:,.0f} s{touched}{said}")
    typer.echo(f"wrote {out}")


def _record_closed_loop(
    plan: Path,
    path: Path | None,
    out: Path,
    controllers: list[str],
    arena: str | None,
    robot: Path | None,
    seed: int,
) -> None:
    """Drive in an arena or an identified world, once for each controller, and say how the drives compare."""
    from sensorgraph.cli.inputs import check_output
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.identification.behaviour import behaviour, table
    from sensorgraph.loading import load_arena
    from sensorgraph.recording.controllers import CONTROLLERS, controller_label
    from sensorgraph.recording.identified_world import PLAN, ArenaWorld, IdentifiedWorld, record_in
    from sensorgraph.show.figures.drives import tracks_picture
    from sensorgraph.world.identified_arena import arena_of
    from sensorgraph.world.robot import load_robot
    from sensorgraph.world.wall_distance import WallDistance

    known = (PLAN, *CONTROLLERS)
    for name in controllers:
        if (name not in known and not name.endswith(".json")) or controllers.count(name) > 1:
            raise SensorgraphError(
                f"controller is {name!r}, expected each of {', '.join(known)}, or a MODEL.json, at most once"
            )
    trajectory, _ = _read(plan)
    if trajectory is None:
        raise SensorgraphError(f"{plan} is a run; a controller needs a plan: its start and its time count")
    graph, machine = None if path is None else Sensorgraph.load(path), load_robot(robot)
    if arena is not None:
        walls = load_arena(arena)
    else:
        assert graph is not None
        walls = arena_of(graph)
    _check_start(trajectory.poses[0], WallDistance(walls), machine.footprint_radius, arena or str(path))
    labels = {name: controller_label(name) for name in controllers}
    if len(set(labels.values())) < len(labels):
        raise SensorgraphError(f"controllers {', '.join(controllers)} share a name; rename one of the files")
    outs = {
        name: out if i == 0 else out.with_suffix(f".{labels[name]}.mcap")
        for i, name in enumerate(controllers)
    }
    for file in outs.values():
        check_output(file, plan, *([] if path is None else [path]))
    runs = {}
    for name, file in outs.items():
        world = ArenaWorld(walls, machine, seed) if graph is None else IdentifiedWorld(graph, machine, seed)
        run = record_in(
            file, world, walls, machine, trajectory, name, name="" if path is None else path.name,
            progress=progress,
        )  # fmt: skip
        runs[labels[name]] = run
        contacts = int(run.meta["contacts"])
        touched = f", touched a wall {contacts} times" if contacts else ""
        unsure = (
            ""
            if not isinstance(world, IdentifiedWorld)
            else (
                f"; the graph has no answer for {world.unanswered:,} of "
                f"{world.n_rays:,} rays ({world.unanswered / max(world.n_rays, 1):.2%}), drawn all the same"
            )
        )
        typer.echo(f"{labels[name]}: {run.n_scans:,} scans{touched}{unsure}")
    typer.echo("\n" + "\n".join(table({name: behaviour(run, walls) for name, run in runs.items()})) + "\n")
    picture = out.with_suffix(".png")
    tracks_picture({name: run.poses[:, :2] for name, run in runs.items()}, walls, picture)
    typer.echo(f"wrote {', '.join(map(str, [*outs.values(), picture]))}")


def _read(plan: Path) -> tuple[Trajectory | None, Run | None]:
    """Read a trajectory, or a run to replay."""
    import logs
    from planners.trajectory import read_csv
    from sensorgraph.errors import SensorgraphError

    inside = plan / "trajectory.csv"
    if plan.is_dir() and inside.is_file():
        return read_csv(inside), None
    if plan.suffix.lower() == ".csv":
        return read_csv(plan), None
    if not plan.exists():
        raise SensorgraphError(
            f"{plan} does not exist; give a plan's folder (`sensorgraph plan` makes one) or a run"
        )
    run = logs.read(plan)
    if len(run.cmd_stamps) < 2:
        raise SensorgraphError(
            f"{plan} has {len(run.cmd_stamps)} commands; give a plan, or a run with /cmd_vel"
        )
    return None, run


def _start(text: str | None, run: Run) -> Floats:
    """Return where a replay begins: as told, or the run's first pose."""
    import numpy as np

    from sensorgraph.cli.inputs import parse_pose
    from sensorgraph.errors import SensorgraphError

    if text is not None:
        return parse_pose(text)
    if not len(run.poses):
        raise SensorgraphError("the run has no pose to begin from; give --start X,Y,PHI")
    return np.asarray(run.poses[0])


def _timeless(path: Path) -> bytes:
    """Return plan.json without the time that planning took: the same seed shall give the same bytes."""
    import json

    from sensorgraph.errors import SensorgraphError

    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as exc:
        raise SensorgraphError(f"{path}: not JSON ({exc}); plan again, or take the file away") from exc
    if isinstance(facts, dict):
        facts.pop("planning_s", None)
    return (json.dumps(facts, indent=1) + "\n").encode()


def _warn_of_other_arena(plan: Path, walls: Arena) -> None:
    """Say so when a plan's folder holds another arena than the one it is driven in."""
    from planners.maps import load

    kept = plan / "arena.geojson"
    if plan.is_dir() and kept.is_file():
        planned = load(kept).walls
        if planned.shape != walls.walls.shape or abs(planned - walls.walls).max(initial=0.0) > 1e-6:
            typer.echo(f"warning: {plan} was planned for another arena than this one", err=True)


def _check_start(pose: Floats, clearance: object, radius: float, arena: str) -> None:
    from sensorgraph.errors import SensorgraphError

    assert callable(clearance)
    free = float(clearance(float(pose[0]), float(pose[1])))
    if free < radius:
        where = f"({pose[0]:.2f}, {pose[1]:.2f})"
        raise SensorgraphError(
            f"the start {where} is {free:.2f} m from a wall of {arena}, less than the footprint_radius of {radius} m; "
            "is this the arena of the plan?"
        )
