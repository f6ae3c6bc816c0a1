"""Share of global starts that find the robot: AMCL and the filter of a graph, from anywhere and after a global search.

    python -m benchmarks.global_starts ../shared/data/raw-carmen/intel.clf.bz2 --work /tmp/in_map

As `graph_filter.py`, without being told where to start: particles lie anywhere in the mapped space, or about the places
that the global search of `locate` finds for the first scan in the graph.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from benchmarks.arguments import log_of_halves, parser_of
from benchmarks.graph_filter import MOST, N_RAYS, filtered, graph_with_memory
from benchmarks.localize_in_map import Halves, halves
from benchmarks.particle_filter import Motion, driven, fitted_amcl
from planners.types import Floats
from sensorgraph.exporting.amcl_filter import START_SPREAD, updates
from sensorgraph.exporting.amcl_filter import filtered as follow_amcl
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization.global_search import find_places, local_view
from sensorgraph.localization.known_map import known_map
from sensorgraph.localization.scans import scan_points
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.seen_space import seen_space

N_GLOBAL, N_FIRST, N_STARTS = 8000, 10, 20
"""Number of particles anywhere; number of updates, and of starts."""
CONVERGED = 0.5
"""[m] Largest error of a filter that has converged."""


def anywhere(graph: Sensorgraph, n: int, rng: np.random.Generator) -> Floats:
    """Return n poses in the space that the training rays crossed."""
    model = graph.model
    assert isinstance(model, Faces | CellModel)
    return seen_space(model).draw(n, rng)


def searched(data: Halves, n: int, rng: np.random.Generator) -> Callable[[int], Floats]:
    """Return what draws n poses about the places that the global search of `locate` finds for a scan."""
    place, scans = known_map(data.walls, data.seen, data.normals), scan_points(data.second)

    def start(first: int) -> Floats:
        view = local_view(scans, np.array([first]), np.zeros((1, 3)))
        poses = find_places(view, place).poses
        return np.asarray(poses[rng.integers(len(poses), size=n)] + rng.normal(size=(n, 3)) * START_SPREAD)

    return start


def converged(
    follow: Callable[[Floats, int], Floats], start: Callable[[int], Floats], data: Halves
) -> tuple[float, float]:
    """Return the share of global starts that have found the robot after `N_FIRST` updates, and the seconds of each."""
    usable = np.flatnonzero(data.covered & np.isfinite(data.truth[:, 0]))
    found, began = [], time.process_time()
    for first in usable[np.linspace(0, 0.9 * len(usable), N_STARTS).astype(int)]:
        poses = follow(start(int(first)), int(first))
        last = np.flatnonzero(np.isfinite(poses[:, 0]))[-1]
        found.append(np.hypot(*(poses[last, :2] - data.truth[last, :2])) < CONVERGED)
    return float(np.mean(found)), (time.process_time() - began) / N_STARTS


def main() -> None:
    """Print how often filters find the robot that are not told where it starts."""
    parser = parser_of(__doc__)
    log_of_halves(parser)
    given = parser.parse_args()
    data = halves(given.log, given.work, hidden=N_RAYS)
    second, drive = data.second, driven(data.second)
    fitted = fitted_amcl(data.first, data.graph)
    graph = graph_with_memory(data, given.log, given.work)
    motion, rng = Motion.fit(data.first), np.random.default_rng(0)

    def by_graph(particles: Floats, first: int) -> Floats:
        return filtered(graph, motion, data, particles, first, N_FIRST, np.random.default_rng(first)).poses

    def by_amcl(particles: Floats, first: int) -> Floats:
        last = first + [0, *updates(drive[first:])][:N_FIRST][-1] + 1
        poses = follow_amcl(
            drive[first:last], second.ranges[first:last], second.sensor, particles, fitted.field, fitted.numbers,
            rng=np.random.default_rng(first), laser_model=fitted.laser_model,
        )  # fmt: skip
        return np.concatenate([np.full((first, 3), np.nan), poses])

    starts = (
        (N_GLOBAL, "anywhere", lambda _: anywhere(graph, N_GLOBAL, rng)),
        (MOST, "about the places of a global search", searched(data, MOST, rng)),
    )
    for n, where, start in starts:
        for name, follow in (("AMCL, fitted", by_amcl), ("graph", by_graph)):
            share, seconds = converged(follow, start, data)
            print(
                f"{name}, {n} particles {where}: {100 * share:.0f} % found after {N_FIRST} updates; {seconds:.1f} s"
            )


if __name__ == "__main__":
    main()
