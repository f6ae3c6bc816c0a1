"""Random numbers that belong to places: each square of a grid keeps its number for a lifetime.

Uniform number: u = u_sm with probability events[s, m], otherwise u_fresh.
Normal number: z = sqrt(1 - sum_sm noise[s, m]) z_fresh + sum_sm sqrt(noise[s, m]) z_sm.
Here u_sm and z_sm belong to the square of size s that the ray ends in, for the current interval of lifetime m.
Nothing is stored: u_sm and z_sm are hashes of the seed, the square, the viewing direction and the interval of time
(splitmix64, Steele, Lea and Flood 2014). They do not depend on the robot or on when it passes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Floats, Ints

SECTORS = 8
"""Number of viewing directions of a place; surfaces seen from different directions are independent."""
TURN = 1.0
"""[rad] Angle of the grid in the map, so that walls do not coincide with borders of squares."""
_UNIT = 1.0 / 2.0**53


def squares(places: Floats, size: float) -> Ints:
    """Return column, row and sector (..., 3) of places (..., 3) [m, m, rad] in a grid of squares of side `size` [m]."""
    cos, sin = math.cos(TURN), math.sin(TURN)
    x, y, angle = np.moveaxis(places, -1, 0)
    sector = np.floor(angle / (2 * np.pi) * SECTORS) % SECTORS
    parts = [np.floor((cos * x - sin * y) / size), np.floor((sin * x + cos * y) / size), sector]
    return np.stack(parts, axis=-1).astype(np.int64)


def places_of(starts: Floats, bearings: Floats, mode: Floats, range_max: float) -> Floats:
    """Return the predicted end points of rays and their directions (n, n_rays, 3) [m, m, rad].

    Parameters
    ----------
    starts : (n, 3) or (n, n_rays, 3) [m, m, rad] Poses of the laser.
    mode : (n, n_rays) [m] Predicted ranges; a ray without a surface ends at `range_max`.
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
    time : [s] Time of the scan.
    places : (n_rays, 3) Places as `places_of` returns them.
    fresh : Independent uniform and normal numbers (n_rays,) of the rays.
    table : Sizes [m], lifetimes [s], and the shares of events and noise that squares keep.
    """
    sizes, lifetimes, events, noise = table
    keys = np.stack([squares(places, size) for size in sizes.tolist()])
    uniform, normal = fresh[0].copy(), fresh[1].copy()
    _draw(np.uint64(seed), time, keys, lifetimes, events, noise, uniform, normal)
    return uniform, normal


@kernel
def _splitmix64(z: Any) -> Any:
    z = z + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel
def _uniform(z: Any) -> Any:
    return (float(z >> np.uint64(11)) + 0.5) * _UNIT


@kernel
def _interval_hash(key: Any, time: Any, lifetimes: Any, m: Any) -> Any:
    """Return the hash of a square for its interval of the m-th lifetime; the last lifetime is unlimited."""
    own = _splitmix64(key ^ np.uint64(m + 1))
    if m == len(lifetimes):
        return own
    return _splitmix64(own ^ np.uint64(np.int64(math.floor(time / lifetimes[m] + _uniform(own)))))


@kernel
def _draw(
    seed: Any, time: Any, squares: Any, lifetimes: Any, events: Any, noise: Any, uniform: Any, normal: Any
) -> Any:
    """Replace the fresh numbers (n_rays,) by the mixture that the module's equations define."""
    n_sizes, n_lifetimes = events.shape
    own = math.sqrt(max(1.0 - noise.sum(), 0.0))
    for i in range(len(uniform)):
        left, is_kept = 1.0, False
        z = own * normal[i]
        for s in range(n_sizes - 1, -1, -1):  # from large to small squares
            key = _splitmix64(seed ^ np.uint64(s + 1))
            for part in range(3):
                key = _splitmix64(key ^ np.uint64(squares[s, i, part]))
            choice, above = left * _uniform(_splitmix64(key)), 0.0
            for m in range(n_lifetimes):
                above += events[s, m]
                if not is_kept and choice < above:
                    uniform[i] = _uniform(_interval_hash(key ^ np.uint64(1 << 32), time, lifetimes, m))
                    is_kept = True
                if noise[s, m] > 0:
                    h = _interval_hash(key ^ np.uint64(1 << 33), time, lifetimes, m)
                    size = math.sqrt(-2.0 * noise[s, m] * math.log(_uniform(h)))
                    z += size * math.cos(2.0 * math.pi * _uniform(_splitmix64(h)))
            left -= above
        normal[i] = z
