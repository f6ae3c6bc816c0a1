"""Which of the effects tried comes first, where people and strays are told by their law."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

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
