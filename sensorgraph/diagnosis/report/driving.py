"""Calibration from driving alone, as plain data and as a section of the page."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding
from sensorgraph.diagnosis.motion.calibration.estimate import NUISANCES, PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.motion.calibration.verdict import source_of
from sensorgraph.diagnosis.report.page_shell import picture, without_breaks

UNITS = dict(
    zip(
        (*PARAMETERS, *NUISANCES), ("1", "1", "rad/m", "m", "m", "rad", "s", "m/m", "m/m"), strict=True
    )
)  # fmt: skip


def calibrations(finding: DrivingFinding) -> list[dict[str, Any]]:
    """Return the parameters of each run, and their change within it, as plain data."""
    return [
        {**_calibration(name, found), "change": _change(finding, name)}
        for name, found in finding.runs.items()
    ]


def _calibration(name: str, found: DrivingCalibration) -> dict[str, Any]:
    return {
        "run": name,
        "way_m": found.way_m,
        "turn_rad": found.turn_rad,
        "duration_s": found.duration_s,
        "stated_mount": found.mount.tolist(),
        "parameters": {
            key: {
                "value": found.of(key)[0],
                "stderr": found.of(key)[1],
                "unit": unit,
                "observable": key not in found.hidden,
                "why": found.hidden.get(key),
            }
            for key, unit in UNITS.items()
        },
    }


def _change(finding: DrivingFinding, name: str) -> dict[str, Any] | None:
    change = finding.changes[name]
    if change is None:
        return None
    one = change.difference
    return {"name": one.name, "difference": one.value, "stderr": one.stderr, "at_s": change.at_s}


def driving_section(finding: DrivingFinding, drawn: Path | None, *, heading: str) -> str:
    """Return the calibration of each run as HTML, with the picture of its parts."""
    caption = (
        "Line and band: the whole run with two standard errors. Dots: eighths of the run with one standard error, for "
        "independent windows."
    )
    parts = [f"<h2>{escape(heading)}</h2>"] if heading else []
    for name, found in finding.runs.items():
        said = "".join(f"<li>{without_breaks(line)}</li>" for line in finding.lines_of(name))
        parts.append(f"<p>{escape(name)}, {without_breaks(source_of(found))}:</p><ul>{said}</ul>")
    return "\n".join([*parts, picture(drawn, "parameters along the runs", caption)])
