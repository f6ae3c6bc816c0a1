"""How a cone is looked for: which are tried, and how far a search goes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import further
from scan_samples import data_of

from planners.arena import Arena
from sensorgraph.diagnosis.scan.candidates import polish, proposed_candidates
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.model_selection import explain
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects import EFFECTS, sonar_cone
from sensorgraph.world.robot import parse_robot


def test_the_groups_of_a_sweep_begin_with_the_weakest_value() -> None:
    view = SimpleNamespace(
        short=np.full((3, 61), 1.0),
        lost=np.full((3, 61), 0.0),
        sensor=parse_robot("sensor: {n_rays: 61}").sensor,
    )
    for group in sonar_cone.sweep(view):  # type: ignore[arg-type]
        values = [value["gamma"] for value in group]
        assert values == sorted(values)


def test_a_narrow_cone_is_tried_though_few_readings_are_short(hall: Arena) -> None:
    """2.9 degrees shorten what is met at a slant by less than the scatter of most readings."""
    data = data_of(hall, (EFFECTS["sonar_cone"](gamma=0.05, alpha_max=1.25),))
    null = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds())
    best = max(proposed_candidates(FitResiduals(data, null)), key=lambda c: c.gain)
    assert best.amendment.name == "sonar_cone" and best.amendment["gamma"] < 0.08


@pytest.mark.parametrize("start", [1.5, *further(0.45)])
def test_a_search_goes_on_as_long_as_it_strides(hall: Arena, start: float) -> None:
    """Four rounds ended 0.15 rad off the largest incidence, and a dropout was found beside the cone."""
    cone = EFFECTS["sonar_cone"](gamma=0.12, alpha_max=0.98)
    data, noise_bounds = data_of(hall, (cone,)), NoiseBounds()
    far = (EFFECTS["sonar_cone"](gamma=0.12, alpha_max=start),)
    state = start_state(data, noise_bounds)
    (found,) = polish(data, far, state, noise_bounds, rounds=4, first=1.0)
    assert found["alpha_max"] == pytest.approx(0.98, abs=0.03)
    assert found["gamma"] == pytest.approx(0.12, abs=0.01)


@pytest.mark.slow
def test_stretched_tolerances_do_not_hide_the_width_of_a_cone(hall: Arena) -> None:
    """Around a cone of 0.16 rad the tolerances stretch; the search through all effects still ends at 0.12."""
    cone = EFFECTS["sonar_cone"](gamma=0.12, alpha_max=0.98)
    data, noise_bounds = data_of(hall, (cone,)), NoiseBounds()
    off = fit(
        data,
        (EFFECTS["sonar_cone"](gamma=0.16, alpha_max=0.98),),
        start_state(data, noise_bounds),
        noise_bounds,
    )
    assert max(off.state.pose_scale, off.state.map_scale) > SCAN.nuisance.stretched_scale
    (found,) = explain(data, noise_bounds).final.model
    assert found.name == "sonar_cone" and found["gamma"] == pytest.approx(0.12, abs=0.01)
