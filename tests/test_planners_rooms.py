"""Rooms: large ones are cut into parts that are connected, whatever walls stand in them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from planners_samples import outlined
from scipy import ndimage

from planners import rooms
from planners.clearance import Barriers
from planners.reach import reach


def test_a_large_room_with_walls_in_it_is_cut_into_connected_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A comb of walls: a straight cut across the teeth would part each half into many pieces."""
    free = shapely.box(0, 0, 8, 4).difference(
        shapely.union_all([shapely.box(x, 1.5, x + 0.1, 4) for x in np.arange(1.6, 8, 1.6)])
    )
    arena = outlined(free)
    floor = reach(arena, Barriers(arena), clearance=0.22, cell=0.25)
    least, most = 12, 120
    assert most < rooms.MAX_CELLS
    for name, value in {"PASSAGE": 0.01, "MIN_CELLS": least, "MAX_CELLS": most}.items():
        monkeypatch.setattr(rooms, name, value)
    cells = floor.cells()
    parts = rooms.rooms(floor, cells)
    assert len(parts) >= cells.sum() / most
    np.testing.assert_array_equal(np.sum(parts, axis=0), cells.astype(int))
    for part in parts:
        assert least <= part.sum() <= most
        assert ndimage.label(part)[1] == 1  # no tooth is thinner than a cell: here neighbours are connected
