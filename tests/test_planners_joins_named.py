"""Joins by a planner of OMPL that is asked for by name, and by one of the user's own."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from planners_samples import door_arena

from planners import PlanError, plan
from planners.arguments import check_join_planner
from planners.clearance import Barriers
from planners.joins.paths import connect
from planners.reach import reach
from planners.vehicle import Vehicle

OWN = """
from pathlib import Path
from ompl import geometric

class Own(geometric.RRTConnect):
    def __init__(self, information):
        super().__init__(information)
        Path({mark!r}).touch()
"""
STARTS, ENDS = np.array([[0.5, 0.5]]), np.array([[3.5, 0.5]])


def joined(name: str) -> np.ndarray:
    """Return the path through the door, and check it."""
    arena = door_arena(0.9)
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=0.22, cell=0.25)
    named = type(free)(**(vars(free) | {"join_planner": name}))
    (path,), joins = connect(STARTS, ENDS, reach=named, barriers=barriers, seed=1)
    assert path is not None
    assert joins.planned == 1
    assert barriers.are_clear(path[:-1], path[1:], 0.218).all()
    np.testing.assert_allclose(path[[0, -1]], np.concatenate([STARTS, ENDS]))
    return path


def test_another_planner_of_ompl_finds_a_way_too() -> None:
    paths = [joined(name) for name in ("RRTConnect", "RRT", "BITstar")]
    lengths = [float(np.hypot(*np.diff(path, axis=0).T).sum()) for path in paths]
    assert max(lengths) < 1.3 * min(lengths)
    assert len({path.tobytes() for path in paths}) == 3


def test_a_users_own_planner_is_plugged_in_by_module_and_class(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mark = tmp_path / "asked"
    (tmp_path / "own_planner.py").write_text(OWN.format(mark=str(mark)))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    joined("own_planner:Own")
    assert mark.exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("PRM", "is unknown; expected"),
        ("nowhere_to_be_found:Own", "cannot be imported .*on PYTHONPATH"),
        ("planners.task:Own", "module planners.task has no 'Own'; give the name of its class"),
    ],
)
def test_a_planner_that_is_not_there_is_refused_before_planning(name: str, said: str) -> None:
    with pytest.raises(PlanError, match=said):
        plan(door_arena(0.9), Vehicle(), cell=0.5, headings=4, join_planner=name)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("def Own(:", "cannot be imported .SyntaxError"),
        ("1 / 0", "cannot be imported .ZeroDivisionError"),
        ("import no_such_library", "cannot be imported .*fix the error in its module"),
        ("Own = 3", "is not a class"),
        (
            "def Own(information):\n    raise ValueError('boom\\nmore')",
            r"'broken_planner:Own' ended .*ValueError: boom\);",
        ),
    ],
    ids=["syntax", "import", "its own import", "number", "raises"],
)
def test_a_users_own_planner_that_fails_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, said: str
) -> None:
    (tmp_path / "broken_planner.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "broken_planner", raising=False)
    with pytest.raises(PlanError, match=said):
        joined(check_join_planner("broken_planner:Own"))
