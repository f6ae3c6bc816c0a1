"""Robot: the contents of robot.yaml, parsed and checked."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

from logs.run import RangeSensor
from planners.vehicle import DRIVES, Limits, Vehicle
from planners.yaml_text import parse_yaml
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error, refuse_unknown
from sensorgraph.types import Floats
from sensorgraph.world.robot_sensor import OWN_KEYS, SENSOR_DEFAULTS, parse_sensors, sensor_of
from sensorgraph.world.robot_values import section, value_of

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PoseReference:
    """External pose reference, such as an overhead camera."""

    rate: float = 30.0
    """[Hz]"""
    sigma_xy: float = 0.002
    """[m] White noise of x and of y."""
    sigma_yaw: float = 0.0015
    """[rad] White noise of phi."""


@dataclass(frozen=True, kw_only=True)
class Wheels:
    """A differential pair of wheels, and the noise of its odometry."""

    radius: float = 0.10
    """[m]"""
    base: float = 0.40
    """[m] Distance between the wheels."""
    sigma_v: float = 0.004
    """[m/s] White noise of the measured speed."""
    sigma_omega: float = 0.006
    """[rad/s] White noise of the measured turn rate."""
    rate: float = 20.0
    """[Hz] Rate of odometry and of commands."""


@dataclass(frozen=True, kw_only=True)
class Actuators:
    """First-order motors with dead time."""

    tau: float = 0.10
    """[s] Time constant of v and omega after a step of the command."""
    delay: float = 0.0
    """[s] Time between a command and its first effect. A delay of at least half of `control_period` may
    include the mean wait for a control tick."""


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Standard deviations of a careful setup; smaller deviations than 2.5 times these are nuisances, not effects."""

    map: float = 0.0045
    """[m] Vertices of the map."""
    mount_xy: float = 0.0018
    """[m] Laser in base_link."""
    mount_yaw: float = 0.0006
    """[rad]"""
    pose_xy: float = 0.0022
    """[m] Reference pose."""
    pose_yaw: float = 0.0015
    """[rad]"""
    stamp: float = 0.0035
    """[s] Clocks."""
    control_period: float = 0.05
    """[s] Period of the base's control loop. A command waits for the next tick, so that its delay is uniform
    over one period."""
    transport_jitter: float = 0.005
    """[s] Standard deviation of the transport time of a command from its stamp to the base."""


@dataclass(frozen=True, kw_only=True)
class Robot(Vehicle):
    """All of robot.yaml: the vehicle of the planners, its range sensor, and the noise of its parts."""

    sensor: RangeSensor
    pose: PoseReference = field(default_factory=PoseReference)
    wheels: Wheels = field(default_factory=Wheels)
    actuators: Actuators = field(default_factory=Actuators)
    tolerances: Tolerances = field(default_factory=Tolerances)
    stated: frozenset[str] = frozenset()
    """Keys that the file contains, such as `tolerances.map` or `sensors`; all others have their defaults, which
    are not held against a log."""
    mounts: Mapping[str, Floats] = field(default_factory=dict)
    """Name of each of several sensors (its topic or frame in logs) -> (3,) [m, m, rad] in base_link."""
    text: str = ""
    """Text of the file, kept for the record."""

    def __repr__(self) -> str:
        """Summarise the robot in one line."""
        return f"Robot {self.name}: {self.drive}, radius {self.footprint_radius:g} m, {self.limits}, {self.sensor}"

    @property
    def stated_base(self) -> float | None:
        """[m] Distance between the wheels; None if the file does not contain it."""
        return self.wheels.base if "wheels.base" in self.stated else None


SECTIONS: dict[str, dict[str, Any]] = {
    "limits": asdict(Limits()),
    "sensor": SENSOR_DEFAULTS,
    "pose": asdict(PoseReference()),
    "wheels": asdict(Wheels()),
    "actuators": asdict(Actuators()),
    "tolerances": asdict(Tolerances()),
}
TOP: dict[str, Any] = {f.name: f.default for f in fields(Vehicle) if f.name != "limits"}


def default_robot() -> Robot:
    """Return the robot of an empty file."""
    return parse_robot("")


@as_sensorgraph_error
def load_robot(path: Path | str | None = None) -> Robot:
    """Read a robot.yaml; without a path, that of the shipped robot.

    Raises
    ------
    SensorgraphError : The file does not exist or is invalid.
    """
    if path is None:
        return parse_robot((files("sensorgraph.data") / "radix.yaml").read_text(), name="radix.yaml")
    path = Path(path)
    if path.is_dir():
        raise SensorgraphError(f"{path} is a directory, expected a robot.yaml file")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as exc:
        raise SensorgraphError(f"{path} is not a text file, expected a robot.yaml") from exc
    if not text.strip():
        logger.warning("%s is empty: every value is the default of robot.yaml", path)
    return parse_robot(text, name=str(path))


def parse_robot(text: str, *, name: str = "robot.yaml") -> Robot:
    """Parse the text of a robot.yaml; missing keys have their defaults.

    Raises
    ------
    SensorgraphError : The text is not YAML, a key is unknown, or a value is invalid. The message contains
        `name`.
    """
    try:
        data = parse_yaml(text)
    except ValueError as exc:
        raise SensorgraphError(f"{name}: not YAML: {exc}") from exc
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise SensorgraphError(
            f"{name}: contains a {type(data).__name__}, expected keys such as `name:`, `drive:`, `limits:`"
        )
    if {"features", "image"} & set(data):
        raise SensorgraphError(
            f"{name}: contains an arena (keys {', '.join(map(str, [*data][:4]))}), expected a robot.yaml; are arena and robot swapped?"
        )
    refuse_unknown(data, [*TOP, *SECTIONS, "sensors"], "key", where=name)
    values = {key: section(name, key, data.get(key), defaults) for key, defaults in SECTIONS.items()}
    top = {key: value_of(name, key, data.get(key, default), default) for key, default in TOP.items()}
    if top["drive"] not in DRIVES:
        raise SensorgraphError(f"{name}: drive is {top['drive']!r}, expected one of {', '.join(DRIVES)}")
    several = None if data.get("sensors") is None else parse_sensors(name, data["sensors"])
    stated = {key: frozenset(data.get(key) or ()) for key in SECTIONS}
    extra = [key for key in OWN_KEYS if several is not None and key in stated["sensor"]]
    if extra:
        raise SensorgraphError(
            f"{name}: `sensor.{extra[0]}` does not go with `sensors`, where each sensor has its own; `sensor` has only "
            "the shared keys: range_min, range_max, sigma, resolution, rate, height"
        )
    try:
        return Robot(
            **top,
            limits=Limits(**values["limits"]),
            sensor=sensor_of(values["sensor"], stated["sensor"], several),
            pose=PoseReference(**values["pose"]),
            wheels=Wheels(**values["wheels"]),
            actuators=Actuators(**values["actuators"]),
            tolerances=Tolerances(**values["tolerances"]),
            stated=frozenset(f"{key}.{one}" for key, keys in stated.items() for one in keys)
            | ({"sensors"} if several is not None else frozenset()),
            mounts={part.name: part.mount for part in several or [] if part.name},
            text=text,
        )
    except ValueError as exc:
        raise SensorgraphError(f"{name}: {exc}") from exc
