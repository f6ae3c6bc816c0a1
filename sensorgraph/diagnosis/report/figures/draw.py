"""Draw all pictures of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report.comparison import ComparedScans
from sensorgraph.diagnosis.report.figures.arena import arena_picture, next_run_picture
from sensorgraph.diagnosis.report.figures.calibration import calibration_picture
from sensorgraph.diagnosis.report.figures.residuals import profile_picture, residuals_picture


def draw_all(finding: Finding, compared: ComparedScans | None, folder: Path) -> dict[str, Path]:
    """Draw every picture for which the finding has data; return name -> file."""
    scan = finding.channels.get("scan")
    pictures: dict[str, Callable[[Path], None]] = {}
    if compared is not None:
        pictures["arena"] = partial(arena_picture, finding, compared)
        pictures["residuals"] = partial(residuals_picture, finding, compared)
    if scan is not None and scan.unknown is not None and scan.unknown.profile is not None:
        pictures["profile"] = partial(profile_picture, scan.unknown.profile)
    if finding.driving is not None:
        pictures["calibration"] = partial(calibration_picture, finding.driving.runs)
    if finding.next_run is not None:
        poses = finding.next_run.trajectory.poses
        pictures["next_run"] = partial(next_run_picture, poses, finding.data.arena)
    files = {name: folder / f"{name}.png" for name in pictures}
    for name, draw in pictures.items():
        draw(files[name])
    return files
