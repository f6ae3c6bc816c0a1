"""Views: the poses that show most surface, chosen greedily, for scans when time is short."""

from __future__ import annotations

import numpy as np

from logs.run import RangeSensor
from planners.arena import Arena
from planners.errors import PlanError
from planners.methods.overview import N_CANDIDATES
from planners.reach import Reach
from sensorgraph.graph import Sensorgraph
from sensorgraph.planning.survey import LaserSurvey, survey_of
from sensorgraph.types import Floats, Ints

CANDIDATES_PER_VIEW = 5
"""Minimum number of candidate poses for each view."""


def views_within(
    reach: Reach,
    n: int,
    *,
    arena: Arena,
    sensor: RangeSensor,
    graph: Sensorgraph | None = None,
    seed: int = 0,
) -> Floats:
    """Choose n poses (n, 3) [m, m, rad] of base_link that the robot can reach, in order of decreasing gain.

    Parameters
    ----------
    graph : Sensorgraph whose expected error is the weight of each ray; None: equal weights.
    """
    if n < 1:
        raise PlanError(f"`views` is {n}, expected 1 or more")
    rng = np.random.default_rng(seed)
    nodes = np.nonzero(reach.mask)
    pick = rng.integers(len(nodes[0]), size=max(N_CANDIDATES, CANDIDATES_PER_VIEW * n))
    places = reach.nodes((nodes[0][pick], nodes[1][pick]))
    candidates = np.column_stack([places, rng.uniform(-np.pi, np.pi, len(places))])
    return candidates[choose_views(candidates, survey_of(arena, sensor, graph), n)]


def choose_views(candidates: Floats, survey: LaserSurvey, n: int) -> Ints:
    """Return the indices of n of the candidates (n_candidates, 3), in order of decreasing gain.

    The gain of a pose can only decrease when others are chosen (it is submodular). Earlier gains are therefore
    upper bounds, and few candidates are evaluated again (lazy greedy algorithm, Minoux 1978).
    """
    bound, chosen = survey.gain(candidates), list[int]()
    while len(chosen) < min(n, len(candidates)):
        i = int(bound.argmax())
        bound[i] = survey.gain(candidates[[i]])[0]
        if bound[i] < bound.max():
            continue
        survey.mark(candidates[[i]])
        bound[i] = -np.inf
        chosen.append(i)
    return np.array(chosen, dtype=np.intp)
