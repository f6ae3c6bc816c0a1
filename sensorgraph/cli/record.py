"""`sensorgraph record`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from logs.run import Run
    from planners.arena import Arena, Floats
    from planners.trajectory import Trajectory


def record(
    plan: Annotated[
        Path,
        typer.Argument(help="A plan's folder, its trajectory.csv, or a run whose /cmd_vel is driven again."),
    ],
    arena: Annotated[str, typer.Option(help="GeoJSON, map_server yaml, or a shipped one: square, office.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The run to write, *.mcap.")],
    robot: Annotated[Path | None, typer.Option(help="robot.yaml; default: the shipped robot.")] = None,
    start: Annotated[
        str | None, typer.Option(help="X,Y,PHI in m, m, rad: where a replay of commands begins.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all noise: same seed, same bytes.")] = 0,
) -> None:
    """Drive the embedded robot along a plan, with its lag, drift and noise, and log it as MCAP.

    Examples:

      sensorgraph record runs/plan --arena office -o runs/office.mcap

      sensorgraph record old_run.mcap --arena lab.geojson --robot robot.yaml -o again.mcap
    """
    import numpy as np

    import logs
    from planners.maps import geojson
    from sensorgraph.cli.inputs import check_output, named_arena, named_robot
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import GapError
    from sensorgraph.world.clearance import WallDistance
    from sensorgraph.world.drive import follow, replay
    from sensorgraph.world.simulate import occupancy, simulate

    check_output(out, plan)
    if out.suffix != ".mcap":
        raise GapError(f"{out}: a run is written as *.mcap; name it {out.with_suffix('.mcap').name}")
    walls, machine = named_arena(arena), named_robot(robot)
    trajectory, commands = _read(plan)
    if trajectory is not None and start is not None:
        raise GapError("--start is where a replay of commands begins; a plan begins where it was planned")
    _warn_of_other_arena(plan, walls)
    rng = np.random.default_rng(seed)
    clearance = WallDistance(walls)
    with progress("driving", "commands") as tick:
        if trajectory is not None:
            _check_start(trajectory.poses[0], clearance, machine.robot.footprint_radius, arena)
            driven = follow(trajectory, machine, clearance=clearance, rng=rng, progress=tick)
        else:
            assert commands is not None
            begin = _start(start, commands)
            _check_start(begin, clearance, machine.robot.footprint_radius, arena)
            driven = replay(
                commands.cmd_stamps, commands.commands, begin, machine, clearance=clearance, progress=tick
            )
    attachments = {"arena.geojson": geojson.dumps(walls).encode(), "robot.yaml": machine.text.encode()}
    facts = plan / "plan.json" if plan.is_dir() else plan.with_name("plan.json")
    if trajectory is not None and facts.is_file():
        attachments["plan.json"] = _timeless(facts)
    meta = {"simulated": "true", "seed": str(seed), "contacts": str(driven.contacts)}
    with progress("scanning", "scans") as tick:
        run = simulate(driven, walls, machine, rng=rng, meta=meta, attachments=attachments, progress=tick)
    with progress("writing", "messages") as tick:
        logs.write(run, out, occupancy=occupancy(walls), progress=tick)
    touched = f", touched a wall {driven.contacts} times" if driven.contacts else ""
    typer.echo(f"{run.n_scans:,} scans of {run.sensor.n_rays} rays in {run.stamps[-1]:,.0f} s{touched}")
    typer.echo(f"wrote {out}")


def _read(plan: Path) -> tuple[Trajectory | None, Run | None]:
    """Read a trajectory, or a run to replay."""
    import logs
    from planners.trajectory import read_csv
    from sensorgraph.errors import GapError

    inside = plan / "trajectory.csv"
    if plan.is_dir() and inside.is_file():
        return read_csv(inside), None
    if plan.suffix.lower() == ".csv":
        return read_csv(plan), None
    if not plan.exists():
        raise GapError(f"{plan} does not exist; give a plan's folder (`sensorgraph plan` makes one) or a run")
    run = logs.read(plan)
    if len(run.cmd_stamps) < 2:
        raise GapError(f"{plan} has {len(run.cmd_stamps)} commands; give a plan, or a run with /cmd_vel")
    return None, run


def _start(text: str | None, run: Run) -> Floats:
    """Return where a replay begins: as told, or the run's first pose."""
    import numpy as np

    from sensorgraph.cli.inputs import parse_pose
    from sensorgraph.errors import GapError

    if text is not None:
        return parse_pose(text)
    if not len(run.poses):
        raise GapError("the run has no pose to begin from; give --start X,Y,PHI")
    return np.asarray(run.poses[0])


def _timeless(path: Path) -> bytes:
    """Return plan.json without the time that planning took: the same seed shall give the same bytes."""
    import json

    from sensorgraph.errors import GapError

    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as exc:
        raise GapError(f"{path}: not JSON ({exc}); plan again, or take the file away") from exc
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
    from sensorgraph.errors import GapError

    assert callable(clearance)
    free = float(clearance(float(pose[0]), float(pose[1])))
    if free < radius:
        where = f"({pose[0]:.2f}, {pose[1]:.2f})"
        raise GapError(
            f"the start {where} is {free:.2f} m from a wall of {arena}, less than the footprint_radius of {radius} m; "
            "is this the arena of the plan?"
        )
