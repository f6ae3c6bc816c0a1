"""The metrics of `benchmarks/locate.py`: relations that contradict each other are told from poses that are wrong."""

from __future__ import annotations

import numpy as np

from benchmarks.locate import triangle_closures
from logs.transforms import compose, invert

RNG = np.random.default_rng(0)
POSES = np.column_stack([RNG.uniform(-5, 5, (90, 2)), RNG.uniform(-3, 3, 90)])


def relations(sd: float) -> np.ndarray:
    """Return three relations (90, 8) between each three poses in a row, off by `sd` [m] along x and y each."""
    rows = []
    for k in range(0, 90, 3):
        for a, b in ((k, k + 1), (k + 1, k + 2), (k, k + 2)):
            x, y, phi = compose(invert(POSES[a]), POSES[b]) + RNG.normal(0.0, sd, 3) * [1, 1, 0]
            rows.append([a, b, x, y, 0.0, 0.0, 0.0, phi])
    return np.array(rows)


def test_relations_of_one_world_close() -> None:
    place, turn, used = triangle_closures(relations(0.0))
    assert len(place) == 30 and len(used) == 90
    assert place.max() < 1e-9 and turn.max() < 1e-9


def test_what_triangles_miss_tells_the_error_of_one_relation() -> None:
    place, _, _ = triangle_closures(relations(0.03))
    one = np.sqrt((place**2).mean() / 3)
    assert abs(one / (0.03 * np.sqrt(2)) - 1) < 0.3  # 60 numbers: a standard error of 9 %
