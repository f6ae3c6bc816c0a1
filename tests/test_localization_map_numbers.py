"""Which track segments are one map."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from sensorgraph.localization.map_states import map_numbers


def numbers(*closures: tuple[int, int]) -> list[int]:
    """Return the maps of two segments of ten key frames each, with closures between their key frames."""
    first, second = np.array(closures, dtype=np.intp).reshape(-1, 2).T
    tracked: Any = SimpleNamespace(piece=np.repeat([0, 1], 10), is_carried=np.zeros(19, dtype=np.bool_))
    closed: Any = SimpleNamespace(closures=SimpleNamespace(first=first, second=second))
    return map_numbers(tracked, closed).tolist()


def test_closures_of_two_places_join_two_segments() -> None:
    assert numbers((2, 12), (6, 16)) == [1, 1]


def test_one_place_that_looks_like_two_neighbours_joins_nothing() -> None:
    """As a submap of a corridor fits several along another one."""
    assert numbers((2, 14), (6, 14)) == [1, 2]
    assert numbers((4, 12), (4, 16)) == [1, 2]
    assert numbers() == [1, 2]
