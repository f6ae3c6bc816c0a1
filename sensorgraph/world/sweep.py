"""Ray times of a laser, where robot.yaml and log may disagree: only what robot.yaml states replaces the log."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from logs.run import RangeSensor, Run, rare_times
from logs.sweep import differs
from sensorgraph.errors import SensorgraphError
from sensorgraph.world.robot import Robot

RAY_TIMES, FROM_ROBOT = "ray_times", "robot.yaml"
"""Key and value of `Run.meta` that mark ray times which robot.yaml states; a localization does not replace them."""
INTERLACED = ("interlaced_sweeps", "sweep_period")


def with_stated_times(logged: RangeSensor, robot: Robot) -> RangeSensor:
    """Return the sensor of a log with the ray times that robot.yaml states.

    The direction of a sweep is that of the log, unless robot.yaml states a clockwise one or an `angle_increment`.

    Raises
    ------
    SensorgraphError : The stated times contradict those of the log.
    """
    described, stated = robot.sensor, robot.stated
    times: dict[str, Any] = {}
    if "sensor.sweep_time" in stated:
        is_known = described.is_clockwise or "sensor.angle_increment" in stated
        is_clockwise = described.is_clockwise if is_known else logged.is_clockwise
        times["sweep_time"] = math.copysign(described.sweep_time, -1.0 if is_clockwise else 1.0)
    if any(f"sensor.{name}" in stated for name in INTERLACED):
        times |= {name: getattr(described, name) for name in INTERLACED}
    if times:  # they replace those of several lasers that are read as one
        times["delays"] = np.zeros(0)
    if "sensor.first_ray_delay" in stated:
        times["first_ray_delay"] = described.first_ray_delay
    try:
        return replace(logged, **times)
    except ValueError as exc:
        raise SensorgraphError(
            f"the ray times of robot.yaml do not go with those of the log: {exc}; state interlaced_sweeps and "
            "sweep_period in robot.yaml"
        ) from exc


def states_times(robot: Robot) -> bool:
    """Return whether robot.yaml states any ray time."""
    names = ("sweep_time", *INTERLACED, "first_ray_delay")
    return any(f"sensor.{name}" in robot.stated for name in names)


def sweep_warning(run: Run, robot: Robot, *, name: str = "robot.yaml") -> str | None:
    """Return a warning if robot.yaml states other ray times than the log; None if they agree.

    Raises
    ------
    SensorgraphError : The stated times contradict those of the log.
    """
    logged, used = run.sensor, with_stated_times(run.sensor, robot)
    if differs(abs(logged.sweep_time), abs(used.sweep_time)):
        return (
            f"a sweep takes {abs(logged.sweep_time):.3g} s in the log and {abs(used.sweep_time):.3g} s in {name} "
            f"(`sensor.sweep_time`), which is used"
        )
    if used.sweep_time and logged.is_clockwise != used.is_clockwise:
        ways = [f"{'' if one.is_clockwise else 'counter-'}clockwise" for one in (logged, used)]
        return f"a sweep is {ways[0]} in the log and {ways[1]} in {name} (`sensor.sweep_time`), which is used"
    if rare_times(logged) == rare_times(used):
        return None
    return f"the log has {_rare_text(logged)}; {name} has {_rare_text(used)}, which is used"


def _rare_text(sensor: RangeSensor) -> str:
    delay = f"ray 0 at {sensor.first_ray_delay:.3g} s after the stamp"
    if sensor.interlaced_sweeps == 1:
        return f"one sweep per scan and {delay}"
    return f"{sensor.interlaced_sweeps} sweeps per scan, {sensor.sweep_period:.3g} s apart, and {delay}"


def with_sweep_of(run: Run, robot: Robot) -> Run:
    """Return a run with the ray times that robot.yaml states, marked in `meta`; without any, the run itself.

    Drivers often leave `time_increment` at 0, or set a wrong value or direction. The stamp of a message is the time of
    the ray that is taken first; the stamp of a run is that of ray 0, which a clockwise laser takes last.

    Raises
    ------
    SensorgraphError : The stated times contradict those of the log.
    """
    if not states_times(robot):
        return run
    if sweep_warning(run, robot) is not None:
        used = with_stated_times(run.sensor, robot)
        later = used.ray_0_after_first - run.sensor.ray_0_after_first
        run = replace(run, sensor=used, stamps=run.stamps + later)
    if run.meta.get(RAY_TIMES) == FROM_ROBOT:
        return run
    return replace(run, meta={**run.meta, RAY_TIMES: FROM_ROBOT})
