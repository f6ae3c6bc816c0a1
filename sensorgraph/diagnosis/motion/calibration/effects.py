"""Effects of wheels and mount from driving alone: their sizes, the odometry channel, and the ledger of a run without an arena."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.engine.ledger import Entry, Ledger
from sensorgraph.diagnosis.engine.verdict import Facts
from sensorgraph.diagnosis.ledger import effect_entry, least_size, ledger_of
from sensorgraph.diagnosis.motion.calibration.comparison import (
    QUANTITIES,
    SURE,
    Change,
    is_long_enough,
)
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.motion.wheel_structure import ODOMETRY_FAMILIES
from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF

THRESHOLD = SURE**2 / 2
"""[nats] Evidence of an estimate that is `SURE` standard errors off."""
CHANGE = ODOMETRY_FAMILIES["jump"]
"""Name in the ledger, and noun phrase, of a change at a moment."""
NEEDS_ARENA = "only wheels and mount are estimated without an arena, since poses from the run's own scans absorb the rest"


def calibrated_effects(found: DrivingCalibration, base: float | None) -> list[Amendment]:
    """Return the effects of wheels and mount with their sizes and evidence, whether or not these are material.

    Parameters
    ----------
    base : [m] Wheelbase that the odometry uses; None: unknown, so that unequal radii have no size.
    """
    (way, way_sd), (turn, turn_sd), (bias, bias_sd) = (found.of(name) for name in PARAMETERS[:3])
    (x, x_sd), (y, y_sd), (yaw, yaw_sd) = (found.of(name) for name in PARAMETERS[3:])
    ratio = turn / way
    stated = found.mount
    shift = {"dx": x - stated[0], "dy": y - stated[1]}
    angle = MOUNT_YAW.parameters[0].name
    known = [
        (WHEEL_RADIUS, {"s": 1 / way - 1}, {"s": way_sd / way**2}),
        (WHEEL_BASE, {"s": ratio - 1}, {"s": ratio * float(np.hypot(turn_sd / turn, way_sd / way))}),
        (MOUNT_XY, shift, {"dx": x_sd, "dy": y_sd}),
        (MOUNT_YAW, {angle: yaw - stated[2]}, {angle: yaw_sd}),
    ]
    if base is not None:
        known.append((WHEEL_RADIUS_DIFF, {"s": -bias * base}, {"s": bias_sd * base}))
    return [
        Amendment(
            effect=effect,
            parameters=values,
            stderr=errors,
            evidence=0.5 * max(abs(values[name]) / errors[name] for name in values) ** 2,
        )
        for effect, values, errors in known
    ]


def is_material(a: Amendment) -> bool:
    """Tell whether a parameter is surely not zero and large enough to matter."""
    return any(
        abs(a[p.name]) > max(SURE * a.stderr[p.name], p.materiality or 0.0) for p in a.effect.parameters
    )


def effects_of(found: DrivingCalibration, base: float | None) -> tuple[Amendment, ...]:
    """Return the material effects of wheels and mount, for `record` and `export`; see `calibrated_effects`."""
    named = [a for a in calibrated_effects(found, base) if is_material(a)]
    return tuple(sorted(named, key=lambda a: -(a.evidence or 0.0)))


# channel and ledger ----------------------------------------------------------------------------------------------------


def hidden_effects(found: DrivingCalibration) -> dict[str, str]:
    """Return the effects that a run does not show, with the reason."""
    return {
        QUANTITIES[name].effect.name: f"{QUANTITIES[name].title}: {why}"
        for name, why in reversed(found.hidden.items())
    }


def driving_channel(
    found: DrivingCalibration, effects: tuple[Amendment, ...], base: float | None
) -> ChannelResult:
    """Return the odometry channel of one run: effects of wheels and mount.

    Parameters
    ----------
    effects : The material ones.
    base : [m] Wheelbase that the odometry uses; None: unknown, so that unequal wheels have no size.
    """
    hidden = hidden_effects(found)
    if base is None:
        hidden.setdefault(WHEEL_RADIUS_DIFF.name, "it needs the wheelbase; give --robot with wheels.base")
    shown = [a for a in calibrated_effects(found, base) if a.name not in hidden]
    return ChannelResult(
        channel="odometry",
        effects=effects,
        within_tolerance=tuple(a for a in shown if _is_significant(a) and not is_material(a)),
        considered=tuple(map(_entry, shown)),
        not_observable=hidden,
        notes={"calibration": "from driving alone"},
    )


def driving_ledger(found: DrivingCalibration, change: Change | None, wheels: ChannelResult) -> Ledger:
    """Return the ledger of one run without an arena: all effects, and a change during the run.

    Parameters
    ----------
    change : Change during the run, if there is one.
    wheels : The odometry channel of the run (`driving_channel`).
    """
    wheels = replace(
        wheels,
        considered=(*wheels.considered, _change_entry(found, change)),
        unknown=None if change is None else _unknown(change),
        notes={},
    )
    tested = {entry.name for entry in wheels.considered}
    unseen = {name: NEEDS_ARENA for name in EFFECTS if name not in tested}
    unseen |= {LATENCY.name: _relative_delay(found), **wheels.not_observable}
    channels = (ChannelResult(channel="scan"), wheels, ChannelResult(channel="drive"))
    entries = ledger_of({one.channel: replace(one, not_observable=unseen) for one in channels})
    return Ledger(
        entries=tuple(entry for entry in entries if entry.facts.has_name or entry.name == CHANGE[0])
    )


def _relative_delay(found: DrivingCalibration) -> str:
    """Return why driving alone names no latency."""
    delay, error = found.of("delay")
    return (
        f"the scan delay of {QUANTITIES['delay'].text(delay, error)} is relative to the odometry; "
        "only reference poses can show which of the two is late"
    )


def _entry(a: Amendment) -> Entry:
    """Return the entry of an effect of wheels or mount."""
    facts = Facts(
        has_name=True, accepted=_is_significant(a), evidence=a.evidence, threshold=THRESHOLD, is_material=is_material(a)
    )  # fmt: skip
    remark = f"it is smaller than what matters ({least_size(a.effect)})"
    return replace(effect_entry(a, facts), remark=remark)


def _is_significant(a: Amendment) -> bool:
    return a.evidence is not None and a.evidence > THRESHOLD


def _change_entry(found: DrivingCalibration, change: Change | None) -> Entry:
    """Return the entry of a change of wheels or mount during the run."""
    name, title = CHANGE
    if change is None:
        why = "" if is_long_enough(found) else "the drive is too short to show a change during it"
        weak = Facts(has_name=False, evidence=None if why else 0.0, threshold=THRESHOLD, not_tried=why)
        return Entry(name=name, channel="odometry", title=title, facts=weak)
    one, q = change.difference, QUANTITIES[change.difference.name]
    facts = Facts(has_name=False, accepted=True, evidence=change.evidence, threshold=THRESHOLD)
    estimate = f"{q.title} by {q.text(one.value, one.stderr)} at about {change.at_s:.0f} s"
    return Entry(name=name, channel="odometry", title=title, facts=facts, estimate=estimate)


def _unknown(change: Change) -> Unknown:
    """Return a change during the run as a difference without a name."""
    return Unknown(
        statement=change.sentence,
        statistic=change.evidence,
        threshold=THRESHOLD,
        family=CHANGE[0],
        families=(QUANTITIES[change.difference.name].causes,),
    )
