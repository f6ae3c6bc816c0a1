"""`sensorgraph export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from logs.run import Run
    from planners.arena import Arena
    from sensorgraph.world.robot import Robot


ExportSource = Annotated[
    str,
    typer.Argument(
        metavar="GRAPH|ARENA",
        help="Sensorgraph (model faces), GeoJSON file, map_server yaml, log with a map, or a shipped arena: square, office.",
    ),
]
ExportTarget = Annotated[
    str, typer.Option("--to", metavar="TARGET", help="Target: mujoco, irsim, gazebo or nav2.")
]
ExportOut = Annotated[Path, typer.Option("-o", "--out", help="Folder for the exported files.")]
ExportEffects = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="effects.yaml: effects to build in, as far as the target supports them."
    ),
]
ExportRobot = Annotated[
    Path | None,
    typer.Option(
        "--robot",
        help="robot.yaml; default: the robot kept in --run or in the log with the map, else the shipped one with the laser of the "
        "sensorgraph.",
    ),
]
ExportRun = Annotated[
    Path | None, typer.Option(help="nav2: run from which the AMCL parameters are estimated.")
]
ExportNoGo = Annotated[
    list[str] | None,
    typer.Option(
        help="nav2: keepout zone, as GeoJSON of kind no_go or as corners x,y,x,y,x,y (m); repeatable."
    ),
]
WallHeight = Annotated[
    float | None, typer.Option(help="Height of the walls (m); default: 0.5 m above the laser.")
]


def export(
    source: ExportSource,
    target: ExportTarget,
    out: ExportOut,
    robot: ExportRobot = None,
    effects: ExportEffects = None,
    run: ExportRun = None,
    no_go: ExportNoGo = None,
    wall_height: WallHeight = None,
) -> None:
    """Export an arena or a sensorgraph, with robot and laser, to another simulator or to Nav2.

    Examples:

      sensorgraph export square --to mujoco -o twin && python twin/drive.py runs/plan -o twin.mcap

      sensorgraph export lab.sensorgraph --robot robot.yaml --effects found/effects.yaml --to irsim -o twin

      sensorgraph export office --to gazebo -o office_gazebo

      sensorgraph export lab.sensorgraph --to nav2 --run run.mcap --no-go 1,1,2,1,2,2 -o nav2
    """
    from planners.maps.no_go import zones
    from sensorgraph.cli.inputs import check_folder, print_log_notes
    from sensorgraph.effects.effects_file import read as read_effects
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.exporting.export import check_target
    from sensorgraph.exporting.export import export as write_world
    from sensorgraph.exporting.nav2 import check_zones
    from sensorgraph.exporting.world import ExportedWorld
    from sensorgraph.loading import exported_arena, exported_robot, robot_in

    check_target(target)
    check_folder(out)
    if target != "nav2" and (run is not None or no_go):
        raise SensorgraphError(f"--run and --no-go require --to nav2; leave them out for {target}")
    if wall_height is not None and not 0 < wall_height < 100:
        raise SensorgraphError(f"--wall-height is {wall_height:g} m, expected a height between 0 and 100 m")
    arena, graph, kept = exported_arena(source)
    amendments = () if effects is None else read_effects(effects, arena)
    forbidden = [zone for given in no_go or [] for zone in zones(given)]
    check_zones(forbidden, arena.bounds)
    driven = None if run is None else _located(run, arena, source)
    machine = exported_robot(robot, driven, graph, kept=kept)
    world = ExportedWorld.of(arena, machine, amendments, name=Path(source).stem, wall_height=wall_height)
    left_out = write_world(world, target, out, no_go=forbidden, run=driven)
    typer.echo(
        f"{len(world.boxes)} walls, {len(world.discs)} round obstacles, robot {machine.name} with "
        f"{machine.sensor.n_rays} rays, {len(amendments)} effects"
    )
    if robot is None:
        laser = "" if graph is None or driven is not None else f" with the laser of {source}"
        typer.echo(_whose(machine, kept if driven is None else robot_in(driven), str(run or source), laser))
    print_log_notes(*([] if driven is None else [driven]))
    for line in left_out:
        typer.echo(f"not in the files of the world: {line}")
    typer.echo(f"wrote {out}; start with {out / 'README.md'}")


def _whose(machine: Robot, kept: Robot | None, log: str, laser: str) -> str:
    """Return one line about the robot of an export for which none was given."""
    if kept is not None:
        return f"{machine.name} is the robot kept in {log}; --robot gives another"
    return f"{machine.name} is the shipped robot{laser}; --robot gives another"


def _located(path: Path, arena: Arena, place: str) -> Run:
    """Read a run; if it has no reference poses, locate it in the arena."""
    import logs
    from sensorgraph.cli.inputs import with_poses

    return with_poses(logs.read(path), path, None, arena, name=place, options={})
