"""Motion primitives: the moves of the search from a heading step and a mode, in closed form.

A robot that turns in place turns all the time. Its primitive is one part of a heading bin at a constant turn
rate omega, with a linear change of v; its modes are levels of speed. A car's primitive is an arc of the
minimum radius or a straight piece, at constant speed; its modes are gears. Offsets are the integral of
`curve` at `SAMPLES` times and at the end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.coverage import DWELL_PERIODS
from planners.curve import displace
from planners.types import Bools, Floats, Int32s, Ints
from planners.vehicle import Limits

SAMPLES = 8
"""Number of poses at which a primitive is tested for clearance and bins."""
MAX_DURATION = 0.5
"""[s] maximum duration of a primitive of a robot that turns in place."""
MAX_LEVELS = 6
"""Maximum number of speed levels in each direction."""
MAX_ARC = 0.2
"""[m] maximum length of a car's primitive."""
GEAR_CHANGE_COST = 0.75
"""Cost of a gear change as a share of v / a, the time that stopping and starting add to a drive."""
SAFE_DEPTH_REVERSING, SAFE_DEPTH_FORWARD = 1, 25
"""Number of primitives that must be able to follow a safe state of a car with and without a reverse gear; with
fewer, the latter gets trapped in front of walls."""
INNER_DWELL = 0.85
"""Minimum stay in the inner half of a bin, as a share of the log period; the path out of the bin takes the rest."""


class MotionPrimitives(NamedTuple):
    """Primitives by heading step, mode and branch (index of a primitive that leaves a mode)."""

    first_heading: float
    """[rad] heading of step 0."""
    heading_step: float
    """[rad] from one heading step to the next."""
    offsets: Floats
    """(n_headings, n_modes, n_branches, SAMPLES + 1, 2) [m] displacement at the samples and at the end, in map axes."""
    bins: NDArray[np.int16]
    """(n_headings, n_modes, n_branches, SAMPLES) heading bin of each sample."""
    core: Bools
    """As `bins`: whether the sample is in the middle half of its bin; all are, if the log is too slow for that half."""
    turned_steps: Ints
    """(n_modes, n_branches) number of heading steps turned."""
    next_mode: Ints
    """(n_modes, n_branches) mode at the end; -1: no such branch."""
    cost: Ints
    """(n_modes, n_branches) duration in units of time."""
    unit: float
    """[s] unit of time."""
    sample_period: Floats
    """(n_modes, n_branches) [s] between samples."""
    speeds: Floats
    """(n_modes,) [m/s] speed at the start of a primitive (cars: the sign is the gear)."""
    is_fine: Bools
    """(n_modes, n_branches) whether the branch is a short one, used only by the search for the nearest bin."""
    stops_first: Bools
    """(n_modes, n_branches) whether the robot stops before the branch."""
    heading_bin: NDArray[np.int16]
    """(n_headings,) heading bin of each heading step."""
    safe_depth: int
    """Safety of a state: this many primitives must be able to follow; negative: the robot must stop within as many."""
    omega: float
    """[rad/s] turn rate; 0 for cars."""
    max_offset: float
    """[m] largest distance from the middle sample of a primitive to another sample."""
    max_cost: int
    """[units of time] duration of the slowest primitive."""
    core_margin: float = 0.5
    """Number of samples subtracted at each end of a stay in the middle half of a bin, because its border may be crossed
    anywhere between two samples. It is 0 for slow sensors, for which stays are counted exactly."""

    @property
    def n_headings(self) -> int:
        """Number of heading steps; as many units of time take a full turn."""
        return len(self.offsets)

    def units(self, mode: int, branches: Int32s) -> int:
        """Return the units of time of consecutive primitives (n,) from a mode."""
        total, cost, then = 0, self.cost, self.next_mode
        for branch in branches.tolist():
            total += int(cost[mode, branch])
            mode = int(then[mode, branch])
        return total


def spin_primitives(limits: Limits, headings: int, rate: float) -> MotionPrimitives:
    """Return the primitives of a robot that turns in place at a constant rate, counter-clockwise.

    Parameters
    ----------
    headings : Number of heading bins.
    rate : [Hz] Rate of the log, which must record every bin for any phase of its clock.
    """
    width = 2 * np.pi / headings
    omega = min(limits.omega, width * rate / DWELL_PERIODS)
    parts, core_margin, has_core = _cut_bin(width / omega, rate)
    step, tau = width / parts, width / parts / omega
    n_levels = int(np.clip(round(limits.v / (limits.a * tau)), 1, MAX_LEVELS))
    rise = min(limits.a * tau, limits.v / n_levels)  # [m/s] from one level to the next
    level = np.array(sorted(range(-n_levels, n_levels + 1), key=abs))  # mode 0 is at rest
    then, speeds = _steps_of_level(level), rise * level
    n_headings = headings * parts
    stamps = np.concatenate([(np.arange(SAMPLES) + 0.5) / SAMPLES, [1.0]]) * tau
    heading = np.arange(n_headings) * step - width / 2
    change = rise * (level[np.maximum(then, 0)] - level[:, None]) / tau  # (n_modes, 3) [m/s²]
    shape = (n_headings, *then.shape, SAMPLES + 1)
    full = [
        np.broadcast_to(part, shape)
        for part in (
            heading[:, None, None, None],
            speeds[None, :, None, None],
            change[None, :, :, None],
            np.float64(omega),
            np.float64(0.0),
            stamps,
        )
    ]
    offsets = np.stack(displace(*full), axis=-1)
    which = np.arange(n_headings) // parts % headings
    bins = np.broadcast_to(which[:, None, None, None], (*shape[:3], SAMPLES)).astype(np.int16)
    within = (np.arange(n_headings)[:, None] % parts * step + stamps[:-1] * omega) / width - 0.5  # of the bin
    core = np.broadcast_to(((abs(within) <= 0.25) | (not has_core))[:, None, None, :], bins.shape)
    return MotionPrimitives(
        first_heading=-width / 2,
        heading_step=step,
        offsets=offsets,
        bins=bins,
        core=np.ascontiguousarray(core),
        turned_steps=np.ones(then.shape, dtype=np.int64),
        next_mode=then,
        cost=np.ones(then.shape, dtype=np.int64),
        unit=tau,
        sample_period=np.full(then.shape, tau / SAMPLES),
        speeds=speeds,
        is_fine=np.zeros(then.shape, dtype=np.bool_),
        stops_first=np.zeros(then.shape, dtype=np.bool_),
        heading_bin=which.astype(np.int16),
        safe_depth=-(n_levels + 2),
        omega=float(omega),
        max_offset=_max_offset(offsets),
        max_cost=1,
        core_margin=core_margin,
    )


def _max_offset(offsets: Floats) -> float:
    """Return the largest distance [m] from the middle sample of a primitive to another sample."""
    apart = offsets - offsets[..., [SAMPLES // 2], :]
    return float(np.hypot(*np.moveaxis(apart, -1, 0)).max())


def _cut_bin(duration: float, rate: float) -> tuple[int, float, bool]:
    """Divide the turn through a heading bin into primitives that a log can resolve.

    A bin counts as covered if a single primitive stays in its middle half for long enough. If the usual
    division is too short for a slow sensor, three relaxations follow in order: count stays without a margin,
    divide more coarsely, and count headings outside the middle half.

    Parameters
    ----------
    duration : [s] Duration of the turn through a bin.
    rate : [Hz] Rate of the log.

    Returns
    -------
    The number of primitives, `core_margin` of MotionPrimitives, and whether only the middle half of headings
    counts.
    """
    usual = max(math.ceil(duration / MAX_DURATION - 1e-9), 1)
    for parts in range(usual, 0, -1):
        for margin in (0.5, 0.0):
            if _core_stay(parts, margin) * duration * rate >= INNER_DWELL:
                return parts, margin, True
    return max(min(math.floor(duration * rate), usual), 1), 0.5, False


def _core_stay(parts: int, margin: float) -> float:
    """Return the longest counted stay in the middle half of a bin by one of its primitives, as a share of the turn."""
    start = np.arange(parts) / parts
    low, high = np.maximum(start, 0.25), np.minimum(start + 1 / parts, 0.75)
    n_inside = (low > start + 1e-9).astype(int) + (high < start + 1 / parts - 1e-9)
    return float((high - low - n_inside * margin / (parts * SAMPLES)).max())


def _steps_of_level(level: Ints) -> Ints:
    """Return the modes (n_modes, 3) at most one level away, slower ones first; -1: no such mode."""
    then = np.full((len(level), 3), -1, dtype=np.int64)
    for m, own in enumerate(level.tolist()):
        near = [k for k, other in enumerate(level.tolist()) if abs(other - own) <= 1]
        then[m, : len(near)] = near
    return then


GEARS = {"reeds_shepp": (1, -1), "dubins": (1,)}
"""Gears of each car: 1 forward, -1 backward."""


def car_primitives(
    limits: Limits, headings: int, rate: float, gears: tuple[int, ...], phi: float | None = None
) -> MotionPrimitives:
    """Return the primitives of a car: arcs of the minimum radius and straight pieces, in each of its gears.

    A car with a reverse gear also has pieces of half length, to manoeuvre along walls, and of quarter length
    for the search for the nearest bin. A gear change costs the time of stopping and starting.

    No heading lies on a border of bins or along an axis, unless the heading `phi` [rad] requires it. On a
    border, rounding would decide which of the two bins is logged.
    """
    width, radius = 2 * np.pi / headings, limits.turning_radius
    parts = max(math.ceil(width * radius / MAX_ARC - 1e-9), 1)
    v = min(limits.v_on_arc, width * radius * rate / DWELL_PERIODS)
    shares = (4, 2, 1) if len(gears) > 1 else (1,)
    unit_turn = width / parts / shares[0]
    unit = unit_turn * radius / v
    pause = max(round(GEAR_CHANGE_COST * v / limits.a / unit), 1)
    branches = [(g, c, n) for g in range(len(gears)) for n in shares for c in (0, 1, -1)]
    modes, n_headings = len(gears), headings * parts * shares[0]
    first = 0.5 * unit_turn if len(shares) > 1 else width / parts / 8
    if phi is not None:
        first = phi % unit_turn
    heading = first + np.arange(n_headings) * unit_turn
    gear, curve, length = np.array(branches).T
    stamps = np.concatenate([(np.arange(SAMPLES) + 0.5) / SAMPLES, [1.0]])
    dt = length[:, None] * unit * stamps  # (n_branches, SAMPLES + 1)
    speed = v * np.array(gears)[gear]
    shape = (n_headings, len(branches), SAMPLES + 1)
    zero = np.zeros(shape)
    offsets = np.stack(
        displace(
            zero + heading[:, None, None],
            zero + speed[:, None],
            zero,
            zero + (curve * v / radius)[:, None],
            zero,
            zero + dt,
        ),
        axis=-1,
    )
    turned = heading[:, None, None] + (curve * v / radius)[:, None] * dt
    place = turned[:, :, :-1] / width
    bins = np.floor(place + 0.5).astype(np.int64) % headings
    core = abs(place - np.round(place)) <= 0.25

    def every_mode(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.repeat(array[:, None], modes, axis=1))

    changes = gear[None, :] != np.arange(modes)[:, None]
    cost = length[None, :] + pause * changes
    return MotionPrimitives(
        first_heading=float(first),
        heading_step=unit_turn,
        offsets=every_mode(offsets),
        bins=every_mode(bins.astype(np.int16)),
        core=every_mode(core),
        turned_steps=np.tile(curve * length, (modes, 1)),
        next_mode=np.tile(gear, (modes, 1)),
        cost=cost,
        unit=unit,
        sample_period=np.tile(length * unit / SAMPLES, (modes, 1)),
        speeds=v * np.array(gears, dtype=np.float64),
        is_fine=np.tile((length == 1) & (len(shares) > 1), (modes, 1)),
        stops_first=changes,
        heading_bin=(np.floor(heading / width + 0.5).astype(np.int64) % headings).astype(np.int16),
        safe_depth=SAFE_DEPTH_REVERSING if len(gears) > 1 else SAFE_DEPTH_FORWARD,
        omega=0.0,
        max_offset=_max_offset(offsets),
        max_cost=int(cost.max()),
    )
