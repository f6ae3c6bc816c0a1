"""`sensorgraph why`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

WhyReport = Annotated[
    Path, typer.Argument(metavar="REPORT", help="Folder of a diagnosis, or its report.json.")
]
WhyName = Annotated[
    str,
    typer.Argument(metavar="NAME", help="Effect, or family of differences that no effect explains."),
]


def why(report: WhyReport, name: WhyName) -> None:
    """Explain why an effect was or was not named in a kept report, and what the next run would have to show.

    Examples:

      sensorgraph why diagnosis glass

      sensorgraph why diagnosis/report.json scans_elsewhere
    """
    from sensorgraph.diagnosis.engine.ledger import kept_ledger
    from sensorgraph.diagnosis.engine.why import why as explain

    typer.echo(explain(kept_ledger(report), name))
