"""benchmarks/sensitivity: every number is varied, by itself, and stays what it is by nature."""

from __future__ import annotations

import numpy as np

import sensorgraph.diagnosis.scan
from benchmarks.sensitivity import constants_of, in_process, scaled, settings_of
from sensorgraph.diagnosis.scan import likelihood
from sensorgraph.diagnosis.scan.settings import SCAN


def test_a_number_keeps_its_nature() -> None:
    assert scaled("min_rays", 3, 0.5) == 2 and scaled("min_rays", 1, 0.5) == 1
    assert scaled("min_share", 0.7, 2.0) == 0.85 and scaled("threshold", 12.0, 2.0) == 24.0
    assert scaled("core", (0.75, 1.15), 2.0) == (1.5, 2.3) and scaled("min_z", {"bias": 4.5}, 2.0) == {
        "bias": 9.0
    }
    assert scaled("name", "text", 2.0) is None and scaled("is_on", True, 2.0) is None


def test_a_variant_leaves_no_trace() -> None:
    """Each setting of the scan channel has a label of its own; one varied in a process of its own stays as it is here."""
    settings = list(settings_of("scan", SCAN))
    labels = [one.label for one in settings]
    assert len(set(labels)) == len(labels) > 100 and "scan.SelectionSettings.threshold" in labels
    before = SCAN.selection.threshold
    (threshold,) = (one for one in settings if one.label == "scan.SelectionSettings.threshold")
    assert (
        in_process(lambda: [str(SCAN.selection.threshold)], threshold, 2.0) == [str(2 * before)]
        and SCAN.selection.threshold == before
    )


def test_constants_are_varied_where_they_were_imported_and_where_they_are_compiled() -> None:
    found = {one.label: one for one in constants_of("scan", sensorgraph.diagnosis.scan)}
    assert {"scan.depth_edges.MAX_CORNERS", "scan.likelihood.CUT"} < set(found)
    assert not any("CHI2" in label or "settings" in label for label in found)

    def densities() -> list[str]:
        here, beyond = np.linspace(1.95, 2.35, 9), np.full(9, 2.3)
        nothing, half = np.zeros(9), np.full(9, 0.5)
        limits, noise = (0.1, 8.0, 0.001, 0.0), (0.01, 0.01, 0.01, 0.0)
        sigma, two, one = np.full(9, 0.02), np.full(9, 2.0), np.ones(9)
        found = likelihood.mixture(
            here, two, sigma, one, beyond, nothing, half, limits, noise, (0.0, 0.0, 1e-9), 3.0
        )
        return [f"{p:.6f}" for p in found[likelihood.LOG_P]]

    width = found["scan.likelihood.EDGE_WIDTH"]
    before = densities()
    assert in_process(densities, None) == before
    assert in_process(densities, width, 2.0) != before and densities() == before
