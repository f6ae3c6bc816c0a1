"""Express a calibration from driving alone as effects and as sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.motion.calibration.comparison import Change, Difference
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.motion.calibration.words import QUANTITIES
from sensorgraph.effects import Amendment
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF

SURE = 2.64
"""Standard errors. Of 100 robots without any error, five exceed it in one of the six parameters."""
LEAST_DRIFT = 0.005
"""[m/m] minimum drift with the floor that is reported."""


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
        if name not in found.hidden and abs(d) > max(SURE * sd, q[name].materiality)
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
    q = QUANTITIES
    (way, way_sd), (turn, turn_sd), (bias, bias_sd) = (found.of(name) for name in PARAMETERS[:3])
    scale = f"correction to the odometry (in {found.metre} length scale)"
    shown = {
        "way_scale": f"{q['way_scale'].text(way - 1, way_sd)}, {scale}",
        "turn_scale": f"{q['turn_scale'].text(turn - 1, turn_sd)}, correction to the odometry",
        "heading_bias": f"{q['heading_bias'].text(bias, bias_sd)}, missing in the odometry (wheels of unequal size)",
    }
    lines = [f"{q[name].title}: {text}" for name, text in shown.items() if name not in found.hidden]
    lines += [*_mount_lines(found), *_delay_lines(found), *_floor_lines(found)]
    return lines + [f"{q[name].title}: not observable, {why}" for name, why in found.hidden.items()]


def _mount_lines(found: DrivingCalibration) -> list[str]:
    """Return the mount as one line, or as one per quantity if the drive does not show all of it."""
    names, q = PARAMETERS[3:], QUANTITIES
    mount = {name: q[name].text(*found.of(name)) for name in names if name not in found.hidden}
    scaled = zip(names, found.mount * [100.0, 100.0, float(np.degrees(1.0))], ("cm", "cm", "°"), strict=True)
    stated = {
        name: f"{v:.1f}{'' if unit == '°' else ' '}{unit}".replace("-", "−") for name, v, unit in scaled
    }
    if len(mount) < len(names):
        return [f"{q[name].title}: {text} (specified: {stated[name]})" for name, text in mount.items()]
    x, y, phi = mount.values()
    return [
        f"laser: {x} ahead of the axle, {y} to the left, turned by {phi} (specified: {', '.join(stated.values())})"
    ]


def _delay_lines(found: DrivingCalibration) -> list[str]:
    """Return the delay between scans and odometry, also if there is none."""
    if "delay" in found.hidden:
        return []
    delay, sd = found.of("delay")
    q = QUANTITIES["delay"]
    if abs(delay) > max(SURE * sd, q.materiality):
        older = "older" if delay < 0 else "newer"
        return [
            f"scan delay: scans are {1e3 * abs(delay):.0f} ± {1e3 * sd:.0f} ms {older} than the odometry at their stamps"
        ]
    return [f"scan delay: {q.text(delay, sd)}, none that matters"]


def _floor_lines(found: DrivingCalibration) -> list[str]:
    """Return the drift with the floor, if there is one."""
    drift = found.values[-2:]
    size, sd = float(np.hypot(*drift)), float(found.stderr[-2:].max())
    if size <= max(LEAST_DRIFT, SURE * sd):
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
    one, q = change.difference, QUANTITIES[change.difference.name]
    return [
        f"The {q.title} changes during the run, at about {change.at_s:.0f} s, by {q.text(one.value, one.stderr)}: {q.causes}"
    ]
