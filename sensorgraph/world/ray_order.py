"""Match the rays of two sensors: bearings are compared modulo 2 pi, independent of the first ray.

Drivers of lasers with a full turn number their rays from 0 to 2 pi (LDS-01 of the TurtleBot3, RPLIDAR) or
from -pi to pi. Rays keep the index of their log; results with another numbering are reordered.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.run import RangeSensor
from planners.arena import wrap
from sensorgraph.types import Floats, Ints

SAME_BEARING = 1e-3
"""[rad] Maximum difference between equal bearings."""


def ray_order(bearings: Floats, wanted: Floats, *, tolerance: float = SAME_BEARING) -> Ints | None:
    """Return the index of the ray at each wanted bearing; None if the bearings differ.

    Parameters
    ----------
    bearings : (n_rays,) [rad] Increasing bearings.
    wanted : (n_rays,) [rad] Increasing bearings.
    tolerance : [rad] Maximum difference of equal bearings.

    Returns
    -------
    Index (n_rays,) into `bearings`, a cyclic shift.
    """
    n = len(bearings)
    if len(wanted) != n or n == 0:
        return None
    shifts = (0, int(np.abs(wrap(bearings - wanted[0])).argmin()))
    orders = [(np.arange(n, dtype=np.intp) + shift) % n for shift in shifts]
    errors = [float(np.abs(wrap(bearings[order] - wanted)).max()) for order in orders]
    best = int(errors[1] < errors[0])
    return orders[best] if errors[best] <= tolerance else None


def is_full_turn(bearings: Floats) -> bool:
    """Tell whether the last of the bearings (n_rays,) [rad] is one step before the first."""
    n = len(bearings)
    return n > 2 and bool((bearings[-1] - bearings[0]) * (n + 0.5) / (n - 1) > 2 * np.pi)


def neighbouring_rays(sensor: RangeSensor) -> tuple[Ints, Ints]:
    """Return the right and left ray (n_pairs,) of each pair of neighbours, including last and first of a full turn.

    Rays of different sensors in a composite sensor are not neighbours.
    """
    right = np.arange(sensor.n_rays - 1, dtype=np.intp)
    left = right + 1
    if sensor.is_composite:
        same = (sensor.origins[left] == sensor.origins[right]).all(axis=1)
        return right[same], left[same]
    if is_full_turn(sensor.bearings):
        right, left = np.append(right, sensor.n_rays - 1), np.append(left, 0)
    return right, left


def with_rays_like(
    sensor: RangeSensor, wanted: Floats, *, tolerance: float = SAME_BEARING
) -> RangeSensor | None:
    """Return the sensor with its rays in the order of the wanted bearings (n_rays,) [rad]; None if they differ."""
    order = ray_order(sensor.bearings, wanted, tolerance=tolerance)
    if order is None:
        return None
    bearings = sensor.bearings[order]
    turns = np.round((wanted - bearings) / (2 * np.pi))
    if not turns.any() and (order[:1] == 0).all():
        return sensor
    return replace(
        sensor,
        bearings=bearings + 2 * np.pi * turns,
        origins=sensor.origins[order] if len(sensor.origins) else sensor.origins,
        cones=sensor.cones[order] if len(sensor.cones) else sensor.cones,
        delays=sensor.delays[order] if len(sensor.delays) else sensor.delays,
    )


def ray_order_line(bearings: Floats, other: Floats, other_name: str) -> str:
    """Return a line that reports a different numbering of the same rays; empty if the numbering is the same."""
    order = ray_order(bearings, other)
    if order is None or order[0] == 0:
        return ""
    return (
        f"ray 0 points to {np.degrees(bearings[0]):.4g}°, that of {other_name} to {np.degrees(other[0]):.4g}°: "
        "the same rays modulo 360°; each log keeps its ray numbers"
    )


def bearings_text(bearings: Floats, other: Floats) -> str:
    """Return a text with the bearings (n_rays,) and the expected ones (n_other,) [rad]."""
    (a, b), (c, d) = (np.degrees(some[[0, -1]]) for some in (bearings, other))
    return f"{len(bearings)} rays from {a:.4g}° to {b:.4g}°, expected {len(other)} from {c:.4g}° to {d:.4g}°"
