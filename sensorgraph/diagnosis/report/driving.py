"""The report of runs without arena and reference: report.json, report.html, effects.yaml and a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from logs.files import atomic_file
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding
from sensorgraph.diagnosis.motion.calibration.estimate import NUISANCES, PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.motion.calibration.verdict import source_of
from sensorgraph.diagnosis.motion.calibration.words import ABSORBED
from sensorgraph.diagnosis.report.data import effect_dict, plain
from sensorgraph.diagnosis.report.figures.calibration import calibration_picture
from sensorgraph.diagnosis.report.files import remove_old_report
from sensorgraph.diagnosis.report.page_shell import page_shell, picture, without_breaks
from sensorgraph.effects import effects_file
from sensorgraph.files import atomic_folder
from sensorgraph.version import __version__

UNITS = dict(
    zip(
        (*PARAMETERS, *NUISANCES), ("1", "1", "rad/m", "m", "m", "rad", "s", "m/m", "m/m"), strict=True
    )
)  # fmt: skip


def save_driving(finding: DrivingFinding, folder: Path, settings: Mapping[str, Any]) -> None:
    """Write the report into a folder; all of it or nothing."""
    with atomic_folder(folder) as part:
        kept = {"version": __version__, **settings}
        report = plain({**driving_dict(finding), "settings": kept})
        with atomic_file(part / "report.json") as file:
            file.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        effects_file.write(finding.effects, part / "effects.yaml")
        calibration_picture(finding.runs, part / "calibration.png")
        with atomic_file(part / "report.html") as file:
            file.write_text(_page(finding, part / "calibration.png"), encoding="utf-8")
        remove_old_report(folder)


def driving_dict(finding: DrivingFinding) -> dict[str, Any]:
    """Return the report as plain data; what needs an arena or a reference is empty."""
    return {
        "effects": [effect_dict(a) for a in finding.effects],
        "unknown": None,
        "where": None,
        "runner_up": None,
        "gap": None,
        "within_tolerance": [],
        "not_observable": dict(ABSORBED),
        "next_run": None,
        "intake": {"reference": "none: located from scans and wheels", "runs": list(finding.runs)},
        "calibration": [
            {**_calibration(name, found), "change": _change(finding, name)}
            for name, found in finding.runs.items()
        ],
        "comparison": [
            {
                "name": d.name,
                "difference": d.value,
                "stderr": d.stderr,
                "unit": UNITS[d.name],
                "differs": d.differs,
                "material": d.is_material,
            }
            for d in finding.differences
        ],
        "summary": finding.lines,
    }


def _calibration(name: str, found: DrivingCalibration) -> dict[str, Any]:
    return {
        "run": name,
        "way_m": found.way_m,
        "turn_rad": found.turn_rad,
        "duration_s": found.duration_s,
        "stated_mount": found.mount.tolist(),
        "parameters": {
            key: {"value": found.of(key)[0], "stderr": found.of(key)[1], "unit": unit}
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
    """Return what the runs tell, with the picture of their parts."""
    caption = (
        "Line and band: the whole run with two standard errors. Dots: its eighths, with one, as if their windows were "
        "independent."
    )
    parts = [f"<h2>{escape(heading)}</h2>"] if heading else []
    for name, found in finding.runs.items():
        said = "".join(f"<li>{without_breaks(line)}</li>" for line in finding.lines_of(name))
        parts.append(f"<p>{escape(name)}, {without_breaks(source_of(found))}:</p><ul>{said}</ul>")
    return "\n".join([*parts, picture(drawn, "parameters along the runs", caption)])


def _page(finding: DrivingFinding, drawn: Path) -> str:
    """Return a page that stands alone."""
    title, *rest = finding.verdict
    absorbed = "".join(f"<li>{escape(why)}</li>" for why in ABSORBED.values())
    is_found = bool(finding.effects) or any(d.differs and d.is_material for d in finding.differences)
    return page_shell(
        headline=title,
        lead=rest,
        eyebrow=f"sensorgraph diagnose: {' and '.join(finding.runs)}, wheels and mount from driving alone",
        kind="found" if is_found or any(finding.changes.values()) else "calm",
        sections=[
            driving_section(finding, drawn, heading=""),
            f"<h2>What the poses absorb</h2><ul>{absorbed}</ul>",
        ],
    )
