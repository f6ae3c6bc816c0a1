"""Members of groups are numbered as a loop would number them."""

from __future__ import annotations

import numpy as np
import pytest

from planners.groups import members


@pytest.mark.parametrize("counts", [[], [0], [3], [2, 0, 0, 4, 1], [0, 5, 0]])
def test_members_are_numbered_group_by_group(counts: list[int]) -> None:
    group, number = members(np.array(counts, dtype=np.int64))
    assert list(zip(group.tolist(), number.tolist(), strict=True)) == [
        (k, i) for k, n in enumerate(counts) for i in range(n)
    ]
