"""The entrants: each answers a case by its files, and writes one report.

An entrant is a function of the folder of a case that returns its report; to enter, add a module and a line here.
"""

from __future__ import annotations

import importlib
import json
import time
import traceback
from pathlib import Path
from typing import Any

ENTRANTS = {
    "sensorgraph": "benchmarks.hidden_effects.entrants.product",
    "least_squares": "benchmarks.hidden_effects.entrants.least_squares",
    "largest_residual": "benchmarks.hidden_effects.entrants.largest_residual",
}
"""Name -> a module with answer(folder of the case) -> report."""


def answer_case(entrant: str, folder: Path, name: str) -> str:
    """Let an entrant answer one case in this process; keep its report and its time, and return one line about it."""
    result = folder / "answers" / entrant / name
    result.mkdir(parents=True, exist_ok=True)
    (result / "report.json").unlink(missing_ok=True)
    notes: dict[str, Any] = {}
    begin = time.process_time()
    try:
        report = importlib.import_module(ENTRANTS[entrant]).answer(folder / "cases" / name)
        (result / "report.json").write_text(json.dumps(report, indent=1))
        names = [one["name"] for one in report.get("effects") or []] + ["unknown"] * bool(
            report.get("unknown")
        )
        said = ", ".join(names) or "silent"
    except Exception as exc:  # an entrant that fails has no report
        said, notes["failed"] = f"no report: {exc}", traceback.format_exc()
    notes["cpu_s"] = time.process_time() - begin
    (result / "run.json").write_text(json.dumps(notes, indent=1))
    return f"{name} {said}, {notes['cpu_s']:.1f} s"
