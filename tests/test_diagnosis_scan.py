"""The scan channel of a diagnosis: derivatives, elimination, likelihood, proposals and proof, each against a plain form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import polygon_arena
from plain_kernels import plain_e_step
from scan_samples import data_of, drive

from planners.arena import Arena
from planners.types import Floats
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.scan.candidates import polish
from sensorgraph.diagnosis.scan.deviations import dispersion
from sensorgraph.diagnosis.scan.fit import Fitted, cast, fit, solver_for, start_state
from sensorgraph.diagnosis.scan.goodness_of_fit import check, held_out
from sensorgraph.diagnosis.scan.likelihood import ExpectedReadings, e_step, expected_readings
from sensorgraph.diagnosis.scan.nuisance import BeamNoise, pose_prior
from sensorgraph.diagnosis.scan.residuals import FitResiduals, replicate
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.score_test import smooth_candidates
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.robot import parse_robot

SIGMA = 0.01


@pytest.fixture(scope="module")
def quiet(hall: Arena) -> ScanData:
    """Return the scans of a run without any effect."""
    return data_of(hall)


@pytest.fixture(scope="module")
def null(quiet: ScanData) -> Fitted:
    """Return its fit without effects."""
    return fit(quiet, (), start_state(quiet, NoiseBounds()), NoiseBounds())


def moved_pose(data: ScanData, step: Floats) -> ScanData:
    stamps, poses = data.track
    return replace(data, track=(stamps, poses + step), memo={})


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_columns_by_the_pose_are_difference_quotients(quiet: ScanData, axis: int) -> None:
    at, h = cast(quiet, ()), 1e-6
    step = np.zeros(3)
    step[axis] = h
    moved = cast(moved_pose(quiet, step), ())
    same = at.jacobian.valid & (moved.beams.wall == at.beams.wall)
    quotient = (moved.expected.reading - at.expected.reading)[same] / h
    np.testing.assert_allclose(at.jacobian.pose[:, axis][same], quotient, atol=2e-3)  # second order over h


@pytest.mark.parametrize(
    ("name", "values", "column"),
    [
        ("mount_xy", {"dx": 1e-6, "dy": 0.0}, Nuisance.MOUNT_X),
        ("mount_xy", {"dx": 0.0, "dy": 1e-6}, Nuisance.MOUNT_Y),
        ("mount_yaw", {"delta": 1e-6}, Nuisance.MOUNT_YAW),
        ("range_bias", {"b": 1e-6}, Nuisance.BIAS),
        ("range_scale", {"s": 1e-6}, Nuisance.SCALE),
        ("range_drift", {"b1": 1e-6}, Nuisance.DRIFT),
        ("latency", {"tau": 1e-6}, Nuisance.DELAY),
        ("scan_skew", {"T": 1e-6}, Nuisance.SKEW),
    ],
)
def test_a_nuisance_does_what_its_effect_does(
    quiet: ScanData, name: str, values: dict[str, float], column: Nuisance
) -> None:
    at = cast(quiet, ())
    moved = cast(quiet, (EFFECTS[name](**values),))
    same = at.jacobian.valid & (moved.beams.wall == at.beams.wall)
    quotient = (moved.expected.reading - at.expected.reading)[same] / 1e-6
    got = at.jacobian.nuisances[:, column][same]
    if column in (
        Nuisance.DELAY,
        Nuisance.SKEW,
    ):  # the velocity is smoothed over 0.4 s, the quotient has the reference's noise
        assert 0.85 < (got @ quotient) / (got @ got) < 1.15
    else:
        assert np.abs(got - quotient).max() < 5e-3 * max(1.0, np.abs(quotient).max())


def test_eliminating_the_poses_solves_the_whole_system(quiet: ScanData, null: Fitted) -> None:
    """Schur complement against one dense least-squares problem with every pose error as an unknown."""
    few = quiet.subset(np.arange(6))
    solver, _ = solver_for(few, (EFFECTS["range_bias"](b=0.0),))
    weight = np.random.default_rng(0).uniform(0.5, 1.5, solver.shape) / SIGMA**2
    system = solver.assemble(weight, 1.0)
    n_scans, k = 6, len(system.right)
    columns = []
    for j in range(k):
        x = np.zeros(k)
        x[j] = 1.0
        state = start_state(few, NoiseBounds())
        state.g = x[: solver.n_g]
        columns.append(solver.shift(state, x[solver.n_g :]).ravel())
    for scan in range(n_scans):
        for axis in range(3):
            state = start_state(few, NoiseBounds())
            state.delta[scan, axis] = 1.0
            columns.append(solver.shift(state, np.zeros(1)).ravel())
    a = np.column_stack(columns)
    w = np.where(solver.jacobian.valid, weight, 0.0).ravel()
    normal = a.T @ (a * w[:, None])
    prior = np.linalg.inv(pose_prior(few, 1.0).covariance)
    for scan in range(n_scans):
        at = slice(k + 3 * scan, k + 3 * scan + 3)
        normal[at, at] += prior[scan]
    right = a.T @ (w * solver.y.ravel())
    inner = np.linalg.inv(normal[k:, k:])
    np.testing.assert_allclose(
        system.matrix, normal[:k, :k] - normal[:k, k:] @ inner @ normal[k:, :k], rtol=1e-6, atol=1e-4
    )
    np.testing.assert_allclose(
        system.right, right[:k] - normal[:k, k:] @ inner @ right[k:], rtol=1e-6, atol=1e-4
    )


@pytest.mark.parametrize(("short", "lattice"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.01), (0.02, 0.05)])
def test_the_compiled_likelihood_is_the_plain_one(quiet: ScanData, short: float, lattice: float) -> None:
    """Readings of every kind: returned, lost, too near and broken, aimed at something or not, beside edges or not."""
    rng, shape = np.random.default_rng(6), (40, 61)
    expected = rng.uniform(0.05, 9.0, shape)
    z = expected + rng.normal(size=shape) * rng.choice([0.005, 0.05, 1.0], shape)
    if lattice:
        z = np.where(rng.random(shape) < 0.8, np.round(z / lattice) * lattice, z)
    z = np.where(rng.random(shape) < 0.4, rng.choice([np.inf, -np.inf, np.nan], shape), np.abs(z))
    beside = rng.random(shape) < 0.3
    expected = ExpectedReadings(
        reading=np.where(rng.random(shape) < 0.2, rng.choice([np.inf, np.nan], shape), expected),
        sigma=rng.uniform(0.005, 0.05, shape),
        p_return=np.broadcast_to(rng.uniform(0, 1, (40, 1)), shape),
        alternative=np.where(beside, expected + rng.normal(size=shape), np.nan),
        spread=np.where(beside, rng.uniform(0, 0.3, shape), 0.0),
        p_alternative=np.where(beside | (rng.random(shape) < 0.1), rng.uniform(0, 0.5, shape), 0.0),
        stray=0.03,
        short=short,
        lattice=lattice,
    )
    data = replace(quiet.subset(np.arange(40)), ranges=z)
    asked = (
        data,
        expected,
        rng.normal(size=shape) * 0.01,
        BeamNoise(core=1.1, tail=0.1, loss=0.01, stray=0.002),
    )
    got, plain = e_step(*asked), plain_e_step(*asked)
    for name in ("log_p", "weight", "residual", "core", "tail", "lost", "stray"):
        np.testing.assert_allclose(
            getattr(got, name), getattr(plain, name), rtol=1e-9, atol=1e-12, err_msg=name
        )


def test_a_reading_has_a_probability_of_one_in_all(quiet: ScanData) -> None:
    """Integrate the density over every reading a ray may give, lost and too close among them."""
    at = cast(quiet, ())
    few = quiet.subset(np.arange(3))
    beams = at.beams
    beams = replace(
        beams, reading=np.tile(np.linspace(0.5, 7.9, 61), (3, 1)), p_return=0.8, sigma=0.02, ox=beams.ox[:3]
    )
    expected = expected_readings(beams, np.zeros((3, 61)), None, 0.03, 0.0, 0.0)
    grid = np.arange(0.05, 8.0, 0.002)
    total = np.zeros((3, 61))
    for z in grid:
        got = e_step(
            replace(few, ranges=np.full((3, 61), z)),
            expected,
            np.zeros((3, 61)),
            BeamNoise(tail=0.1, loss=0.01),
        )
        total += 0.002 * np.exp(got.log_p)
    lost = e_step(
        replace(few, ranges=np.full((3, 61), np.inf)),
        expected,
        np.zeros((3, 61)),
        BeamNoise(tail=0.1, loss=0.01),
    )
    np.testing.assert_allclose(total + np.exp(lost.log_p), 1.0, atol=0.012)  # of 0.05 to 8 m, and a floor


def test_without_an_effect_nuisances_stay_small_and_scales_at_one(null: Fitted) -> None:
    tau = null.solver.tau
    assert (np.abs(null.state.g) < 1.5 * tau).all()
    assert null.state.pose_scale < 1.2
    assert null.state.map_scale < 1.2
    assert 0.9 < null.state.noise.core < 1.1


def test_corners_stay_within_a_box_that_shrinks(hall: Arena) -> None:
    """A wall that stands 3 cm off must not pass for a careful map: the scale of its tolerance shrinks after a solve."""
    data = data_of(hall, (EFFECTS["moved_wall"](d=0.03).at("w/edge_0"),))
    got = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds())
    assert (np.abs(got.state.g) <= got.solver.box(got.state) * (1 + 1e-9)).all()


def test_screening_foresees_the_gain_of_a_fit(hall: Arena) -> None:
    data = data_of(hall, (EFFECTS["range_bias"](b=0.008),))
    free = NoiseBounds()
    without = fit(data, (), start_state(data, free), free)
    foreseen = next(c for c in smooth_candidates(data, without) if c.amendment.name == "range_bias")
    with_it = fit(data, (foreseen.amendment,), without.state, free)
    assert with_it.j - without.j > 20
    assert 0.4 < foreseen.gain / (with_it.j - without.j) < 2.5
    assert abs(with_it.model[0]["b"] - 0.008) < 0.002


@pytest.mark.parametrize(
    ("name", "place", "values"),
    [
        ("range_bias", "", {"b": 0.02}),
        ("range_scale", "", {"s": 0.01}),
        ("mount_yaw", "", {"delta": 0.02}),
        ("mount_xy", "", {"dx": 0.02, "dy": -0.015}),
        ("latency", "", {"tau": 0.03}),
        ("scan_skew", "", {"T": 0.05}),
        ("moved_wall", "w/edge_1", {"d": 0.05}),
        ("map_scale", "", {"s": 0.01, "dx": 0.0, "dy": 0.0}),
        ("range_drift", "", {"b1": 0.03}),
        ("unmapped_obstacle", "", {"x": 5.0, "y": 4.0, "r": 0.15}),
    ],
)
def test_a_fit_recovers_what_was_planted(
    hall: Arena, name: str, place: str, values: dict[str, float]
) -> None:
    planted = EFFECTS[name](**values)
    planted = planted.at(place) if place else planted
    data = data_of(hall, (planted,))
    start = planted.moved_to(
        {k: 0.8 * v for k, v in values.items() if k in planted.effect.steps and k not in "xy"}
    )
    got = fit(data, (start,), start_state(data, NoiseBounds()), NoiseBounds())
    sd = np.sqrt(np.diag(got.solution.covariance))
    for k, (parameter, deviation) in enumerate(zip(planted.effect.steps, sd, strict=True)):
        assert abs(got.model[0][parameter] - values[parameter]) < 4 * deviation + 1e-4, (k, parameter)


@pytest.mark.parametrize("s", [0.01, -0.015])
def test_a_fit_does_not_depend_on_where_it_starts(hall: Arena, s: float) -> None:
    """Without the effect, wide tolerances and heavy tails explain it; the noise recovers from there last."""
    data, bounds = data_of(hall, (EFFECTS["range_scale"](s=s),)), NoiseBounds()
    start, scale = start_state(data, bounds), (EFFECTS["range_scale"](s=0.0),)
    without = fit(data, (), start, bounds)
    assert without.state.map_scale > 2.0
    found = [fit(data, scale, state, bounds) for state in (start, without.state)]
    assert found[0].j == pytest.approx(found[1].j, abs=1.0)  # nats


def test_replicates_are_as_the_model_says(quiet: ScanData, null: Fitted) -> None:
    rng, ratios = np.random.default_rng(1), []
    for _ in range(3):
        view = FitResiduals(*replicate(quiet, null, rng))
        seen = view.returned & view.valid
        ratios.append(np.median(np.abs(view.residual[seen] / view.sigma[seen])) / 0.6745)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)  # of normal noise; 40,000 readings give 0.01


def test_scans_that_differ_show_in_the_dispersion(quiet: ScanData) -> None:
    rng = np.random.default_rng(2)
    bursts = rng.random(quiet.n_scans) < 0.3
    noisy = quiet.ranges + rng.normal(size=quiet.ranges.shape) * np.where(bursts, 0.02, 0.0)[:, None]
    changed = replace(quiet, ranges=noisy, memo={})
    got = fit(changed, (), start_state(changed, NoiseBounds()), NoiseBounds())
    assert dispersion(FitResiduals(changed, got)).ratio > 2


@pytest.mark.parametrize("size", [0.0025, 0.012])
def test_what_is_sure_but_small_is_no_doubt_and_a_doubt_says_its_size(quiet: ScanData, size: float) -> None:
    step = size * np.sign(np.sin(6 * quiet.sensor.bearings))  # no effect of the library has such steps
    fine = replace(quiet.sensor, sigma=0.003)
    noise = np.random.default_rng(4).normal(size=quiet.ranges.shape) * fine.sigma
    ideal = fit(quiet, (), start_state(quiet, NoiseBounds()), NoiseBounds()).cast
    data = replace(quiet, sensor=fine, ranges=ideal.expected.reading + noise + step, memo={})
    got = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds())
    doubt = check(data, got, 0.0, {}, rng=np.random.default_rng(5))
    if size < 0.005:
        assert not doubt.is_doubted and doubt.immaterial
    else:
        assert doubt.told is not None and doubt.told.size is not None
        assert 0.5 * size < doubt.told.size.offset < 1.5 * size
        assert any("bearing" in cause for cause in doubt.told.causes)


def test_one_block_in_eight_is_held_out(quiet: ScanData) -> None:
    held = held_out(quiet)
    assert 0.05 < held.mean() < 0.2
    assert (np.diff(np.flatnonzero(held)) == 1).any()  # whole blocks


@pytest.mark.parametrize(("away", "doubted"), [(0, False), (60, True)])
def test_a_pane_that_is_away_for_a_stretch_of_the_run_is_no_pane(
    hall: Arena, away: int, doubted: bool
) -> None:
    wall = max(range(4), key=lambda i: float(np.hypot(*(hall.walls[i][1] - hall.walls[i][0]))))
    pane = EFFECTS["glass"](a=0.5, b=4.5, alpha_ret=0.3, depth=1.5).at(hall.names[wall])
    with_pane, without = drive(hall, (pane,)), drive(hall)
    ranges = with_pane.ranges.copy()
    ranges[:away] = without.ranges[:away]
    run = replace(with_pane, ranges=ranges)
    data, _ = prepare_scans(run, hall, parse_robot("sensor: {n_rays: 61}"), ())
    null = fit(data, (), start_state(data, NoiseBounds()), NoiseBounds())
    fitted = fit(data, (pane,), start_state(data, NoiseBounds()), NoiseBounds())
    gained = fitted.j - null.j
    doubt = check(data, fitted, gained, {0: gained}, rng=np.random.default_rng(0))
    assert gained > 500
    assert (doubt.told is not None and 0 in doubt.told.failed) == doubted


def with_box(hall: Arena) -> Arena:
    """Return the hall with a square box of 30 cm that no map has."""
    x, y = 1.2, 1.2
    box = np.array([(x, y), (x + 0.3, y), (x + 0.3, y + 0.3), (x, y + 0.3)])
    rings = [
        [(0, 0), (6, 0), (6, 5), (0, 5)],
        [(2.0, 3.0), (2.6, 3.0), (2.6, 3.5), (2.0, 3.5)],
        [(4.0, 1.0), (4.5, 1.2), (4.3, 1.7)],
        [(float(a), float(b)) for a, b in box],
    ]
    return polygon_arena(*rings)


@pytest.mark.slow
def test_the_outline_of_a_box_where_a_disc_is_said_doubts_no_other_name(hall: Arena) -> None:
    """A box that the map lacks and a biased laser: both are named, though a disc is not what stands there."""
    run = drive(with_box(hall), (EFFECTS["range_bias"](b=0.03),), n=200)
    found = diagnose(run, hall, parse_robot("sensor: {n_rays: 61}"), plan_next=False)
    assert {a.name for a in found.effects} == {"unmapped_obstacle", "range_bias"}
    box = next(a for a in found.effects if a.name == "unmapped_obstacle")
    assert abs(box["x"] - 1.35) < 0.05
    assert abs(box["y"] - 1.35) < 0.05
    assert 0.13 < box["r"] < 0.23


def test_a_share_is_searched_between_none_and_all(quiet: ScanData) -> None:
    """A bounded search tried 103 %: probabilities below 0, and a noise that is no number."""
    far, noise_bounds = (EFFECTS["random_outliers"](p=0.9),), NoiseBounds()
    state = start_state(quiet, noise_bounds)
    with np.errstate(invalid="raise"):
        (found,) = polish(quiet, far, state, noise_bounds, rounds=4, first=2.0)
    assert 0.0 < found["p"] < 0.9


@pytest.mark.parametrize(("x", "r", "is_told"), [(2.4, 0.1, True), (5.3, 0.03, False)])
def test_a_bulge_of_a_wall_is_told_where_it_matters(hall: Arena, x: float, r: float, is_told: bool) -> None:
    """Before the wall y = 0, by 7 cm over 19 cm, or by 2 cm over 6: that is less than 0.2 % of the readings."""
    disc = EFFECTS["unmapped_obstacle"](x=x, y=-0.3 * r, r=r)
    data, noise_bounds = data_of(hall, (disc,)), NoiseBounds()
    bare = fit(data, (), start_state(data, noise_bounds), noise_bounds)
    fitted = fit(data, (disc,), bare.state, noise_bounds)
    found = check(data, fitted, 500.0, {0: 500.0}, rng=np.random.default_rng(0), null=bare)
    assert found.is_doubted is is_told
    assert not is_told or (found.told is not None and 0 in found.told.failed)
    assert is_told or any("an object stands against the wall" in text for text in found.immaterial)
