"""Where to drive next: how little a sensorgraph knows of each (x, y, phi) bin."""

from __future__ import annotations

import numpy as np

from planners.coverage import Coverage
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.types import Floats

POSES_PER_BLOCK = 4096  # poses predicted at a time
UNKNOWN = 1.0
"""Of a ray that the graph does not answer; an answered ray counts its chance of being off, which is less."""


def uncertainty(graph: Sensorgraph, grid: Coverage, *, max_rays: int | None = None) -> Floats:
    """Return the mean doubt (nx, ny, n_phi) over rays at the middle of each reachable bin, 0 to 1; 0 elsewhere.

    An unanswered ray counts 1, an answered one half its said chance of being more than 5 cm off: where nobody
    has looked comes before where the equations are poor.

    Parameters
    ----------
    max_rays : ask every n-th ray only, so that these are not many more; None: all
    """
    rays = np.arange(0, graph.sensor.n_rays, max(1, graph.sensor.n_rays // (max_rays or graph.sensor.n_rays)))
    bins = np.argwhere(grid.reachable)
    middle = grid.origin + grid.cell * (bins[:, :2] + 0.5)
    poses = np.column_stack([middle, bins[:, 2] * (2 * np.pi / grid.headings)])
    poses = poses_for(graph, "base_link", graph.sensor.mount, poses)
    out = np.zeros(grid.counts.shape)
    score = np.empty(len(bins))
    for start in range(0, len(bins), POSES_PER_BLOCK):
        said = graph.predict(poses[start : start + POSES_PER_BLOCK], rays=rays)
        score[start : start + POSES_PER_BLOCK] = np.where(said.answered, 0.5 * said.p_off, UNKNOWN).mean(
            axis=1
        )
    out[tuple(bins.T)] = score
    return out
