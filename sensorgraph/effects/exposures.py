"""Common tests of whether a run could show an effect, and the texts that give the reason."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.errors import MAX_LISTED
from sensorgraph.effects.interfaces import Exposure
from sensorgraph.types import Floats

UNEXPECTED = 5.0
"""[nats] Evidence of a reading far from its expected value."""


def listed(places: Sequence[str]) -> str:
    """Return the first few places as text."""
    more = len(places) - MAX_LISTED
    return ", ".join(places[:MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def falls_short(nats: float, need: float) -> str:
    """Return a text on the expected evidence of a run and the evidence needed to report an effect [nats]."""
    return f"the expected log Bayes factor is {nats:.0f}, and {need:.0f} are needed"


def blind_walls(exposure: Exposure, nats: Floats, need: float, why: str) -> str:
    """Return the walls with too little evidence as text; `nats` (n_scans, n_rays) is the evidence of each ray."""
    names = exposure.arena.names
    on = exposure.wall >= 0
    total = np.bincount(exposure.wall[on], nats[on], len(names))[: len(names)]
    blind = [name for name, value in zip(names, total, strict=True) if value < need]
    return f"{listed(blind)}: {why}" if blind else ""


def too_few_returns(exposure: Exposure, share: float, need: float) -> str:
    """Return a text if a share of odd readings is not detectable among the usual outliers; empty otherwise."""
    p, usual = share, exposure.stray
    per_return = p * np.log(p / usual) + (1 - p) * np.log((1 - p) / (1 - usual)) if p > usual else 0.0
    nats = exposure.n_seen * per_return
    return "" if nats >= need else f"only {exposure.n_seen} returns; {falls_short(nats, need)}"


def count_of_returns(exposure: Exposure) -> str:
    """Return a text on the number of returns."""
    return f"only {exposure.n_seen} returns"


def spread_of_ranges(exposure: Exposure) -> str:
    """Return a text on the 90 % interval of the ranges."""
    low, high = np.percentile(exposure.reading[exposure.seen], [5, 95]) if exposure.n_seen else (0.0, 0.0)
    return f"the ranges are only from {low:.1f} to {high:.1f} m"


def speeds(exposure: Exposure) -> str:
    """Return a text on the 95 % quantiles of speed and turn rate."""
    speed = float(np.percentile(np.hypot(*exposure.twists[:, :2].T), 95))
    turn = float(np.percentile(np.abs(exposure.twists[:, 2]), 95))
    return f"the robot drove at most {speed:.2f} m/s and turned at most {turn:.2f} rad/s"
