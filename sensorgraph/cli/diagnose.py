"""`sensorgraph diagnose`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sensorgraph.cli.options import Force, NoReturn, PosesFrom, Slice, Topics

if TYPE_CHECKING:
    from logs.run import Run
    from planners.arena import Arena
    from sensorgraph.diagnosis.finding import Finding
    from sensorgraph.diagnosis.site_baseline import SiteBaseline
    from sensorgraph.effects import Amendment
    from sensorgraph.world.robot import Robot


DiagnoseRuns = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...",
        help="Run to diagnose; a second run of the same place serves only to verify the result.",
    ),
]
DiagnoseArena = Annotated[
    str | None,
    typer.Option(
        help="GeoJSON file, map_server yaml, log with /map, or a shipped arena; default: the arena kept in the run."
    ),
]
DiagnoseRobot = Annotated[
    Path | None,
    typer.Option(
        help="robot.yaml; default: the robot kept in the run. The sensor's unstated values are those of the run."
    ),
]
DiagnoseOut = Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the report.")]
DiagnoseEffects = Annotated[
    Path | None, typer.Option(help="effects.yaml with effects that the simulation already includes.")
]
DiagnoseCommissioning = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="RUN",
        help="Run of the same robot and place that is known to be good; only differences from it are reported. "
        "Repeatable: several good runs show their normal spread.",
    ),
]
DiagnoseSimulation = Annotated[
    Path | None,
    typer.Option(
        metavar="RUN",
        help="Log of your own simulator (Gazebo, Isaac, MuJoCo, ir-sim, ...) in the same arena; only differences "
        "between the two logs are reported.",
    ),
]
DiagnoseSeed = Annotated[
    int, typer.Option(min=0, help="Random seed of the simulated replicates; same seed, same report.")
]
DiagnoseWhy = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Also explain why this effect, or family of differences, was or was not named."
    ),
]


def diagnose(
    runs: DiagnoseRuns,
    arena: DiagnoseArena = None,
    robot: DiagnoseRobot = None,
    out: DiagnoseOut = Path("diagnosis"),
    effects: DiagnoseEffects = None,
    commissioning: DiagnoseCommissioning = None,
    simulation: DiagnoseSimulation = None,
    seed: DiagnoseSeed = 0,
    topic: Topics = None,
    no_return: NoReturn = None,
    force: Force = False,
    poses: PosesFrom = None,
    heights: Slice = None,
    why: DiagnoseWhy = None,
) -> None:
    """Find the physical effects that explain why measurement and simulation differ, and verify them.

    Examples:

      sensorgraph diagnose run.mcap --arena lab.geojson --robot robot.yaml -o diagnosis

      sensorgraph diagnose run.mcap second.mcap -o diagnosis && rerun diagnosis/review.rrd

      sensorgraph diagnose run.mcap --arena lab.geojson --why glass

      sensorgraph diagnose run.mcap --effects diagnosis/effects.yaml -o remaining

      sensorgraph diagnose run.mcap --simulation gazebo.mcap --arena lab.geojson --robot robot.yaml

      sensorgraph diagnose today.log.gz --commissioning good.log.gz --arena lab.geojson --robot robot.yaml

      sensorgraph diagnose monday.log friday.log -o wheels
    """
    from sensorgraph.cli.inputs import noted, read_options, read_run, with_poses, with_robot
    from sensorgraph.cli.progress import progress
    from sensorgraph.diagnosis.diagnose import diagnose as diagnose_run
    from sensorgraph.diagnosis.report.files import save_diagnosis
    from sensorgraph.diagnosis.simulation import diagnose_against_simulation
    from sensorgraph.diagnosis.without_reference import driving_of, with_described_mount, with_driving

    _check(runs, simulation, commissioning, out, why)
    reading = read_options(topic, no_return, robot, heights)
    loaded = [read_run(path, reading) for path in runs]
    if arena is None and not (effects or commissioning or simulation) and _have_no_arena(loaded):
        _drive_alone(loaded, runs, robot, out, poses, reading, why)
        return
    walls, machine = _place(loaded[0], runs[0], arena, robot)
    place, kept = arena or "the arena kept in the run", str(robot or "the robot.yaml kept in the run")

    def posed(run: Run, path: Path) -> Run:
        stated = with_robot(run, str(path), machine, kept)
        located = with_poses(stated, path, poses, walls, name=place, options=reading)
        return with_described_mount(located, machine)

    loaded = [posed(run, path) for run, path in zip(loaded, runs, strict=True)]
    _print_ray_orders(runs, loaded, machine)
    known, bars = _known(effects, walls), noted(progress, *loaded)
    baseline = _commission([read_run(path, reading) for path in commissioning or ()], walls, machine, seed)
    options: dict[str, Any] = {"known": known, "seed": seed, "force": force, "progress": bars}
    if simulation is not None:
        options |= {"simulation": posed(read_run(simulation, reading), simulation), "name": str(simulation)}
    driving = driving_of(loaded[0], machine, name=runs[0].name, progress=bars)
    finding = (diagnose_run if simulation is None else diagnose_against_simulation)(
        loaded.pop(0),  # free the scans of a long log as soon as they are no longer needed
        arena=walls,
        robot=machine,
        second=loaded.pop() if loaded else None,
        baseline=baseline,
        **options,
    )
    finding = with_driving(finding, driving, machine)
    settings = {
        **_report_settings(runs, arena, machine, known, seed, poses, topic, no_return),
        "simulation": simulation and simulation.name,
        "commissioning": baseline and baseline.to_dict(", ".join(path.name for path in commissioning or ())),
    }
    with bars("reporting", "files") as tick:
        save_diagnosis(finding, out, walls, machine, name=runs[0].name, settings=settings, progress=tick)
    _print_finding(finding, known, out, why)


def _print_ray_orders(paths: Sequence[Path], loaded: Sequence[Run], machine: Robot) -> None:
    """Print each run whose ray order differs from the robot's."""
    from sensorgraph.cli.inputs import print_ray_order

    for path, run in zip(paths, loaded, strict=True):
        print_ray_order(str(path), run.sensor.bearings, machine.name, machine.sensor.bearings)


def _report_settings(
    runs: Sequence[Path],
    arena: str | None,
    machine: Robot,
    known: Sequence[Amendment],
    seed: int,
    poses: str | None,
    topic: Topics,
    no_return: str | None,
) -> dict[str, Any]:
    """Return the settings for the report: the inputs, the known effects, and how the log was read."""
    return {
        "seed": seed,
        "runs": [path.name for path in runs],
        "arena": arena or "kept in the run",
        "poses": poses,
        "topics": list(topic or []),
        "no_return": no_return,
        "robot": machine.name,
        "robot_yaml": machine.text,
        "tolerances": vars(machine.tolerances),
        "known_effects": [a.name for a in known],
    }


def _have_no_arena(runs: Sequence[Run]) -> bool:
    """Return whether no run keeps an arena, so that only wheels and mount can be estimated."""
    from sensorgraph.loading import arena_in

    return all(arena_in(run) is None for run in runs)


def _drive_alone(
    loaded: Sequence[Run],
    paths: Sequence[Path],
    robot: Path | None,
    out: Path,
    poses: str | None,
    reading: Mapping[str, Any],
    why: str | None,
) -> None:
    """Estimate wheels and mount from runs without an arena."""
    from sensorgraph.cli.inputs import noted, print_log_notes, with_poses, with_robot
    from sensorgraph.cli.messages import print_warnings
    from sensorgraph.cli.progress import progress
    from sensorgraph.diagnosis.motion.calibration.driving import check_odometry, diagnose_driving
    from sensorgraph.diagnosis.report.files import save_driving
    from sensorgraph.intake import log_notes
    from sensorgraph.localization.locate import corrections_of
    from sensorgraph.world.robot import load_robot

    machine = None if robot is None else load_robot(robot)
    loaded = [
        with_robot(run, str(path), machine, str(robot)) for run, path in zip(loaded, paths, strict=True)
    ]
    for run, path in zip(loaded, paths, strict=True):
        check_odometry(run, name=path.name)
    names = [path.name if len({p.name for p in paths}) == len(paths) else str(path) for path in paths]
    runs = {
        name: (run, with_poses(run, path, poses, options=reading))
        for name, run, path in zip(names, loaded, paths, strict=True)
    }
    base = None if machine is None else machine.stated_base
    finding = diagnose_driving(runs, base=base, progress=noted(progress, *loaded))
    corrected = [note for _, located in runs.values() for note in corrections_of(located)]
    save_driving(
        finding, out, {"runs": names, "robot": robot and robot.name}, [*log_notes(*loaded), *corrected]
    )
    print_log_notes(*loaded)
    print_warnings(corrected)
    for line in finding.lines:
        typer.echo(line)
    typer.echo(
        "no arena: only wheels and mount are estimated, from scans and odometry alone; give --arena to test other effects"
    )
    if base is None:
        typer.echo(
            "effects.yaml lacks the heading bias: unequal wheel radii need a known wheelbase; give --robot with wheels.base"
        )
    typer.echo(f"wrote {out / 'report.html'}, report.json, effects.yaml, calibration.png")
    if why is not None:
        typer.echo(f"\n{finding.why(why)}")


def _check(
    runs: Sequence[Path],
    simulation: Path | None,
    commissioning: Sequence[Path] | None,
    out: Path,
    why: str | None,
) -> None:
    """Refuse contradictory arguments before any file is read."""
    from sensorgraph.cli.inputs import check_folder
    from sensorgraph.diagnosis.ledger import check_name

    if why is not None:
        check_name(why)
    _check_runs(runs, commissioning or ())
    _check_simulation(simulation, runs, commissioning)
    check_folder(out)


def _check_runs(runs: Sequence[Path], commissioning: Sequence[Path]) -> None:
    """Refuse more than two runs, a second run that is the first, and a run that is its own commissioning run."""
    from sensorgraph.errors import SensorgraphError

    if len(runs) > 2:
        raise SensorgraphError(
            f"{len(runs)} runs given, expected one, or two of which the second only verifies the result"
        )
    if len(runs) == 2 and _is_among(runs[:1], runs[1]):
        raise SensorgraphError(
            f"{runs[1]} is given twice; the second run verifies the result and must be a different run"
        )
    for good in commissioning:
        if _is_among(runs, good):
            raise SensorgraphError(
                f"{good} is given as its own commissioning run, in which nothing has changed; give another run"
            )


def _is_among(runs: Sequence[Path], path: Path) -> bool:
    """Return whether a file is one of the runs, by whatever name."""
    return path.exists() and any(run.exists() and run.samefile(path) for run in runs)


def _check_simulation(
    simulation: Path | None, runs: Sequence[Path], commissioning: Sequence[Path] | None
) -> None:
    """Refuse a simulation together with a commissioning run, and a run given as its own simulation."""
    from sensorgraph.errors import SensorgraphError

    if simulation is None:
        return
    if commissioning:
        raise SensorgraphError(
            "--simulation and --commissioning are both given; a run can be compared with only one of them"
        )
    if _is_among(runs, simulation):
        raise SensorgraphError(f"{simulation} is given as its own simulation; give a log of your simulator")


def _place(run: Run, name: Path, arena: str | None, robot: Path | None) -> tuple[Arena, Robot]:
    """Return the arena and the robot that were given, else those kept in the run."""
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.loading import arena_in, load_arena, robot_for

    walls = load_arena(arena) if arena is not None else arena_in(run)
    if walls is None:
        raise SensorgraphError(f"{name} keeps no arena; give one with --arena")
    return walls, robot_for(run, robot)


def _known(path: Path | None, walls: Arena) -> Sequence[Amendment]:
    """Read the effects that the simulation already includes."""
    from sensorgraph.effects import effects_file

    if path is None:
        return ()
    known = effects_file.read(path)
    effects_file.check_places(known, walls, name=str(path))
    return known


def _commission(good: list[Run], walls: Arena, machine: Robot, seed: int) -> SiteBaseline | None:
    """Estimate the baseline of the site from runs that are known to be good, if there are any."""
    from sensorgraph.cli.progress import progress
    from sensorgraph.diagnosis.commissioning import commission_all

    if not good:
        return None
    if len(good) == 1:
        typer.echo(
            "warning: one commissioning run cannot show the spread between good runs; give several", err=True
        )
    with progress("commissioning", "%") as tick:
        return commission_all(good, walls, machine, seed=seed, progress=tick)


def _print_finding(finding: Finding, known: Sequence[Amendment], out: Path, why: str | None) -> None:
    """Print the notes on the log, the result, and why a hypothesis was or was not named."""
    from sensorgraph.cli.messages import print_warnings

    print_warnings(finding.intake["log_notes"])
    typer.echo("\n".join(_lines(finding, known, out)))
    if why is not None:
        typer.echo(f"\n{finding.why(why)}")


def _lines(finding: Finding, known: Sequence[Amendment], out: Path) -> list[str]:
    """Return the lines for the console."""
    from sensorgraph.diagnosis.report.considered import unobservable_line
    from sensorgraph.diagnosis.report.quantities import brief
    from sensorgraph.diagnosis.report.summary import intake_sentences, summarise

    summary = summarise(finding)
    review = "" if finding.explained is None else ", review.rrd"
    lines = [summary.headline, *summary.details, *intake_sentences(finding)]
    if known:
        lines.append(f"effects included as given: {'; '.join(brief(a) for a in known)}")
    if finding.driving is not None:  # the summary has the verdict, unless the arena does not fit
        lines += finding.driving.lines[0 if finding.explained is None else 1 :]
    lines.append(f"wrote {out / 'report.html'}, report.json, effects.yaml{review}")
    if finding.next_run is not None:
        plan = out / "next_run"
        kept = f"--arena {plan / 'arena.geojson'} --robot {plan / 'robot.yaml'}"
        lines.append(f"next run: sensorgraph record {plan} {kept} -o next.mcap")
    hidden = unobservable_line(finding)
    return [*lines, hidden] if hidden else lines
