"""The model with lags: planted equations come back, the search is the plain one, and no lag crosses a gap."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sensorgraph as sg
from logs.run import RangeSensor, Run
from robotmodic_ident import Moments, Scale, Terms, select
from sensorgraph.building.build import build
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.narmax.candidates import NarmaxForm, ReadingColumns, ReadingScale
from sensorgraph.models.narmax.drawing import DrawnRun
from sensorgraph.models.narmax.model import RayNarmax
from sensorgraph.models.narmax.noise import Stretches
from sensorgraph.models.narmax.search import SharedMoments
from sensorgraph.models.narmax.sequences import ScanSequence, held
from sensorgraph.recording.identified_world import IdentifiedWorld
from sensorgraph.world.robot import default_robot

pytestmark = pytest.mark.usefixtures("trusted_scans")

SENSOR = RangeSensor(bearings=np.radians([-20.0, -10.0, 0.0, 10.0, 20.0]), range_min=0.1, range_max=40.0)
NOISE, SIGMA = 0.6, 0.05
A, B = np.array([0.3, 0.5, 0.1, -0.3, 0.2]), np.array([0.2, -0.2, 0.1, 0.3, -0.1])


def drive(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return poses (n, 3) of a robot that wanders."""
    v = 0.3 + 0.2 * np.sin(np.arange(n) / 7.0) + 0.05 * rng.normal(size=n)
    omega = np.sin(np.arange(n) / 11.0) + 0.3 * rng.normal(size=n)
    phi = np.cumsum(0.1 * omega)
    xy = np.cumsum(0.1 * v[:, None] * np.column_stack([np.cos(phi), np.sin(phi)]), axis=0)
    return np.column_stack([4.0 * np.sin(xy), np.pi - (np.pi - phi) % (2 * np.pi)])


def planted(rng: np.random.Generator, n: int, lost: float = 0.0) -> Run:
    """Make a world of r_i(k) = 10 + 0.5 r_i(k-1) - 0.2 r_j(k-1) + a x(k) + b x(k) y(k) + e(k) + 0.6 e(k-1), where j is next.

    a = 0.3, 0.5, 0.1, -0.3, 0.2 and b = 0.2, -0.2, 0.1, 0.3, -0.1.
    """
    poses = drive(rng, n)
    x, y = poses[:, 0], poses[:, 1]
    e = SIGMA * rng.normal(size=(n, 5))
    r = np.full((n, 5), 14.0)
    for k in range(1, n):
        beside = np.r_[r[k - 1, 1:], 0.0]
        r[k] = 10 + 0.5 * r[k - 1] - 0.2 * beside + A * x[k] + B * x[k] * y[k] + e[k] + NOISE * e[k - 1]
    return of(poses, np.where(rng.random(r.shape) < lost, np.inf, r))


def of(poses: np.ndarray, ranges: np.ndarray) -> Run:
    stamps = 0.1 * np.arange(len(poses))
    return Run(sensor=SENSOR, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)


FORM = {"lags": 2, "degree": 2, "neighbours": 1}


@pytest.fixture(scope="module")
def run() -> Run:
    return planted(np.random.default_rng(3), 1500)


@pytest.fixture(scope="module")
def graph(run: Run) -> Sensorgraph:
    return build([run], model="narmax", **FORM)


def model_of(graph: Sensorgraph) -> RayNarmax:
    assert isinstance(graph.model, RayNarmax)
    return graph.model


def test_planted_lags_neighbours_and_noise_come_back_within_their_intervals(graph: Sensorgraph) -> None:
    model = model_of(graph)
    for ray in range(4):
        names = [model.form.names(ray)[i] for i in model.order[ray] if i >= 0]
        assert {f"r{ray}(k-1)", f"r{ray + 1}(k-1)", "x(k)", "x(k)*y(k)"} <= set(names)
        width = model.readings.width
        for name, truth in ((f"r{ray}(k-1)", 0.5 * width), (f"r{ray + 1}(k-1)", -0.2 * width)):
            at = names.index(name)
            assert abs(model.theta[ray, at] - truth) < 4 * model.stderr[ray, at]
            assert 0 < model.stderr[ray, at] < 0.1
        assert len(names) <= 8  # 5 are planted
        assert abs(model.noise[ray, 0] - NOISE) < 4 * model.noise_stderr[ray, 0]
    assert np.allclose(model.sigma[1], SIGMA, rtol=0.1)  # one step ahead leaves the innovation
    assert np.median(model.tests[:, 0]) > 0.01  # and nothing of it is correlated


def test_equation_names_lags_noise_and_says_what_a_pose_alone_gives(graph: Sensorgraph) -> None:
    text = graph.equation(1)
    for part in (
        "r1(k) = ",
        "*r1(k-1)",
        "*r2(k-1)",
        "*e(k-1)",
        "a pose without history: r1(k)",
        "95 % interval",
    ):
        assert part in text
    assert graph.model.summary()["scans"].startswith("1498 of 1500 fitted, stretches: 1; 2 at the start")


@pytest.mark.parametrize("lost", [0.0, 0.1, 0.7])
def test_batched_search_is_the_plain_search_of_each_ray(lost: float) -> None:
    run = planted(np.random.default_rng(5), 600, lost)
    form = NarmaxForm(lags=2, degree=2, neighbours=1, spacing=1, noise_lags=0, n_terms=12)
    motion = ScanSequence(poses=run.poses, stamps=run.stamps, sequence=np.zeros(run.n_scans, dtype=np.intp))
    ranges = np.where(np.isfinite(run.ranges), run.ranges, np.nan)
    rows = np.flatnonzero(motion.position >= 2)
    scale = Scale.of({"x": run.poses[:, 0], "y": run.poses[:, 1]})
    readings = held(ranges, motion.position)
    columns = ReadingColumns(form, ReadingScale.of(ranges), readings, motion, rows)
    signals = motion.signals(rows, 2)
    moments = SharedMoments(form.shared.matrix(signals, scale), columns, ranges[rows], form)
    centre, width = ReadingScale.of(ranges).centre, ReadingScale.of(ranges).width
    found = list(moments.searches(is_static=False))
    assert len(found) == 5
    for ray in (0, 2, 4):
        has = [j for j, (o, _, _) in enumerate(form.readings) if 0 <= ray + o < 5]
        names = [*form.shared.names, *(form.names(ray)[len(form.shared) + j] for j in has)]
        own = {
            f"r{ray + o}(k-{lag})": (readings[rows - lag, ray + o] - centre) / width
            for o, lag, factor in form.readings
            if not factor and 0 <= ray + o < 5
        }
        plain = Moments(Terms.parse(*names), 1, scale=scale).add(signals | own, ranges[rows, ray])
        selection = select(plain, 12, criterion="ebic", keep=["1"])
        expected = [names[i] for i in selection.chosen(0)]
        assert [form.names(ray)[i] for i in found[ray].order] == expected
        np.testing.assert_allclose(found[ray].err, selection.err[0, : len(expected)], atol=1e-9)


def test_graph_comes_back_bit_for_bit(graph: Sensorgraph, run: Run, tmp_path: Path) -> None:
    graph.save(tmp_path / "a.sensorgraph")
    again = Sensorgraph.load(tmp_path / "a.sensorgraph")
    again.save(tmp_path / "b.sensorgraph")
    assert (tmp_path / "a.sensorgraph").read_bytes() == (tmp_path / "b.sensorgraph").read_bytes()
    assert np.array_equal(graph.predict(run.poses[:50]).ranges, again.predict(run.poses[:50]).ranges)
    assert again.equation(2) == graph.equation(2)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [("order", 9999, "order is"), ("memory", 1.0, "memory is"), ("rows", -1, "rows is")],
)
def test_damaged_arrays_are_refused(graph: Sensorgraph, name: str, value: float, said: str) -> None:
    header, arrays = graph.model.state()
    spoiled = arrays[name].copy()
    spoiled.flat[0] = value
    with pytest.raises(ValueError, match=said):
        RayNarmax.restore(graph.sensor, header, arrays | {name: spoiled})


def halves_of(run: Run, gap: float) -> Run:
    """Let `gap` [s] pass in the middle of a run."""
    stamps = run.stamps + gap * (np.arange(run.n_scans) >= run.n_scans // 2)
    return replace(run, stamps=stamps, pose_stamps=stamps)


def test_no_lag_crosses_a_gap_or_the_border_of_a_run(run: Run) -> None:
    n = run.n_scans
    first, second = (
        replace(
            run, **{name: getattr(run, name)[part] for name in ("stamps", "ranges", "pose_stamps", "poses")}
        )
        for part in (slice(0, n // 2), slice(n // 2, n))
    )
    by_gap = model_of(build([halves_of(run, 5.0)], model="narmax", **FORM))
    by_run = model_of(build([first, second], model="narmax", **FORM))
    assert by_gap.used == {"scans": n, "rows": n - 4, "dropped": 4, "stretches": 2} == by_run.used
    np.testing.assert_allclose(by_gap.theta, by_run.theta, rtol=1e-9, atol=1e-12)
    motion = ScanSequence(
        poses=run.poses, stamps=halves_of(run, 5.0).stamps, sequence=(np.arange(n) >= n // 2).astype(np.intp)
    )
    other = run.ranges.copy()
    other[: n // 2] += 1.0
    rays = np.arange(5)
    for measured in ((run.ranges, other), (None, None)):
        a, b = (by_gap.predict_sequence(motion, rays, m).mode for m in measured)
        assert np.array_equal(a[n // 2 :], b[n // 2 :])


def test_filters_start_anew_in_each_stretch() -> None:
    values = np.random.default_rng(0).normal(size=(10, 2))
    runs = Stretches(np.array([0, 1, 2, 5, 6, 7, 8, 20, 21, 30]))
    out = runs.whitened(np.array([0.5]), values)
    assert np.array_equal(out[[0, 3, 7, 9]], values[[0, 3, 7, 9]])
    np.testing.assert_allclose(out[4], values[4] - 0.5 * values[3])
    assert runs.lagged(values[:, 0], 1)[3] == 0.0


def test_dropouts_that_last_come_back_as_memory() -> None:
    rng = np.random.default_rng(8)
    run = planted(rng, 1500)
    lost = np.zeros(run.ranges.shape, dtype=bool)
    for k in range(1, run.n_scans):
        lost[k] = rng.random(5) < np.where(lost[k - 1], 0.7, 0.1)
    model = model_of(build([replace(run, ranges=np.where(lost, np.inf, run.ranges))], model="narmax", **FORM))
    assert np.allclose(model.memory, 0.6, atol=0.1)
    said = model.predict(run.poses, np.arange(5), "mode").p_no_return
    assert abs(said.mean() - 0.25) < 0.03  # 0.1 / (1 - 0.6)


def test_evaluate_scores_one_step_and_free_run_beside_persistence(graph: Sensorgraph) -> None:
    fresh = planted(np.random.default_rng(99), 400)
    found = sg.evaluate(graph, fresh).to_dict()
    assert found["one_step"]["median_m"] < SIGMA < found["persistence"]["median_m"]
    assert found["one_step"]["median_m"] < found["free_run"]["median_m"] < found["all"]["median_m"]
    assert "one_step" not in sg.evaluate(build([fresh], model="polynomial", degree=1), fresh).to_dict()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"harmonics": 2}, "harmonics is not known to the model narmax; expected lags, degree"),
        ({"lags": 90}, "lags is 90, expected 0 to 20"),
        ({"degree": 7, "lags": 5}, "candidates, expected at most 4000; specify fewer lags"),
    ],
)
def test_options_that_make_no_model_are_named(run: Run, options: dict[str, int], said: str) -> None:
    with pytest.raises(SensorgraphError, match=said):
        build([run], model="narmax", **options)


def test_scans_that_never_follow_each_other_are_refused(run: Run) -> None:
    stamps = np.cumsum(np.where(np.arange(run.n_scans) % 2, 0.1, 9.0))
    with pytest.raises(SensorgraphError, match="no stretch of 5 scans without a gap among 1500"):
        build([replace(run, stamps=stamps, pose_stamps=stamps)], model="narmax")


def test_a_drawn_run_has_the_noise_and_the_lags_of_the_model(graph: Sensorgraph) -> None:
    model = model_of(graph)
    rng = np.random.default_rng(11)
    poses = drive(rng, 500)
    drawn = DrawnRun(model, 0.1)
    readings = np.array([drawn.scan(pose, rng.random(5), rng.normal(size=5)) for pose in poses])
    motion = ScanSequence(poses=poses, stamps=0.1 * np.arange(500), sequence=np.zeros(500, dtype=np.intp))
    said = model.predict_sequence(motion, np.arange(5), readings)
    rest = (readings - said.mode)[50:]
    np.testing.assert_allclose(rest.std(axis=0), model.sigma[1], rtol=0.15)
    alike = [np.corrcoef(rest[1:, ray], rest[:-1, ray])[0, 1] for ray in range(5)]
    assert np.abs(alike).max() < 5 / np.sqrt(450)  # one step ahead nothing is left that could be foreseen
    alone = (readings - model.predict(poses, np.arange(5), "mode").mode)[50:]
    assert min(np.corrcoef(alone[1:, ray], alone[:-1, ray])[0, 1] for ray in range(5)) > 0.3


def test_a_world_of_lags_is_the_same_scan_by_scan_and_together(graph: Sensorgraph) -> None:
    robot = replace(default_robot(), sensor=SENSOR)
    poses = drive(np.random.default_rng(12), 40)
    together = IdentifiedWorld(graph, robot, seed=4).scans(0, poses)
    world = IdentifiedWorld(graph, robot, seed=4)
    np.testing.assert_array_equal(together, [world.scan(k, pose) for k, pose in enumerate(poses)])
    np.testing.assert_array_equal(together, world.scans(0, poses))  # from the start again
    assert (IdentifiedWorld(graph, robot, seed=5).scans(0, poses) != together).all()


def test_without_lags_the_form_says_so(run: Run) -> None:
    still = build([run], model="narmax", lags=0, degree=1, neighbours=1)
    assert still.model.summary()["form"].startswith("degree 1 in pose and twist, without lags: ")
    assert "r1(k-1)" not in still.equation(1)
