"""Every kind of odd log, by name: what is odd, and what is true of it."""

from __future__ import annotations

import zlib

import numpy as np

from benchmarks.fuzz.structure.draft import Draft
from benchmarks.fuzz.structure.kinds_laser import RAYS, TYPES, UNITS
from benchmarks.fuzz.structure.kinds_nodes import NODES
from benchmarks.fuzz.structure.kinds_times import CLOCKS, COUNTS
from benchmarks.fuzz.structure.kinds_topics import FRAMES, TOPICS
from benchmarks.fuzz.structure.start import Kind, Start, kind
from benchmarks.fuzz.structure.writers import CARMEN_LASER, CONTAINERS, TEXTS

GROUPS: dict[str, dict[str, Kind]] = {
    "topics": TOPICS,
    "frames": FRAMES,
    "clocks": CLOCKS,
    "units": UNITS,
    "counts": COUNTS,
    "types": TYPES,
    "rays": RAYS,
    "containers": {name: kind(containers=(name,)) for name in CONTAINERS if name not in TEXTS}
    | {
        name: kind(containers=(name,), laser=CARMEN_LASER, reference=0.0, **facts)
        for name, facts in TEXTS.items()
    },
    "nodes": NODES,
}
KINDS = {"nothing": kind()} | {
    f"{group}.{name}": one for group, kinds in GROUPS.items() for name, one in kinds.items()
}
"""Name -> what makes one log of it."""


def draft_of(name: str, number: int, seed: int) -> Draft:
    """Make one log of a kind."""
    return KINDS[name](Start(np.random.default_rng([seed, number, zlib.crc32(name.encode())])))
