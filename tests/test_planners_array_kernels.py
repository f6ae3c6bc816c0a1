"""Kernels on arrays do what numpy does."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planners.array_kernels import is_any, last_up_to, make_heap, pop_least, set_all


@given(st.lists(st.sampled_from([0.0, -1.0, 2.5, 1e9, np.inf]) | st.floats(-10, 10), max_size=60))
def test_a_heap_gives_the_stable_order(values: list[float]) -> None:
    costs, heap = np.array(values, dtype=np.float64), np.empty(len(values), dtype=np.int64)
    make_heap(heap, len(heap), costs)
    order = [pop_least(heap, len(heap) - k, costs) for k in range(len(heap))]
    assert order == np.argsort(costs, kind="stable").tolist()


@given(st.lists(st.booleans(), min_size=1, max_size=12), st.data())
def test_stretches_of_a_mask(values: list[bool], data: st.DataObject) -> None:
    mask = np.array(values)
    first = data.draw(st.integers(0, len(mask) - 1))
    last = data.draw(st.integers(first - 1, len(mask) - 1))
    assert is_any(mask, first, last) == mask[first : last + 1].any()
    expected = mask.copy()
    expected[first : last + 1] = True
    set_all(mask, first, last)
    assert (mask == expected).all()


def test_bisection_finds_the_last_value_up_to_a_limit() -> None:
    values = np.array([0.0, 1.0, 1.0, 2.5])
    for most in (0.0, 0.5, 1.0, 2.4, 2.5, 9.0):
        assert last_up_to(values, most) == np.searchsorted(values, most, side="right") - 1
    assert last_up_to(values, -1.0) == 0
