"""Priority of the next drive: expected error of a sensorgraph in each (x, y, phi) bin."""

from __future__ import annotations

import numpy as np

from planners.coverage import Coverage
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import POSES_AT_A_TIME, Sensorgraph
from sensorgraph.types import Floats

UNKNOWN = 1.0
"""Expected error of a ray that the graph does not answer; that of an answered ray is smaller."""


def uncertainty(graph: Sensorgraph, grid: Coverage, *, max_rays: int | None = None) -> Floats:
    """Return the expected error (nx, ny, n_phi) at the middle of each reachable bin, from 0 to 1; 0 elsewhere.

    It is the mean over the rays of 1 for an unanswered ray, and p_off / 2 for an answered one. Here p_off is
    the probability of an error above 5 cm. So unobserved places come before places with inaccurate equations.

    Parameters
    ----------
    max_rays : Query every n-th ray only, so that their number is about this; None: all.
    """
    rays = np.arange(0, graph.sensor.n_rays, max(1, graph.sensor.n_rays // (max_rays or graph.sensor.n_rays)))
    bins = np.argwhere(grid.reachable)
    middle = grid.origin + grid.cell * (bins[:, :2] + 0.5)
    poses = np.column_stack([middle, bins[:, 2] * (2 * np.pi / grid.headings)])
    poses = poses_for(graph, "base_link", graph.sensor.mount, poses)
    out = np.zeros(grid.counts.shape)
    score = np.empty(len(bins))
    for start in range(0, len(bins), POSES_AT_A_TIME):
        prediction = graph.predict(poses[start : start + POSES_AT_A_TIME], rays=rays)
        score[start : start + POSES_AT_A_TIME] = np.where(
            prediction.answered, 0.5 * prediction.p_off, UNKNOWN
        ).mean(axis=1)
    out[tuple(bins.T)] = score
    return out
