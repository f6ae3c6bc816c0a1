"""Summary of the mixture of one ray in numpy: what `sensorgraph.models.mixture.summarise` is compared with."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from planners.types import Floats
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.distribution import TAIL
from sensorgraph.models.mixture import MIN_WEIGHT


def summarise_plain(
    r: Floats, w: Floats, s: Floats, n: int, leftover: float, farthest: float, which: int
) -> tuple[float, float, float, float, float, float]:
    """Compute `summarise` in numpy: the arguments and the result are the same."""
    r, w, s = r[:n], w[:n], s[:n]
    total = float(w.sum())
    if total <= MIN_WEIGHT:
        return farthest, farthest, farthest, farthest, leftover, 1.0
    mean = float(w @ r) / total
    sigma = math.sqrt(float(w @ ((r - mean) ** 2 + s**2)) / total)
    median = _median_plain(r, w, s)
    inside = (r >= r[:, None]) & (r <= (r + TAIL * s)[:, None])  # (window, candidate)
    inside &= np.arange(n) >= np.arange(n)[:, None]
    window = inside[int(np.argmax(inside @ w))]
    mode = _median_plain(r[window], w[window], s[window])
    point = (mode, median, mean)[which]
    near = w @ (ndtr((point + OFF_DISTANCE - r) / s) - ndtr((point - OFF_DISTANCE - r) / s))
    return median, mode, mean, sigma, leftover, min(max(1.0 - float(near) / total, 0.0), 1.0)


def _median_plain(r: Floats, w: Floats, s: Floats) -> float:
    total = float(w.sum())
    low, high = float((r - 9 * s).min()), float((r + 9 * s).max())
    return float(brentq(lambda x: float(w @ ndtr((x - r) / s)) - total / 2, low, high, xtol=1e-12))
