"""Gains of earlier rounds spare fits; the model that is found stays the one of a search that fits every candidate."""

from __future__ import annotations

import math

import pytest
from conftest import polygon_arena
from test_diagnosis_scan import drive

from sensorgraph.diagnosis.scan import model_selection
from sensorgraph.diagnosis.scan.candidates import SearchMemory, name_at_place
from sensorgraph.diagnosis.scan.fit import Fitted, fit
from sensorgraph.diagnosis.scan.model_selection import explain
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS
from sensorgraph.world.robot import parse_robot


def bias(expected: float) -> Candidate:
    return Candidate(amendment=EFFECTS["range_bias"](b=0.02), gain=expected)


def test_a_gain_is_a_bound_from_the_next_round_on() -> None:
    memory = SearchMemory()
    assert memory.bound(bias(100.0)) == math.inf
    memory.note(bias(100.0), 40.0)
    assert memory.bound(bias(100.0)) == math.inf
    memory.begin()
    assert memory.bound(bias(100.0)) == 40.0


def test_of_several_starts_the_largest_gain_counts() -> None:
    memory = SearchMemory()
    memory.note(bias(100.0), 40.0)
    memory.note(bias(20.0), 7.0)
    memory.begin()
    assert memory.bound(bias(20.0)) == 40.0


def test_a_bound_is_void_where_more_is_expected_than_at_the_fit() -> None:
    memory = SearchMemory()
    memory.note(bias(100.0), 40.0)
    memory.begin()
    assert memory.bound(bias(90.0)) == 40.0
    assert memory.bound(bias(200.0)) == math.inf


@pytest.mark.slow
def test_a_lazy_search_fits_less_and_finds_the_same_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    hall = polygon_arena(
        [(0, 0), (6, 0), (6, 5), (0, 5)],
        [(2.0, 3.0), (2.6, 3.0), (2.6, 3.5), (2.0, 3.5)],
        [(4.0, 1.0), (4.5, 1.2), (4.3, 1.7)],
    )
    planted = (EFFECTS["random_outliers"](p=0.03), EFFECTS["range_bias"](b=0.05), EFFECTS["max_range"](R=3.2))
    data, _ = prepare_scans(drive(hall, planted, seed=1), hall, parse_robot("sensor: {n_rays: 61}"), ())
    fits: list[Fitted] = []

    def counted(*args: object, **options: object) -> Fitted:
        fits.append(fit(*args, **options))  # type: ignore[arg-type]
        return fits[-1]

    monkeypatch.setattr(model_selection, "fit", counted)
    lazy = {name_at_place(a) for a in explain(data, NoiseBounds()).final.model}
    n_lazy = len(fits)
    fits.clear()
    monkeypatch.setattr(model_selection.CandidateFits, "has_sure_winner", lambda self: False)
    full = {name_at_place(a) for a in explain(data, NoiseBounds()).final.model}
    assert lazy == full == {name_at_place(a) for a in planted}
    assert n_lazy < len(fits)
