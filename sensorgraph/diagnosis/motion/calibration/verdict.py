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
LEAST_DELAY = 0.01
"""[s] minimum delay that is reported."""
LEAST_DRIFT = 0.005
"""[m/m] minimum drift with the floor that is reported."""


def effects_of(found: DrivingCalibration, base: float | None) -> tuple[Amendment, ...]:
    """Return the material effects of wheels and mount, for `record` and `export`.

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
    named = []
    for effect, values, errors in known:
        sizes = {p.name: abs(values[p.name]) / errors[p.name] for p in effect.parameters}
        if any(
            sizes[p.name] > SURE and abs(values[p.name]) > (p.materiality or 0.0) for p in effect.parameters
        ):
            evidence = 0.5 * max(sizes.values()) ** 2
            named.append(Amendment(effect=effect, parameters=values, stderr=errors, evidence=evidence))
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
        if abs(d) > max(SURE * sd, q[name].materiality)
    ]
    if told:
        return f"Wheels and mount differ from the specified values: {', '.join(told)}."
    return "Wheels and mount agree with the specified values, within the accuracy of driving alone."


def source_of(found: DrivingCalibration) -> str:
    """Return the length and duration of the drive."""
    return (
        f"from driving alone, {found.way_m:.0f} m and {found.turn_rad / (2 * np.pi):.0f} full turns in "
        f"{found.duration_s / 60:.0f} min"
    )


def lines_of(found: DrivingCalibration) -> list[str]:
    """Return the calibration of one run, one line per quantity."""
    q = QUANTITIES
    (way, way_sd), (turn, turn_sd), (bias, bias_sd) = (found.of(name) for name in PARAMETERS[:3])
    mount = [q[name].text(*found.of(name)) for name in PARAMETERS[3:]]
    stated = [f"{v:.1f}".replace("-", "−") for v in found.mount * [100.0, 100.0, float(np.degrees(1.0))]]
    lines = [
        f"distance scale: {q['way_scale'].text(way - 1, way_sd)}, correction to the odometry (in {found.metre} length scale)",
        f"turn scale: {q['turn_scale'].text(turn - 1, turn_sd)}, correction to the odometry",
        f"heading bias: {q['heading_bias'].text(bias, bias_sd)}, missing in the odometry (wheels of unequal size)",
        f"laser: {mount[0]} ahead of the axle, {mount[1]} to the left, turned by {mount[2]} (specified: "
        f"{stated[0]} cm, {stated[1]} cm, {stated[2]}°)",
    ]
    delay, delay_sd = found.of("delay")
    if abs(delay) > LEAST_DELAY and abs(delay) > SURE * delay_sd:
        older = "older" if delay < 0 else "newer"
        lines.append(
            f"scan delay: scans are {1e3 * abs(delay):.0f} ± {1e3 * delay_sd:.0f} ms {older} than the odometry at their stamps"
        )
    drift = found.values[-2:]
    size, sd = float(np.hypot(*drift)), float(found.stderr[-2:].max())
    if size > LEAST_DRIFT and size > SURE * sd:
        lines.append(
            f"floor: moves the robot {100 * size:.1f} ± {100 * sd:.1f} cm per metre towards "
            f"{np.degrees(np.arctan2(drift[1], drift[0])) % 360:.0f}° of the map (a slope, the nap of a carpet)"
        )
    return lines


def difference_line(one: Difference, first: str, second: str) -> str:
    """Return the difference of a parameter between two runs, with its possible causes."""
    q = QUANTITIES[one.name]
    return (
        f"{q.title} of {second} differs from that of {first} by {q.text(one.value, one.stderr)}: {q.causes}"
    )


def verdict(differences: Sequence[Difference], first: str, second: str) -> list[str]:
    """Return the lines that state whether two runs agree."""
    told = [d for d in differences if d.differs and d.is_material]
    small = [d for d in differences if d.differs and not d.is_material]
    if told:
        lines = ["The two runs differ.", *(difference_line(d, first, second) for d in told)]
    else:
        worst = max(differences, key=lambda d: abs(d.value) / d.stderr)
        lines = [
            f"The two runs agree in wheels and mount (largest difference {abs(worst.value) / worst.stderr:.1f} standard "
            f"errors, {QUANTITIES[worst.name].title})."
        ]
    lines += [f"Too small to matter: {difference_line(d, first, second)}" for d in small]
    return lines


def change_lines(change: Change | None) -> list[str]:
    """Return the line that states whether wheels and mount stayed constant during the run."""
    if change is None:
        return ["Wheels and mount are constant during the run."]
    one, q = change.difference, QUANTITIES[change.difference.name]
    return [
        f"The {q.title} changes during the run, at about {change.at_s:.0f} s, by {q.text(one.value, one.stderr)}: {q.causes}"
    ]
