"""`sensorgraph inspect`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sensorgraph.cli.messages import with_flags
from sensorgraph.cli.options import NoReturn, RunRobot, Slice, Topics

if TYPE_CHECKING:
    from logs.inspection import Inspection
    from logs.run import Run
    from sensorgraph.world.orientation import Orientation


InspectFile = Annotated[
    Path, typer.Argument(help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log, CSV table, or a map.")
]
InspectArena = Annotated[
    str | None,
    typer.Option(
        help="Map to check the orientation of the scan against; default: the arena kept in the run."
    ),
]
InspectJson = Annotated[Path | None, typer.Option(help="Also write the findings to this JSON file.")]
InspectPolicy = Annotated[
    Path | None,
    typer.Option(
        "--policy",
        help="Limits of `watch --init-policy` for topics, rates, gaps and stamps; they decide the exit code: 0 ok, "
        "1 warning, 2 error.",
    ),
]


def inspect(
    file: InspectFile,
    topic: Topics = None,
    arena: InspectArena = None,
    json: InspectJson = None,
    policy: InspectPolicy = None,
    no_return: NoReturn = None,
    robot: RunRobot = None,
    heights: Slice = None,
) -> None:
    """Show the topics, rates and frames of a log, missing signals and suspicious values; or describe a map.

    The last table shows what the log can be used for and why: locate, build,
    and the diagnosis of laser, wheels and motors. It also shows the ground
    covered, and the minute of driving that would help most.

    Examples:

        sensorgraph inspect run.mcap

        sensorgraph inspect run.mcap --arena lab.geojson

        sensorgraph inspect map.yaml

        sensorgraph inspect others.bag --topic scan=/front/scan --topic pose=/ground_truth

        sensorgraph inspect run.mcap --policy site.yaml

        sensorgraph inspect others.bag --topic scan=/scan@rear_laser --topic odom=/tf --json found.json
    """
    from logs.inspection import inspect as look
    from sensorgraph.cli.inputs import check_output, read_options, write_json
    from sensorgraph.cli.progress import reading_bar
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.loading import arena_in, load_arena, robot_in
    from sensorgraph.watching.policy import load_topics
    from sensorgraph.world.described import differences, with_robot
    from sensorgraph.world.orientation import orientation
    from sensorgraph.world.robot import load_robot

    if json is not None:
        check_output(json, file)
    expected = None if policy is None else load_topics(policy)
    if _is_map(file):
        facts = _map_facts(file)
        if json is not None:
            write_json(json, facts)
        typer.echo("\n".join([f"{file}: a map, {facts['map']}", *(f"  {note}" for note in facts["notes"])]))
        return
    with reading_bar() as tick:
        found = look(file, **read_options(topic, no_return, robot, heights), progress=tick)
    lines: list[str] = []
    oriented = None
    if found.run is not None:
        walls = load_arena(arena) if arena is not None else None
        lines += [f"arena {arena}", *(f"  {note}" for note in walls.notes)] if walls and walls.notes else []
        if walls is None:
            try:
                walls = arena_in(found.run)
            except SensorgraphError as exc:
                lines += [f"WARNING: {exc}"]
        machine, stated = robot_in(found.run) if robot is None else load_robot(robot), found.run
        if machine is not None:
            rays, times = differences(
                stated, machine, robot_name=str(robot or "the robot.yaml kept in the run")
            )
            lines += [f"WARNING: {line}" for line in (rays, times) if line]
            stated = stated if rays else with_robot(stated, machine)
            if "sensor.sweep_time" in machine.stated:  # which some warnings advise to state
                kept = tuple(line for line in found.warnings if "sensor.sweep_time" not in line)
                found = replace(found, warnings=kept)
        oriented = orientation(stated, walls)
        lines += _orientation_lines(stated, oriented)
    if json is not None:
        names = () if oriented is None else ("best", "against", "fits")
        turned = {name: getattr(oriented, name) for name in names} or None
        write_json(json, {**found.to_dict(), "orientation": turned})
    typer.echo(with_flags("\n".join(found.lines(lines))))
    _judge(found, expected)


def _orientation_lines(run: Run, oriented: Orientation | None) -> list[str]:
    """Return the fits of the orientations, and what else makes the scans contradict each other."""
    from sensorgraph.world.self_fit import self_fit

    if oriented is None:
        return []
    better = self_fit(run) if oriented.best == "as logged" else None
    warning = [] if better is None else [f"WARNING: {better.line()}"]
    return ["orientation", *(f"  {line}" for line in (*oriented.lines(), *warning))]


def _is_map(file: Path) -> bool:
    """Return whether a file is a map by its name; not the metadata.yaml of a bag."""
    from logs.formats import BAG_METADATA
    from planners.maps import MAPS

    return file.suffix.lower() in MAPS and file.is_file() and file.name != BAG_METADATA


def _judge(found: Inspection, expected: dict[str, Any] | None) -> None:
    """Print how a log differs from a policy, if there is one; exit with 1 for a warning and 2 for an error."""
    from logs.expectations import deviations

    if expected is None:
        return

    each = deviations(found, expected)
    typer.echo("policy")
    for one in each:
        typer.echo(f"  {one.level}: {one.text}")
    if not each:
        typer.echo(f"  ok: {len(expected)} topics as expected")
        return
    raise typer.Exit(2 if any(one.level == "error" for one in each) else 1)


def _map_facts(file: Path) -> dict[str, Any]:
    """Return the size of a map, and the notes on how its cells were interpreted."""
    from sensorgraph.loading import load_arena

    arena = load_arena(file)
    x0, y0, x1, y1 = arena.bounds
    return {
        "path": str(file),
        "map": f"{x1 - x0:g} x {y1 - y0:g} m, {arena.n_walls:,} walls, {arena.free.area:.1f} m² free",
        "bounds": [x0, y0, x1, y1],
        "n_walls": arena.n_walls,
        "free_m2": arena.free.area,
        "notes": list(arena.notes),
    }
