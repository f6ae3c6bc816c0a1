"""Robot and log: what robot.yaml does not state is taken from the log, and what it states must agree."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np

from logs.run import RangeSensor, Run
from logs.sensor import median_step
from planners.yaml_text import parse_yaml
from sensorgraph.errors import SensorgraphError
from sensorgraph.quantities import ROUNDED
from sensorgraph.types import Floats
from sensorgraph.world.ray_order import SAME_BEARING, bearings_text, is_full_turn, ray_order
from sensorgraph.world.robot import Robot
from sensorgraph.world.robot_sensor import ANGLE_KEYS
from sensorgraph.world.sweep import FROM_ROBOT, sweep_warning, with_stated_times, with_sweep_of

MOUNT = "mount"
"""Key of `Run.meta` that marks a mount which robot.yaml states; its value is `unknown` if the log has no transform."""
TIMES = ("sweep_time", "interlaced_sweeps", "sweep_period", "first_ray_delay")
LOGGED = ("range_min", "range_max", "rate")
"""Fields that every log contains."""
RARELY_LOGGED = ("sigma", "resolution", "height")
"""Fields that are 0 in a log that does not contain them."""


def with_robot(run: Run, robot: Robot, *, name: str = "the log", robot_name: str = "robot.yaml") -> Run:
    """Return a run with the ray times and the mount of a single laser that robot.yaml states.

    Parameters
    ----------
    name, robot_name : Files of run and robot, for messages.

    Raises
    ------
    SensorgraphError : robot.yaml states other rays than those of the run.
    """
    if other := other_rays(robot, run.sensor.bearings, name=name, robot_name=robot_name):
        raise SensorgraphError(other)
    run = with_sweep_of(run, robot)
    mount, is_used = robot.sensor.mount, "sensor.mount" in robot.stated and not run.sensor.is_composite
    if not is_used or (run.meta.get(MOUNT) == FROM_ROBOT and np.array_equal(mount, run.sensor.mount)):
        return run
    return replace(run, sensor=replace(run.sensor, mount=mount), meta={**run.meta, MOUNT: FROM_ROBOT})


def other_rays(robot: Robot, bearings: Floats, *, name: str, robot_name: str = "robot.yaml") -> str:
    """Return an error text if rays (n_rays,) [rad] differ from those that robot.yaml states; empty if they agree."""
    if _are_as_stated(robot, bearings):
        return ""
    keys = rays_text(bearings)
    return (
        f"the rays of {name} differ from those of {robot_name} ({bearings_text(bearings, robot.sensor.bearings)}); "
        "give the robot.yaml of the robot that recorded the run, or "
        + (f"write sensor: {{{keys}}}" if keys else "remove its keys of the rays")
    )


def differences(run: Run, robot: Robot, *, robot_name: str) -> tuple[str, str]:
    """Return texts for rays and for ray times of robot.yaml that differ from those of the log; empty where they agree."""
    rays = other_rays(robot, run.sensor.bearings, name="the log", robot_name=robot_name)
    return rays, sweep_warning(run, robot, name=robot_name) or ""


def _are_as_stated(robot: Robot, bearings: Floats) -> bool:
    """Return whether rays (n_rays,) [rad] are as robot.yaml states them, apart from rounded angles."""
    described, n = robot.sensor.bearings, len(bearings)
    step = median_step(bearings, 2 * np.pi)
    tolerance = max(SAME_BEARING, min(step / 2, ROUNDED))
    if _states_all_rays(robot):
        return ray_order(bearings, described, tolerance=tolerance) is not None
    if "sensor.n_rays" in robot.stated:
        return len(described) == n
    if "sensor.fov" in robot.stated:
        return abs(_field_of_view(described) - _field_of_view(bearings)) <= 2 * tolerance
    return True


def _field_of_view(bearings: Floats) -> float:
    """Return the field of view [rad] of increasing bearings (n_rays,): a full turn includes the step to the first ray."""
    span = float(np.ptp(bearings))
    return 2 * np.pi if is_full_turn(bearings) else span


def _states_all_rays(robot: Robot) -> bool:
    """Return whether robot.yaml determines the bearings."""
    keys = ({"sensors"}, *({f"sensor.{name}"} for name in ANGLE_KEYS), {"sensor.n_rays", "sensor.fov"})
    return any(some <= robot.stated for some in keys)


def rays_text(bearings: Floats) -> str:
    """Return the keys that describe evenly spaced rays (n_rays,) [rad] in a robot.yaml; empty if they are not."""
    n = len(bearings)
    if n < 2 or np.ptp(np.diff(bearings)) > SAME_BEARING / n:
        return ""
    first, last = np.degrees(bearings[[0, -1]])
    return f"angle_min: {first:.6g} deg, angle_max: {last:.6g} deg, n_rays: {n}"


def completed(robot: Robot, logged: RangeSensor) -> Robot:
    """Return the robot with the values of the sensor that robot.yaml does not state, from a log.

    Raises
    ------
    SensorgraphError : Values of robot.yaml and log contradict each other, such as range_min and range_max.
    """
    timed, stated = with_stated_times(logged, robot), robot.stated
    taken: dict[str, Any] = {name: getattr(timed, name) for name in TIMES}
    taken |= {name: getattr(logged, name) for name in LOGGED if f"sensor.{name}" not in stated}
    for name in RARELY_LOGGED:
        if f"sensor.{name}" not in stated and getattr(logged, name) > 0:
            taken[name] = getattr(logged, name)
    if not {"sensor.mount", "sensors"} & stated:
        taken["mount"] = logged.mount
    if logged.n_rays == robot.sensor.n_rays:
        taken["delays"] = timed.delays
    if not _states_all_rays(robot) and _are_as_stated(robot, logged.bearings):
        taken |= {name: getattr(logged, name) for name in ("bearings", "origins", "cones", "delays")}
    changed = [
        name for name, value in taken.items() if not np.array_equal(value, getattr(robot.sensor, name))
    ]
    if not changed:
        return robot
    try:
        sensor = replace(robot.sensor, **taken)
    except ValueError as exc:
        raise SensorgraphError(
            f"values of the sensor in robot.yaml and in the log contradict each other: {exc}"
        ) from exc
    return replace(robot, sensor=sensor, text=_text_with(robot, sensor, changed))


def _text_with(robot: Robot, sensor: RangeSensor, changed: list[str]) -> str:
    """Return the text of robot.yaml with values of the sensor that it does not state.

    Bearings that are not evenly spaced cannot be written.
    """
    data = parse_yaml(robot.text) or {}
    own: dict[str, Any] = dict(data.get("sensor") or {})
    for name in changed:
        if name == "bearings" and rays_text(sensor.bearings):
            own.pop("fov", None)
            first, last = sensor.bearings[[0, -1]].tolist()
            own |= {"angle_min": first, "angle_max": last, "n_rays": sensor.n_rays}
        elif name == "mount":
            own[name] = sensor.mount.tolist()
        elif name not in ("bearings", "origins", "cones", "delays") and f"sensor.{name}" not in robot.stated:
            own[name] = getattr(sensor, name)
            if (
                name == "sweep_time" and robot.sensor.is_clockwise
            ):  # the file lists the rays in descending order
                own[name] = -own[name]
    lines = (f"{key}: {json.dumps(value)}" for key, value in ({**data, "sensor": own}).items())
    return "\n".join(lines) + "\n"
