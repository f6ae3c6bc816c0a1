"""Read the ledger of a kept report."""

from __future__ import annotations

import json
from pathlib import Path

from sensorgraph.diagnosis.engine.ledger import Ledger
from sensorgraph.errors import SensorgraphError


def kept_ledger(path: Path) -> Ledger:
    """Return the ledger of a report: its folder, or its report.json.

    Raises
    ------
    SensorgraphError
        There is no report, it is damaged, or it was written by a version without a ledger.
    """
    file = path / "report.json" if path.is_dir() else path
    if not file.is_file():
        raise SensorgraphError(f"{file} does not exist; give the folder of a diagnosis, or its report.json")
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as exc:
        raise SensorgraphError(
            f"{file} is not JSON ({exc}); expected the report.json of a diagnosis"
        ) from exc
    if not isinstance(report, dict) or "effects" not in report:
        raise SensorgraphError(f"{file} is not a report; expected the report.json of a diagnosis")
    if "ledger" not in report:
        raise SensorgraphError(f"{file} has no ledger, as of an older version; diagnose the run again")
    try:
        return Ledger.from_list(report["ledger"])
    except (KeyError, TypeError, AttributeError, IndexError) as exc:
        raise SensorgraphError(f"the ledger of {file} is damaged ({exc}); diagnose the run again") from exc
