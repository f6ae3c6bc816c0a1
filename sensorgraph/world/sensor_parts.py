"""Which of several sensors, read as one, a ray belongs to; and each of them as a sensor of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.run import RangeSensor
from logs.transforms import compose
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Ints

PART = "sensor"
"""What each of several sensors is called, with its number behind it."""


def sensor_of_rays(sensor: RangeSensor) -> Ints:
    """Return the number of the sensor (n_rays,) that each ray is of, counted in the order of their first rays.

    Rays that start in one place are of one sensor.
    """
    if not sensor.is_composite:
        return np.zeros(sensor.n_rays, dtype=np.intp)
    _, first, index = np.unique(np.round(sensor.origins, 6), axis=0, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[index.ravel()]


def part_names(sensor: RangeSensor) -> list[str]:
    """Return what each of several sensors is called as the place of an effect; none where there is one sensor."""
    if not sensor.is_composite:
        return []
    return [f"{PART} {k}" for k in range(int(sensor_of_rays(sensor).max()) + 1)]


def check_parts(places: Sequence[str], names: Sequence[str]) -> None:
    """Refuse a place that reads like one of several sensors, and is none of these.

    Raises
    ------
    SensorgraphError : there is no such sensor
    """
    for place in places:
        if place.partition(" ")[0] == PART and place not in names:
            known = f"{names[0]} to {names[-1]}" if names else "one sensor, so leave the location out"
            raise SensorgraphError(f"an effect is of `{place}`, the robot has {known}")


def part_of(sensor: RangeSensor, rays: Ints) -> RangeSensor:
    """Return one of several sensors, by its rays (n,), mounted where these start."""
    some = sensor.take(rays)
    mount = compose(sensor.mount, np.append(sensor.origins[rays[0]], 0.0))
    return replace(some, mount=mount, origins=np.zeros((0, 2)))
