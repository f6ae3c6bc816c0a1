"""The polygon of the fewest segments: as found by trying all, and with the corners that a digital polygon has."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from sensorgraph.types import Floats, Ints
from sensorgraph.world.fewest_segments import closed_corners, open_corners

TOLERANCE = 0.99


def staircase(rng: np.random.Generator, n: int) -> Floats:
    """Return a walk on half the lattice, or a digital line with a jog (n, 2)."""
    if rng.random() < 0.5:
        return np.cumsum(0.5 * rng.integers(-1, 2, size=(n, 2)), axis=0)
    x = np.arange(n)
    y = np.round(rng.normal() * x + rng.uniform() + (x > n // 2) * rng.integers(0, 3))
    return np.stack([x, y], axis=1).astype(np.float64)


def plain_open_corners(points: Floats, tolerance: float) -> Ints:
    """Return the result of `open_corners` by direct evaluation of each segment."""
    n = len(points)
    best: list[tuple[float, float, list[int]]] = [(0, 0.0, [0])]
    for j in range(1, n):
        options = []
        for i in range(j):
            own = points[i : j + 1]
            if _is_within(own, tolerance):
                squares = np.linalg.svd(own - own.mean(axis=0), compute_uv=False)
                fewest, left, way = best[i]
                options.append((fewest + 1, left + float(squares[-1] ** 2), [*way, j]))
        best.append(min(options, key=lambda o: (o[0], o[1])))
    return np.array(best[-1][2])


def _is_within(points: Floats, tolerance: float) -> bool:
    """Return whether points (n, 2) stay within a tolerance of the chord from the first to the last."""
    chord = points[-1] - points[0]
    inner = points[1:-1] - points[0]
    length = float(np.hypot(*chord))
    if not len(inner):
        return True
    far = np.hypot(*inner.T)
    if length == 0.0:
        return bool((far <= tolerance).all())
    ahead, across = inner @ chord / length, inner @ np.array([-chord[1], chord[0]]) / length
    near = (np.abs(across) <= tolerance) & ((ahead >= 0) | (far <= tolerance))
    return bool(near.all() and far.max() <= length + tolerance)


@settings(max_examples=300, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_there_are_no_fewer_segments_and_none_that_fit_better(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = staircase(rng, int(rng.integers(3, 26)))
    fast, plain = open_corners(points, TOLERANCE), plain_open_corners(points, TOLERANCE)
    assert len(fast) == len(plain)
    assert fast[0] == 0
    assert fast[-1] == len(points) - 1
    assert misfit(points, fast) == pytest.approx(misfit(points, plain), abs=1e-9)


def misfit(points: Floats, corners: np.ndarray) -> float:
    """Return the squares that the best line of each segment leaves."""
    parts = [points[a : b + 1] for a, b in pairwise(corners)]
    return sum(float(np.linalg.svd(p - p.mean(axis=0), compute_uv=False)[-1] ** 2) for p in parts)


@pytest.mark.parametrize("degrees", [0, 7, 20, 33, 45])
@pytest.mark.parametrize("first", [0, 11, 30])
def test_a_polygon_drawn_on_a_lattice_keeps_its_corners_wherever_it_is_opened(
    degrees: int, first: int
) -> None:
    drawn = shapely.Polygon([(0, 0), (40, 0), (40, 25), (18, 25), (18, 12), (0, 12)])
    drawn = shapely.affinity.rotate(drawn, degrees)
    along = np.linspace(0, drawn.exterior.length, 600, endpoint=False)
    points = np.round(shapely.get_coordinates(drawn.exterior.interpolate(along)))
    points = points[(np.diff(points, axis=0, append=points[:1]) != 0).any(axis=1)]
    points = np.roll(points, -first, axis=0)
    found = points[closed_corners(points, TOLERANCE)]
    true = np.array(drawn.exterior.coords)[:-1]
    apart = np.hypot(*(found[:, None] - true[None]).transpose(2, 0, 1))
    assert apart.min(axis=0).max() < 3.0
    assert len(found) <= len(true) + 1  # the point at which the chain was opened may stay
    assert (apart.min(axis=1) < 3.0).sum() >= len(true)
