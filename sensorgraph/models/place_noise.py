"""Numbers that belong to places: what is drawn for a ray is kept by the squares that it ends in, each for its lifetime.

Nothing is stored: a number is a hash of the seed, the square, the direction it is seen from and the interval of time
(splitmix64, Steele, Lea and Flood 2014), so it does not hang on who drives, and when it comes by.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Floats, Ints

SECTORS = 8
"""Directions that a place is seen from; what is in front of it from one says little of another."""
TURN = 1.0
"""[rad] of the squares to the map, so that no wall of a building lies along the border of squares."""
_UNIT = 1.0 / 2.0**53


def squares(places: Floats, size: float) -> Ints:
    """Return column, row and sector (..., 3) of places (..., 3) [m, m, rad] among squares of a side [m]."""
    cos, sin = math.cos(TURN), math.sin(TURN)
    x, y, angle = np.moveaxis(places, -1, 0)
    sector = np.floor(angle / (2 * np.pi) * SECTORS) % SECTORS
    parts = [np.floor((cos * x - sin * y) / size), np.floor((sin * x + cos * y) / size), sector]
    return np.stack(parts, axis=-1).astype(np.int64)


def places_of(starts: Floats, bearings: Floats, mode: Floats, range_max: float) -> Floats:
    """Return where rays are predicted to end, and their directions (n, n_rays, 3) [m, m, rad].

    Parameters
    ----------
    starts : (n, 3) or (n, n_rays, 3) [m, m, rad] of the laser
    mode : (n, n_rays) [m]; a ray without a surface ends at `range_max`
    """
    starts = starts[:, None] if starts.ndim == 2 else starts
    angle = starts[..., 2] + bearings
    r = np.where(np.isfinite(mode), np.clip(mode, 0.0, range_max), range_max)
    return np.stack([starts[..., 0] + r * np.cos(angle), starts[..., 1] + r * np.sin(angle), angle], axis=-1)


def numbers_at(
    seed: int,
    time: float,
    places: Floats,
    fresh: tuple[Floats, Floats],
    table: tuple[Floats, Floats, Floats, Floats],
) -> tuple[Floats, Floats]:
    """Return a uniform and a normal number for each ray (n_rays,) of one scan.

    Parameters
    ----------
    time : [s] of the scan
    places : (n_rays, 3) of `places_of`
    fresh : a uniform and a normal number of each ray's own (n_rays,)
    table : sizes [m], lifetimes [s], and the shares of events and of noise that squares keep
    """
    sizes, lifetimes, events, noise = table
    keys = np.stack([squares(places, size) for size in sizes.tolist()])
    uniform, normal = fresh[0].copy(), fresh[1].copy()
    _draw(np.uint64(seed), time, keys, lifetimes, events, noise, uniform, normal)
    return uniform, normal


@kernel
def _mixed(z: Any) -> Any:
    z = z + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel
def _unit(z: Any) -> Any:
    return (float(z >> np.uint64(11)) + 0.5) * _UNIT


@kernel
def _of_interval(key: Any, time: Any, lifetimes: Any, m: Any) -> Any:
    """Return the hash of a square's interval of its m-th lifetime; the last is for ever."""
    own = _mixed(key ^ np.uint64(m + 1))
    if m == len(lifetimes):
        return own
    return _mixed(own ^ np.uint64(np.int64(math.floor(time / lifetimes[m] + _unit(own)))))


@kernel
def _draw(
    seed: Any, time: Any, squares: Any, lifetimes: Any, events: Any, noise: Any, uniform: Any, normal: Any
) -> Any:
    """Replace the fresh numbers (n_rays,) by those that squares (n_sizes, n_rays, 3) keep, in their shares."""
    n_sizes, n_lifetimes = events.shape
    own = math.sqrt(max(1.0 - noise.sum(), 0.0))
    for i in range(len(uniform)):
        left, is_kept = 1.0, False
        z = own * normal[i]
        for s in range(n_sizes - 1, -1, -1):  # the large squares hold the small ones
            key = _mixed(seed ^ np.uint64(s + 1))
            for part in range(3):
                key = _mixed(key ^ np.uint64(squares[s, i, part]))
            choice, above = left * _unit(_mixed(key)), 0.0
            for m in range(n_lifetimes):
                above += events[s, m]
                if not is_kept and choice < above:
                    uniform[i] = _unit(_of_interval(key ^ np.uint64(1 << 32), time, lifetimes, m))
                    is_kept = True
                if noise[s, m] > 0:
                    h = _of_interval(key ^ np.uint64(1 << 33), time, lifetimes, m)
                    size = math.sqrt(-2.0 * noise[s, m] * math.log(_unit(h)))
                    z += size * math.cos(2.0 * math.pi * _unit(_mixed(h)))
            left -= above
        normal[i] = z
