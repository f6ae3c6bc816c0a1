"""Spins: turns on the spot through all missing headings of a cell that end towards the next move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.arena import wrap
from planners.curve import CurveBuilder, blend_offset
from planners.types import Bools, Floats

GUARD = 0.1
"""Minimum depth to which a spin enters its last bin, as a share of the width of a heading bin."""
BORDER = 0.02
"""An arrival closer than this to the border of a bin, as a share of its width, does not cover it."""
MAX_REVERSE = 0.8
"""[m] maximum length of a move driven backward to save turning."""


@dataclass(frozen=True, kw_only=True)
class Departure:
    """How to leave a place: turn by `angle`, then drive `distance` (backward if negative)."""

    angle: float
    """[rad]"""
    distance: float
    """[m]"""


def least_sweep(phi: float, need: Bools, direction: int) -> float:
    """Return the angle [rad, 0 or more] to turn from heading phi until every heading bin of `need` is visited.

    Parameters
    ----------
    need : (n_phi,) Missing bins; the bin of phi is visited without a turn.
    direction : 1 counter-clockwise, -1 clockwise.
    """
    width = 2 * np.pi / len(need)
    bins = np.flatnonzero(need)
    inside = wrap(np.subtract(phi, bins * width, dtype=np.float64)) / width  # -0.5 .. 0.5 within the bin
    border = (bins - direction * (0.5 - GUARD)) * width
    ahead = direction * (border - phi) % (2 * np.pi)
    ahead[abs(inside) <= 0.5 - BORDER] = 0.0
    return float(ahead.max(initial=0.0))


def choose_departure(
    builder: CurveBuilder, target: Floats | None, need: Bools | None, overlap: tuple[float, float]
) -> Departure:
    """Choose the shortest turn that passes the headings in `need` and ends facing `target` or facing away from it.

    Parameters
    ----------
    target : (2,) [m] Next place; None at the end of the plan.
    need : (n_phi,) Headings to pass here; None: only turn towards the target.
    overlap : [s] Overlap of the turn with the move before it and with the move after it.
    """
    best: tuple[float, Departure] | None = None
    phi = float(builder.pose[2])
    for direction in (-builder.last_turn, builder.last_turn):
        sweep = 0.0 if need is None else least_sweep(phi, need, direction)
        if target is None:
            width = 0.0 if need is None or sweep == 0.0 else 2 * np.pi / len(need)
            choices = [Departure(angle=direction * (sweep + (0.5 - GUARD) * width), distance=0.0)]
        else:
            reach = float(np.hypot(*(target - builder.pose[:2])))
            gears = (1, -1) if reach <= MAX_REVERSE and need is not None else (1,)
            choices = [_towards(builder, target, direction, gear, sweep, overlap) for gear in gears]
        for choice in choices:
            cost = abs(choice.angle)
            if best is None or cost < best[0] - 1e-6:
                best = (cost, choice)
    assert best is not None
    return best[1]


def _towards(
    builder: CurveBuilder,
    target: Floats,
    direction: int,
    gear: int,
    sweep: float,
    overlap: tuple[float, float],
) -> Departure:
    """Turn by at least `sweep` in this direction until the target is ahead (gear 1) or behind (-1)."""
    phi = float(builder.pose[2])
    heading, distance, angle = phi, 0.0, 0.0
    bend = np.zeros(2)
    for _ in range(3):  # fixed-point iteration: the offsets of the blends and the angle depend on each other
        cos, sin = np.cos(heading), np.sin(heading)
        here = builder.rest(angle, overlap[0]) if angle else builder.pose[:2]
        leg = target - here - np.array([cos * bend[0] - sin * bend[1], sin * bend[0] + cos * bend[1]])
        distance = float(np.hypot(*leg))
        heading = float(np.arctan2(leg[1], leg[0])) + (np.pi if gear < 0 else 0.0)
        turn = direction * (heading - phi) % (2 * np.pi)
        if 2 * np.pi - turn < 1e-7:
            turn = 0.0
        while turn < sweep - 1e-9:
            turn += 2 * np.pi
        angle = direction * turn
        bend = departure_offset(builder, angle, gear * distance, overlap[1])
    return Departure(angle=angle, distance=gear * distance)


def departure_offset(builder: CurveBuilder, angle: float, distance: float, overlap: float) -> Floats:
    """Return the end offset (2,) [m] of a move, in its own frame, if it starts before the turn has ended."""
    limits = builder.limits
    turn_ramp = min(builder.spin / limits.alpha, float(np.sqrt(abs(angle) / limits.alpha)))
    move_ramp = min(limits.v / limits.a, float(np.sqrt(abs(distance) / limits.a)))
    back = min(overlap, turn_ramp, move_ramp)
    if back <= 0 or abs(angle) < 1e-9:
        return np.zeros(2)
    a, alpha = float(np.copysign(limits.a, distance)), float(np.copysign(limits.alpha, angle))
    return np.array(blend_offset(a, -alpha, back))
