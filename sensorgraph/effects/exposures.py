"""Shared tests of whether a run could have shown an effect, and the sentences that say so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.effects.interfaces import Exposure
from sensorgraph.types import Bools, Floats

UNEXPECTED = 5.0
"""[nats] of a reading far from where it is expected."""
MAX_PLACES = 4
"""Places named in a sentence."""
ONE_WALL = 0.98
"""Share of rays on one wall above which they may as well tell of that wall."""
MIN_RAYS = 4
"""Rays; fewer tell nothing of where they are."""


def listed(places: Sequence[str]) -> str:
    """Name the first few places."""
    more = len(places) - MAX_PLACES
    return ", ".join(places[:MAX_PLACES]) + (f" and {more} more" if more > 0 else "")


def falls_short(nats: float, need: float) -> str:
    """Say how much evidence a run would bring, and how much a name takes [nats]."""
    return f"it would bring {nats:.0f} nats, and a name takes {need:.0f}"


def blind_walls(exposure: Exposure, nats: Floats, need: float, why: str) -> str:
    """Name the walls on which too few rays would tell; `nats` (n_scans, n_rays) of each ray."""
    names = exposure.arena.names
    on = exposure.wall >= 0
    total = np.bincount(exposure.wall[on], nats[on], len(names))[: len(names)]
    blind = [name for name, value in zip(names, total, strict=True) if value < need]
    return f"{listed(blind)}: {why}" if blind else ""


def too_few_returns(exposure: Exposure, share: float, need: float) -> str:
    """Say that a share of odd readings would not stand out of the strays that need no effect."""
    p, usual = share, exposure.stray
    per_return = p * np.log(p / usual) + (1 - p) * np.log((1 - p) / (1 - usual)) if p > usual else 0.0
    nats = exposure.n_seen * per_return
    return "" if nats >= need else f"only {exposure.n_seen} returns; {falls_short(nats, need)}"


def only_wall(exposure: Exposure, some: Bools) -> str:
    """Return the one wall that nearly all of some rays met; empty where there is none."""
    walls = np.bincount(exposure.wall[some & (exposure.wall >= 0)])
    n = int(walls.sum())
    if n < MIN_RAYS or walls.max() <= ONE_WALL * n:
        return ""
    return exposure.arena.names[int(walls.argmax())]


def count_of_returns(exposure: Exposure) -> str:
    """Say how many returns there are."""
    return f"only {exposure.n_seen} returns"


def spread_of_ranges(exposure: Exposure) -> str:
    """Say which ranges there are."""
    low, high = np.percentile(exposure.reading[exposure.seen], [5, 95]) if exposure.n_seen else (0.0, 0.0)
    return f"ranges only from {low:.1f} to {high:.1f} m"


def speeds(exposure: Exposure) -> str:
    """Say how fast the robot drove and turned."""
    speed = float(np.percentile(np.hypot(*exposure.twists[:, :2].T), 95))
    turn = float(np.percentile(np.abs(exposure.twists[:, 2]), 95))
    return f"the robot drove at most {speed:.2f} m/s and turned at most {turn:.2f} rad/s"
