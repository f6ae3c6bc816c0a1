"""Equations, numbers and gaps of a report in words, and plain JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sensorgraph.diagnosis.report.data import plain
from sensorgraph.diagnosis.report.quantities import gap_sentence, number, parameters, percent
from sensorgraph.diagnosis.result import FitQuality, Gap
from sensorgraph.effects import EFFECTS


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_has_an_equation_with_numbers(name: str) -> None:
    effect = EFFECTS[name]
    assert effect.equation
    a = effect(**{p.name: 0.5 for p in effect.parameters})
    assert len(parameters(a)) == len(effect.parameters)
    assert all("=" in text for text in parameters(a))


def test_numbers_are_rounded_to_their_errors() -> None:
    assert number(-2.4137, 0.094) == "−2.41 ± 0.09"
    assert number(2.4137, 0.13, signed=True) == "+2.41 ± 0.13"
    assert number(1.888, 0.00041) == "1.8880 ± 0.0004"
    assert number(3.5226) == "3.52"
    assert number(0.0) == "0.00"
    assert number(float("inf")) == "inf"
    assert number(0.012, float("nan")) == "0.0120"
    assert [percent(p) for p in (None, 0.001, 0.5, 1.0)] == ["–", "< 1 %", "50 %", "> 99 %"]


def test_the_gap_is_told_in_nats_where_metres_hardly_change() -> None:
    floor = FitQuality(rmse_m=0.01, normalised=1.0, nats_per_ray=-3.0)
    before = FitQuality(rmse_m=0.0192, normalised=1.92, nats_per_ray=-2.0)
    after = FitQuality(rmse_m=0.0101, normalised=1.01, nats_per_ray=-2.9)
    assert "from 1.92 to 1.01 times" in gap_sentence(
        Gap(before=before, after=after, noise_floor=floor, n_rays=9)
    )
    lost = replace(before, nats_per_ray=-2.9)
    assert "by 0.9 per reading" in gap_sentence(Gap(before=before, after=lost, noise_floor=floor, n_rays=9))
    assert gap_sentence(None) == ""


def test_json_holds_plain_finite_numbers() -> None:
    data = plain({"a": np.float64(1.5), "b": [float("nan"), np.arange(2)], 3: (np.int64(4), None, Path("x"))})
    assert json.loads(json.dumps(data, allow_nan=False)) == {
        "a": 1.5,
        "b": [None, [0, 1]],
        "3": [4, None, "x"],
    }
