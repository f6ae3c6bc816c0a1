"""`sensorgraph recover`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

RecoverFile = Annotated[
    Path,
    typer.Argument(
        help="Truncated or damaged MCAP file or ROS 1 bag, also the .part or .active file of a killed recorder."
    ),
]
RecoverOut = Annotated[Path, typer.Option("-o", "--out", help="MCAP file for the recovered messages.")]


def recover(
    file: RecoverFile,
    out: RecoverOut,
) -> None:
    """Recover every complete message of a truncated or damaged MCAP file or ROS 1 bag, and report the losses.

    Examples:

        sensorgraph recover run.mcap.part -o run.mcap

        sensorgraph recover drive.bag.active -o drive.mcap
    """
    from logs.recovery import recover as save
    from sensorgraph.cli.progress import progress

    with progress("recovering") as tick:
        saved = save(file, out, progress=tick)
    typer.echo("\n".join([*saved.lines(), f"wrote {out}"]))
