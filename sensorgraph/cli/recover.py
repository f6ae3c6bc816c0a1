"""`sensorgraph recover`: save what is whole in a broken file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def recover(
    file: Annotated[
        Path, typer.Argument(help="A cut or damaged MCAP file; also the .part of a killed recorder.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Where to write what was saved.")],
) -> None:
    """Write every complete message of a broken file, and say what was lost.

    Examples:

        sensorgraph recover run.mcap.part -o run.mcap
    """
    from logs.recovery import recover as save
    from sensorgraph.cli.progress import progress

    with progress("recovering") as tick:
        saved = save(file, out, progress=tick)
    typer.echo("\n".join([*saved.lines(), f"wrote {out}"]))
