"""`sensorgraph diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def diagnose(
    runs: Annotated[
        list[Path],
        typer.Argument(help="A run; a second one of the same place is used for nothing but the proof."),
    ],
    arena: Annotated[
        str | None,
        typer.Option(help="GeoJSON, map_server yaml, or a shipped one; default: the one kept in the run."),
    ] = None,
    robot: Annotated[Path | None, typer.Option(help="robot.yaml; default: the one kept in the run.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the report.")] = Path("diagnosis"),
    seed: Annotated[int, typer.Option(min=0, help="Of the replicates: same seed, same report.")] = 0,
) -> None:
    """Find where simulation and measurement disagree, name the missing effect, and show the gap shrink.

    Examples:

      sensorgraph diagnose run.mcap --arena lab.geojson --robot robot.yaml -o diagnosis
    """
    import logs
    from sensorgraph.cli.inputs import kept_arena, named_arena, named_robot, write_json
    from sensorgraph.diagnose.diagnose import diagnose as work
    from sensorgraph.diagnose.report import to_dict
    from sensorgraph.errors import GapError

    run = logs.read(runs[0])
    walls = named_arena(arena) if arena is not None else kept_arena(run)
    if walls is None:
        raise GapError(f"{runs[0]} keeps no arena; give one with --arena")
    machine = named_robot(robot)
    second = logs.read(runs[1]) if len(runs) > 1 else None
    finding = work(run, walls, machine, second=second, seed=seed)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "report.json", to_dict(finding))
    for a in finding.effects:
        typer.echo(f"{a.name} {dict(a.parameters)}")
