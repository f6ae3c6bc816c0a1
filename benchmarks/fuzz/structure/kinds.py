"""Every kind of odd log, by name: what is odd, and what is true of it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import Draft
from benchmarks.fuzz.structure.kinds_clocks import CLOCKS
from benchmarks.fuzz.structure.kinds_counts import COUNTS
from benchmarks.fuzz.structure.kinds_frames import FRAMES
from benchmarks.fuzz.structure.kinds_nodes import NODES
from benchmarks.fuzz.structure.kinds_rays import RAYS
from benchmarks.fuzz.structure.kinds_topics import TOPICS
from benchmarks.fuzz.structure.kinds_types import TYPES
from benchmarks.fuzz.structure.kinds_units import UNITS
from benchmarks.fuzz.structure.start import LASERS, Kind, Start
from benchmarks.fuzz.structure.writers import CONTAINERS

UNREADABLE = ("bag_without_index",)
"""Containers that `recover` reads, and the other commands refuse."""


def _in(container: str) -> Callable[[Start], Draft]:
    def make(start: Start) -> Draft:
        if not container.startswith("carmen"):
            draft = start.draft()
            draft.usable = container not in UNREADABLE
        else:
            draft = start.draft(replace(LASERS[4], n=start.pick((180, 181))), reference=0.0)
            if "alone" in container or "raw" in container:
                draft.expects = set()
                draft.gauges |= {"lever", "yaw"}
        draft.container = container
        return draft

    return make


KINDS: dict[str, Kind] = {
    "nothing": lambda start: start.draft(),
    **{f"topics.{name}": kind for name, kind in TOPICS.items()},
    **{f"frames.{name}": kind for name, kind in FRAMES.items()},
    **{f"clocks.{name}": kind for name, kind in CLOCKS.items()},
    **{f"units.{name}": kind for name, kind in UNITS.items()},
    **{f"counts.{name}": kind for name, kind in COUNTS.items()},
    **{f"types.{name}": kind for name, kind in TYPES.items()},
    **{f"rays.{name}": kind for name, kind in RAYS.items()},
    **{f"containers.{name}": _in(name) for name in CONTAINERS},
    **{f"nodes.{name}": kind for name, kind in NODES.items()},
}
"""Name -> what makes one log of it."""


def draft_of(name: str, number: int, seed: int) -> Draft:
    """Make one log of a kind."""
    return KINDS[name](Start(np.random.default_rng([seed, number, zlib.crc32(name.encode())])))
