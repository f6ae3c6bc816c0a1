"""Diagnosis: a finding with the arena and the robot it is about, which prints itself and saves its report."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from logs.html_table import html_table
from planners.arena import Arena
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report import data
from sensorgraph.diagnosis.report.files import save_diagnosis
from sensorgraph.diagnosis.report.quantities import parameters, percent, place_text
from sensorgraph.diagnosis.report.summary import summarise
from sensorgraph.world.robot import Robot


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
