"""What a graph leaves of its training scans, and the memory that this has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import POSES_AT_A_TIME, Sensorgraph
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.narmax.fit import sequence_of
from sensorgraph.models.residual_memory import MEMORY, ResidualMemory, events_of
from sensorgraph.types import Progress


def with_memory(graph: Sensorgraph, scans: TrainingScans, progress: Progress | None = None) -> Sensorgraph:
    """Identify the memory of a graph's residuals on its training scans; no lag crosses a gap.

    Raises
    ------
    SensorgraphError : too few scans follow each other
    """
    some = scans.part(slice(0, MEMORY.max_scans))
    motion = sequence_of(some)
    index = np.arange(len(some)) + motion.sequence
    if int((motion.position > 0).sum()) < MEMORY.min_rows:
        raise SensorgraphError(
            f"{int((motion.position > 0).sum())} of {len(some)} training scans follow another without a gap, expected "
            f"{MEMORY.min_rows} or more for a `memory`; give a log with its scans in a row"
        )
    parts = []
    for first in range(0, len(some), POSES_AT_A_TIME):
        if progress is not None:
            progress(first, len(some))
        rows = slice(first, first + POSES_AT_A_TIME)
        poses = some.poses[rows] if some.ray_poses is None else some.ray_poses[rows]
        said = graph.predict(poses)
        parts.append(events_of(some.ranges[rows], said.mode, said.p_no_return, said.p_off))
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return replace(graph, memory=ResidualMemory.fit(**whole, index=index))
