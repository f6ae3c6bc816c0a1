"""Composite sensors: the sensor of each ray, and each part as a separate sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.run import RangeSensor
from logs.transforms import compose
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Ints

PART = "sensor"
"""Name of a part, followed by its number."""


def sensor_of_rays(sensor: RangeSensor) -> Ints:
    """Return the number of the sensor (n_rays,) of each ray, in the order of their first rays.

    Rays with the same origin belong to one sensor.
    """
    if not sensor.is_composite:
        return np.zeros(sensor.n_rays, dtype=np.intp)
    _, first, index = np.unique(np.round(sensor.origins, 6), axis=0, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[index.ravel()]


def part_names(sensor: RangeSensor) -> list[str]:
    """Return the names of the parts as locations of effects; empty for a single sensor."""
    if not sensor.is_composite:
        return []
    return [f"{PART} {k}" for k in range(int(sensor_of_rays(sensor).max()) + 1)]


def check_parts(places: Sequence[str], names: Sequence[str]) -> None:
    """Reject a location that names a part that does not exist.

    Raises
    ------
    SensorgraphError : There is no such sensor.
    """
    for place in places:
        if place.partition(" ")[0] == PART and place not in names:
            known = f"{names[0]} to {names[-1]}" if names else "one sensor, so leave the location out"
            raise SensorgraphError(f"an effect applies to `{place}`, but the robot has {known}")


def part_of(sensor: RangeSensor, rays: Ints) -> RangeSensor:
    """Return one part, given its rays (n,), mounted at their origin."""
    some = sensor.take(rays)
    mount = compose(sensor.mount, np.append(sensor.origins[rays[0]], 0.0))
    return replace(some, mount=mount, origins=np.zeros((0, 2)))
