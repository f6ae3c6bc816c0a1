"""Diagnose runs without arena and reference poses: calibrate their wheels and mount.

The ledger lists the effects that driving alone tested, those that it cannot show, and what decided.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from logs.run import Run
from sensorgraph.diagnosis.engine.ledger import Entry, Facts, Ledger
from sensorgraph.diagnosis.engine.why import why
from sensorgraph.diagnosis.ledger import effect_entry, least_size, needs_of
from sensorgraph.diagnosis.motion.calibration.comparison import (
    Change,
    Difference,
    change_within,
    compare,
    is_long_enough,
)
from sensorgraph.diagnosis.motion.calibration.estimate import DrivingCalibration, calibrate
from sensorgraph.diagnosis.motion.calibration.laser_motion import laser_motion, with_moving_odometry
from sensorgraph.diagnosis.motion.calibration.verdict import (
    SURE,
    calibrated_effects,
    change_lines,
    effects_of,
    headline,
    is_material,
    lines_of,
    source_of,
    verdict,
)
from sensorgraph.diagnosis.motion.calibration.words import EFFECT_OF, QUANTITIES
from sensorgraph.diagnosis.motion.families import ODOMETRY_FAMILIES
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import ProgressBars, no_progress

THRESHOLD = 0.5 * SURE**2
"""[nats] Evidence of an estimate that is `SURE` standard errors off."""
CHANGE = ODOMETRY_FAMILIES["jump"]
"""Name in the ledger, and noun phrase, of a change at a moment."""
NEEDS_ARENA = "only wheels and mount are estimated without an arena, since poses from the run's own scans absorb the rest"


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


def driving_ledger(found: DrivingCalibration, change: Change | None, base: float | None) -> Ledger:
    """Return the ledger of one run.

    Parameters
    ----------
    change : Change during the run, if there is one.
    base : [m] Wheelbase that the odometry uses; None: unknown, so that unequal wheels have no size.
    """
    hidden = {EFFECT_OF[name]: why for name, why in reversed(found.hidden.items())}
    if base is None:
        hidden.setdefault(WHEEL_RADIUS_DIFF.name, "it needs the wheelbase; give --robot with wheels.base")
    if LATENCY.name not in hidden:
        delay, error = found.of("delay")
        hidden[LATENCY.name] = (
            f"the scan delay of {QUANTITIES['delay'].text(delay, error)} is relative to the odometry; "
            "only reference poses can show which of the two is late"
        )
    entries = []
    for a in calibrated_effects(found, base):
        why = hidden.get(a.name, "")
        evidence = None if why else a.evidence
        facts = Facts(
            has_name=True, accepted=evidence is not None and evidence > THRESHOLD, evidence=evidence, threshold=THRESHOLD,
            is_material=is_material(a), not_observable=why,
        )  # fmt: skip
        entry = effect_entry(a, facts)
        entries.append(replace(entry, remark=f"it is smaller than what matters ({least_size(a.effect)})"))
    known = {entry.name for entry in entries}
    for name, effect in EFFECTS.items():
        if name not in known:
            facts = Facts(has_name=True, not_observable=hidden.get(name, NEEDS_ARENA))
            entries.append(
                Entry(
                    name=name, channel=effect.channel, title=effect.title, facts=facts, needs=needs_of(effect)
                )
            )
    return Ledger(entries=(*entries, _change(found, change)))


def _change(found: DrivingCalibration, change: Change | None) -> Entry:
    """Return the entry of a change of wheels or mount during the run."""
    name, title = CHANGE
    if change is None:
        why = "" if is_long_enough(found) else "the drive is too short to show a change during it"
        weak = Facts(has_name=False, evidence=None if why else 0.0, threshold=THRESHOLD, not_tried=why)
        return Entry(name=name, channel="odometry", title=title, facts=weak)
    one, q = change.difference, QUANTITIES[change.difference.name]
    facts = Facts(
        has_name=False, accepted=True, evidence=0.5 * (one.value / one.stderr) ** 2, threshold=THRESHOLD
    )
    estimate = f"{q.title} by {q.text(one.value, one.stderr)} at about {change.at_s:.0f} s"
    return Entry(
        name=name, channel="odometry", title=title, facts=facts, estimate=estimate,
        needs=f"which of these is the cause: {q.causes}",
    )  # fmt: skip
