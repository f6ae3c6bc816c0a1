"""benchmarks/sensitivity: every number is varied, by itself, and stays what it is by nature."""

from __future__ import annotations

import numpy as np

from benchmarks.sensitivity import Said, blocks, differs, in_process
from benchmarks.sensitivity.numbers import numbers_of, scaled
from sensorgraph.diagnosis.scan import likelihood
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.models.faces import blurred_edges, visibility


def test_a_number_keeps_its_nature() -> None:
    assert scaled("min_rays", 3, 0.5) == 2 and scaled("min_rays", 1, 0.5) == 1
    assert scaled("min_share", 0.7, 2.0) == 0.85 and scaled("threshold", 12.0, 2.0) == 24.0
    assert scaled("core", (0.75, 1.15), 2.0) == (1.5, 2.3) and scaled("min_z", {"bias": 4.5}, 2.0) == {
        "bias": 9.0
    }
    assert scaled("name", "text", 2.0) is None and scaled("is_on", True, 2.0) is None


def test_a_variant_leaves_no_trace() -> None:
    """Each number of the scan channel has a label of its own; one varied in a process of its own stays as it is here."""
    numbers = list(numbers_of("sensorgraph.diagnosis.scan"))
    labels = [one.label for one in numbers]
    name = "diagnosis.scan.settings.SCAN.selection.threshold"
    assert len(set(labels)) == len(labels) > 100 and name in labels
    before = SCAN.selection.threshold
    threshold = numbers[labels.index(name)]
    assert (
        in_process(lambda: [str(SCAN.selection.threshold)], [threshold], 2.0) == [str(2 * before)]
        and SCAN.selection.threshold == before
    )


def test_an_answer_changes_beyond_noise() -> None:
    usual = {"median [mm]": 100.0, "wrong [%]": 0.3}
    assert not differs(usual | {"median [mm]": 104.0, "wrong [%]": 0.7}, dict(usual))
    assert differs(usual | {"median [mm]": 106.0}, dict(usual)) and differs(
        usual | {"wrong [%]": 0.9}, dict(usual)
    )
    assert differs(usual | {"median [mm]": float("nan")}, dict(usual)) and differs("range bias", "silent")


def test_numbers_of_one_module_are_varied_together_first() -> None:
    numbers = list(numbers_of("sensorgraph.models.faces"))
    groups = blocks(numbers)
    assert [one for group in groups for one in group] == numbers and len(groups) < len(numbers) / 2
    assert all(one.module is group[0].module for group in groups for one in group)


def test_a_number_is_varied_where_it_was_imported_and_where_others_follow_from_it() -> None:
    (stops,) = (one for one in numbers_of("sensorgraph.models.faces.visibility") if one.name == "PRIOR_STOPS")

    def values() -> list[Said]:
        return [f"{one.PRIOR_STOPS:g} {one.PRIOR_CROSSINGS:g}" for one in (visibility, blurred_edges)]

    assert values() == ["0.02 0.04"] * 2 and in_process(values, [stops], 2.0) == ["0.04 0.08"] * 2


def test_constants_are_varied_where_they_are_compiled() -> None:
    found = {one.label: one for one in numbers_of("sensorgraph.diagnosis.scan")}
    assert {"diagnosis.scan.depth_edges.MAX_CORNERS", "diagnosis.scan.likelihood.EDGE_WIDTH"} < set(found)
    assert not any("CHI2" in label for label in found)

    def densities() -> list[Said]:
        here, beyond = np.linspace(1.95, 2.35, 9), np.full(9, 2.3)
        nothing, half = np.zeros(9), np.full(9, 0.5)
        limits, noise = (0.1, 8.0, 0.001, 0.0), (0.01, 0.01, 0.01, 0.0)
        sigma, two, one = np.full(9, 0.02), np.full(9, 2.0), np.ones(9)
        found = np.zeros((7, 9))
        likelihood.mixture(
            here, two, sigma, one, beyond, nothing, half, limits, noise, (0.0, 0.0, 1e-9), 3.0, found
        )
        return [f"{p:.6f}" for p in found[likelihood.LOG_P]]

    width = found["diagnosis.scan.likelihood.EDGE_WIDTH"]
    before = densities()
    assert in_process(densities) == before
    assert in_process(densities, [width], 2.0) != before and densities() == before
