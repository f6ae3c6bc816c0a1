"""The law of the group of readings whose mean residual is largest, as an engineer would find it by eye.

Groups are all readings, a sector, a wall, late readings, missing or unexpected returns.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects.entrants.simulated import MAX_RESIDUAL, Scans
from benchmarks.hidden_effects.library import MATERIALITY
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.seen import Seen, read_case

CHANCE = 3.0
"""Materialities that the mean residual of a group must reach."""


def answer(case: Path) -> dict[str, Any]:
    """Return a report."""
    seen = read_case(case)
    return largest_residual(seen) if seen.rings else {"effects": [], "unknown": None}


def largest_residual(case: Seen) -> dict[str, Any]:
    """Name the law of the group of readings that is off the most."""
    scans = Scans(case)
    mu, wall = scans.expected({})
    names = [f"{name}/edge_{i}" for name, ring in case.rings.items() for i in range(len(ring))]
    far = mu > float(case.robot["sensor"]["range_max"])
    seen = np.isfinite(scans.z) & np.isfinite(mu) & ~far
    with np.errstate(invalid="ignore"):
        off = np.where(seen, scans.z - mu, 0.0)
    found: list[tuple[float, dict[str, Any]]] = []

    def look(name: str, group: Floats, key: str, place: str = "", least: float = 0.02) -> None:
        chosen = seen & group.astype(bool)
        if chosen.sum() >= least * seen.sum():
            mean = float(off[chosen].mean())
            location = {"name": place, "xy": None} if place else None
            found.append(
                (
                    abs(mean) / MATERIALITY[name][0],
                    {"name": name, "parameters": {key: mean}, "location": location},
                )
            )

    look("range_bias", np.ones_like(mu), "b")
    look("range_drift", np.broadcast_to(scans.share[:, None] > 2 / 3, mu.shape), "b1")
    for k in range(8):
        low, high = np.quantile(scans.bearings, [k / 8, (k + 1) / 8])
        look("sector_bias", np.broadcast_to((scans.bearings >= low) & (scans.bearings < high), mu.shape), "b")
    for k, name in enumerate(names):
        is_outer = name.startswith(f"{next(iter(case.rings))}/")
        label = "moved_wall" if is_outer else "moved_obstacle"
        look(label, wall == k, "d" if is_outer else "dx", name if is_outer else name.partition("/")[0])
    short = seen & (off < -MAX_RESIDUAL / 2)
    found.append((short.mean() / 0.01, {"name": "unmapped_obstacle", "parameters": {}}))
    lost = np.isposinf(scans.z) & np.isfinite(mu) & ~far
    found.append((lost.mean() / 0.01, {"name": "max_range", "parameters": {}}))
    ratio, best = max(found, key=lambda pair: pair[0])
    return {"effects": [best] if ratio >= CHANCE else [], "unknown": None}
