"""Diagnose runs without arena and reference poses: calibrate their wheels and mount.

`effects` expresses the calibration as effects of the library, with their ledger.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from logs.run import Run
from sensorgraph.diagnosis.engine.ledger import Ledger
from sensorgraph.diagnosis.engine.why import why
from sensorgraph.diagnosis.motion.calibration.comparison import (
    QUANTITIES,
    Change,
    Difference,
    change_within,
    compare,
    is_long_enough,
)
from sensorgraph.diagnosis.motion.calibration.effects import (
    driving_channel,
    driving_ledger,
    effects_of,
    hidden_effects,
)
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, DrivingCalibration, calibrate
from sensorgraph.diagnosis.motion.calibration.laser_motion import laser_motion, with_moving_odometry
from sensorgraph.diagnosis.result import ChannelResult
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
        found = self.runs[names[0]]
        return [headline(found, self.changes[names[0]]), *(f"{text}." for text in _delays(found))]

    @property
    def nameless(self) -> list[str]:
        """Return what the last run shows and no effect can state: sentences about unequal wheels without a size, a delay, a change."""
        name, found = list(self.runs.items())[-1]
        out, (bias, sd) = [], found.of("heading_bias")
        q, change = QUANTITIES["heading_bias"], self.changes[name]
        if self.base is None and "heading_bias" not in found.hidden and q.is_off(bias, sd):
            out.append(
                f"The odometry misses a {q.title} of {q.text(bias, sd)}: wheels of unequal size, of which the wheelbase "
                "(wheels.base in robot.yaml) gives the effect"
            )
        return [*out, *_delays(found), *([] if change is None else [change.sentence])]

    def lines_of(self, name: str) -> list[str]:
        """Return the calibration of one run, one line per quantity."""
        found = self.runs[name]
        return [*lines_of(found), *change_lines(self.changes[name], is_tested=is_long_enough(found))]

    @property
    def channel(self) -> ChannelResult:
        """The odometry channel of the last run, as driving alone shows it."""
        return driving_channel(list(self.runs.values())[-1], self.effects, self.base)

    @property
    def hidden(self) -> dict[str, str]:
        """Return the effects that the last run does not show, with the reason."""
        return hidden_effects(list(self.runs.values())[-1])

    @cached_property
    def ledger(self) -> Ledger:
        """All effects and a change during the run, with the verdicts on the last run."""
        name, found = list(self.runs.items())[-1]
        return driving_ledger(found, self.changes[name], self.channel)

    def why(self, name: str) -> str:
        """Return why an effect was or was not named.

        Raises
        ------
        SensorgraphError
            The ledger has no such name; the message lists the known ones.
        """
        return why(self.ledger, name)

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
            changes[name] = change_within(found[name])
    first, *others = found.values()
    return DrivingFinding(
        runs=found,
        changes=changes,
        differences=compare(first, others[0]) if others else (),
        effects=effects_of(others[0] if others else first, base),
        base=base,
    )


# sentences ------------------------------------------------------------------------------------------------------------


def headline(found: DrivingCalibration, change: Change | None) -> str:
    """Return one line for a run: what changed during it, or what differs from the specified values."""
    if change is not None:
        return change_lines(change)[0]
    q = QUANTITIES
    off = {
        name: (found.of(name)[0] - stated, found.of(name)[1])
        for name, stated in zip(PARAMETERS, found.stated.tolist(), strict=True)
    }
    told = [
        f"{q[name].title} {q[name].text(d, sd)}"
        for name, (d, sd) in off.items()
        if name not in found.hidden and q[name].is_off(d, sd)
    ]
    if told:
        return f"Wheels and mount differ from the specified values: {', '.join(told)}."
    if len(found.hidden) == len(PARAMETERS) + 1:
        return f"The drive does not show wheels and mount: {found.hidden[PARAMETERS[0]]}."
    if found.hidden:
        unseen = ", ".join(q[name].title for name in found.hidden)
        return f"Wheels and mount agree with the specified values, as far as the drive shows them; it does not show: {unseen}."
    return "Wheels and mount agree with the specified values, within the accuracy of driving alone."


def source_of(found: DrivingCalibration) -> str:
    """Return the length and duration of the drive."""
    turns = found.turn_rad / (2 * np.pi)
    return (
        f"from driving alone, {_short(found.way_m)} m and {_short(turns)} full turns in "
        f"{_short(found.duration_s / 60)} min"
    )


def _short(value: float) -> str:
    """Return a number with two digits or more."""
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def lines_of(found: DrivingCalibration) -> list[str]:
    """Return the calibration of one run, one line per quantity."""
    corrections = {
        "way_scale": f"correction to the odometry (in {found.metre} length scale)",
        "turn_scale": "correction to the odometry",
        "heading_bias": "missing in the odometry (wheels of unequal size)",
    }
    lines = []
    for name, stated in zip(PARAMETERS, found.stated.tolist(), strict=True):
        (value, sd), q = found.of(name), QUANTITIES[name]
        if name in corrections and name not in found.hidden:
            lines.append(f"{q.title}: {q.text(value - stated, sd)}, {corrections[name]}")
        elif name not in found.hidden:
            number = f"{q.factor * stated:.1f}".replace("-", "−")
            lines.append(f"{q.title}: {q.text(value, sd)} (specified: {number} {q.unit})")
    lines += [*_delay_lines(found), *_floor_lines(found)]
    return lines + [f"{QUANTITIES[name].title}: not observable, {why}" for name, why in found.hidden.items()]


def _delay_lines(found: DrivingCalibration) -> list[str]:
    """Return the delay between scans and odometry, also if there is none."""
    if "delay" in found.hidden:
        return []
    if is_delayed(found):
        return [f"scan delay: {delay_text(found)}"]
    return [f"scan delay: {QUANTITIES['delay'].text(*found.of('delay'))}, none that matters"]


def is_delayed(found: DrivingCalibration) -> bool:
    """Tell whether scans and odometry surely have other times than their stamps, by as much as matters."""
    return "delay" not in found.hidden and QUANTITIES["delay"].is_off(*found.of("delay"))


def _delays(found: DrivingCalibration) -> list[str]:
    """Return the delay that matters as a sentence, if there is one."""
    return [delay_text(found).capitalize()] if is_delayed(found) else []


def delay_text(found: DrivingCalibration) -> str:
    """Return the delay between scans and odometry."""
    delay, sd = found.of("delay")
    size = QUANTITIES["delay"].text(abs(delay), sd, sign=False)
    return f"scans are {size} {'older' if delay < 0 else 'newer'} than the odometry at their stamps"


def _floor_lines(found: DrivingCalibration) -> list[str]:
    """Return the drift with the floor, if there is one."""
    drift = found.values[-2:]
    size, sd = float(np.hypot(*drift)), float(found.stderr[-2:].max())
    if not QUANTITIES["way_scale"].is_off(size, sd):
        return []
    return [
        f"floor: moves the robot {100 * size:.1f} ± {100 * sd:.1f} cm per metre towards "
        f"{np.degrees(np.arctan2(drift[1], drift[0])) % 360:.0f}° of the map (a slope, the nap of a carpet)"
    ]


def difference_line(one: Difference, first: str, second: str) -> str:
    """Return the difference of a parameter between two runs, with its possible causes."""
    q = QUANTITIES[one.name]
    return (
        f"{q.title} of {second} differs from that of {first} by {q.text(one.value, one.stderr)}: {q.causes}"
    )


def verdict(differences: Sequence[Difference], first: str, second: str) -> list[str]:
    """Return the lines that state whether two runs agree."""
    shown = [d for d in differences if d.is_shown]
    told = [d for d in shown if d.differs and d.is_material]
    small = [d for d in shown if d.differs and not d.is_material]
    if told:
        lines = ["The two runs differ.", *(difference_line(d, first, second) for d in told)]
    elif not shown:
        lines = ["The two runs cannot be compared: one of them does not show wheels and mount."]
    else:
        worst = max(shown, key=lambda d: abs(d.value) / d.stderr)
        of = "" if len(shown) == len(differences) else ", as far as both show them"
        lines = [
            f"The two runs agree in wheels and mount{of} (largest difference {abs(worst.value) / worst.stderr:.1f} standard "
            f"errors, {QUANTITIES[worst.name].title})."
        ]
    lines += [f"Too small to matter: {difference_line(d, first, second)}" for d in small]
    return lines


def change_lines(change: Change | None, *, is_tested: bool = True) -> list[str]:
    """Return the line that states whether wheels and mount stayed constant during the run.

    Parameters
    ----------
    is_tested : False: the run is too short for the test.
    """
    if change is None and not is_tested:
        return ["The drive is too short to show a change during it."]
    if change is None:
        return ["Wheels and mount are constant during the run."]
    return [change.sentence]
