"""Draw all pictures of a diagnosis."""

from __future__ import annotations

from pathlib import Path

from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report.comparison import ComparedScans
from sensorgraph.diagnosis.report.figures.arena import arena_picture
from sensorgraph.diagnosis.report.figures.calibration import calibration_picture
from sensorgraph.diagnosis.report.figures.gap import gap_picture
from sensorgraph.diagnosis.report.figures.next_run import next_run_picture
from sensorgraph.diagnosis.report.figures.profile import profile_picture
from sensorgraph.diagnosis.report.figures.ranking import ranking_picture
from sensorgraph.diagnosis.report.figures.residuals import residuals_picture
from sensorgraph.diagnosis.result import Gap


def draw_all(finding: Finding, compared: ComparedScans | None, folder: Path) -> dict[str, Path]:
    """Draw every picture for which the finding has data; return name -> file."""
    out: dict[str, Path] = {}
    if compared is not None:
        out["arena"] = folder / "arena.png"
        arena_picture(finding, compared, out["arena"])
        out["residuals"] = folder / "residuals.png"
        residuals_picture(finding, compared, out["residuals"])
    scan = finding.channels.get("scan")
    if scan is not None and scan.unknown is not None and scan.unknown.profile is not None:
        out["profile"] = folder / "profile.png"
        profile_picture(scan.unknown.profile, out["profile"])
    gaps = _gaps(finding)
    if gaps:
        out["gap"] = folder / "gap.png"
        gap_picture(gaps, finding.second_gap, out["gap"])
    if finding.explained is not None and any(step.tried for step in finding.explained.steps):
        out["ranking"] = folder / "ranking.png"
        ranking_picture(finding, out["ranking"])
    if finding.driving is not None:
        out["calibration"] = folder / "calibration.png"
        calibration_picture(finding.driving.runs, out["calibration"])
    if finding.next_run is not None:
        out["next_run"] = folder / "next_run.png"
        next_run_picture(finding.next_run.trajectory.poses, finding.data.arena, out["next_run"])
    return out


def _gaps(finding: Finding) -> dict[str, Gap]:
    """Return the gaps to draw: channels with an effect first, then the scan channel."""
    measured = {name: result for name, result in finding.channels.items() if result.gap is not None}
    first = [n for n, result in measured.items() if result.effects or result.unknown is not None]
    names = dict.fromkeys([*first, *(n for n in measured if n == "scan")]) or dict.fromkeys(measured)
    return {name: gap for name in names if (gap := measured[name].gap) is not None}
