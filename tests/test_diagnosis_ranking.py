"""Which of the effects tried comes first, where people and strays are told by their law."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from conftest import polygon_arena
from scan_samples import data_of

from sensorgraph.diagnosis.scan import ranking
from sensorgraph.effects import EFFECTS

THRESHOLD = 12.0


@pytest.mark.parametrize(
    ("tried", "lawful", "first"),
    [
        ([("people", 20.0), ("random_outliers", 15.0)], {"random_outliers"}, "random_outliers"),
        ([("people", 20.0), ("random_outliers", 15.0)], {"people", "random_outliers"}, "people"),
        ([("people", 20.0), ("random_outliers", 15.0)], set(), "people"),
        ([("people", 20.0), ("random_outliers", 9.0)], {"random_outliers"}, "people"),
        ([("people", 40.0), ("random_outliers", 15.0)], {"random_outliers"}, "people"),
        ([("people", 20.0), ("people", 19.0), ("random_outliers", 15.0)], {"random_outliers"}, "random_outliers"),
        ([("range_bias", 20.0), ("random_outliers", 15.0)], {"random_outliers"}, "range_bias"),
    ],
    ids=["law tells", "both keep it", "none keeps it", "too weak", "too far behind", "another start", "no absorber"],
)  # fmt: skip
def test_people_and_strays_that_are_as_likely_are_told_by_their_law(
    monkeypatch: pytest.MonkeyPatch, tried: list[tuple[str, float]], lawful: set[str], first: str
) -> None:
    def keeps(_: Any, fitted: Any) -> bool:
        return fitted.model[-1].name in lawful

    monkeypatch.setattr(ranking, "_keeps_its_law", keeps)
    parameters = {"people": {"p": 0.01}, "random_outliers": {"p": 0.01}, "range_bias": {"b": 0.02}}
    fits = [(SimpleNamespace(model=[EFFECTS[name](**parameters[name])]), gain) for name, gain in tried]
    order = ranking.ranked(cast(Any, SimpleNamespace(clutter_nats={})), cast(Any, fits), THRESHOLD)
    assert order[0][0].model[-1].name == first and len(order) == len(tried)


def test_an_obstacle_has_moved_within_the_room() -> None:
    box = [(3.0, 2.0), (3.6, 2.0), (3.6, 2.6), (3.0, 2.6)]
    arena = polygon_arena([(0, 0), (6, 0), (6, 5), (0, 5)], box)
    data, name = data_of(arena), arena.names[-1].split("/")[0]
    for dx, dy, is_possible in ((-3.4, 0.0, False), (-2.0, 1.0, True), (0.02, 0.0, True), (0.0, 3.0, False)):
        moved = EFFECTS["moved_obstacle"](dx=dx, dy=dy).at(name)
        assert ranking.stands_in_room(data, moved) == is_possible
