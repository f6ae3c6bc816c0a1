"""The polynomial model: planted worlds come back, and it knows where it has been."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import further

from logs.run import RangeSensor, Run
from sensorgraph.building.build import build as build_any
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models import MODELS

pytestmark = pytest.mark.usefixtures("trusted_scans")

BEARINGS = np.radians(np.linspace(-90, 90, 19))
build = partial(build_any, model="polynomial")
FORM = {"degree": 2, "harmonics": 1, "n_terms": 18}


def run_at(poses: np.ndarray, ranges: np.ndarray, bearings: np.ndarray = BEARINGS, **sensor: float) -> Run:
    """Make a run whose scans and poses have the same stamps."""
    stamps = np.arange(len(poses)) * 0.1
    return Run(
        sensor=RangeSensor(bearings=bearings, **sensor),
        stamps=stamps,
        ranges=ranges,
        pose_stamps=stamps,
        poses=poses,
    )


def poses_in(rng: np.random.Generator, n: int, x: tuple[float, float], y: tuple[float, float]) -> np.ndarray:
    return np.column_stack([rng.uniform(*x, n), rng.uniform(*y, n), rng.uniform(-np.pi, np.pi, n)])


def room(poses: np.ndarray, bearings: np.ndarray = BEARINGS, size: float = 4.0) -> np.ndarray:
    """Cast rays inside a square room with a corner at the origin."""
    angle = poses[:, 2:3] + bearings
    c, s = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore"):
        to_x = np.abs((np.where(c > 0, size, 0.0) - poses[:, 0:1]) / c)
        to_y = np.abs((np.where(s > 0, size, 0.0) - poses[:, 1:2]) / s)
    return np.minimum(to_x, to_y)


def planted(poses: np.ndarray) -> np.ndarray:
    """Give a world where every ray is exactly a polynomial of degree 2 with one harmonic."""
    x, y, phi = poses.T[:, :, None]
    i = np.arange(len(BEARINGS))
    return 3 + 0.1 * i * x + 0.2 * x * y * np.cos(phi) - 0.1 * y**2 * np.sin(phi) + 0.02 * i


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.fixture(scope="module")
def square() -> tuple[Run, Sensorgraph]:
    rng = np.random.default_rng(1)
    poses = poses_in(rng, 2500, (0.3, 3.7), (0.3, 3.7))
    run = run_at(poses, room(poses) + 0.01 * rng.normal(size=(2500, 19)))
    return run, build([run], degree=4, harmonics=4, n_terms=60)


def test_planted_polynomial_world_is_recovered_exactly(rng) -> None:
    poses = poses_in(rng, 400, (0, 4), (0, 4))
    graph = build([run_at(poses, planted(poses), range_max=20.0)], **FORM)
    fresh = poses_in(rng, 200, (0.2, 3.8), (0.2, 3.8))
    np.testing.assert_allclose(graph.predict(fresh).ranges, planted(fresh), atol=1e-9)


def test_planted_degree_and_harmonic_are_chosen_automatically(rng) -> None:
    poses = poses_in(rng, 1500, (0, 4), (0, 4))
    noisy = planted(poses) + 0.05 * rng.normal(size=(1500, 19))
    graph = build([run_at(poses, noisy, range_max=20.0)])
    choice = graph.model.form
    assert (choice.degree, choice.harmonics) == (2, 1)
    # centred, they are 1, x, (xy, x, y, 1) cos, (y^2, y, 1) sin: nine; noise may let in one or two
    assert 8 <= choice.n_terms <= 11


def test_missing_returns_of_one_ray_change_no_other_ray(rng) -> None:
    poses = poses_in(rng, 600, (0, 4), (0, 4))
    ranges = planted(poses)
    holed = ranges.copy()
    holed[rng.random(600) < 0.4, 3] = np.nan
    holed[rng.random(600) < 0.2, 3] = -np.inf
    whole = build([run_at(poses, ranges, range_max=20.0)], **FORM).predict(poses)
    partly = build([run_at(poses, holed, range_max=20.0)], **FORM).predict(poses)
    others = np.arange(19) != 3
    np.testing.assert_allclose(partly.ranges[:, others], whole.ranges[:, others], atol=1e-10)
    np.testing.assert_allclose(partly.ranges[:, 3], whole.ranges[:, 3], atol=1e-8)
    assert partly.p_no_return[:, 3].max() < 0.01  # broken and too close are not "nothing seen"


def test_nothing_seen_where_the_world_is_open(rng) -> None:
    poses = poses_in(rng, 3000, (0, 8), (0, 4))
    ranges = planted(poses)
    ranges[poses[:, 0] > 5, 7] = np.inf
    graph = build([run_at(poses, ranges, range_max=20.0)], degree=5, harmonics=1, n_terms=30)
    fresh = poses_in(rng, 500, (0.3, 7.7), (0.3, 3.7))
    clear = np.abs(fresh[:, 0] - 5) > 0.7  # a polynomial rounds the step
    said = np.isposinf(graph.predict(fresh, rays=[7]).ranges[:, 0])
    np.testing.assert_array_equal(said[clear], fresh[clear, 0] > 5)
    assert not np.isposinf(graph.predict(fresh, rays=[6]).ranges).any()


def test_ray_that_never_returned_is_told_as_nothing_and_broken_ray_is_not_answered(rng) -> None:
    poses = poses_in(rng, 300, (0, 4), (0, 4))
    ranges = planted(poses)
    ranges[:, 0], ranges[:, 1] = np.inf, np.nan
    out = build([run_at(poses, ranges, range_max=20.0)], **FORM).predict(poses)
    assert np.isposinf(out.ranges[:, 0]).all() and out.p_no_return[:, 0].min() > 0.99
    assert not out.answered[:, 1].any()
    assert out.answered[:, 0].mean() > 0.99 and out.answered[:, 2].mean() > 0.99


@pytest.mark.parametrize("offset", [(1e5, -1e5), *further(((-3e4, 7.0),))])
def test_offset_of_the_map_changes_no_prediction(square, offset) -> None:
    run, graph = square
    shift = np.array([*offset, 0.0])
    moved = build([replace(run, poses=run.poses + shift)], degree=4, harmonics=4, n_terms=60)
    poses = run.poses[:500]
    a, b = graph.predict(poses), moved.predict(poses + shift)
    np.testing.assert_allclose(
        a.ranges, b.ranges, atol=1e-7
    )  # float64 at 1e5 m: 1.5e-11 m, times the condition
    np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-6)
    assert (a.answered == b.answered).mean() > 0.995  # cells are cut at a rounded corner


def test_turning_robot_and_bearings_moves_each_equation_to_another_ray(rng) -> None:
    step = float(np.diff(BEARINGS)[0])
    poses = poses_in(rng, 1500, (0.3, 3.7), (0.3, 3.7))
    turned = poses - np.array([0, 0, step])  # ray i + 1 now looks where ray i looked
    form = {"degree": 3, "harmonics": 3, "n_terms": 70}
    a = build([run_at(poses, room(poses))], **form).predict(poses)
    b = build([run_at(turned, room(turned))], **form).predict(turned)
    np.testing.assert_allclose(a.ranges[:, :-1], b.ranges[:, 1:], atol=1e-6)


def test_square_room_is_predicted_and_answered_where_the_robot_drove(square) -> None:
    _, graph = square
    fresh = poses_in(np.random.default_rng(2), 2000, (0.35, 3.65), (0.35, 3.65))
    out = graph.predict(fresh)
    residual = out.mode - room(fresh)
    assert np.median(np.abs(residual)) < 0.12
    assert out.answered.mean() > 0.995
    said = np.sqrt((out.sigma**2).mean())
    assert said == pytest.approx(np.sqrt((residual**2).mean()), rel=0.1)
    assert out.p_off.mean() == pytest.approx((np.abs(residual) > 0.05).mean(), abs=0.03)


def test_right_half_is_not_answered_after_training_on_the_left(rng) -> None:
    left = poses_in(rng, 1500, (0.3, 1.9), (0.3, 3.7))
    graph = build([run_at(left, room(left))], degree=3, harmonics=3, n_terms=40)
    inside = poses_in(rng, 500, (0.35, 1.85), (0.35, 3.65))
    right = poses_in(rng, 500, (2.5, 3.7), (0.3, 3.7))
    assert graph.predict(inside).answered.mean() > 0.995
    assert not graph.predict(right).answered.any()


def test_unseen_heading_is_not_answered_unless_the_sensor_sees_all_around(rng) -> None:
    poses = poses_in(rng, 1500, (0.3, 3.7), (0.3, 3.7))
    poses[:, 2] = rng.uniform(-0.5, 0.5, 1500)
    back = poses[:100] + np.array([0, 0, np.pi])
    form = {"degree": 2, "harmonics": 1, "n_terms": 10}
    assert not build([run_at(poses, room(poses))], **form).predict(back).answered.any()


def test_prediction_stays_within_the_sensors_limits(square) -> None:
    run, graph = square
    far = graph.predict(np.array([[50.0, -80.0, 1.0]]))
    assert (far.mode >= run.sensor.range_min).all() and (far.mode <= run.sensor.range_max).all()
    assert not far.answered.any()


def test_rays_asked_for_are_the_same_columns(square) -> None:
    run, graph = square
    all_rays, some = graph.predict(run.poses[:50]), graph.predict(run.poses[:50], rays=[7, 2])
    for name in ("ranges", "sigma", "p_no_return", "p_off", "answered"):
        np.testing.assert_allclose(getattr(some, name), getattr(all_rays, name)[:, [7, 2]], rtol=1e-12)


def test_equation_printed_in_metres_is_what_is_predicted(square) -> None:
    from robotmodic_ident import Terms

    run, graph = square
    text = graph.equation(4).splitlines()[1]
    body = text.removeprefix("r4 = ").split("   [m")[0].replace(" - ", " + -").split(" + ")
    total = np.zeros(20)
    columns = dict(zip(("x", "y", "phi"), run.poses[:20].T, strict=True))
    for part in body:
        sign, part = (-1.0, part[1:]) if part.startswith("-") else (1.0, part)
        head, _, rest = part.partition("*")
        try:
            weight, name = float(head), rest or "1"
        except ValueError:
            weight, name = 1.0, part
        total += sign * weight * Terms.parse(name).matrix(columns, n=20)[:, 0]
    np.testing.assert_allclose(total, graph.predict(run.poses[:20], rays=[4]).mode[:, 0], atol=1e-4)


@pytest.mark.parametrize("name", MODELS)
def test_every_model_survives_its_file_bit_for_bit(name: str, square, tmp_path: Path) -> None:
    whole, _ = square
    run = run_at(whole.poses[:150], whole.ranges[:150])
    options = {"cell": 0.2} if name == "cells" else {}
    graph = build_any([run], model=name, **options)
    graph.save(tmp_path / "a.sensorgraph")
    again = Sensorgraph.load(tmp_path / "a.sensorgraph")
    for field in ("ranges", "median", "mean", "sigma", "p_no_return", "p_off", "answered"):
        a, b = (getattr(g.predict(run.poses[:99]), field) for g in (graph, again))
        np.testing.assert_array_equal(a, b)
    assert again.equation(3) == graph.equation(3)
    again.save(str(tmp_path / "b.sensorgraph"))
    assert Sensorgraph.load(str(tmp_path / "b.sensorgraph")).sensor.n_rays == again.sensor.n_rays
    build_any([run], model=name, **options).save(tmp_path / "c.sensorgraph")
    first = (tmp_path / "a.sensorgraph").read_bytes()
    assert first == (tmp_path / "b.sensorgraph").read_bytes() == (tmp_path / "c.sensorgraph").read_bytes()
    assert not list(tmp_path.glob("*.part"))


def test_two_runs_are_fitted_together(rng) -> None:
    poses = poses_in(rng, 800, (0, 4), (0, 4))
    first, second = (run_at(p, planted(p), range_max=20.0) for p in (poses[:300], poses[300:]))
    graph = build([first, second], **FORM)
    whole = build([run_at(poses, planted(poses), range_max=20.0)], **FORM)
    np.testing.assert_allclose(graph.predict(poses).ranges, whole.predict(poses).ranges, atol=1e-9)
    assert [entry["trained"] for entry in graph.origin["inputs"]] == [300, 500]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"runs": []}, "no run"),
        ({"model": "neural"}, "expected one of .*polynomial"),
        ({"split": "random"}, "expected one of every10, block"),
        ({"degree": -1}, "degree is -1"),
        ({"depth": 3}, "option depth is not known"),
    ],
)
def test_what_cannot_be_built_is_said_in_one_line(square, change: dict, words: str) -> None:
    arguments = {"runs": [square[0]], **change}
    with pytest.raises(SensorgraphError, match=words) as caught:
        build(arguments.pop("runs"), **arguments)
    assert "\n" not in str(caught.value)


def test_runs_of_other_sensors_or_frames_are_refused(rng) -> None:
    poses = poses_in(rng, 50, (0, 4), (0, 4))
    run = run_at(poses, planted(poses), range_max=20.0)
    fewer = run_at(poses, planted(poses)[:, :9], bearings=BEARINGS[:9], range_max=20.0)
    with pytest.raises(SensorgraphError, match="other bearings"):
        build([run, fewer], **FORM)
    with pytest.raises(SensorgraphError, match="one frame"):
        build([run, replace(run, pose_frame="laser")], **FORM)


def test_scans_without_pose_are_counted_and_too_few_is_an_error(rng) -> None:
    poses = poses_in(rng, 200, (0, 4), (0, 4))
    run = run_at(poses, planted(poses), range_max=20.0)
    late = replace(run, pose_stamps=run.pose_stamps[50:], poses=poses[50:])
    entry = build([late], **FORM).origin["inputs"][0]
    assert entry["dropped"] == {"before the first pose": 50} and entry["trained"] == 150
    with pytest.raises(SensorgraphError, match="without any pose"):
        build([replace(run, pose_stamps=np.zeros(0), poses=np.zeros((0, 3)))], **FORM)


@pytest.mark.parametrize("damage", ["text", "cut", "newer", "other zip", "wrong shape", "flipped"])
def test_file_that_is_no_sensorgraph_is_told_in_one_line(square, tmp_path: Path, damage: str) -> None:
    import io
    import zipfile

    path = tmp_path / "g.sensorgraph"
    square[1].save(path)
    data = path.read_bytes()
    if damage == "text":
        path.write_text("x,y,phi\n")
    elif damage == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif damage == "flipped":
        middle = len(data) // 2
        path.write_bytes(data[:middle] + bytes([data[middle] ^ 255]) + data[middle + 1 :])
    else:
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                content = old.read(name)
                if damage == "other zip" and name == "header.json":
                    continue
                if damage == "newer" and name == "header.json":
                    content = content.replace(b'"version": 1', b'"version": 99')
                if damage == "wrong shape" and name == "theta.npy":
                    buffer = io.BytesIO()
                    np.save(buffer, np.zeros((2, 2)))
                    content = buffer.getvalue()
                new.writestr(name, content)
    with pytest.raises(SensorgraphError, match="sensorgraph") as caught:
        Sensorgraph.load(path)
    assert "\n" not in str(caught.value)
