"""Report of runs without arena and reference poses: report.json, report.html, effects.yaml and a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import Any

from logs.files import atomic_file
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding
from sensorgraph.diagnosis.motion.calibration.words import ABSORBED
from sensorgraph.diagnosis.report.considered import considered_section
from sensorgraph.diagnosis.report.data import UNITS, calibrations, effect_dict, plain
from sensorgraph.diagnosis.report.figures.calibration import calibration_picture
from sensorgraph.diagnosis.report.files import remove_old_report
from sensorgraph.diagnosis.report.html import driving_section
from sensorgraph.diagnosis.report.page_shell import page_shell, warnings
from sensorgraph.effects import effects_file
from sensorgraph.files import atomic_folder
from sensorgraph.version import __version__


@dataclass(frozen=True, kw_only=True, eq=False)
class DrivingDiagnosis(DrivingFinding):
    """Result of `sensorgraph.diagnose` for runs without arena and reference poses."""

    @classmethod
    def of(cls, finding: DrivingFinding) -> DrivingDiagnosis:
        """Add printing and saving to a finding."""
        return cls(**{f.name: getattr(finding, f.name) for f in fields(DrivingFinding)})

    def to_dict(self) -> dict[str, Any]:
        """Return what `report.json` holds; plain data."""
        return driving_dict(self)

    def save(self, folder: Path | str) -> Path:
        """Write the report into a folder; all of it or nothing."""
        save_driving(self, Path(folder), {})
        return Path(folder)

    def __repr__(self) -> str:
        return "\n".join(self.lines)


def save_driving(
    finding: DrivingFinding, folder: Path, settings: Mapping[str, Any], log_notes: Sequence[str] = ()
) -> None:
    """Write the report into a folder; all of it or nothing.

    Parameters
    ----------
    log_notes : warnings of the readers of the runs
    """
    with atomic_folder(folder) as part:
        kept = {"version": __version__, **settings}
        report = plain({**driving_dict(finding), "settings": kept})
        report["intake"]["log_notes"] = list(log_notes)
        with atomic_file(part / "report.json") as file:
            file.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        effects_file.write(finding.effects, part / "effects.yaml")
        calibration_picture(finding.runs, part / "calibration.png")
        with atomic_file(part / "report.html") as file:
            file.write_text(_page(finding, part / "calibration.png", log_notes), encoding="utf-8")
        remove_old_report(folder)


def driving_dict(finding: DrivingFinding) -> dict[str, Any]:
    """Return the report as plain data; keys that need an arena or reference poses are empty."""
    return {
        "effects": [effect_dict(a) for a in finding.effects],
        "unknown": None,
        "where": None,
        "runner_up": None,
        "gap": None,
        "within_tolerance": [],
        "not_observable": {**finding.hidden, **ABSORBED},
        "ledger": finding.ledger.to_list(),
        "next_run": None,
        "intake": {"reference": "none: located from scans and wheels", "runs": list(finding.runs)},
        "calibration": calibrations(finding),
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


def _page(finding: DrivingFinding, drawn: Path, log_notes: Sequence[str]) -> str:
    """Return a self-contained page."""
    title, *rest = finding.verdict
    absorbed = "".join(f"<li>{escape(why)}</li>" for why in ABSORBED.values())
    is_found = bool(finding.effects) or any(d.differs and d.is_material for d in finding.differences)
    return page_shell(
        headline=title,
        lead=[*rest, *warnings(log_notes)],
        eyebrow=f"sensorgraph diagnose: {' and '.join(finding.runs)}, wheels and mount from driving alone",
        kind="found" if is_found or any(finding.changes.values()) else "calm",
        sections=[
            driving_section(finding, drawn, heading=""),
            f"<h2>What the poses absorb</h2><ul>{absorbed}</ul>",
            considered_section(finding.ledger),
        ],
    )
