"""`sensorgraph diagnose`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from sensorgraph.effects import Amendment


def diagnose(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN...",
            help="A run; a second one of the same place is used for nothing but the proof.",
        ),
    ],
    arena: Annotated[
        str | None,
        typer.Option(help="GeoJSON, map_server yaml, or a shipped one; default: the one kept in the run."),
    ] = None,
    robot: Annotated[Path | None, typer.Option(help="robot.yaml; default: the one kept in the run.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the report.")] = Path(
        "diagnosis"
    ),
    effects: Annotated[
        Path | None, typer.Option(help="effects.yaml: effects that are part of the model already.")
    ] = None,
    commissioning: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN",
            help="A run of the same robot and place that is known to be good; what differs from it is found.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the replicates: same seed, same report.")] = 0,
    topic: Annotated[
        list[str] | None, typer.Option(metavar="ROLE=NAME", help="Topic of a role: scan, pose, odom, cmd.")
    ] = None,
) -> None:
    """Find where simulation and measurement disagree, name the missing effect, and show the gap shrink.

    Examples:

      sensorgraph diagnose run.mcap --arena lab.geojson --robot robot.yaml -o diagnosis

      sensorgraph diagnose run.mcap second.mcap -o diagnosis && rerun diagnosis/review.rrd

      sensorgraph diagnose run.mcap --effects diagnosis/effects.yaml -o what_is_left

      sensorgraph diagnose today.log.gz --commissioning good.log.gz --arena lab.geojson --robot robot.yaml
    """
    from logs import parse_topics, read
    from sensorgraph.cli.inputs import check_folder, kept_arena, kept_robot, named_arena, robot_for
    from sensorgraph.cli.progress import progress
    from sensorgraph.diagnose.diagnose import diagnose as work
    from sensorgraph.diagnose.report import save
    from sensorgraph.diagnose.words import said
    from sensorgraph.effects import effects_file
    from sensorgraph.errors import GapError

    if len(runs) > 2:
        raise GapError(
            f"{len(runs)} runs given, expected one, or two of which the second is only for the proof"
        )
    if len(runs) == 2 and all(p.exists() for p in runs) and runs[0].samefile(runs[1]):
        raise GapError(f"{runs[1]} is given twice; the second run is for the proof and must be another")
    check_folder(out)
    loaded = []
    for path in runs:
        with progress("reading", "messages") as tick:
            loaded.append(read(path, topics=parse_topics(topic or []), progress=tick))
    run = loaded[0]
    walls = named_arena(arena) if arena is not None else kept_arena(run)
    if walls is None:
        raise GapError(f"{runs[0]} keeps no arena; give one with --arena")
    machine = kept_robot(run) if robot is None else None
    machine = robot_for(run, robot) if machine is None else machine
    known: Sequence[Amendment] = ()
    if effects is not None:
        known = effects_file.read(effects)
        effects_file.check_places(known, walls)
    baseline = None
    if commissioning is not None:
        from sensorgraph.diagnose.commissioning import commission

        with progress("reading", "messages") as tick:
            good = read(commissioning, topics=parse_topics(topic or []), progress=tick)
        with progress("commissioning"):
            baseline = commission(good, walls, machine, seed=seed)
    with progress("diagnosing", "parts") as tick:
        finding = work(
            run,
            walls,
            machine,
            second=loaded[1] if len(loaded) > 1 else None,
            known=known,
            commissioned=baseline,
            seed=seed,
            progress=tick,
        )
    settings = {
        "seed": seed,
        "runs": [path.name for path in runs],
        "arena": arena or "kept in the run",
        "robot": machine.robot.name,
        "tolerances": vars(machine.tolerances),
        "known_effects": [a.name for a in known],
        "commissioning": None
        if baseline is None or commissioning is None
        else baseline.said(commissioning.name),
    }
    with progress("reporting", "files") as tick:
        save(finding, out, name=runs[0].name, settings=settings, progress=tick)
    if finding.next_run is not None:
        finding.next_run.save(out / "next_run", walls, machine)
    what = said(finding)
    typer.echo(what.headline)
    for line in what.details:
        typer.echo(line)
    typer.echo(f"wrote {out / 'report.html'}, and beside it report.json, effects.yaml, review.rrd")
    if finding.next_run is not None:
        plan = out / "next_run"
        typer.echo(
            f"next run: sensorgraph record {plan} --arena {plan / 'arena.geojson'} --robot {plan / 'robot.yaml'} -o next.mcap"
        )
