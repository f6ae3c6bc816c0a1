"""Standard errors of rough parameters and the chance that a size is material: recovered from planted effects."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from test_diagnosis_scan import drive

from planners.arena import Arena
from sensorgraph.diagnosis.scan.candidates import searched
from sensorgraph.diagnosis.scan.consequence import material_probability
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.standard_errors import jagged_error, lattice_error, standard_errors
from sensorgraph.diagnosis.site_baseline import BaselineInterval, SitePrior
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import parse_robot


def fitted(
    hall: Arena, planted: Amendment, start: Amendment, seed: int = 0
) -> tuple[Fitted, dict[str, float]]:
    """Plant an effect, fit it from a start; return the fit and its standard errors."""
    data, _ = prepare_scans(drive(hall, (planted,), seed=seed), hall, parse_robot("sensor: {n_rays: 61}"), ())
    noise_bounds = NoiseBounds()
    first = fit(data, (start,), start_state(data, noise_bounds), noise_bounds)
    got = searched(data, first, noise_bounds, rounds=4, first=1.0, turns=3)
    return got, standard_errors(got, noise_bounds)[0]


@pytest.mark.parametrize(
    ("name", "key", "true", "start"),
    [
        ("max_range", "R", 3.2, 3.22),
        ("incidence_dropout", "alpha_max", 1.15, 1.16),
        ("range_noise", "k", 0.006, 0.003),
        ("random_outliers", "p", 0.012, 0.02),
    ],
)
def test_a_rough_parameter_is_within_its_error(
    hall: Arena, name: str, key: str, true: float, start: float
) -> None:
    got, errors = fitted(hall, EFFECTS[name](**{key: true}), EFFECTS[name](**{key: start}))
    assert abs(got.model[0][key] - true) < 3 * errors[key]
    assert errors[key] < 0.15 * true


def test_the_error_of_scattered_strays_is_that_of_counting(hall: Arena) -> None:
    p = 0.02
    got, errors = fitted(hall, EFFECTS["random_outliers"](p=p), EFFECTS["random_outliers"](p=0.01))
    counting = np.sqrt(p * (1 - p) / got.solver.data.ranges.size)
    assert 0.7 * counting < errors["p"] < 1.8 * counting


@pytest.mark.parametrize("step", [0.02, 0.1, 0.3])
def test_jags_of_a_likelihood_do_not_make_its_error(hall: Arena, step: float) -> None:
    """Where readings jump in and out of reach, the fall beside the estimate is that of the jags, at any short step."""
    data, _ = prepare_scans(drive(hall, ()), hall, parse_robot("sensor: {n_rays: 61}"), ())
    rng, at, error = np.random.default_rng(4), 0.4, 0.02
    jumps = rng.uniform(0.2, 0.6, (data.n_scans, 20))

    def change(value: float) -> np.ndarray:
        smooth = scores * (value - at) - 0.5 * ((value - at) / error) ** 2 / data.n_scans
        return np.asarray(smooth + 0.05 * (signs * ((jumps < value) != (jumps < at))).sum(axis=1))

    signs = rng.choice([-1.0, 1.0], jumps.shape)
    scores = rng.normal(size=data.n_scans) / (error * np.sqrt(data.n_scans))
    scores -= scores.mean()
    assert 0.5 * error < jagged_error(change, data, at, step) < 4 * error


def test_a_lattice_that_is_off_by_its_error_still_holds_every_reading(hall: Arena) -> None:
    q = 0.05
    data, _ = prepare_scans(
        drive(hall, (EFFECTS["quantisation"](q=q),)), hall, parse_robot("sensor: {n_rays: 61}"), ()
    )
    z = data.ranges[data.returned]
    cell = max(data.sensor.resolution, 1e-4)
    off = lattice_error(data, q)
    for step, holds in ((q + 0.99 * off, True), (q + 1.5 * off, False)):
        assert (np.abs(np.round(z / q) * step - z).max() <= 0.5 * cell + 1e-9) == holds


def test_a_size_at_its_limit_is_as_likely_material_as_not() -> None:
    limit = EFFECTS["range_bias"].sizes["b"]
    at = EFFECTS["range_bias"](b=-limit)
    assert material_probability(at, {"b": 0.1 * limit}) == pytest.approx(0.5, abs=1e-6)
    assert material_probability(at, {"b": 0.1 * limit}, slack=1.2) == pytest.approx(norm.cdf(-2), abs=1e-6)


def test_sizes_of_two_axes_add_as_a_vector() -> None:
    limit = EFFECTS["mount_xy"].sizes["dx"]
    along = EFFECTS["mount_xy"](dx=1.3 * limit, dy=0.0)
    aslant = EFFECTS["mount_xy"](dx=1.3 * limit / np.sqrt(2), dy=1.3 * limit / np.sqrt(2))
    error = {"dx": 0.2 * limit, "dy": 0.2 * limit}
    assert material_probability(aslant, error) == pytest.approx(material_probability(along, error))
    assert material_probability(along, error) == pytest.approx(norm.cdf(1.5), abs=1e-6)


def test_what_has_no_limit_of_size_is_material() -> None:
    assert material_probability(EFFECTS["max_range"](R=3.0), {"R": 1.0}) == 1.0


def test_the_end_of_a_part_that_is_the_end_of_its_wall_has_an_error(hall: Arena) -> None:
    pane = EFFECTS["glass"](a=0.0, b=1.0, alpha_ret=0.3, depth=1.5).at(
        hall.names[0], hall.walls[0].mean(axis=0)
    )
    length = float(np.hypot(*(hall.walls[0][1] - hall.walls[0][0])))
    planted = pane.moved_to({"a": 0.4 * length, "b": length})
    got, errors = fitted(hall, planted, planted)
    assert abs(got.model[0]["a"] - 0.4 * length) < 3 * errors["a"]
    assert 0 < errors["b"] < 0.1


def test_a_size_that_the_run_does_not_determine_is_as_probably_material_as_not() -> None:
    pillar = EFFECTS["unmapped_obstacle"](x=1.0, y=2.0, r=3.0)
    assert material_probability(pillar, {"x": 0.01, "y": 0.01, "r": 0.1}) > 0.999
    assert material_probability(pillar, {"x": 0.01, "y": 0.01, "r": 31623.0}) == pytest.approx(0.5, abs=1e-3)


def test_at_a_site_that_is_known_its_spread_from_run_to_run_is_part_of_the_error(hall: Arena) -> None:
    bias = EFFECTS["range_bias"](b=0.03)
    got, alone = fitted(hall, bias, bias)
    usual = BaselineInterval(mean={"b": 0.0}, spread={"b": 0.004}, stderr={"b": 0.001}, dof=8.0)
    known = replace(got, solver=copy(got.solver))
    known.solver.data = replace(got.solver.data, site=SitePrior(intervals={"range_bias": usual}), memo={})
    (told,) = standard_errors(known, NoiseBounds())
    assert told["b"] == pytest.approx(np.hypot(alone["b"], 0.004), rel=0.05)
