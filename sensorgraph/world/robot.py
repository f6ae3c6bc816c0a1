"""Robot: the contents of robot.yaml, parsed and checked."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from logs.run import RangeSensor
from planners.arena import wrap
from planners.vehicle import DRIVES, Limits, Vehicle
from planners.yaml_text import parse_yaml
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Floats


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
    """Keys of sections that the file contains, such as `tolerances.map`; all others have their defaults."""
    mounts: Mapping[str, Floats] = field(default_factory=dict)
    """Name of each of several sensors (its topic or frame in logs) -> (3,) [m, m, rad] in base_link."""
    text: str = ""
    """Text of the file, kept for the record."""


SENSOR_DEFAULTS: dict[str, Any] = {
    "mount": [0.10, 0.0, 0.0],
    "n_rays": 181,
    "fov": 3.14159265,
    "range_min": 0.05,
    "range_max": 8.0,
    "sigma": 0.01,
    "resolution": 0.001,
    "rate": 10.0,
    "sweep_time": 0.0,
    "interlaced_sweeps": 1,
    "sweep_period": 0.0,
    "first_ray_delay": 0.0,
    "height": 0.30,
}
SECTIONS: dict[str, dict[str, Any]] = {
    "limits": asdict(Limits()),
    "sensor": SENSOR_DEFAULTS,
    "pose": asdict(PoseReference()),
    "wheels": asdict(Wheels()),
    "actuators": asdict(Actuators()),
    "tolerances": asdict(Tolerances()),
}
RING: dict[str, Any] = {"name": "", "ring": 16, "radius": 0.2, "first": 0.0, "cone": 0.0}
"""Sensors on a ring around the robot that look outwards: number, radius [m], and bearing of the first [rad].
The k-th is called `name` followed by k."""
MOUNTED: dict[str, Any] = {"name": "", "mount": [0.0, 0.0, 0.0], "cone": 0.0, "n_rays": 1, "fov": 3.14159265}
"""A sensor with its mount in base_link, named like its topic or frame in logs; with several rays, a laser."""
TOP: dict[str, Any] = {f.name: f.default for f in fields(Vehicle) if f.name != "limits"}
MOST = {"n_rays": 100_000, "ring": 1000, "rate": 10_000.0}
POSITIVE = {
    "v",
    "omega",
    "a",
    "alpha",
    "n_rays",
    "interlaced_sweeps",
    "fov",
    "range_max",
    "rate",
    "radius",
    "ring",
    "base",
    "footprint_radius",
}
SIGNED = {"first_ray_delay"}


ANGLES = ("fov", "cone", "first", "_yaw")
"""Suffixes of the keys whose values [rad] may be written in degrees, as `270 deg`; so may the yaw of a
`mount`."""
ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180}


def default_robot() -> Robot:
    """Return the robot of an empty file."""
    return parse_robot("")


def load_robot(path: Path | str | None = None) -> Robot:
    """Read a robot.yaml; without a path, that of the shipped robot.

    Raises
    ------
    SensorgraphError : The file is invalid; the message is one line. OSError if it cannot be opened.
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
    _reject_unknown(name, "", data, [*TOP, *SECTIONS, "sensors"])
    values = {key: _section(name, key, data.get(key), defaults) for key, defaults in SECTIONS.items()}
    top = {key: _value(name, key, data.get(key, default), default) for key, default in TOP.items()}
    if top["drive"] not in DRIVES:
        raise SensorgraphError(f"{name}: drive is {top['drive']!r}, expected one of {', '.join(DRIVES)}")
    sensors = None if data.get("sensors") is None else parse_sensors(name, data["sensors"])
    if sensors is not None:
        extra = [
            key
            for key in ("mount", "n_rays", "fov", "interlaced_sweeps")
            if key in (data.get("sensor") or {})
        ]
        if extra:
            raise SensorgraphError(
                f"{name}: `sensor.{extra[0]}` does not go with `sensors`, where each sensor has its own; `sensor` has only "
                "the shared keys: range_min, range_max, sigma, resolution, rate, height"
            )
    try:
        return Robot(
            **top,
            limits=Limits(**values["limits"]),
            sensor=_sensor(values["sensor"], sensors),
            pose=PoseReference(**values["pose"]),
            wheels=Wheels(**values["wheels"]),
            actuators=Actuators(**values["actuators"]),
            tolerances=Tolerances(**values["tolerances"]),
            stated=frozenset(f"{key}.{name}" for key in SECTIONS for name in data.get(key) or ()),
            mounts={part.name: part.mount for part in sensors or [] if part.name},
            text=text,
        )
    except ValueError as exc:
        raise SensorgraphError(f"{name}: {exc}") from exc


def bearings(n_rays: int, fov: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return (n_rays,) [rad] bearings, evenly spaced over `fov` and symmetric about straight ahead.

    Rays include both ends. In a full turn the last ray is one step before the first.
    """
    if fov > 2 * np.pi - 1e-6:
        return -np.pi + 2 * np.pi * np.arange(n_rays) / n_rays
    return np.linspace(-fov / 2, fov / 2, n_rays) if n_rays > 1 else np.zeros(1)


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorPlace:
    """One of several sensors."""

    mount: Floats
    """(3,) [m, m, rad] in base_link."""
    bearings: Floats
    """(n_rays,) [rad]"""
    cone: float
    """[rad]"""
    name: str
    """Its topic or frame in logs; empty if not given."""


def parse_sensors(name: str, entries: Any) -> list[SensorPlace]:
    """Parse `sensors:`, a list of mounts and rings.

    Raises
    ------
    SensorgraphError : The list is invalid; the message is one line and contains `name`.
    """
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise SensorgraphError(
            f"{name}: `sensors` is {entries!r}, expected a list such as [{{ring: 16, radius: 0.2, cone: 0.26}}]"
        )
    out = []
    for i, entry in enumerate(entries):
        kind = RING if "ring" in entry else MOUNTED
        values = _section(name, f"sensors[{i}]", entry, kind)
        if kind is RING:
            angles = values["first"] + 2 * np.pi * np.arange(values["ring"]) / values["ring"]
            mounts = np.stack(
                [values["radius"] * np.cos(angles), values["radius"] * np.sin(angles), angles], axis=1
            )
            names = [f"{values['name']}{k}" if values["name"] else "" for k in range(len(mounts))]
            out += [
                SensorPlace(mount=mount, bearings=np.zeros(1), cone=values["cone"], name=names[k])
                for k, mount in enumerate(mounts)
            ]
        else:
            try:
                _check_fov(f"sensors[{i}].fov", values["fov"])
            except ValueError as exc:
                raise SensorgraphError(f"{name}: {exc}") from exc
            rays = bearings(values["n_rays"], values["fov"]) if values["n_rays"] > 1 else np.zeros(1)
            mount = np.array(values["mount"], dtype=np.float64)
            out.append(SensorPlace(mount=mount, bearings=rays, cone=values["cone"], name=values["name"]))
    return out


def _sensor(values: Mapping[str, Any], sensors: list[SensorPlace] | None = None) -> RangeSensor:
    """Return the sensor, or several sensors as one in base_link."""
    if sensors is not None:
        shared = {key: value for key, value in values.items() if key not in ("n_rays", "fov", "mount")}
        phi = np.concatenate([wrap(part.bearings + part.mount[2]) for part in sensors])
        owner = np.repeat(np.arange(len(sensors)), [len(part.bearings) for part in sensors])
        order = np.argsort(phi, kind="stable")
        return RangeSensor(
            bearings=phi[order],
            origins=np.array([sensors[k].mount[:2] for k in owner[order]]),
            cones=np.array([sensors[k].cone for k in owner[order]]),
            **shared,
        )
    n_rays, fov = values["n_rays"], values["fov"]
    _check_fov("sensor.fov", fov)
    rest = {key: value for key, value in values.items() if key not in ("n_rays", "fov", "mount")}
    return RangeSensor(
        bearings=bearings(n_rays, fov), mount=np.array(values["mount"], dtype=np.float64), **rest
    )


def _check_fov(key: str, fov: float) -> None:
    if fov > 2 * np.pi + 1e-6:
        raise ValueError(
            f"{key} is {fov} rad, expected at most 2 pi; write an angle in degrees as `{fov:g} deg`"
        )


def _reject_unknown(name: str, where: str, data: Mapping[Any, Any], known: list[str]) -> None:
    for key in data:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
            raise SensorgraphError(f"{name}: unknown key `{where}{key}`; did you mean `{where}{near[0]}`?")


def _section(name: str, key: str, data: Any, defaults: Mapping[str, Any]) -> dict[str, Any]:
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise SensorgraphError(f"{name}: `{key}` is {data!r}, expected keys {', '.join(defaults)}")
    _reject_unknown(name, f"{key}.", data, list(defaults))
    return {k: _value(name, f"{key}.{k}", data.get(k, default), default) for k, default in defaults.items()}


def _value(name: str, key: str, value: Any, default: Any) -> Any:
    """Check a value against the type of its default; numbers are finite and within their limits."""
    if isinstance(default, str):
        if not isinstance(value, str):
            raise SensorgraphError(f"{name}: `{key}` is {value!r}, expected a word such as {default!r}")
        return value
    if isinstance(default, list):
        if isinstance(value, list):
            is_mount = key.split(".")[-1] == "mount"
            value = [_number(v, is_angle=is_mount and i == 2) for i, v in enumerate(value)]
        ok = isinstance(value, list) and len(value) == len(default) and all(_is_number(v) for v in value)
        if not ok:
            raise SensorgraphError(
                f"{name}: `{key}` is {value!r}, expected {len(default)} numbers such as {default}"
            )
        return [float(v) for v in value]
    whole, is_angle = isinstance(default, int), key.endswith(ANGLES)
    value = _number(value, is_angle=is_angle)
    if not _is_number(value) or (whole and value != int(value)):
        unit = " of radians, or an angle with its unit such as `180 deg`," if is_angle else ""
        raise SensorgraphError(
            f"{name}: `{key}` is {value!r}, expected a {'whole ' if whole else ''}number{unit} such as {default}"
        )
    least = "a value above 0" if key.split(".")[-1] in POSITIVE else "0 or more"
    if (value < 0 and key.split(".")[-1] not in SIGNED) or (value == 0 and least == "a value above 0"):
        raise SensorgraphError(f"{name}: `{key}` is {value}, expected {least}")
    most = MOST.get(key.split(".")[-1], np.inf)
    if value > most:
        raise SensorgraphError(f"{name}: `{key}` is {value:g}, expected {most:g} or less")
    return int(value) if whole else float(value)


def _number(value: Any, *, is_angle: bool = False) -> Any:
    """Convert `1e-3`, which YAML reads as text, to a number, and an angle with its unit to radians."""
    if not isinstance(value, str):
        return value
    text = value.strip()
    unit = next((unit for unit in ANGLE_UNITS if text.endswith(unit)), "") if is_angle else ""
    try:
        return float(text.removesuffix(unit)) * ANGLE_UNITS.get(unit, 1.0)
    except ValueError:
        return value


def _is_number(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return isinstance(value, int) or math.isfinite(value)
