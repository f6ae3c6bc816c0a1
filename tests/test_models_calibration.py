"""Calibration: planted mounts, ray terms, pose noise and walls come back; a perfect laser is left alone."""

from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import further

from logs.run import RangeSensor
from logs.transforms import compose, wrap
from planners.maps import geojson
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.calibration.gauge import Gauge, estimate_gauge, find_peak
from sensorgraph.models.calibration.laser_calibration import Calibration
from sensorgraph.models.calibration.matching import Readings, match_readings, mean_incidence, range_change
from sensorgraph.models.calibration.normal_equations import (
    INCIDENCE,
    MOUNT,
    N_COMMON,
    NormalEquations,
    normal_equations,
    select_terms,
    standard_errors,
)
from sensorgraph.models.calibration.pose_refinement import refine_poses
from sensorgraph.models.calibration.ray_terms import (
    INCIDENCE_POWERS,
    MAX_OPTIC_RANGE,
    N_INCIDENCE,
    RayTerms,
    incidence_bias,
)
from sensorgraph.models.faces.forward_selection import Lines
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.reduction import blocks_of
from sensorgraph.models.faces.visibility import Rays, ReturnNoise, binned_faces
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast

SIZE = 4.0  # [m] of the room
BOX = (2.6, 2.2, 3.2, 2.6)  # [m] something to look behind
BEARINGS = np.radians(np.linspace(-120, 120, 61))
SIGMA = 0.005
OFFSET = np.array([0.04, -0.02, 0.01])
STATED = np.array([0.1, 0.0, 0.0])


def reading_of(terms: RayTerms, rho: Floats, cosine: Floats) -> Floats:
    """Return the readings (n, n_rays) at true ranges and |n·u| of the same shape, in numpy."""
    v, q = 1 - cosine, np.minimum(rho, MAX_OPTIC_RANGE) / MAX_OPTIC_RANGE
    shared = sum(s * v**a * q**b for s, (a, b) in zip(terms.incidence, INCIDENCE_POWERS, strict=True))
    return np.asarray(rho + terms.constant + terms.slope * rho + shared)


def room(*, empty: bool = False) -> str:
    boxes = [("room", "arena", (0.0, 0.0, SIZE, SIZE))] + ([] if empty else [("box", "obstacle", BOX)])
    features = []
    for name, kind, (x0, y0, x1, y1) in boxes:
        ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]
        geometry = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": {"name": name, "kind": kind}, "geometry": geometry})
    return json.dumps({"type": "FeatureCollection", "features": features})


def true_faces(*, empty: bool = False) -> FaceSet:
    """Walls of the room, and of the box, as faces."""
    s = SIZE
    n, d = [[1.0, 0], [-1, 0], [0, 1], [0, -1]], [0.0, -s, 0, -s]
    ends = [(0, s), (-s, 0), (-s, 0), (0, s)]
    if not empty:
        x0, y0, x1, y1 = BOX
        n += [[-1, 0], [1, 0], [0, -1], [0, 1]]
        d += [-x0, x1, -y0, y1]
        ends += [(-y1, -y0), (y0, y1), (x0, x1), (-x1, -x0)]
    return binned_faces(Lines(normals=np.array(n, float), offsets=np.array(d), spans=np.array(ends, float)))


def poses_in_room(n: int, rng: np.random.Generator) -> Floats:
    """Poses outside the box and 0.3 m from all walls."""
    p = rng.uniform(0.3, SIZE - 0.3, (3 * n, 2))
    x0, y0, x1, y1 = BOX
    free = (p[:, 0] < x0 - 0.3) | (p[:, 0] > x1 + 0.3) | (p[:, 1] < y0 - 0.3) | (p[:, 1] > y1 + 0.3)
    return np.column_stack([p[free][:n], rng.uniform(-np.pi, np.pi, n)])


def sensor_at(mount: Floats) -> RangeSensor:
    return RangeSensor(bearings=BEARINGS, range_min=0.0, range_max=10.0, mount=mount, sigma=SIGMA)


def log(
    rng: np.random.Generator,
    n: int,
    *,
    mount: Floats = STATED,
    terms: RayTerms | None = None,
    empty: bool = False,
) -> tuple[Floats, Floats, Floats]:
    """Return poses, ranges with noise and without."""
    poses = poses_in_room(n, rng)
    hits = cast(geojson.loads(room(empty=empty)), poses, sensor_at(mount))
    exact = hits.ranges if terms is None else reading_of(terms, hits.ranges, np.cos(hits.incidence))
    return poses, exact + rng.normal(0, SIGMA, exact.shape), exact


def readings_from(ranges: Floats) -> Readings:
    scan, ray = np.divmod(np.arange(ranges.size), ranges.shape[1])
    return Readings(scan=scan, pose=scan, ray=ray, ranges=ranges.ravel(), bearings=BEARINGS, range_max=10.0)


def scans_of(poses: Floats, ranges: Floats, **options: object) -> TrainingScans:
    run = np.zeros(len(poses), dtype=np.intp)
    return TrainingScans(sensor=sensor_at(STATED), poses=poses, ranges=ranges, run=run, **options)  # type: ignore[arg-type]


def planted(rng: np.random.Generator) -> RayTerms:
    n = len(BEARINGS)
    return RayTerms(
        constant=rng.normal(0, 0.02, n), slope=rng.normal(0.004, 0.002, n), incidence=np.zeros(N_INCIDENCE)
    )


def normal_of(poses: Floats, ranges: Floats, faces: FaceSet) -> NormalEquations:
    lasers = compose(poses, STATED)
    readings = readings_from(ranges)
    matches = match_readings(
        readings, lasers, RayTerms.none(len(BEARINGS)), faces, ReturnNoise(sigma=0.03), 0.0
    )
    return normal_equations(readings, lasers, matches, faces, hold=False)


def test_kernel_of_incidence_terms_agrees_with_the_plain_form() -> None:
    rng = np.random.default_rng(1)
    terms = RayTerms(constant=np.zeros(1), slope=np.zeros(1), incidence=rng.normal(size=N_INCIDENCE))
    for rho, den in zip(rng.uniform(0.1, 9, 50), -rng.uniform(0, 1, 50), strict=True):
        plain = reading_of(terms, np.array([rho]), np.array([-den]))[0] - rho
        assert incidence_bias(den, rho, terms.incidence) == pytest.approx(plain, abs=1e-12)


def test_the_mean_of_the_incidence_terms_is_that_of_the_plain_form() -> None:
    rng = np.random.default_rng(4)
    poses, ranges, _ = log(rng, 40, mount=STATED, terms=planted(rng))
    terms = RayTerms(
        constant=np.zeros(len(BEARINGS)),
        slope=np.zeros(len(BEARINGS)),
        incidence=rng.normal(size=N_INCIDENCE),
    )
    lasers = compose(poses, STATED)
    none = RayTerms.none(len(BEARINGS))
    matches = match_readings(readings_from(ranges), lasers, none, true_faces(), ReturnNoise(sigma=0.03), 0.0)
    known = matches.weight > 0
    plain = [
        reading_of(terms, np.array([rho]), np.array([-den]))[0] - rho
        for rho, den in zip(matches.rho[known], matches.den[known], strict=True)
    ]
    assert mean_incidence(matches, terms) == pytest.approx(np.mean(plain), abs=1e-9)


def test_adjustment_recovers_mount_constants_and_slopes_on_known_walls() -> None:
    rng = np.random.default_rng(2)
    terms = planted(rng)
    poses, ranges, _ = log(rng, 400, mount=STATED + OFFSET, terms=terms)
    lasers, faces, noise = compose(poses, STATED), true_faces(), ReturnNoise(sigma=0.05)
    readings, found = readings_from(ranges), RayTerms.none(len(BEARINGS))
    prices = np.zeros(N_COMMON + 2 * len(BEARINGS))
    prices[INCIDENCE] = np.inf
    mount = STATED
    for _ in range(4):  # Gauss-Newton
        matches = match_readings(readings, lasers, found, faces, noise, 0.0)
        normal = normal_equations(readings, lasers, matches, faces, hold=True)
        current = np.concatenate([np.zeros(N_COMMON), found.constant, found.slope])
        values, chosen, _ = select_terms(normal, current, prices)
        mount = compose(mount, values[MOUNT])
        lasers = compose(poses, mount)
        own = values[N_COMMON:].reshape(2, -1) + values[3:5, None]
        found = RayTerms(constant=own[0], slope=own[1], incidence=np.zeros(N_INCIDENCE))
    error = mount - STATED - OFFSET
    se = standard_errors(normal, chosen)[MOUNT] * SIGMA / noise.sigma
    assert (np.abs(error) < 4 * se + [3e-4, 3e-4, 1e-4]).all()  # and what few returns of the wrong face do
    at_2_m = found.constant - terms.constant + 2 * (found.slope - terms.slope)
    assert np.sqrt(np.mean(at_2_m**2)) < 0.001  # 400 returns of 5 mm: 0.25 mm, and the common part


def test_selection_takes_planted_terms_and_no_others() -> None:
    rng = np.random.default_rng(3)
    x = rng.normal(size=(4000, 20)) + 0.7 * rng.normal(size=(4000, 1))
    truth = np.zeros(20)
    truth[[2, 7, 11]] = 0.3, -0.2, 0.15
    y = x @ truth + rng.normal(size=4000)
    empty = np.zeros((0, 2, 20))
    normal = NormalEquations(
        matrix=x.T @ x, rhs=x.T @ y, n_returns=4000.0, face_inverse=np.zeros((0, 2, 2)), face_rhs=np.zeros((0, 2)),
        coupling=empty, centre=np.zeros(0), gauge_weights=np.zeros(0),
    )  # fmt: skip
    values, chosen, worth = select_terms(normal, np.zeros(20), np.full(20, 0.5 * np.log(4000) + np.log(20)))
    assert set(np.flatnonzero(chosen)) == {2, 7, 11}
    np.testing.assert_allclose(values, truth, atol=4 / np.sqrt(4000))
    assert worth > 50


def test_exact_laser_is_worth_no_term() -> None:
    poses, ranges, _ = log(np.random.default_rng(4), 200)
    normal = normal_of(poses, ranges, true_faces())
    n = len(normal.rhs)
    _, chosen, worth = select_terms(
        normal, np.zeros(n), np.full(n, 0.5 * np.log(normal.n_returns) + np.log(n))
    )
    assert not chosen.any() and worth == 0


def test_noisy_poses_come_back_and_their_noise_is_told() -> None:
    rng = np.random.default_rng(5)
    poses, ranges, _ = log(rng, 300)
    off = rng.normal(0, 1, (300, 3)) * [0.01, 0.01, 0.006]
    readings, lasers = readings_from(ranges), compose(compose(poses, STATED), off)
    faces, shifts = true_faces(), np.zeros((300, 3))
    for noise in (ReturnNoise(sigma=SIGMA, sigma_xy=0.01, sigma_yaw=0.006), ReturnNoise(sigma=SIGMA)):
        here = compose(lasers, shifts)
        matches = match_readings(readings, here, RayTerms.none(len(BEARINGS)), faces, noise, 0.0)
        better = refine_poses(readings, here, matches, faces, shifts, ReturnNoise(sigma=SIGMA))
        shifts = better.shifts
    assert better.sigma_xy == pytest.approx(0.01, rel=0.15)  # 600 numbers: 3 %; some returns are gated
    assert better.sigma_yaw == pytest.approx(0.006, rel=0.2)
    left = compose(lasers, shifts) - compose(poses, STATED)
    left[:, 2] = wrap(left[:, 2])
    assert np.median(np.hypot(left[:, 0], left[:, 1])) < 0.002  # 61 returns of 5 mm: 1.3 mm


def test_exact_poses_are_not_worth_refining() -> None:
    poses, ranges, _ = log(np.random.default_rng(6), 200)
    readings, lasers = readings_from(ranges), compose(poses, STATED)
    matches = match_readings(readings, lasers, RayTerms.none(61), true_faces(), ReturnNoise(sigma=SIGMA), 0.0)
    better = refine_poses(
        readings, lasers, matches, true_faces(), np.zeros((200, 3)), ReturnNoise(sigma=SIGMA)
    )
    assert better.log_evidence < 0 and better.sigma_xy < 0.001


@pytest.mark.parametrize("top", [0.0042, -0.011, 0.019])
def test_search_finds_a_lopsided_cusp(top: float) -> None:
    found = find_peak(lambda x: -2e5 * abs(x - top) * (2 if x > top else 1), reach=0.012)
    assert found.shift == pytest.approx(top, abs=0.0005) and found.stderr < 0.0005


@pytest.mark.parametrize("slope", [0.0, 2e5])
def test_search_without_a_peak_is_not_observed(slope: float) -> None:
    assert not find_peak(lambda x: slope * x, reach=0.012).is_observed


def gauge_of(wrong: float, *, empty: bool) -> Gauge:
    """Search from walls that all sit `wrong` [m] too near, with ranges that agree with them."""
    rng = np.random.default_rng(7)
    poses, ranges, _ = log(rng, 500, empty=empty)
    faces, noise = true_faces(empty=empty), ReturnNoise(sigma=SIGMA)
    readings, lasers = readings_from(ranges), compose(poses, STATED)
    right = match_readings(readings, lasers, RayTerms.none(61), faces, noise, 0.0)
    off = readings_from((ranges.ravel() + range_change(right, wrong)).reshape(ranges.shape))
    near = faces._replace(offsets=faces.offsets + wrong)
    matches = match_readings(off, lasers, RayTerms.none(61), near, noise, 0.0)
    angle = lasers[off.scan, 2] + BEARINGS[off.ray]
    rays = Rays(
        origins=lasers[off.scan, :2],
        directions=np.stack([np.cos(angle), np.sin(angle)], axis=1),
        ranges=matches.ranges,
        range_max=10.0,
    )
    return estimate_gauge(rays, matches, near, noise, reach=0.012)


@pytest.mark.parametrize("wrong", [-0.006, *further(0.005)])
def test_occlusion_edges_tell_where_all_walls_are(wrong: float) -> None:
    found = gauge_of(wrong, empty=False)
    assert found.is_observed and found.shift == pytest.approx(-wrong, abs=0.0015)  # few scans: bins of 1 cm


def test_walls_of_an_empty_room_cannot_be_told() -> None:
    found = gauge_of(0.005, empty=True)
    assert not found.is_observed and found.shift == 0


def test_calibration_survives_its_file() -> None:
    rng = np.random.default_rng(8)
    made = Calibration(
        terms=planted(rng), offset=OFFSET, offset_se=np.full(3, 1e-4), can_mount=True, n_own=61,
        gauge=Gauge(shift=0.0, stderr=np.inf), sigma_xy=0.005, sigma_yaw=0.003,
    )  # fmt: skip
    header, arrays = made.state()
    again = Calibration.restore(61, json.loads(json.dumps(header)), arrays)
    assert again.summary() == made.summary()
    assert "not observable" in again.summary()["common shift of the walls"]
    np.testing.assert_array_equal(again.terms.constant, made.terms.constant)
    with pytest.raises(ValueError, match="shapes"):
        Calibration.restore(60, header, arrays)


@pytest.mark.slow
def test_uncalibrated_laser_is_identified_with_its_faces() -> None:
    rng = np.random.default_rng(9)
    terms = planted(rng)
    terms.incidence[INCIDENCE_POWERS.index((2, 1))] = 0.03
    poses, ranges, _ = log(rng, 1500, mount=STATED + OFFSET, terms=terms)
    model = Faces.fit(scans_of(poses, ranges))
    fresh, _, exact = log(rng, 300, mount=STATED + OFFSET, terms=terms)
    error = np.abs(model.predict(fresh, np.arange(61), "mode").mode - exact)
    plain = Faces.fit(scans_of(poses, ranges), calibrate=False).predict(fresh, np.arange(61), "mode").mode
    assert (np.abs(model.calibration.offset - OFFSET) < [5e-4, 5e-4, 3e-4]).all()
    assert np.median(error) < 0.001 < 0.01 < np.median(np.abs(plain - exact))
    assert (error < 3 * SIGMA).mean() > 0.99
    more = model.updated(
        blocks_of(scans_of(*log(rng, 300, mount=STATED + OFFSET, terms=terms)[:2])), n_scans=300
    )
    later = np.abs(more.predict(fresh, np.arange(61), "mode").mode - exact)
    assert np.median(later) < 0.001 and (later < 3 * SIGMA).mean() > 0.99
    again = Faces.restore(model.sensor, *model.state())
    np.testing.assert_array_equal(
        again.predict(fresh, np.arange(61), "mode").mode, model.predict(fresh, np.arange(61), "mode").mode
    )
    assert "the laser shows r" in model.equation(3) and "off by +40" in model.summary()["mount"]


@pytest.mark.slow
def test_perfect_laser_stays_exactly_as_stated() -> None:
    for seed in range(3):
        poses, ranges, _ = log(np.random.default_rng([10, seed]), 600)
        model = Faces.fit(scans_of(poses, ranges))
        assert model.calibration.is_as_stated
        np.testing.assert_array_equal(model.mount, STATED)
        assert model.summary()["mount"] == "as stated"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma", "seed"), [(0.005, 11), *further((0.02, 11), (0.02, 13))]
)  # m; at 2 cm, walls are first found many times
def test_noisy_training_poses_hardly_harm(sigma: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses, ranges, _ = log(rng, 1000)
    noisy = poses + rng.normal(0, 1, poses.shape) * [sigma, sigma, 0.7 * sigma]
    model = Faces.fit(scans_of(noisy, ranges))
    fresh, _, exact = log(rng, 300)
    error = np.abs(model.predict(fresh, np.arange(61), "mode").mode - exact)
    assert (error < 3 * SIGMA).mean() > 0.985
    assert np.median(error) < 0.001
    assert model.calibration.sigma_xy == pytest.approx(sigma, rel=0.1)


@pytest.mark.slow
def test_mount_cannot_be_told_from_poses_of_the_laser() -> None:
    rng = np.random.default_rng(12)
    poses, ranges, _ = log(rng, 300, mount=np.zeros(3), terms=planted(rng))
    model = Faces.fit(scans_of(poses, ranges, pose_frame="laser"))
    assert not model.calibration.offset.any() and model.calibration.n_own > 30
    assert model.summary()["mount"] == "not identifiable: the poses are the laser's own"


@pytest.mark.slow
def test_calibration_asked_for_finds_the_one_ray_that_is_off() -> None:
    poses, ranges, _ = log(np.random.default_rng(13), 300)
    ranges[:, 5] += 0.05
    model = Faces.fit(scans_of(poses, ranges), calibrate=True)
    assert model.calibration.n_own == 1
    assert model.calibration.terms.constant[5] == pytest.approx(0.05, abs=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("broken", ["mirrored", "noise", "one scan"])
def test_log_that_makes_no_sense_is_not_calibrated(broken: str) -> None:
    rng = np.random.default_rng(14)
    poses, ranges, _ = log(rng, 200)
    if broken == "mirrored":
        ranges = ranges[:, ::-1]
    elif broken == "noise":
        ranges = rng.uniform(0.2, 9.0, ranges.shape)
    else:
        poses, ranges = poses[:1], ranges[:1]
    model = Faces.fit(scans_of(poses, ranges))
    np.testing.assert_array_equal(model.mount, STATED)
    assert model.calibration.terms.is_none
