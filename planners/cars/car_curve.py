"""Curves of cars: chains of arcs and straight pieces, driven as fast as v and a allow, from rest to rest in each gear.

At distance s from the start of a run of length L, the speed is min(v, sqrt(2 a s), sqrt(2 a (L - s))).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from planners.cars.reeds_shepp import Arcs, take_arcs
from planners.curve import Curve, curve_of_pieces
from planners.types import ROUND_OFF, Floats
from planners.vehicle import Limits


def curve_of_arcs(
    pose: Floats, length: Floats, bend: np.ndarray, gear: np.ndarray, limits: Limits, v: float | None = None
) -> Curve:
    """Return the curve of a car that drives arcs and straight pieces (m,) from `pose` (3,), from rest to rest.

    Parameters
    ----------
    length : (m,) [m] Length of each piece.
    bend : (m,) 1 counter-clockwise, 0 straight, -1 clockwise.
    gear : (m,) 1 forward, -1 backward; the car stops where it changes.
    v : [m/s] Speed; default: the maximum that the limits allow.
    """
    top = limits.v_on_arc if v is None else v
    a = limits.a_on_arc
    runs = np.flatnonzero(np.diff(gear, prepend=gear[:1] - 1, append=gear[-1:] + 1))
    parts = [
        _run(length[i:k], bend[i:k], top, a, float(gear[i]), limits.turning_radius)
        for i, k in pairwise(runs.tolist())
    ]
    dt, twists, rates = (np.concatenate(column) for column in zip(*parts, strict=True))
    return curve_of_pieces(pose, dt, twists, rates, np.full(len(dt), "drive" if v is not None else "join"))


def car_section(curve: Curve, first: int, last: int, limits: Limits) -> Curve:
    """Return pieces `first` to `last` (excluded) of a car's curve as a drive from rest to rest."""
    arcs = take_arcs(arcs_of_curve(curve), slice(first, last))
    top = float(abs(curve.twists[:, 0]).max())
    return curve_of_arcs(curve.poses[first], arcs.length, arcs.bend, arcs.gear, limits, top)


def arcs_of_curve(curve: Curve) -> Arcs:
    """Return the arcs (n,) of a car's curve, one for each piece."""
    dt = np.diff(np.append(curve.starts, curve.duration))[:, None]
    length, turn = (curve.twists * dt + 0.5 * curve.rates * dt * dt).T
    bend = np.where(abs(turn) > ROUND_OFF, np.sign(turn), 0.0)
    return Arcs(abs(length), bend.astype(np.int64), np.sign(length).astype(np.int64))


def _run(
    length: Floats, bend: np.ndarray, v: float, a: float, gear: float, radius: float
) -> tuple[Floats, Floats, Floats]:
    """Return dt (n,), twists (n, 2) and rates (n, 2) of pieces (m,) driven in one gear from rest to rest."""
    ends = np.concatenate([[0.0], np.cumsum(length)])
    total = ends[-1]
    ramp = min(v * v / (2 * a), total / 2)
    marks = np.concatenate([ends, [ramp, total - ramp]])
    marks = np.sort(marks)
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-9])]
    marks[-1] = total
    low, high = marks[:-1], marks[1:]
    middle = 0.5 * (low + high)
    owner = np.clip(np.searchsorted(ends, middle, side="right") - 1, 0, len(length) - 1)

    def speed(s: Floats) -> Floats:
        return np.asarray(np.sqrt(2 * a * np.minimum(np.minimum(s, total - s).clip(0.0), ramp)))

    before, after = speed(low), speed(high)
    dt = 2 * (high - low) / (before + after)
    rate = (after - before) / dt
    kappa = bend[owner] / radius
    return (
        dt,
        np.stack([gear * before, kappa * before], axis=1),
        np.stack([gear * rate, kappa * rate], axis=1),
    )


def cusps(curve: Curve) -> Floats:
    """Return where a car starts or changes gear, (n, 4): x, y, phi, and 0 [rad] for the turn there."""
    gear = np.sign(curve.twists[:, 0] + curve.rates[:, 0] * 1e-6)
    at = np.flatnonzero(np.diff(gear, prepend=0.0))
    return np.column_stack([curve.poses[at], np.zeros(len(at))])
