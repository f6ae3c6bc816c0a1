"""What was expected of an effect before the model had any stands as long as as much is expected of one of its starts."""

from __future__ import annotations

from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.search_memory import FirstGains
from sensorgraph.effects import EFFECTS


def hidden(at: float, gain: float) -> Candidate:
    """A sector that a part of the robot may hide."""
    return Candidate(amendment=EFFECTS["self_occlusion"](r0=0.3, theta1=at, theta2=at + 0.1), gain=gain)


def test_a_gain_that_stays_stands_though_another_start_has_gone() -> None:
    first = FirstGains()
    first.compare([hidden(-0.6, 1418.0), hidden(-1.4, 321.0)], is_first=True)
    first.compare([hidden(-1.4, 343.0)], is_first=False)
    assert first.has(hidden(-1.4, 343.0))
    assert not first.has(hidden(-0.6, 1418.0))
    assert first.still_has(hidden(-1.4, 343.0).amendment)


def test_a_gain_that_has_changed_stands_no_more_even_if_it_comes_back() -> None:
    first = FirstGains()
    first.compare([hidden(0.2, 300.0)], is_first=True)
    first.compare([hidden(0.2, 120.0)], is_first=False)
    first.compare([hidden(0.2, 300.0)], is_first=False)
    assert not first.has(hidden(0.2, 300.0))
    assert not first.still_has(hidden(0.2, 300.0).amendment)


def test_what_is_not_compared_stands() -> None:
    first = FirstGains()
    first.compare([hidden(0.2, 300.0)], is_first=True)
    first.compare([], is_first=False)
    assert first.has(hidden(0.2, 300.0))
    assert not first.has(Candidate(amendment=EFFECTS["range_bias"](b=0.02), gain=300.0))
