"""Outlines of rasters: the union of their boxes, however the cells touch."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sensorgraph.world.cell_outline import outline, widened_outline

ORIGIN, CELL = np.array([-1.5, 2.0]), 0.25


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 1.0])
def test_it_is_the_union_of_the_cells(share: float) -> None:
    """Cells at random touch at corners, hold holes, and holes with cells in them."""
    for seed in range(5):
        cells = np.random.default_rng(seed).random((13, 9)) < share
        cells[0, 0] = True
        i, j = np.nonzero(cells)
        low = ORIGIN + CELL * np.stack([i, j], axis=1)
        boxes = shapely.union_all(shapely.box(*low.T, *(low + CELL).T))
        found = outline(cells, ORIGIN, CELL)
        assert found.is_valid and found.symmetric_difference(boxes).area == pytest.approx(0.0, abs=1e-9)
        wide = widened_outline(cells, ORIGIN, CELL)
        buffered = boxes.buffer(CELL / 2, join_style="mitre")
        assert wide.is_valid and wide.symmetric_difference(buffered).area == pytest.approx(0.0, abs=1e-9)


def test_no_cell_is_no_area() -> None:
    assert outline(np.zeros((4, 3), dtype=np.bool_), ORIGIN, CELL).is_empty


def test_it_takes_the_time_of_its_edges() -> None:
    """A hall of four million cells with a thousand pillars."""
    cells = np.ones((2000, 2000), dtype=np.bool_)
    cells[30::60, 30::60] = False
    found = widened_outline(cells, ORIGIN, CELL)
    assert found.area == pytest.approx((2001 * CELL) ** 2)  # a gap of one cell closes
