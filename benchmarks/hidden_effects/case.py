"""A case: which one it is, what a diagnoser may see of it, and the truth; every world makes the same kind."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects.log import Log, write_log

KINDS = ("dev", "report")
BACKGROUNDS = ("clean", "dirty", "wrong_tolerances")


class Redraw(Exception):
    """A drawn case cannot be used: no room, a collision, a dull drive, a faint effect. Draw it again."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """Which case: everything else follows from it."""

    suite: str
    index: int
    kinds: str = "dev"
    """A stream of seeds, and the effects outside the library: for development or for reports."""
    background: str = ""
    """Empty: clean and dirty in turn."""
    effect: str = ""
    """This effect instead of the suite's turn."""
    strength: float | None = None
    """0...1 of a single effect instead of strata in turn (own world)."""
    floors: Path | None = None
    """Folder of the floors that rooms are cut from (floors, pixels)."""

    def background_in_turn(self, n: int) -> str:
        """Return the background; every other case is dirty, and each of n effects in turn is clean and dirty."""
        is_dirty = (self.index + (self.index // n if n % 2 == 0 else 0)) % 2 == 1
        return self.background or BACKGROUNDS[is_dirty]


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """What is written."""

    log: Log
    map: Mapping[str, str | bytes]
    """Files of the map: arena.geojson, or arena.yaml and its image."""
    robot: str
    """robot.yaml"""
    truth: dict[str, Any]
    world: str = "hidden_effects"
    """Name of the world in its logs."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """What tests look at; not written."""


def geojson(arena: str, rings: Mapping[str, Sequence[Sequence[float]] | Any], digits: int = 4) -> str:
    """Return a map as a FeatureCollection of rings (n, 2) [m]; `arena` is the name of the outer one."""
    features = []
    for name, ring in rings.items():
        closed = [[round(float(x), digits), round(float(y), digits)] for x, y in (*ring, ring[0])]
        kind = "arena" if name == arena else "obstacle"
        features.append(
            {
                "type": "Feature",
                "properties": {"name": name, "kind": kind},
                "geometry": {"type": "Polygon", "coordinates": [closed]},
            }
        )
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1)


def truth_of(
    spec: Spec,
    hidden: Sequence[dict[str, Any]],
    *,
    is_foreign: bool,
    seed: int,
    background: str,
    n_rays: int,
    stream: str = "",
    **more: Any,
) -> dict[str, Any]:
    """Return the truth file of a case.

    Parameters
    ----------
    hidden : each effect by `told`; of one outside the library there is no other
    more : facts of the world, for who judges an answer
    """
    first = hidden[0] if hidden else None
    return {
        "suite": spec.suite,
        "stream": stream or spec.kinds,
        "index": spec.index,
        "seed": seed,
        "background": background,
        "effects": [] if is_foreign else list(hidden),
        "foreign": first["name"] if first is not None and is_foreign else None,
        "foreign_effect": first if is_foreign else None,
        "channel": first["channel"] if first is not None else None,
        "n_rays": n_rays,
        **more,
    }


def save(case: Case, folder: Path, number: int) -> None:
    """Write a case under a number: what may be seen in cases/, the truth in truth/."""
    seen = folder / "cases" / f"{number:04d}"
    seen.mkdir(parents=True, exist_ok=True)
    write_log(case.log, seen / "run.mcap", case.world)
    for name, content in case.map.items():
        (seen / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    (seen / "robot.yaml").write_text(case.robot)
    (folder / "truth").mkdir(exist_ok=True)
    truth = json.dumps(case.truth, indent=1, default=float)
    (folder / "truth" / f"{number:04d}.json").write_text(truth)
