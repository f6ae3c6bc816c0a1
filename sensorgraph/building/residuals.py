"""Identification of the memory of a graph's residuals on its training scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.transforms import compose
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import POSES_AT_A_TIME, Sensorgraph
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.place_noise import places_of
from sensorgraph.models.residual_memory import ResidualMemory, events_of
from sensorgraph.types import Progress

MIN_READINGS, MAX_READINGS = 2000, 2_000_000
"""Readings that are too few for a memory, and readings that are used of a log, from its start."""
BETWEEN_RUNS = 1e7
"""[s] Time between runs for the memory, so that two runs share only what is permanent."""


def with_memory(graph: Sensorgraph, scans: TrainingScans, progress: Progress | None = None) -> Sensorgraph:
    """Identify the memory of a graph's residuals on its training scans.

    Raises
    ------
    SensorgraphError : There are too few readings.
    """
    n = -(-MAX_READINGS // graph.sensor.n_rays)
    some = scans.part(slice(0, n))
    if some.ranges.size < MIN_READINGS:
        raise SensorgraphError(
            f"{some.ranges.size} training readings are too few to identify a `memory`, expected {MIN_READINGS:,} "
            "or more; give a longer log"
        )
    parts = []
    for first in range(0, len(some), POSES_AT_A_TIME):
        if progress is not None:
            progress(first, len(some))
        rows = slice(first, first + POSES_AT_A_TIME)
        poses = some.poses[rows] if some.ray_poses is None else some.ray_poses[rows]
        predicted = graph.predict(poses)
        starts = compose(poses, scans.laser_mount)
        places = places_of(starts, graph.sensor.bearings, predicted.mode, graph.sensor.range_max)
        events = events_of(some.ranges[rows], predicted.mode, predicted.p_no_return, predicted.p_off)
        parts.append({**events, "places": places})
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    stamps = np.arange(len(some)) / graph.sensor.rate if some.stamps is None else some.stamps
    return replace(graph, memory=ResidualMemory.fit(**whole, stamps=stamps + BETWEEN_RUNS * some.run))
