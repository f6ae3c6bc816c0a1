"""`sensorgraph amend`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from logs.run import Run
    from planners.arena import Arena


AmendFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE...",
        help="URDF, xacro with its includes, SDF, MJCF, nav2_params.yaml or robot.yaml.",
    ),
]
AmendEffects = Annotated[Path, typer.Option(metavar="FILE", help="effects.yaml, as `diagnose` writes it.")]
AmendRun = Annotated[
    Path | None,
    typer.Option(
        help="Run whose rate, angles and ranges of the laser are written; for Nav2, also AMCL's parameters."
    ),
]
AmendArena = Annotated[
    str | None,
    typer.Option(help="Map of the run, for AMCL's parameters; default: the arena kept in the run."),
]
AmendLaser = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Sensor, link, body or site of the laser, if there are several."),
]
AmendOut = Annotated[
    Path | None,
    typer.Option("-o", "--out", help="File, or folder for several files; default: replace the given files."),
]
AmendDryRun = Annotated[bool, typer.Option("--dry-run", help="Print the changes, and write nothing.")]


def amend(
    files: AmendFiles,
    effects: AmendEffects,
    run: AmendRun = None,
    arena: AmendArena = None,
    laser: AmendLaser = None,
    out: AmendOut = None,
    dry_run: AmendDryRun = False,
) -> None:
    """Write found effects into your own URDF, xacro, SDF, MJCF, nav2_params.yaml or robot.yaml.

    Only the changed numbers and a comment at each of them differ; the changes are printed as a unified diff. Without
    --out, the given files are replaced.

    Examples:

      sensorgraph amend model.sdf --effects diagnosis/effects.yaml --dry-run

      sensorgraph amend robot.urdf.xacro laser.urdf.xacro --effects diagnosis/effects.yaml -o amended

      sensorgraph amend nav2_params.yaml --effects diagnosis/effects.yaml --run run.mcap --arena map.yaml
    """
    from sensorgraph.amending.amend import amend as amend_files
    from sensorgraph.errors import SensorgraphError

    if out is not None and dry_run:
        raise SensorgraphError("--out and --dry-run are both given; give only one of them")
    if out is not None:
        _check_out(out, files, [effects, run])
    log, walls = (None, None) if run is None else _log(run, arena)
    found = amend_files(files, effects, run=log, arena=walls, laser=laser)
    typer.echo(found.diff)
    for line in found.left_out:
        typer.echo(f"left out: {line}")
    if dry_run:
        typer.echo("nothing written (--dry-run)")
        return
    for path in found.write(out):
        typer.echo(f"wrote {path}")


def _check_out(out: Path, files: list[Path], others: list[Path | None]) -> None:
    """Refuse an output that cannot be written, or that is one of the inputs."""
    from sensorgraph.cli.inputs import check_folder, check_output

    if out.is_dir() or len(files) > 1:
        check_folder(out)
        for file in files:
            if out.is_dir():
                check_output(out / file.name, *others, *files)
        return
    check_output(out, *others, *files)


def _log(run: Path, arena: str | None) -> tuple[Run, Arena | None]:
    """Read a run and its arena; a run without reference poses is located in it."""
    import logs
    from sensorgraph.cli.inputs import with_poses
    from sensorgraph.loading import arena_in, load_arena

    log = logs.read(run)
    walls = arena_in(log) if arena is None else load_arena(arena)
    if walls is None:
        return log, None
    return with_poses(log, run, None, walls, name=arena or "its arena", options={}), walls
