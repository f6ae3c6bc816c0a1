"""Effects that cast doubt on themselves together do so only where each of them is material."""

from __future__ import annotations

import pytest
from scan_samples import data_of, hall_arena

from sensorgraph.diagnosis.scan.effect_laws import broken_laws
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS


@pytest.mark.parametrize(("of_map", "is_doubted"), [(0.02, True), (0.0, False)])
def test_a_map_that_is_shifted_and_not_stretched_casts_no_doubt_on_stretched_readings(
    of_map: float, is_doubted: bool
) -> None:
    hall = hall_arena()
    model = (EFFECTS["range_scale"](s=0.03), EFFECTS["map_scale"](s=of_map, dx=0.004, dy=0.0))
    data = data_of(hall, model)
    got = fit(data, model, start_state(data, SCAN.noise), SCAN.noise, outer=2)
    doubts = broken_laws(FitResiduals(data, got), {0: 1000.0, 1: 100.0}, 1100.0)
    assert ["stretched" in doubt.statement for doubt in doubts] == [True] * is_doubted
