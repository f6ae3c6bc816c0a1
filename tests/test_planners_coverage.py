"""A bin is what INTERFACE.md says it is, counted the slow way."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.coverage import Coverage
from planners.types import Floats


def grid(nx: int = 4, ny: int = 3, headings: int = 8, cell: float = 0.3) -> Coverage:
    return Coverage.empty(
        origin=np.array([-0.2, 1.0]), cell=cell, cells=np.ones((nx, ny), dtype=bool), headings=headings
    )


def by_hand(coverage: Coverage, poses: Floats) -> dict[tuple[int, int, int], int]:
    counts: dict[tuple[int, int, int], int] = {}
    nx, ny, n_phi = coverage.counts.shape
    for x, y, phi in poses.tolist():
        if not all(map(math.isfinite, (x, y, phi))):
            continue
        i = math.floor((x - coverage.origin[0]) / coverage.cell)
        j = math.floor((y - coverage.origin[1]) / coverage.cell)
        k = min(range(n_phi), key=lambda k: abs(math.remainder(phi - k * 2 * math.pi / n_phi, 2 * math.pi)))
        if 0 <= i < nx and 0 <= j < ny:
            counts[i, j, k] = counts.get((i, j, k), 0) + 1
    return counts


@pytest.mark.parametrize(("seed", "headings"), [(0, 1), (1, 2), (2, 7), (3, 16)])
def test_counts_are_those_of_a_plain_loop(seed: int, headings: int) -> None:
    rng = np.random.default_rng(seed)
    coverage = grid(headings=headings)
    poses = rng.uniform([-0.5, 0.7, -9.0], [1.3, 2.2, 9.0], (2000, 3))
    poses[rng.random(2000) < 0.01] = np.nan
    coverage.add(poses[:1200])
    coverage.add(poses[1200:])
    expected = by_hand(coverage, poses)
    assert coverage.counts.sum() == sum(expected.values())
    assert {tuple(at): int(coverage.counts[tuple(at)]) for at in np.argwhere(coverage.counts)} == expected


def test_heading_bins_are_centred_on_multiples() -> None:
    coverage = grid(headings=16)
    width = 2 * np.pi / 16
    phi = np.array([0.0, 0.49, -0.49, 0.51, 15.6, 16.0, -1.0]) * width
    bins, inside = coverage.bins(np.column_stack([np.zeros((7, 1)), np.full((7, 1), 1.1), phi]))
    assert inside.all()
    assert bins[:, 2].tolist() == [0, 0, 0, 1, 0, 0, 15]


def test_fraction_counts_reachable_bins_only() -> None:
    cells = np.zeros((2, 2), dtype=bool)
    cells[0, 0] = True
    coverage = Coverage.empty(origin=np.zeros(2), cell=1.0, cells=cells, headings=4)
    coverage.add(np.array([[0.5, 0.5, 0.0], [0.9, 0.9, np.pi], [1.5, 1.5, 0.0]]))
    assert coverage.fraction == 0.5
    assert coverage.core_fraction == 0.25  # (0.9, 0.9) lies in the outer half of its cell
    assert len(coverage.holes()) == 2
    np.testing.assert_allclose(coverage.holes()[0], [0.5, 0.5, np.pi / 2])


def test_holes_filled_one_by_one_complete_the_coverage() -> None:
    coverage = grid()
    coverage.add(coverage.holes()[::3])
    coverage.add(coverage.holes())
    assert coverage.fraction == coverage.core_fraction == 1.0
    assert coverage.dispersion() == (0.0, 0.0)


def test_dispersion_is_the_way_to_the_farthest_bin() -> None:
    coverage = grid(nx=5, ny=1, headings=8)
    coverage.add(np.array([[-0.05, 1.1, 0.0]]))
    over_floor, by_turning = coverage.dispersion()
    assert over_floor == np.inf  # no pose at all at the other headings
    assert by_turning == np.inf
    x = -0.05 + 0.3 * np.arange(5)
    for phi in np.arange(8) * np.pi / 4:
        coverage.add(np.array([[x[0], 1.1, phi]]))
    coverage.add(np.column_stack([x, np.full(5, 1.1), np.zeros(5)]))
    over_floor, by_turning = coverage.dispersion()
    assert over_floor == pytest.approx(4 * 0.3)
    assert by_turning == pytest.approx(np.pi)


def test_edges_bound_the_bins() -> None:
    coverage = grid()
    x, y, phi = coverage.edges
    middles = np.stack(
        np.meshgrid(*(0.5 * (e[1:] + e[:-1]) for e in (x, y, phi)), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    coverage.add(middles)
    assert (coverage.counts == 1).all()
    assert (coverage.core == 1).all()
