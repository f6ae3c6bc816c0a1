"""A hidden effect, as the physics reads it and as the truth tells it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.blind_world.rooms import Floats


@dataclass(kw_only=True, eq=False)
class Hidden:
    """One effect; filled step by step while a case is drawn."""

    name: str
    values: dict[str, float] = field(default_factory=dict)
    """Parameters as told, SI units."""
    wall: int = -1
    """Index in Room.walls of the wall it sits on."""
    place: str | None = None
    """Name of the wall or obstacle it sits on."""
    xy: tuple[float, float] | None = None
    """[m] where it is."""
    shapes: dict[str, Floats] = field(default_factory=dict)
    """What the physics needs besides, not told."""

    def __getitem__(self, parameter: str) -> float:
        return self.values[parameter]


Secrets = Mapping[str, Hidden]
"""Effects by name."""


def rounded(value: Any, digits: int = 5) -> float:
    """Return a value as the truth tells it."""
    return float(round(value, digits))


def either_sign(rng: np.random.Generator) -> int:
    """Draw -1 or 1."""
    return int(rng.choice([-1, 1]))


def material_size(rng: np.random.Generator, materiality: float) -> float:
    """Draw a size clearly above a materiality."""
    return float(materiality * rng.uniform(1.7, 6))
