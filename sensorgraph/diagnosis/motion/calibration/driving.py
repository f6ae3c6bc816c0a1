"""Diagnose runs that have neither arena nor reference: what their wheels and their mount tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from logs.run import Run
from sensorgraph.diagnosis.motion.calibration.comparison import Change, Difference, change_within, compare
from sensorgraph.diagnosis.motion.calibration.estimate import DrivingCalibration, calibrate
from sensorgraph.diagnosis.motion.calibration.laser_motion import laser_motion, with_moving_odometry
from sensorgraph.diagnosis.motion.calibration.verdict import (
    change_lines,
    effects_of,
    headline,
    lines_of,
    source_of,
    verdict,
)
from sensorgraph.effects import Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import ProgressBars, no_progress


@dataclass(frozen=True, kw_only=True, eq=False)
class DrivingFinding:
    """What one or two runs tell without arena and reference."""

    runs: Mapping[str, DrivingCalibration]
    """Name -> what driving alone tells."""
    changes: Mapping[str, Change | None]
    """Name -> what changed within the run."""
    differences: tuple[Difference, ...]
    """Of the second run from the first, in the order of PARAMETERS; empty with one run."""
    effects: tuple[Amendment, ...]
    """Material, of the last run; for `record` and `export`."""

    @property
    def verdict(self) -> list[str]:
        """Say it in a line, or in a few where two runs differ."""
        names = list(self.runs)
        if len(names) > 1:
            return verdict(self.differences, names[0], names[1])
        return [headline(self.runs[names[0]], self.changes[names[0]])]

    def lines_of(self, name: str) -> list[str]:
        """Say what one run tells, quantity by quantity."""
        return [*lines_of(self.runs[name]), *change_lines(self.changes[name])]

    @property
    def lines(self) -> list[str]:
        """Say it, the verdict first."""
        out = self.verdict
        for name, found in self.runs.items():
            out += [f"{name}, {source_of(found)}:", *(f"  {line}" for line in self.lines_of(name))]
        return out


def check_odometry(run: Run, *, name: str = "the run") -> None:
    """Refuse a run that cannot tell wheels and mount, before it is located."""
    try:
        with_moving_odometry(run)
    except SensorgraphError as exc:
        raise SensorgraphError(f"{name}: {exc}") from exc


def diagnose_driving(
    runs: Mapping[str, tuple[Run, Run]], *, base: float | None = None, progress: ProgressBars = no_progress
) -> DrivingFinding:
    """Calibrate wheels and mount from driving alone, and compare two runs.

    Parameters
    ----------
    runs : name -> the run as logged, and the same run located; one or two
    base : [m] between the wheels, as the odometry takes it; None: not known

    Raises
    ------
    SensorgraphError : a run has no odometry, or is too short
    """
    found: dict[str, DrivingCalibration] = {}
    changes: dict[str, Change | None] = {}
    for name, (run, located) in runs.items():
        try:
            motion = laser_motion(run, located, progress=progress)
        except SensorgraphError as exc:
            raise SensorgraphError(f"{name}: {exc}") from exc
        with progress("calibrating wheels and mount", ""):
            found[name] = calibrate(motion)
            changes[name] = change_within(motion, found[name])
    first, *others = found.values()
    return DrivingFinding(
        runs=found,
        changes=changes,
        differences=compare(first, others[0]) if others else (),
        effects=effects_of(others[0] if others else first, base),
    )
