"""What was expected of an effect before the model had any stands as long as as much is expected of one of its starts."""

from __future__ import annotations

import pytest
from conftest import polygon_arena
from test_diagnosis_scan import drive

from sensorgraph.diagnosis.scan.first_gains import FirstGains, name_at_place
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.model_selection import explain
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.shortlist import shortlist
from sensorgraph.effects import EFFECTS
from sensorgraph.world.robot import parse_robot

PLANTED = (EFFECTS["random_outliers"](p=0.03), EFFECTS["range_bias"](b=0.05), EFFECTS["max_range"](R=3.2))


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


def hall_scans() -> ScanData:
    """Scans of a hall with a box and a wedge, with three effects of the laser."""
    hall = polygon_arena(
        [(0, 0), (6, 0), (6, 5), (0, 5)],
        [(2.0, 3.0), (2.6, 3.0), (2.6, 3.5), (2.0, 3.5)],
        [(4.0, 1.0), (4.5, 1.2), (4.3, 1.7)],
    )
    data, _ = prepare_scans(drive(hall, PLANTED, seed=1), hall, parse_robot("sensor: {n_rays: 61}"), ())
    return data


@pytest.mark.slow
def test_what_was_removed_from_the_model_is_not_proposed_again() -> None:
    data = hall_scans()
    null = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds(), outer=2, inner=4)
    proposed = {name_at_place(c.amendment) for c in shortlist(data, null, 0.0, FirstGains())}
    best = name_at_place(PLANTED[2])
    assert best in proposed
    again = {name_at_place(c.amendment) for c in shortlist(data, null, 0.0, FirstGains(), {best})}
    assert best not in again
    assert proposed - {best} <= again


@pytest.mark.slow
def test_the_search_finds_three_effects_of_the_laser() -> None:
    final = explain(hall_scans(), NoiseBounds()).final
    assert {name_at_place(a) for a in final.model} == {name_at_place(a) for a in PLANTED}
