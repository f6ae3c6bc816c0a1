"""robot.yaml: mount, time and limits of the laser, motors and wheels."""

from __future__ import annotations

import math
from collections.abc import Callable

import yaml

from sensorgraph.amending.findings import CannotHoldError, MeasuredLaser, apply, why
from sensorgraph.amending.text import Why
from sensorgraph.amending.yaml_text import YamlFile, as_number
from sensorgraph.effects import Amendment, Effect
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.max_range import MAX_RANGE
from sensorgraph.effects.min_range import MIN_RANGE
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.quantisation import QUANTISATION
from sensorgraph.effects.scan_skew import SCAN_SKEW
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.world.robot import Robot, parse_robot
from sensorgraph.world.robot_values import value_of

WHAT = "robot.yaml"


def amend_robot(
    data: YamlFile,
    amendments: tuple[Amendment, ...],
    *,
    laser: str | None,
    measured: MeasuredLaser | None,
    file: str,
) -> list[str]:
    """Amend a robot.yaml; return what it cannot hold, one line each.

    Raises
    ------
    SensorgraphError : The file is not a robot.yaml.
    """
    robot = parse_robot(data.file.data.decode("utf-8"), name=file)
    writer = _RobotFile(data, robot)
    sensor, wheels, motors = robot.sensor, robot.wheels, robot.actuators
    top = why_inverse(wheels.radius), why_inverse(wheels.base)
    handlers: dict[Effect, Callable[[Amendment], None]] = {
        MOUNT_XY: writer.mount_xy,
        MOUNT_YAW: lambda a: writer.mount(2, a["delta"], why(a, "delta")),
        LATENCY: lambda a: writer.put("sensor", "first_ray_delay", lambda old: old - a["tau"], why(a, "tau")),
        SCAN_SKEW: lambda a: writer.put(
            "sensor", "sweep_time", lambda old: _longer(old, a["T"]), why(a, "T")
        ),
        MAX_RANGE: lambda a: writer.put(
            "sensor", "range_max", lambda _: a["R"], why(a, "R"), sensor.range_max
        ),
        MIN_RANGE: lambda a: writer.put(
            "sensor", "range_min", lambda _: a["r_min"], why(a, "r_min"), sensor.range_min
        ),
        QUANTISATION: lambda a: writer.put("sensor", "resolution", lambda _: a["q"], why(a, "q")),
        ACTUATOR_LAG: lambda a: writer.put(
            "actuators", "tau", lambda old: max(old + a["tau"], 0.0), why(a, "tau"), motors.tau
        ),
        DEAD_TIME: lambda a: writer.put(
            "actuators", "delay", lambda old: max(old + a["L"], 0.0), why(a, "L"), motors.delay
        ),
        SPEED_SATURATION: lambda a: writer.put(
            "limits", "v", lambda old: min(old, a["v_max"]), why(a, "v_max"), robot.limits.v
        ),
        WHEEL_RADIUS: lambda a: writer.put(
            "wheels", "radius", lambda old: old / (1 + a["s"]), top[0](a), wheels.radius
        ),
        WHEEL_BASE: lambda a: writer.put(
            "wheels", "base", lambda old: old / (1 + a["s"]), top[1](a), wheels.base
        ),
    }
    lines = apply(amendments, handlers, WHAT, file, [data.file])
    lines += [
        f"{file}: the odometry of old logs keeps the {a.effect.title} ({a.name}) that its driver assumed; "
        "keep the effect for them"
        for a in amendments
        if a.effect in (WHEEL_RADIUS, WHEEL_BASE)
    ]
    if measured is not None:
        cause = Why(cause=f"as in {measured.name}", sigma=measured.rate_sigma)
        if abs(sensor.rate - measured.rate) > 3 * measured.rate_sigma:
            writer.put("sensor", "rate", lambda _: measured.rate, cause, sensor.rate)
    return lines


def why_inverse(size: float) -> Callable[[Amendment], Why]:
    """Return the function of the reason for a length that an effect divides by 1 + s."""
    return lambda a: why(a, "s", per=size)


def _longer(sweep: float, by: float) -> float:
    """Return a sweep time [s] with more time; a negative one takes the last ray first."""
    return math.copysign(abs(sweep) + by, sweep)


class _RobotFile:
    """Changes of keys, which are added if they are missing."""

    def __init__(self, data: YamlFile, robot: Robot) -> None:
        self.data, self.robot = data, robot

    def put(
        self, section: str, key: str, new: Callable[[float], float], reason: Why, default: float = 0.0
    ) -> None:
        """Write a key; a value with a unit is replaced by SI."""
        node = self.data.find(section, key)
        if node is None:
            self.data.add(self.data.find(section), (section, key), f"{new(default):.6g}", reason)
            return
        old = as_number(node)
        if old is None:  # with a unit, as in 20 ms
            old = value_of(self.data.file.path.name, f"{section}.{key}", node.value, default)
        self.data.put(node, new(old), reason)
        self.data.check_anchors()

    def mount_xy(self, a: Amendment) -> None:
        """Move the laser."""
        self.mount(0, a["dx"], why(a, "dx"))
        self.mount(1, a["dy"], why(a, "dy"))

    def mount(self, index: int, change: float, reason: Why) -> None:
        """Add to a number of the mount."""
        if "sensors" in self.robot.stated:
            raise CannotHoldError("it has several sensors, each with a mount")
        node = self.data.find("sensor", "mount")
        if isinstance(node, yaml.SequenceNode) and len(node.value) == 3:
            old = as_number(node.value[index])
            old = float(self.robot.sensor.mount[index]) if old is None else old  # with a unit, as in 5 cm
            self.data.put(node.value[index], old + change, reason)
            return
        values = [float(one) for one in self.robot.sensor.mount]
        values[index] += change
        text = f"[{', '.join(f'{one:.6g}' for one in values)}]"
        if node is not None:
            raise CannotHoldError("its mount is not a list of three numbers")
        self.data.add(self.data.find("sensor"), ("sensor", "mount"), text, reason)
