"""The sensors of robot.yaml: their keys, the bearings of their rays, and several sensors as one."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from logs.run import RangeSensor
from planners.arena import wrap
from sensorgraph.errors import SensorgraphError
from sensorgraph.quantities import ROUNDED
from sensorgraph.types import Floats
from sensorgraph.world.robot_values import section

RAYS: dict[str, Any] = {
    "n_rays": 181,
    "fov": 3.14159265,
    "angle_min": None,
    "angle_max": None,
    "angle_increment": None,
}
"""Keys of the rays: their number and field of view, or the fields of a LaserScan."""
SENSOR_DEFAULTS: dict[str, Any] = {
    "mount": [0.10, 0.0, 0.0],
    **RAYS,
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
RING: dict[str, Any] = {"name": "", "ring": 16, "radius": 0.2, "first": 0.0, "cone": 0.0}
"""Sensors on a ring around the robot that look outwards: number, radius [m], and bearing of the first [rad].
The k-th is called `name` followed by k."""
MOUNTED: dict[str, Any] = {"name": "", "mount": [0.0, 0.0, 0.0], "cone": 0.0, **RAYS, "n_rays": 1}
"""A sensor with its mount in base_link, named like its topic or frame in logs; with several rays, a laser."""
ANGLE_KEYS = ("angle_min", "angle_max", "angle_increment")
OWN_KEYS = ("mount", *RAYS, "interlaced_sweeps")
"""Keys of a single sensor that do not go with `sensors`."""
REPEATED = 1e-4
"""[rad] A ray less than this before a full turn repeats the first one, as in the readers of logs."""


def bearings(n_rays: int, fov: float) -> Floats:
    """Return (n_rays,) [rad] bearings, evenly spaced over `fov` and symmetric about straight ahead.

    DescribedRays include both ends. In a full turn, also if written as 6.28, the last ray is one step before the first.
    """
    missing = 2 * np.pi - fov
    if missing < min(ROUNDED, np.pi / n_rays):
        return np.asarray(-np.pi + 2 * np.pi * np.arange(n_rays) / n_rays)
    return np.linspace(-fov / 2, fov / 2, n_rays) if n_rays > 1 else np.zeros(1)


@dataclass(frozen=True, kw_only=True, eq=False)
class DescribedRays:
    """The rays of a laser."""

    bearings: Floats
    """(n_rays,) [rad] Increasing."""
    is_descending: bool = False
    """Whether the file lists them in the opposite order, as a driver with a negative `angle_increment` does."""


def rays_of(key: str, values: Mapping[str, Any], given: Collection[str]) -> DescribedRays:
    """Return the rays from n_rays and fov, or from fields of a LaserScan.

    Parameters
    ----------
    key : Where the values are in the file, such as `sensor`.
    values : Values of all keys of `RAYS`.
    given : Keys that the file contains.

    Raises
    ------
    ValueError : The keys contradict each other or do not determine the rays; the message contains `key`.
    """
    used = [name for name in ANGLE_KEYS if values[name] is not None]
    if not used:
        return DescribedRays(bearings=bearings(values["n_rays"], values["fov"]))
    if "fov" in given:
        raise ValueError(f"`{key}.fov` does not go with `{key}.{used[0]}`; remove one of them")
    first, last, step = (values[name] for name in ANGLE_KEYS)
    n = values["n_rays"] if "n_rays" in given else None
    if len(used) + (n is not None) < 3 and not (n == 1 and first is not None):
        raise ValueError(
            f"`{key}.{used[0]}` alone does not determine the rays; expected n_rays and two of angle_min, angle_max and "
            "angle_increment, or all three"
        )
    n, step = _number_and_step(key, first, last, step, n)
    start = last - step * (n - 1) if first is None else first
    if abs(step) * (n - 1) > 2 * (np.pi + abs(step)):
        raise ValueError(
            f"`{key}` has {n} rays, {np.degrees(abs(step)):.4g}° apart; expected at most a full turn; check n_rays"
        )
    along = start + step * np.arange(n)
    rising = along[::-1] if step < 0 else along
    turn = np.searchsorted(rising, rising[0] + 2 * np.pi - REPEATED)
    return DescribedRays(bearings=rising[:turn], is_descending=step < 0)


def _number_and_step(
    key: str, first: float | None, last: float | None, step: float | None, n: int | None
) -> tuple[int, float]:
    """Return the number of rays and the step [rad] between them, negative for descending bearings."""
    if n == 1:
        return 1, 1.0
    if step is None:
        assert first is not None and last is not None and n is not None
        step = (last - first) / (n - 1)
    if step == 0:
        raise ValueError(f"`{key}` has an angle between rays of 0; expected another one")
    if first is None or last is None:
        assert n is not None
        return n, step
    steps = (last - first) / step
    if n is None:
        n = round(steps) + 1
        if abs(steps - round(steps)) > 0.25 or n < 1:
            raise ValueError(
                f"`{key}` has {steps:.4g} times angle_increment from angle_min to angle_max, expected a whole number, 0 "
                "or more; give n_rays in place of angle_max"
            )
        return n, (last - first) / (n - 1) if n > 1 else 1.0
    if abs(steps + 1 - n) >= 2:  # drivers round the number of steps, and count steps or rays
        raise ValueError(
            f"`{key}` has {n} rays, but {steps + 1:.4g} with angle_increment from angle_min to angle_max; "
            "remove n_rays or angle_max"
        )
    return n, step


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
        values = section(name, f"sensors[{i}]", entry, kind)
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
                rays = rays_of(f"sensors[{i}]", values, entry)
            except ValueError as exc:
                raise SensorgraphError(f"{name}: {exc}") from exc
            mount = np.array(values["mount"], dtype=np.float64)
            out.append(
                SensorPlace(mount=mount, bearings=rays.bearings, cone=values["cone"], name=values["name"])
            )
    return out


def sensor_of(
    values: Mapping[str, Any], given: Collection[str], several: list[SensorPlace] | None = None
) -> RangeSensor:
    """Return the sensor, or several sensors as one in base_link.

    Parameters
    ----------
    values : Values of all keys of `sensor`.
    given : Keys of `sensor` that the file contains.

    Raises
    ------
    ValueError : The values contradict each other.
    """
    rest = {key: value for key, value in values.items() if key not in ("mount", *RAYS)}
    if several is not None:
        phi = np.concatenate([wrap(part.bearings + part.mount[2]) for part in several])
        owner = np.repeat(np.arange(len(several)), [len(part.bearings) for part in several])
        order = np.argsort(phi, kind="stable")
        return RangeSensor(
            bearings=phi[order],
            origins=np.array([several[k].mount[:2] for k in owner[order]]),
            cones=np.array([several[k].cone for k in owner[order]]),
            **rest,
        )
    rays = rays_of("sensor", values, given)
    if rays.is_descending and values["interlaced_sweeps"] > 1:
        raise ValueError(
            "`sensor.interlaced_sweeps` counts rays in the order of rising bearings; write a positive angle_increment, and "
            "a negative sweep_time for a laser that turns clockwise"
        )
    if rays.is_descending:
        rest["sweep_time"] = -rest["sweep_time"]
    return RangeSensor(bearings=rays.bearings, mount=np.array(values["mount"], dtype=np.float64), **rest)
