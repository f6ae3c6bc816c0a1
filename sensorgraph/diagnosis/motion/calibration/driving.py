"""Diagnose runs without arena and reference poses: calibrate their wheels and mount."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from logs.run import Run
from sensorgraph.diagnosis.engine.ledger import Ledger
from sensorgraph.diagnosis.engine.why import why
from sensorgraph.diagnosis.motion.calibration.comparison import (
    Change,
    Difference,
    change_within,
    compare,
    is_long_enough,
)
from sensorgraph.diagnosis.motion.calibration.considered import driving_ledger
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
from sensorgraph.diagnosis.motion.calibration.words import EFFECT_OF, QUANTITIES
from sensorgraph.effects import Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import ProgressBars, no_progress


@dataclass(frozen=True, kw_only=True, eq=False)
class DrivingFinding:
    """Result of one or two runs without arena and reference poses."""

    runs: Mapping[str, DrivingCalibration]
    """Name -> calibration from driving alone."""
    changes: Mapping[str, Change | None]
    """Name -> change during the run."""
    differences: tuple[Difference, ...]
    """Second run minus first run, in the order of PARAMETERS; empty with one run."""
    effects: tuple[Amendment, ...]
    """Material effects of the last run; for `record` and `export`."""
    base: float | None = None
    """[m] Wheelbase that the odometry uses; None: unknown."""

    @property
    def verdict(self) -> list[str]:
        """Return the verdict as one line, or as several lines if two runs differ."""
        names = list(self.runs)
        if len(names) > 1:
            return verdict(self.differences, names[0], names[1])
        return [headline(self.runs[names[0]], self.changes[names[0]])]

    def lines_of(self, name: str) -> list[str]:
        """Return the calibration of one run, one line per quantity."""
        found = self.runs[name]
        return [*lines_of(found), *change_lines(self.changes[name], is_tested=is_long_enough(found))]

    @cached_property
    def ledger(self) -> Ledger:
        """All hypotheses, with the verdicts on the last run."""
        name, found = list(self.runs.items())[-1]
        return driving_ledger(found, self.changes[name], self.base)

    def why(self, name: str) -> str:
        """Return why an effect was or was not named.

        Raises
        ------
        SensorgraphError
            The ledger has no such name; the message lists the known ones.
        """
        return why(self.ledger, name)

    @property
    def hidden(self) -> dict[str, str]:
        """Return the effects that the last run does not show, with the reason."""
        found = list(self.runs.values())[-1]
        return {
            EFFECT_OF[name]: f"{QUANTITIES[name].title}: {why}"
            for name, why in reversed(found.hidden.items())
        }

    @property
    def lines(self) -> list[str]:
        """Return the result as lines, the verdict first."""
        out = self.verdict
        for name, found in self.runs.items():
            out += [f"{name}, {source_of(found)}:", *(f"  {line}" for line in self.lines_of(name))]
        return out


def check_odometry(run: Run, *, name: str = "the run") -> None:
    """Reject a run without odometry, before it is located."""
    try:
        with_moving_odometry(run)
    except SensorgraphError as exc:
        raise SensorgraphError(f"{name}: {exc}; give an arena to diagnose the laser alone") from exc


def diagnose_driving(
    runs: Mapping[str, tuple[Run, Run]], *, base: float | None = None, progress: ProgressBars = no_progress
) -> DrivingFinding:
    """Calibrate wheels and mount from driving alone, and compare two runs.

    Parameters
    ----------
    runs : Name -> the run as logged, and the same run located; one or two.
    base : [m] Wheelbase that the odometry uses; None: unknown.

    Raises
    ------
    SensorgraphError : A run has no odometry.
    """
    found: dict[str, DrivingCalibration] = {}
    changes: dict[str, Change | None] = {}
    for name, (run, located) in runs.items():
        try:
            motion = laser_motion(run, located, progress=progress)
        except SensorgraphError as exc:
            raise SensorgraphError(f"{name}: {exc}; give an arena to diagnose the laser alone") from exc
        with progress("calibrating wheels and mount", ""):
            found[name] = calibrate(motion)
            changes[name] = change_within(motion, found[name])
    first, *others = found.values()
    return DrivingFinding(
        runs=found,
        changes=changes,
        differences=compare(first, others[0]) if others else (),
        effects=effects_of(others[0] if others else first, base),
        base=base,
    )
