"""`sensorgraph plan`."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sensorgraph.cli.options import PosesFrom
from sensorgraph.termination import INTERRUPTED

if TYPE_CHECKING:
    from logs.run import Run
    from planners.arena import Arena
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.world.robot import Robot

MAX_VIEWS = 1000
"""A plan of more views takes longer than covering (x, y, φ)."""
PlanArena = Annotated[
    str | None,
    typer.Argument(
        help="GeoJSON file, map_server yaml, sensorgraph, square or office; "
        "default: the arena kept in the --resume run, else that of --graph."
    ),
]
PlanRobot = Annotated[
    Path | None,
    typer.Option(help="robot.yaml; default: the robot kept in the --resume run, else the shipped robot."),
]
PlanOut = Annotated[Path, typer.Option("-o", "--out", help="Folder for the plan.")]
PlanPlanner = Annotated[
    str,
    typer.Option(
        help="coverage, stop_and_spin, views (with --views), or a baseline: random_bounce, wall_following."
    ),
]
PlanOrder = Annotated[
    str | None,
    typer.Option(
        metavar="fast|anytime",
        help="fast: shortest complete drive, room by room. anytime: the whole floor coarsely, then finer until complete, "
        "so that a drive cut short shows the most. Default: anytime with --budget or --graph (drive: diff), else fast.",
    ),
]
PlanGraph = Annotated[
    Path | None,
    typer.Option(help="A sensorgraph: look first where its expected error is highest (order anytime)."),
]
PlanViews = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=MAX_VIEWS,
        help="Visit this number of poses that see the most surface, instead of covering (x, y, φ).",
    ),
]
PlanCell = Annotated[float, typer.Option(help="Side of a position cell (m).")]
PlanHeadings = Annotated[int, typer.Option(help="Number of heading bins in a full turn.")]
PlanStart = Annotated[
    str | None,
    typer.Option(
        help="Start pose X,Y,PHI (m, m, rad, or with units: 90 deg); default: chosen by the planner."
    ),
]
PlanEnd = Annotated[str | None, typer.Option(help="End pose X,Y,PHI (m, m, rad); default: at the last bin.")]
PlanBattery = Annotated[
    float | None,
    typer.Option(
        metavar="MIN", help="Split the plan into runs of this many minutes, from the dock and back."
    ),
]
PlanDock = Annotated[
    str | None, typer.Option(help="Dock pose X,Y,PHI (m, m, rad); default: the start of the plan.")
]
PlanBudget = Annotated[
    float | None,
    typer.Option(metavar="MIN", help="Limit the drive to this many minutes and report its coverage."),
]
PlanMargin = Annotated[
    float,
    typer.Option(min=0.0, help="Clearance between robot and walls (m); a larger margin reaches fewer bins."),
]
PlanJoinPlanner = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="OMPL planner for paths around obstacles: RRTConnect, BITstar, ..., or your own as module:Class.",
    ),
]
PlanNoGo = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE|x,y,x,y,...",
        help="Zone that the robot must not enter but can see through: GeoJSON polygons of kind no_go, or "
        "corners (m); repeatable.",
    ),
]
PlanDuration = Annotated[
    float | None,
    typer.Option(help="Duration of random_bounce and wall_following (s); default: the reference time."),
]
PlanResume = Annotated[
    list[Path] | None, typer.Option(help="Run already driven: plan only the bins it missed; repeatable.")
]
PlanPriority = Annotated[
    Path | None,
    typer.Option(help="A sensorgraph: drive first where it does not answer, then where it is least certain."),
]
PlanSeed = Annotated[int, typer.Option(help="Random seed; the same seed gives the same plan.")]


def plan(
    out: PlanOut,
    arena: PlanArena = None,
    robot: PlanRobot = None,
    planner: PlanPlanner = "coverage",
    order: PlanOrder = None,
    views: PlanViews = None,
    cell: PlanCell = 0.25,
    headings: PlanHeadings = 16,
    start: PlanStart = None,
    end: PlanEnd = None,
    battery: PlanBattery = None,
    dock: PlanDock = None,
    budget: PlanBudget = None,
    no_go: PlanNoGo = None,
    margin: PlanMargin = 0.02,
    join_planner: PlanJoinPlanner = "RRTConnect",
    duration: PlanDuration = None,
    resume: PlanResume = None,
    poses: PosesFrom = None,
    priority: PlanPriority = None,
    graph: PlanGraph = None,
    seed: PlanSeed = 0,
) -> None:
    """Plan a collision-free drive that visits every reachable position in every heading.

    Examples:

      sensorgraph plan square -o runs/plan

      sensorgraph plan lab.geojson --robot robot.yaml --cell 0.2 --start 1.0,0.5,0 -o runs/lab

      sensorgraph plan office --views 100 -o runs/views

      sensorgraph plan office --battery 60 --dock 1.5,1.5,0 -o runs/office

      sensorgraph plan office --budget 10 --resume 1.mcap --resume 2.mcap --graph lab.sensorgraph -o runs/third

      sensorgraph plan office --budget 30 --end 1.5,1.5,0 --no-go 4,1,5,1,5,2 -o runs/half_an_hour

    Ctrl-C saves the plan so far as a shorter, valid plan.
    """
    import logs
    from planners.maps.no_go import zones
    from sensorgraph.cli.inputs import check_folder, parse_pose, print_log_notes
    from sensorgraph.cli.progress import progress_with_status
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.planning.plan import plan as make_plan

    _silence("planners.report", "planners.ompl_planner")  # their warnings are printed below
    check_folder(out)
    runs = [logs.read(path) for path in resume or () if views is None]
    place = _place(arena, resume or [], runs, graph or priority)
    opened = cache(Sensorgraph.load)  # arena, --graph and --priority are often the same file
    driven = _located(runs, resume or [], place, poses, opened)
    counted, kept = "bins" if planner == "coverage" and views is None else "stops", _robot_in(runs)
    with progress_with_status("planning", counted) as (tick, set_status):
        made = make_plan(
            _arena_in(place, opened), robot or kept, planner=planner, cell=cell, headings=headings, views=views, duration=duration, order=order,
            start=None if start is None else parse_pose(start),
            end=None if end is None else parse_pose(end, "--end"),
            no_go=[zone for given in no_go or [] for zone in zones(given)],
            resume=driven or None,
            priority=None if priority is None else opened(priority),
            graph=None if graph is None else opened(graph),
            budget=_seconds("--budget", budget),
            battery=_seconds("--battery", battery),
            dock=None if dock is None else parse_pose(dock, "--dock"),
            margin=margin, join_planner=join_planner, seed=seed, progress=tick, status=set_status,
        )  # fmt: skip
    report = made.drive.report
    if isinstance(place, str):
        report["arena"] = Path(place).name
    made.save(out)
    print_log_notes(*runs)
    notes = *made.arena.notes, *_robot_note(report, robot, kept), _summary(report), *_runs(report)
    _print(report["warnings"], [*notes, f"wrote {out}"])
    if report.get("interrupted"):
        raise typer.Exit(INTERRUPTED)


def _robot_in(runs: list[Run]) -> Robot | None:
    """Return the robot that the first of some runs keeps."""
    from sensorgraph.loading import robot_in

    return next((robot for run in runs if (robot := robot_in(run)) is not None), None)


def _robot_note(report: dict[str, Any], given: Path | None, kept: Robot | None) -> list[str]:
    """Return one line about the robot of the plan if none was given."""
    if given is not None:
        return []
    robot, whose = report["robot"], "the shipped" if kept is None else "the run's"
    size = f"a disc of {robot['footprint_radius']:g} m"
    return [f"planned for {whose} robot {robot['name']}, {size}; --robot gives another"]


def _print(warnings: list[str], lines: list[str]) -> None:
    for line in warnings:
        typer.echo(f"warning: {line}", err=True)
    typer.echo("\n".join(lines))


def _silence(*names: str) -> None:
    for name in names:
        if not (log := logging.getLogger(name)).hasHandlers():
            log.addHandler(logging.NullHandler())


def _place(arena: str | None, resume: list[Path], runs: list[Run], graph: Path | None) -> Arena | str:
    """Return the given arena, else the one kept in a run to resume, else the path of the graph."""
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.loading import arena_in

    if arena is not None:
        return arena
    for run in runs:
        if (kept := arena_in(run)) is not None:
            return kept
    if graph is not None:
        return str(graph)
    raise SensorgraphError(
        "no arena given, expected a *.geojson, a map_server *.yaml, a *.sensorgraph, or a shipped arena: square, office"
        if not runs
        else f"{resume[0]} keeps no arena; give the arena in which it was recorded, or --graph"
    )


def _arena_in(place: Arena | str, opened: Callable[[Path], Sensorgraph]) -> Arena | str:
    """Return the arena of a graph, or any other place as it is."""
    from sensorgraph.world.identified_arena import arena_of

    if isinstance(place, str) and place.endswith(".sensorgraph") and Path(place).exists():
        return arena_of(opened(Path(place)))
    return place


def _located(
    runs: list[Run],
    paths: list[Path],
    place: Arena | str,
    poses: str | None,
    opened: Callable[[Path], Sensorgraph],
) -> list[Run | Path]:
    """Return the runs to resume from: their files, or the located runs if they have no reference poses."""
    from sensorgraph.cli.inputs import with_poses, with_poses_of_graph
    from sensorgraph.loading import load_arena
    from sensorgraph.localization.kept import KEY

    found: list[Run | Path] = list(paths)
    for k, (run, path) in enumerate(zip(runs, paths, strict=False)):
        if isinstance(place, str) and place.endswith(".sensorgraph"):
            at = with_poses_of_graph(run, path, poses, opened(Path(place)), place, {})
        elif isinstance(place, str):
            at = with_poses(run, path, poses, load_arena(place), name=place)
        else:
            at = with_poses(run, path, poses, place, name="the arena kept in the run")
        if KEY in at.meta:
            found[k] = at
    return found


def _summary(report: dict[str, Any]) -> str:
    """Return the result of a plan as one line."""
    joins = report["joins"]
    failed = f", {joins['failed']} failed" if joins["failed"] else ""
    by_wavefront = f", {joins['flooded']} by a wavefront search" if joins["flooded"] else ""
    before = f"; {100 * report['coverage_before']:.2f} % before" if report["coverage_before"] else ""
    views = f"{len(report['views']) - joins['failed']:,} views, " if "views" in report else ""
    return (
        f"{views}{report['covered_cells']:,} of {report['reachable_cells']:,} (x, y, phi) bins "
        f"({100 * report['coverage']:.2f} %{before}) in {_hours(report['drive_time_s'])}{_least(report)} and "
        f"{report['path_m']:.0f} m, {report['ratio']:.2f} of the reference time; joins: {joins['direct']:,} straight, "
        f"{joins['planned']} by OMPL{by_wavefront}{failed}; clearance {report['min_clearance_m']:.3f} m, "
        f"the margin leaves {100 * report['share_of_bare_footprint']:.1f} % of the cells reachable; "
        f"planned in {report['planning_s']:.1f} s"
    )


def _least(report: dict[str, Any]) -> str:
    """Return the least time of turns and straight moves, for a complete first plan of a robot that turns in place.

    A plan that is faster has the bound of any drive, by its number of logged poses.
    """
    bound, is_cut = report["lower_bound_s"], "budget_s" in report or report.get("interrupted", False)
    covers = report["planner"] in ("coverage", "stop_and_spin") and report["robot"]["drive"] == "diff"
    if bound <= 0 or is_cut or not covers or report["coverage_before"]:
        return ""
    if bound <= (report["covered_cells"] - 1) / report["rate"]:
        return " (turns on the spot and straight moves take longer)"
    return f" (turns on the spot and straight moves take at least {_hours(bound)})"


def _hours(seconds: float) -> str:
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min"


def _runs(report: dict[str, Any]) -> list[str]:
    """Return one line per run of a battery plan."""
    return [
        f"run_{k}: {run['drive_time_s'] / 60:.1f} min, of which {(run['out_s'] + run['home_s']) / 60:.1f} min from and "
        f"to the dock; {run['new_bins']:,} new bins, {100 * run['coverage']:.2f} % so far"
        for k, run in enumerate(report.get("sessions", []), start=1)
    ]


def _seconds(option: str, minutes: float | None) -> float | None:
    """Convert an option in minutes to seconds."""
    from planners.errors import PlanError

    if minutes is None:
        return None
    if not 0 < minutes < float("inf"):
        raise PlanError(f"{option} is {minutes:g} min, expected a positive number of minutes")
    return 60 * minutes
