"""Effects whose size or place depends on the run: sections of walls that are seen, places that are visited."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.blind.base import V, X, Y
from benchmarks.hidden_effects.worlds.blind.drive import Driven
from benchmarks.hidden_effects.worlds.blind.effects import Hidden, material_size, rounded
from benchmarks.hidden_effects.worlds.blind.robots import Robot
from benchmarks.hidden_effects.worlds.blind.rooms import Room
from benchmarks.hidden_effects.worlds.blind.scans import Scans

DOOR_ROOM = (0.9, 2.1, 2.2)
"""[m] the room behind a door: before the hinge, deep, beyond the hinge."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scenery:
    """What a run without the effects saw, to place them in."""

    room: Room
    """The map."""
    built: Room
    """The room as it stands, without any effect."""
    robot: Robot
    driven: Driven
    scans: Scans
    hidden: Mapping[str, Hidden]
    """All that is hidden in the run."""
    duration: float
    """[s] as planned."""
    plain: bool
    """The set-up is clean or a pair is hidden; a few details differ, for variety."""

    def draw_section(
        self,
        hidden: Hidden,
        rng: np.random.Generator,
        *,
        lengths: tuple[float, float],
        least_share: float,
        avoid: int = -1,
    ) -> float:
        """Put an effect on a section [m] of a wall that many rays meet; return their median range [m].

        Parameters
        ----------
        least_share : of all rays, where there is such a wall
        avoid : index of a wall
        """
        wall, along, sections = self.scans.wall, self.scans.along, []
        for edge, length in enumerate(self.room.lengths):
            if length < 0.9 or edge == avoid:
                continue
            on_wall = wall == edge
            for _ in range(6):
                width = min(rng.uniform(*lengths), 0.85 * length)
                a = rng.uniform(0.05, length - width - 0.05) if length - width > 0.1 else 0.05
                inside = (along[on_wall] > a) & (along[on_wall] < a + width)
                seen = self.scans.true_ranges[on_wall][inside]
                middle = np.median(seen) if inside.any() else 0.0
                sections.append((inside.sum() / wall.size, edge, a, a + width, middle))
        if not sections:
            raise Redraw("no wall is long enough")
        sections.sort(reverse=True)
        good = [one for one in sections if one[0] > max(least_share, 0.4 * sections[0][0])] or sections[:1]
        _, edge, a, b, middle = good[rng.integers(len(good))]
        hidden.wall, hidden.place = edge, self.room.wall_name(edge)
        hidden.values |= {"a": rounded(a, 3), "b": rounded(b, 3)}
        return float(middle)


def visited(
    driven: Driven, radius: float, n: int, rng: np.random.Generator, *, moving: bool = False
) -> Floats:
    """Draw places (n, 2) [m] on the way, those first where the robot is within a radius [m] for longest."""
    log = driven.log[::50]
    if moving:
        log = log[np.abs(log[:, V]) > 0.05]
    places = log[rng.choice(len(log), n)][:, [X, Y]]
    shares = [(np.hypot(*(log[:, [X, Y]] - place).T) < radius).mean() for place in places]
    return np.asarray(places[np.argsort(shares)[::-1]])


def place_slip(hidden: Hidden, driven: Driven, rng: np.random.Generator) -> None:
    """Put a slippery patch where the robot drives often."""
    radius = rounded(rng.uniform(0.4, 0.75), 3)
    x, y = visited(driven, radius, 60, rng, moving=True)[int(rng.integers(0, 6))]
    hidden.xy = (rounded(x, 3), rounded(y, 3))
    hidden.values = {
        "s": rounded(material_size(rng, 0.05), 4),
        "x": hidden.xy[0],
        "y": hidden.xy[1],
        "r": radius,
    }


SECTIONS = {
    "glass": ((0.9, 2.0), 0.05),
    "mirror": ((0.7, 1.6), 0.04),
    "black_surface": ((0.8, 2.0), 0.05),
    "f_door": ((0.8, 0.95), 0.03),
    "f_bloom": ((0.2, 0.35), 0.008),
    "f_curtain": ((0.9, 2.0), 0.04),
}
"""Of effects of a part of a wall: between which lengths [m] it is, and the least share of the rays that meet it."""
DURING_RUN = {"f_door": (0.35, 0.55), "f_knock": (0.4, 0.6), "f_shoved": (0.35, 0.6)}
"""Of what happens once: between which shares of the run."""


def place(scenery: Scenery, hidden: Hidden, rng: np.random.Generator) -> None:
    """Draw what of an effect depends on the run."""
    middle = 0.0
    if hidden.name in SECTIONS:
        moved = scenery.hidden.get("moved_wall") if hidden.name == "black_surface" else None
        lengths, least_share = SECTIONS[hidden.name]
        avoid = -1 if moved is None else moved.wall
        middle = scenery.draw_section(hidden, rng, lengths=lengths, least_share=least_share, avoid=avoid)
    if hidden.name in ("f_dust", "f_ramp"):
        _spot(scenery, hidden, rng)
    if hidden.name == "glass":
        hidden.values["alpha_ret"] = rounded(rng.uniform(0.3, 0.65), 3)
        hidden.values["depth"] = rounded(rng.uniform(0.6, 2.2), 2) if scenery.plain else 0.0
    elif hidden.name == "black_surface":
        hidden.values["r0"] = rounded(middle * rng.uniform(0.55, 0.8), 3)
    elif hidden.name == "f_door":
        _door(scenery, hidden)
    elif hidden.name == "f_dust":
        hidden.values["mu"] = float(rng.uniform(0.12, 0.25))
    elif hidden.name == "f_ramp":
        hidden.values["beta"] = float(scenery.robot.height / rng.uniform(1.2, 1.8))
        hidden.values["dir"] = float(rng.uniform(-3, 3))
    elif hidden.name == "max_range":
        ranges = scenery.scans.true_ranges
        seen = ranges[ranges < scenery.robot.range_max]
        hidden.values = {"R": rounded(np.quantile(seen, rng.uniform(0.75, 0.88)), 2)}
    elif hidden.name == "min_range":
        hidden.values = {"r_min": rounded(np.quantile(scenery.scans.true_ranges, rng.uniform(0.06, 0.15)), 3)}
    if hidden.name in DURING_RUN:
        hidden.values["t0"] = rounded(scenery.duration * rng.uniform(*DURING_RUN[hidden.name]), 2)


def _spot(scenery: Scenery, hidden: Hidden, rng: np.random.Generator) -> None:
    radius = float(rng.uniform(0.5, 0.8))
    x, y = visited(scenery.driven, radius, 40, rng)[int(rng.integers(3, 10)) - 1]
    hidden.xy = (rounded(x, 3), rounded(y, 3))
    hidden.values = {"x": float(x), "y": float(y), "r": radius}


def _door(scenery: Scenery, hidden: Hidden) -> None:
    """Build the small room behind the door, and hinge its leaf."""
    outer, edge = scenery.built.outer, hidden.wall
    along = outer[(edge + 1) % len(outer)] - outer[edge]
    along = along / np.hypot(*along)
    out = scenery.built.outward(edge)
    hinge = outer[edge] + along * hidden["a"]
    before, deep, beyond = DOOR_ROOM
    corners = [
        hinge - along * before,
        hinge - along * before + out * deep,
        hinge + along * beyond + out * deep,
        hinge + along * beyond,
    ]
    hidden.shapes = {
        "behind": np.array([(*corners[k], *corners[k + 1]) for k in range(3)]),
        "leaf": along * (hidden["b"] - hidden["a"]),
        "hinge": hinge,
    }
    hidden.values |= {"angle": -1.75, "dt": 2.5}
    hidden.xy = (rounded(hinge[0], 3), rounded(hinge[1], 3))


PLACED = (
    "glass", "mirror", "black_surface", "f_door", "f_dust", "f_ramp", "max_range", "min_range", "f_knock", "f_bloom",
    "f_curtain", "f_shoved",
)  # fmt: skip
"""In the order in which they are drawn."""
