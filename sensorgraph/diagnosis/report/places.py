"""Places of effects in the arena: points and sections of walls to mark."""

from __future__ import annotations

import numpy as np

from planners.arena import Arena
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.effects import Amendment
from sensorgraph.types import Floats


def marks(finding: Finding) -> list[tuple[str, tuple[float, float]]]:
    """Return label and point (x, y) [m, map] of every effect, and of an unexplained difference, that has a place."""
    out = [(a.effect.title, xy) for a in finding.effects if (xy := point_of(a)) is not None]
    unknown = finding.unknown
    if unknown is not None and unknown.deviation is not None and unknown.deviation.xy is not None:
        out.append(("unknown", unknown.deviation.xy))
    return out


def point_of(a: Amendment) -> tuple[float, float] | None:
    """Return the point (x, y) [m, map] of an effect, if it has one."""
    if a.effect.place == "spot" and {"x", "y"} <= set(a.parameters):
        return float(a["x"]), float(a["y"])
    return None if a.location is None else a.location.xy


def wall_sections(arena: Arena, a: Amendment) -> list[Floats]:
    """Return the walls, or the part of a wall, of an effect; each (2, 2) [m]."""
    pairs = zip(arena.names, arena.walls, strict=True)
    chosen = [wall for name, wall in pairs if a.place and a.place in (name, name.rsplit("/", 1)[0])]
    if len(chosen) == 1 and {"a", "b"} <= set(a.parameters):
        first, last = chosen[0]
        direction = (last - first) / max(float(np.hypot(*(last - first))), 1e-9)
        return [np.stack([first + a["a"] * direction, first + a["b"] * direction])]
    return chosen
