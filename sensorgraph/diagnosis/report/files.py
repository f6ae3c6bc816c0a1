"""Write the report of a diagnosis: report.json, report.html, effects.yaml, review.rrd and pictures in one folder.

A `Diagnosis` is a finding with the arena and the robot it is about, which prints itself and saves its report; a
`DrivingDiagnosis` is that of runs without arena and reference poses.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from logs.files import atomic_file
from logs.html_table import html_table
from planners.arena import Arena
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.motion.calibration.comparison import ABSORBED
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding
from sensorgraph.diagnosis.report import data
from sensorgraph.diagnosis.report.arena_figure import arena_picture, marks, next_run_picture
from sensorgraph.diagnosis.report.comparison import ComparedScans, compare
from sensorgraph.diagnosis.report.considered import considered_section
from sensorgraph.diagnosis.report.data import UNITS, calibrations, effect_dict, plain, to_dict
from sensorgraph.diagnosis.report.html import driving_section, page
from sensorgraph.diagnosis.report.quantities import (
    parameters,
    percent,
    place_text,
)
from sensorgraph.diagnosis.report.rerun_view import write as write_review
from sensorgraph.diagnosis.report.residual_figures import (
    calibration_picture,
    gap_picture,
    profile_picture,
    residuals_picture,
)
from sensorgraph.diagnosis.report.summary import summarise
from sensorgraph.diagnosis.result import Gap
from sensorgraph.effects import effects_file
from sensorgraph.files import atomic_folder, write_timing
from sensorgraph.show.page_shell import page_shell, warnings
from sensorgraph.types import Progress
from sensorgraph.version import __version__
from sensorgraph.world.robot import Robot

PICTURES = ("arena", "profile", "residuals", "gap", "ranking", "next_run", "calibration")
NEXT_RUN_FILES = ("trajectory.csv", "arena.geojson", "robot.yaml", "plan.json")
PARTS = ("report.json", "effects.yaml", "pictures", "report.html", "review.rrd")
"""What is written, in this order."""


def save_diagnosis(
    finding: Finding,
    folder: Path,
    arena: Arena,
    robot: Robot,
    *,
    name: str = "run",
    settings: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> None:
    """Write the report and the next run into a folder, all of it or nothing; replace an earlier report.

    Parameters
    ----------
    arena, robot : used for the diagnosis; stored with the next run
    name, settings, progress : see `save_report`
    """
    with atomic_folder(folder) as part:
        save_report(finding, part, name=name, settings=settings, progress=progress)
        if finding.next_run is not None:
            finding.next_run.save(part / "next_run", arena, robot)
        remove_old_report(folder)


def save_report(
    finding: Finding,
    folder: Path,
    *,
    name: str = "run",
    settings: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Write the report of a diagnosis; return its files. Each is complete or not there.

    Parameters
    ----------
    name : of the run
    settings : configuration, kept in the report; the version is added
    progress : called with the number of parts done
    """

    def done(count: int) -> None:
        if progress is not None:
            progress(count, len(PARTS))

    folder.mkdir(parents=True, exist_ok=True)
    kept = {"version": __version__, **(settings or {})}
    report = plain({**to_dict(finding), "settings": kept})
    files = {key: folder / key for key in ("report.json", "effects.yaml", "report.html", "review.rrd")}
    with atomic_file(files["report.json"]) as part:
        part.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    write_timing(folder, {"cpu_s": dict(finding.seconds)})
    done(1)
    effects_file.write(finding.effects, files["effects.yaml"])
    done(2)
    compared = compare(finding)
    pictures = draw_all(finding, compared, folder)
    done(3)
    html = page(finding, pictures, title=name, settings=kept, next_run=report["next_run"])
    with atomic_file(files["report.html"]) as part:
        part.write_text(html, encoding="utf-8")
    done(4)
    if compared is None:
        del files["review.rrd"]
    else:
        write_review(
            compared,
            files["review.rrd"],
            report=markdown(finding, name),
            marks=marks(finding, compared.arena),
        )
    done(5)
    return [*files.values(), *pictures.values()]


def remove_old_report(folder: Path) -> None:
    """Remove pictures, review and next run of an earlier report, which the new one may not have."""
    for name in ("review.rrd", *(f"{picture}.png" for picture in PICTURES)):
        (folder / name).unlink(missing_ok=True)
    plan = folder / "next_run"
    for name in NEXT_RUN_FILES:
        (plan / name).unlink(missing_ok=True)
    if plan.is_dir() and not any(plan.iterdir()):
        plan.rmdir()


def markdown(finding: Finding, name: str) -> str:
    """Return headline and sentences in markdown."""
    summary = summarise(finding)
    note = f"*{name}. Gap and residuals are those of the bare simulator at the reference poses.*"
    return "\n\n".join([f"# {summary.headline}", *summary.details, note]) + "\n"


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis(Finding):
    """Result of `sensorgraph.diagnose`."""

    arena: Arena
    robot: Robot

    @classmethod
    def of(cls, finding: Finding, arena: Arena, robot: Robot) -> Diagnosis:
        """Add arena and robot to a finding."""
        return cls(**{f.name: getattr(finding, f.name) for f in fields(Finding)}, arena=arena, robot=robot)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `report.json` as plain data."""
        return data.to_dict(self)

    def save(self, folder: Path | str) -> Path:
        """Write report, pictures, `effects.yaml` and the next run into a folder; all of it or nothing."""
        save_diagnosis(self, Path(folder), self.arena, self.robot)
        return Path(folder)

    def __repr__(self) -> str:
        named = "".join(f"\n  {effect!r}" for effect in self.effects[:4])
        return f"Diagnosis: {summarise(self).headline}{named}"

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: the headline, and each named effect with size and probability."""
        rows = [
            (a.effect.title, place_text(a), ", ".join(parameters(a)), percent(a.probability))
            for a in self.effects
        ]
        return html_table(summarise(self).headline, rows, head=("effect", "place", "size", "probability"))


def draw_all(finding: Finding, compared: ComparedScans | None, folder: Path) -> dict[str, Path]:
    """Draw every picture for which the finding has data; return name -> file."""
    scan = finding.channels.get("scan")
    pictures: dict[str, Callable[[Path], None]] = {}
    if compared is not None:
        pictures["arena"] = partial(arena_picture, finding, compared)
        pictures["residuals"] = partial(residuals_picture, finding, compared)
    if scan is not None and scan.unknown is not None and scan.unknown.profile is not None:
        pictures["profile"] = partial(profile_picture, scan.unknown.profile)
    if gaps := _gaps(finding):
        pictures["gap"] = partial(gap_picture, gaps, finding.second_gap)
    if finding.driving is not None:
        pictures["calibration"] = partial(calibration_picture, finding.driving.runs)
    if finding.next_run is not None:
        poses = finding.next_run.trajectory.poses
        pictures["next_run"] = partial(next_run_picture, poses, finding.data.arena)
    files = {name: folder / f"{name}.png" for name in pictures}
    for name, draw in pictures.items():
        draw(files[name])
    return files


def _gaps(finding: Finding) -> dict[str, Gap]:
    """Return the gaps to draw: channels with an effect first, then the scan channel."""
    measured = {name: result for name, result in finding.channels.items() if result.gap is not None}
    first = [n for n, result in measured.items() if result.effects or result.unknown is not None]
    names = dict.fromkeys([*first, *(n for n in measured if n == "scan")]) or dict.fromkeys(measured)
    return {name: gap for name in names if (gap := measured[name].gap) is not None}


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
