"""How well a graph of an office predicts, with intervals over arenas and seeds, and how small and fast it is.

    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python -m benchmarks.office_graph [--seeds 0,1]

The shipped office and random ones (`benchmarks/offices.py`), 181 rays over half a turn, sigma 1 cm, exact poses. A graph
is built from poses chosen by `sensorgraph.planning.views.choose_views` and from as many drawn evenly; it is asked for 2,000 fresh
poses. Shares are of the rays that hit something; within 3 sigma of the noisy reading, wrong against the true range. An
interval is that of the mean over arenas and seeds, 95 % by Student's t.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.arguments import fastest, half_interval, heads, parser_of, timed
from benchmarks.places import arena_named
from logs.run import RangeSensor, Run
from planners.arena import Arena
from planners.types import Floats
from sensorgraph.building.build import build
from sensorgraph.graph import Sensorgraph
from sensorgraph.planning.survey import LaserSurvey
from sensorgraph.planning.views import choose_views
from sensorgraph.world.raycast import cast
from sensorgraph.world.wall_distance import WallDistance

SENSOR = RangeSensor(
    bearings=np.linspace(-np.pi / 2, np.pi / 2, 181), range_min=0.02, range_max=30.0, sigma=0.01
)
WALL_CLEARANCE = 0.2  # [m] that poses keep from walls
CANDIDATES_PER_VIEW = 5  # for each view
ARENAS, N_POSES, N_FRESH_POSES = ("office", "1", "2", "3", "4", "5"), 1000, 2000
REPEATS = 5  # of a prediction; the fastest counts


@dataclass(frozen=True, kw_only=True)
class GraphScore:
    """One graph; shares in 0 ... 1."""

    within_3_sigma: float
    wrong: float
    answered: float
    wrong_of_answered: float
    median: float
    """[m]"""
    fit: float
    """[s] of one core."""
    size: float
    """[bytes]"""
    speed: float
    """[rays/s] of one core."""


GRAPH_COLUMNS = {
    "within_3_sigma": ("within 3σ [%]", 100.0, 2),
    "wrong": ("wrong > 5 cm [%]", 100.0, 3),
    "answered": ("answered [%]", 100.0, 2),
    "wrong_of_answered": ("of these wrong [%]", 100.0, 3),
    "median": ("median [mm]", 1000.0, 2),
    "fit": ("fit [s]", 1.0, 2),
    "size": ("file [kB]", 1e-3, 0),
    "speed": ("M rays/s", 1e-6, 2),
}


def somewhere(arena: Arena, n: int, rng: np.random.Generator) -> Floats:
    """Return n poses (n, 3) spread evenly over the free floor and all headings."""
    x0, y0, x1, y1 = arena.bounds
    clearance, found = WallDistance(arena), np.zeros((0, 3))
    while len(found) < n:
        some = rng.uniform([x0, y0, -np.pi], [x1, y1, np.pi], (n, 3))
        some = some[arena.contains(some[:, :2])]
        far = [clearance(x, y) > WALL_CLEARANCE for x, y in some[:, :2]]
        found = np.concatenate([found, some[far]])
    return found[:n]


def training(arena: Arena, n: int, rng: np.random.Generator, *, planned: bool) -> Floats:
    """Return the poses (n, 3) that a graph is built from."""
    if not planned:
        return somewhere(arena, n, rng)
    candidates = somewhere(arena, CANDIDATES_PER_VIEW * n, rng)
    return candidates[choose_views(candidates, LaserSurvey(arena, SENSOR), n)]


def measure(arena: Arena, n: int, seed: int, *, planned: bool) -> GraphScore:
    """Build from n poses and ask for fresh ones."""
    rng = np.random.default_rng([seed, 51])
    poses = training(arena, n, rng, planned=planned)
    ranges = cast(arena, poses, SENSOR).ranges
    stamps: Floats = np.arange(n) / 10.0
    run = Run(
        sensor=SENSOR, stamps=stamps, ranges=ranges + SENSOR.sigma * rng.normal(size=ranges.shape),
        pose_stamps=stamps, poses=poses,
    )  # fmt: skip
    with timed() as took:
        graph = build([run])
    check = somewhere(arena, N_FRESH_POSES, np.random.default_rng([seed, 52]))
    truth = cast(arena, check, SENSOR).ranges
    said = graph.predict(check)
    hit = np.isfinite(truth)
    off = np.abs(said.mode - truth)[hit]
    noisy = truth + SENSOR.sigma * rng.normal(size=truth.shape)
    answered = said.answered[hit]
    return GraphScore(
        within_3_sigma=float((np.abs(said.mode - noisy)[hit] <= 3 * SENSOR.sigma).mean()),
        wrong=float((off > 0.05).mean()),
        answered=float(answered.mean()),
        wrong_of_answered=float((off[answered] > 0.05).mean()),
        median=float(np.median(off)),
        fit=took.cpu,
        size=size_of(graph),
        speed=truth.size / fastest(lambda: graph.predict(check), REPEATS),
    )


def size_of(graph: Sensorgraph) -> float:
    """Return the bytes of the graph's file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "office.sensorgraph"
        graph.save(path)
        return float(path.stat().st_size)


def main() -> None:
    """Build, ask, print a row for each graph and the means."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", default="0,1")
    options = parser.parse_args()
    measure(arena_named("office"), 100, 0, planned=False)  # compiles
    print(heads("poses", "arena, seed", *(label for label, _, _ in GRAPH_COLUMNS.values()), text=2))
    for planned in (True, False):
        kind = f"{N_POSES:,} {'planned' if planned else 'uniform'}"
        rows: list[GraphScore] = []
        for name in ARENAS:
            for seed in map(int, options.seeds.split(",")):
                rows.append(measure(arena_named(name), N_POSES, seed, planned=planned))
                cells = [
                    f"{scale * getattr(rows[-1], key):.{d}f}" for key, (_, scale, d) in GRAPH_COLUMNS.items()
                ]
                print(f"| {kind} | {name}, {seed} | " + " | ".join(cells) + " |")
        means = []
        for key, (_, scale, digits) in GRAPH_COLUMNS.items():
            values = np.array([scale * getattr(row, key) for row in rows])
            means.append(f"**{values.mean():.{digits}f}** ± {half_interval(values):.{digits}f}")
        print(f"| **{kind}** | mean of {len(rows)} | " + " | ".join(means) + " |")


if __name__ == "__main__":
    main()
