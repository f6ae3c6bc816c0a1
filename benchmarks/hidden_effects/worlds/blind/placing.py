"""Effects whose size or place depends on the run: sections of walls that are seen, places that are visited."""

from __future__ import annotations

import numpy as np

from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.worlds.blind.drive import Driven
from benchmarks.hidden_effects.worlds.blind.effects import Hidden, rounded
from benchmarks.hidden_effects.worlds.blind.scans import Scans
from benchmarks.hidden_effects.worlds.blind.setups import Setup, visited

DOOR_ROOM = (0.9, 2.1, 2.2)
"""[m] the room behind a door: before the hinge, deep, beyond the hinge."""


def draw_section(
    setup: Setup,
    scans: Scans,
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
    wall, along, sections = scans.wall, scans.along, []
    for edge, length in enumerate(setup.room.lengths):
        if length < 0.9 or edge == avoid:
            continue
        on_wall = wall == edge
        for _ in range(6):
            width = min(rng.uniform(*lengths), 0.85 * length)
            a = rng.uniform(0.05, length - width - 0.05) if length - width > 0.1 else 0.05
            inside = (along[on_wall] > a) & (along[on_wall] < a + width)
            seen = scans.true_ranges[on_wall][inside]
            middle = np.median(seen) if inside.any() else 0.0
            sections.append((inside.sum() / wall.size, edge, a, a + width, middle))
    if not sections:
        raise Redraw("no wall is long enough")
    sections.sort(reverse=True)
    good = [one for one in sections if one[0] > max(least_share, 0.4 * sections[0][0])] or sections[:1]
    _, edge, a, b, middle = good[rng.integers(len(good))]
    hidden.wall, hidden.place = edge, setup.room.wall_name(edge)
    hidden.values |= {"a": rounded(a, 3), "b": rounded(b, 3)}
    return float(middle)


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


def place(
    setup: Setup, driven: Driven, scans: Scans, hidden: Hidden, rng: np.random.Generator, *, plain: bool
) -> None:
    """Draw what of an effect depends on the run.

    Parameters
    ----------
    driven, scans : of the run without the effects
    plain : the set-up is clean or a pair is hidden; a few details differ, for variety
    """
    middle = 0.0
    if hidden.name in SECTIONS:
        moved = setup.hidden.get("moved_wall") if hidden.name == "black_surface" else None
        lengths, least_share = SECTIONS[hidden.name]
        avoid = -1 if moved is None else moved.wall
        middle = draw_section(
            setup, scans, hidden, rng, lengths=lengths, least_share=least_share, avoid=avoid
        )
    if hidden.name in ("f_dust", "f_ramp"):
        _spot(driven, hidden, rng)
    if hidden.name == "glass":
        hidden.values["alpha_ret"] = rounded(rng.uniform(0.3, 0.65), 3)
        hidden.values["depth"] = rounded(rng.uniform(0.6, 2.2), 2) if plain else 0.0
    elif hidden.name == "black_surface":
        hidden.values["r0"] = rounded(middle * rng.uniform(0.55, 0.8), 3)
    elif hidden.name == "f_door":
        _door(setup, hidden)
    elif hidden.name == "f_dust":
        hidden.values["mu"] = float(rng.uniform(0.12, 0.25))
    elif hidden.name == "f_ramp":
        hidden.values["beta"] = float(setup.robot.height / rng.uniform(1.2, 1.8))
        hidden.values["dir"] = float(rng.uniform(-3, 3))
    elif hidden.name == "max_range":
        ranges = scans.true_ranges
        seen = ranges[ranges < setup.robot.range_max]
        hidden.values = {"R": rounded(np.quantile(seen, rng.uniform(0.75, 0.88)), 2)}
    elif hidden.name == "min_range":
        hidden.values = {"r_min": rounded(np.quantile(scans.true_ranges, rng.uniform(0.06, 0.15)), 3)}
    if hidden.name in DURING_RUN:
        hidden.values["t0"] = rounded(setup.duration * rng.uniform(*DURING_RUN[hidden.name]), 2)


def _spot(driven: Driven, hidden: Hidden, rng: np.random.Generator) -> None:
    radius = float(rng.uniform(0.5, 0.8))
    x, y = visited(driven, radius, 40, rng)[int(rng.integers(3, 10)) - 1]
    hidden.xy = (rounded(x, 3), rounded(y, 3))
    hidden.values = {"x": float(x), "y": float(y), "r": radius}


def _door(setup: Setup, hidden: Hidden) -> None:
    """Build the small room behind the door, and hinge its leaf."""
    outer, edge = setup.built_plain.outer, hidden.wall
    along = outer[(edge + 1) % len(outer)] - outer[edge]
    along = along / np.hypot(*along)
    out = setup.built_plain.outward(edge)
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
