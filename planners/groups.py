"""Members of groups of different sizes, as flat arrays."""

import numpy as np

from planners.types import Ints


def members(counts: Ints) -> tuple[Ints, Ints]:
    """Return the group and the number within it, each (counts.sum(),), of all members of groups of `counts` (n,) members."""
    group: Ints = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
    return group, np.arange(len(group)) - np.repeat(np.cumsum(counts) - counts, counts)
