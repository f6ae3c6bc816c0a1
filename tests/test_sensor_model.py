"""The graph as a sensor model: densities, quantiles and samples of one distribution, likelihoods that find the pose."""

from __future__ import annotations

import logging
import multiprocessing
import os
from collections.abc import Callable

import numpy as np
import pytest
from conftest import further

import sensorgraph as sg
from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph import sensor_model
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models import MODELS
from sensorgraph.models.base import TrainingScans
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast

SIGMA = 0.01  # [m]
LASER_MODELS = ("faces", "cells", "polynomial", "narmax")


def somewhere(n: int, rng: np.random.Generator) -> Floats:
    """Poses (n, 3) in the left part of the room, off the pillar."""
    return np.column_stack(
        [rng.uniform(0.4, 2.2, n), rng.uniform(0.4, 2.6, n), rng.uniform(-np.pi, np.pi, n)]
    )


def measured(arena: Arena, sensor: RangeSensor, poses: Floats, rng: np.random.Generator) -> Floats:
    ranges = cast(arena, poses, sensor).ranges
    return ranges + SIGMA * rng.normal(size=ranges.shape)


@pytest.fixture(scope="module")
def graphs(room: Arena, sensor: RangeSensor) -> dict[str, Sensorgraph]:
    """A graph of each model of a laser, from the same 400 scans; stretches of two scans suffice for a lag."""
    rng = np.random.default_rng(1)
    poses = somewhere(400, rng)
    stamps = 0.1 * np.arange(400)
    scans = TrainingScans(
        sensor=sensor, poses=poses, ranges=measured(room, sensor, poses, rng), run=np.zeros(400, dtype=np.intp),
        stamps=stamps, sequence=np.arange(400) // 2,
    )  # fmt: skip
    options = {
        "faces": {"calibrate": False, "cells": False},
        "polynomial": {"degree": 3, "harmonics": 2},
        "narmax": {"lags": 1, "degree": 2, "noise_lags": 0},
    }
    return {
        name: Sensorgraph(
            model=MODELS[name].fit(scans, **options.get(name, {})),
            sensor=sensor,
            pose_frame="base_link",
            origin={},
        )
        for name in LASER_MODELS
    }


@pytest.mark.parametrize("name", LASER_MODELS)
def test_distribution_of_a_prediction_is_consistent(graphs: dict[str, Sensorgraph], name: str) -> None:
    graph, poses = graphs[name], somewhere(20, np.random.default_rng(3))
    found = graph.predict(poses)
    low, high = found.interval(0.9)
    np.testing.assert_allclose(found.cdf(high) - found.cdf(low), 0.9, atol=2e-3)
    weights, means, widths, faces = found.components()
    assert weights.shape == means.shape == widths.shape == faces.shape
    single = graph.predict(poses, rays=[7])
    np.testing.assert_allclose(single.quantile(0.5), found.quantile(0.5)[:, [7]])
    ends = found.points()
    start = graph.lasers(poses)[:, None, :2]
    far = np.hypot(*np.moveaxis(ends - start, -1, 0))
    np.testing.assert_allclose(far, np.where(np.isfinite(found.ranges), found.ranges, np.nan), atol=1e-9)


@pytest.mark.parametrize(("name", "coverage"), [("faces", 0.02), ("cells", 0.06)])
def test_intervals_hold_what_they_say(
    graphs: dict[str, Sensorgraph], room: Arena, sensor: RangeSensor, name: str, coverage: float
) -> None:
    """On fresh scans from exact poses."""
    rng = np.random.default_rng(4)
    poses = somewhere(100, rng)
    ranges = measured(room, sensor, poses, rng)
    found = graphs[name].predict(poses)
    for share in (0.5, 0.9, 0.99):
        low, high = found.interval(share)
        inside = ((ranges >= low) & (ranges <= high))[found.answered]
        assert inside.mean() == pytest.approx(share, abs=coverage)


def test_pose_errors_widen_the_distribution(
    graphs: dict[str, Sensorgraph], room: Arena, sensor: RangeSensor
) -> None:
    """Readings from poses that are 2 cm off are within 90 % intervals of the graph that knows it, and of no other."""
    rng = np.random.default_rng(8)
    poses = somewhere(200, rng)
    ranges = measured(room, sensor, poses, rng)
    off = poses + rng.normal(size=poses.shape) * [0.02, 0.02, 0.003]

    def inside(graph: Sensorgraph) -> float:
        found = graph.predict(off)
        low, high = found.interval(0.9)
        return float(((ranges >= low) & (ranges <= high))[found.answered].mean())

    graph = graphs["faces"]
    assert inside(graph.with_pose_errors(0.02, 0.003)) == pytest.approx(0.9, abs=0.03)
    assert inside(graph) < 0.7


@pytest.mark.parametrize("name", LASER_MODELS)
def test_likelihood_is_highest_at_the_true_pose(
    graphs: dict[str, Sensorgraph], room: Arena, sensor: RangeSensor, name: str
) -> None:
    rng = np.random.default_rng(6)
    pose = np.array([1.2, 1.4, 0.7])
    scan = measured(room, sensor, pose[None], rng)[0]
    others = pose + rng.uniform(-1, 1, (200, 3)) * [0.5, 0.5, 1.0]
    found = graphs[name].log_likelihood(scan, np.vstack([pose, others]))
    assert found.shape == (201,)
    near = 0.2 if name == "narmax" else 0.06  # [m] of degree 2, without harmonics
    assert np.argmax(found) == 0 or np.abs(others[np.argmax(found) - 1] - pose)[:2].max() < near


def test_sum_of_rays_and_threads_and_one_pose_for_each_ray_agree(graphs: dict[str, Sensorgraph]) -> None:
    graph = graphs["faces"]
    poses = somewhere(150, np.random.default_rng(7))  # several tasks of threads
    scan = graph.predict(poses[:1]).ranges[0]
    found = graph.log_likelihood(scan, poses)
    each = graph.log_likelihood(scan, poses, per_ray=True)
    np.testing.assert_allclose(each.sum(axis=1), found)
    alone = [graph.log_likelihood(scan, pose)[0] for pose in poses[::50]]
    np.testing.assert_allclose(found[::50], alone)
    swept = np.repeat(poses[:5, None], graph.sensor.n_rays, axis=1)
    np.testing.assert_allclose(graph.log_likelihood(scan, swept), found[:5])
    some = graph.log_likelihood(scan, poses[:5], rays=[3, 9])
    np.testing.assert_allclose(some, each[:5, [3, 9]].sum(axis=1))


@pytest.mark.parametrize("name", LASER_MODELS)
def test_tables_around_one_pose_hold_its_likelihood(graphs: dict[str, Sensorgraph], name: str) -> None:
    graph, pose = graphs[name], np.array([[1.2, 1.4, 0.7]])
    scan = graph.predict(pose).ranges[0]
    scan[[3, 9, 20]] = np.inf, np.nan, -np.inf
    near = graph.near(scan, pose, unanswered="skip")
    each = graph.log_likelihood(scan, pose, per_ray=True, unanswered="skip")[0]
    each[9] = 0.0  # a broken reading counts nothing
    for ray in range(graph.sensor.n_rays):
        assert near.log_likelihood(pose, np.array([ray]))[0] == pytest.approx(each[ray], abs=1e-6)


@pytest.mark.parametrize("name", ["faces", "cells"])
def test_tables_rank_near_poses_as_casts_do(
    graphs: dict[str, Sensorgraph], room: Arena, sensor: RangeSensor, name: str
) -> None:
    rng = np.random.default_rng(10)
    pose = np.array([1.2, 1.4, 3.1])  # headings on both sides of pi
    scan = measured(room, sensor, pose[None], rng)[0]
    poses = pose + rng.normal(size=(200, 3)) * [0.03, 0.03, 0.02]
    found, exact = (
        function(scan, poses, correlated=False)
        for function in (lambda *a, **k: graphs[name].near(*a, **k).log_likelihood(poses), graphs[name].log_likelihood)
    )  # fmt: skip
    assert np.corrcoef(found, exact)[0, 1] > 0.98
    assert np.std(found - exact) < 0.2 * np.std(exact)


def test_unanswered_rays_count_broad_or_not_at_all(graphs: dict[str, Sensorgraph]) -> None:
    graph = graphs["faces"]
    outside = np.array([[3.6, 0.5, 0.0], [1.0, 1.0, 0.0], [20.0, 0.0, 0.0]])
    scan = np.full(graph.sensor.n_rays, 1.0)
    broad = graph.log_likelihood(scan, outside, per_ray=True)[2]
    np.testing.assert_allclose(broad, graph.unknown_space.log_likelihood(np.array(1.0), graph.sensor))
    assert (graph.log_likelihood(scan, outside, per_ray=True, unanswered="skip")[2] == 0).all()


def test_readings_of_unknown_space_have_a_probability_of_one_and_the_median_of_known_space(
    graphs: dict[str, Sensorgraph],
) -> None:
    graph = graphs["faces"]
    space, sensor = graph.unknown_space, graph.sensor
    z = np.linspace(0.0, sensor.range_max, 100_001)
    density = np.exp(space.log_likelihood(z, sensor))
    none, too_close = np.exp(space.log_likelihood(np.array([np.inf, -np.inf]), sensor))
    inside = np.trapezoid(density, z)
    assert inside + none == pytest.approx(1.0, abs=1e-3)
    assert too_close == pytest.approx(
        np.trapezoid(density[z < sensor.range_min], z[z < sensor.range_min]), abs=1e-3
    )
    poses = somewhere(400, np.random.default_rng(3))
    ranges = graph.predict(poses).ranges
    assert np.median(ranges[np.isfinite(ranges)]) == pytest.approx(
        space.median, rel=0.4
    )  # the crossed space is larger


@pytest.mark.parametrize("name", ["faces", *further("cells")])
def test_samples_have_the_distribution(graphs: dict[str, Sensorgraph], name: str) -> None:
    graph, poses = graphs[name], somewhere(6, np.random.default_rng(9))
    drawn = graph.sample(poses, 200, seed=3)
    assert drawn.shape == (200, 6, graph.sensor.n_rays)
    np.testing.assert_array_equal(drawn[:2], graph.sample(poses, 2, seed=3))
    found = graph.predict(poses)
    below = (drawn < found.quantile(0.5)).mean(axis=0)[found.answered]
    assert below.mean() == pytest.approx(0.5, abs=0.05)
    # each ray has its own distribution: shares below quantiles scatter as binomial ones do
    n, step = len(drawn), 0.5 * graph.sensor.resolution
    for q in (0.1, 0.3, 0.7, 0.9):
        share = (drawn <= found.quantile(q) + step).mean(axis=0)
        expected = found.cdf(found.quantile(q) + step) * (1.0 - found.p_no_return)
        z = (share - expected) / np.sqrt(q * (1.0 - q) / n)
        assert np.sqrt(np.mean(z[found.answered] ** 2)) < 1.25


BAD = {
    "millimetres": (lambda scan: 1000 * scan, [1.0, 1.0, 0.0], "divide millimetres by 1000"),
    "another sensor": (lambda scan: scan[:-1], [1.0, 1.0, 0.0], "a scan has 60 ranges, expected the 61 rays"),
    "outside": (lambda scan: scan, [90.0, 1.0, 0.0], "all poses are outside the map, the first at (90.10, 1.02)"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_bad_input_is_one_line(graphs: dict[str, Sensorgraph], kind: str) -> None:
    change, pose, words = BAD[kind]
    scan = np.full(61, 1.0)
    with pytest.raises(SensorgraphError) as error:
        graphs["faces"].log_likelihood(change(scan), np.array([pose]))  # type: ignore[no-untyped-call]
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_one_pose_no_pose_and_masked_numbers(graphs: dict[str, Sensorgraph]) -> None:
    scan, pose = np.full(61, 1.0), np.array([1.0, 1.0, 0.3])
    for graph in graphs.values():
        np.testing.assert_array_equal(graph.predict(pose).ranges, graph.predict(pose[None]).ranges)
        nowhere = np.zeros((0, 3))
        assert graph.predict(nowhere).quantile(0.5).shape == graph.predict(nowhere).ranges.shape == (0, 61)
        assert graph.log_likelihood(scan, nowhere).shape == (0,)
        assert graph.sample(nowhere, 2).shape == (2, 0, 61)
    hidden = np.ma.masked_array(np.where(np.arange(61) < 30, 0.2, scan), mask=np.arange(61) < 30)
    found = graphs["faces"].log_likelihood(hidden, pose)
    np.testing.assert_allclose(found, graphs["faces"].log_likelihood(hidden.filled(np.nan), pose))


def test_a_mask_chooses_rays_and_other_indices_are_refused(graphs: dict[str, Sensorgraph]) -> None:
    graph, pose = graphs["faces"], np.array([1.0, 1.0, 0.3])
    mask = np.isin(np.arange(61), [3, 9])
    np.testing.assert_array_equal(
        graph.predict(pose, rays=mask).ranges, graph.predict(pose, rays=[3, 9]).ranges
    )
    for rays, words in (
        ([1.5], "whole numbers from 0 to 60"), ([], "whole numbers"), (3, "whole numbers"), ([61], "ray 61 does not exist"),
        ([-1], "ray -1"), (mask[:10], "chooses 2 of 10"), (["a"], "whole numbers"),
    ):  # fmt: skip
        with pytest.raises(SensorgraphError, match=words):
            graph.predict(pose, rays=rays)  # type: ignore[arg-type]


def test_wrong_arguments_are_one_line(graphs: dict[str, Sensorgraph]) -> None:
    graph, pose = graphs["faces"], np.array([[1.0, 1.0, 0.3]])
    found = graph.predict(pose)
    calls: dict[str, Callable[[], object]] = {
        "q is 2, expected": lambda: found.quantile(2.0),
        "`n` is -1, expected a whole number": lambda: graph.sample(pose, -1),
        "`n` is 1.5": lambda: graph.sample(pose, 1.5),  # type: ignore[arg-type]
        "`seed` is -1": lambda: graph.sample(pose, 1, -1),
        "did you mean `correlated`": lambda: graph.log_likelihood(np.ones(61), pose, corelated=False),  # type: ignore[call-arg]
        "did you mean `rays`": lambda: graph.predict(pose, ray=[1]),  # type: ignore[call-arg]
        "ranges of type list holds no real numbers": lambda: graph.log_likelihood(["a"] * 61, pose),
        "poses of type str": lambda: graph.predict("here"),  # type: ignore[arg-type]
    }
    for words, call in calls.items():
        with pytest.raises(ValueError, match=words) as error:
            call()
        assert "\n" not in str(error.value)
    for function in (found.cdf, found.pdf):
        assert np.isnan(function(np.nan)).all()


def test_broken_readings_count_nothing(graphs: dict[str, Sensorgraph]) -> None:
    scan = np.full(61, np.nan)
    np.testing.assert_array_equal(
        graphs["faces"].log_likelihood(scan, somewhere(3, np.random.default_rng(1))), 0.0
    )


def test_a_sweep_with_one_pose_warns_once(
    graphs: dict[str, Sensorgraph], caplog: pytest.LogCaptureFixture
) -> None:
    from dataclasses import replace

    sensor_model.warn_of_sweep.cache_clear()
    graph = graphs["faces"]
    swept = replace(graph, sensor=replace(graph.sensor, sweep_time=0.05))
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            swept.log_likelihood(np.full(61, 1.0), np.array([[1.0, 1.0, 0.0]]))
    assert sum("pass a pose for each ray" in message for message in caplog.messages) == 1


@pytest.mark.filterwarnings("ignore:This process.*multi-threaded:DeprecationWarning")
def test_likelihood_in_a_forked_process(graphs: dict[str, Sensorgraph]) -> None:
    """The threads of the parent do not exist there, so waiting for them would never end."""
    graph, poses = graphs["faces"], somewhere(200, np.random.default_rng(1))
    scan = graph.predict(poses[0]).median[0]
    here = graph.log_likelihood(scan, poses)
    receiver, sender = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(
        target=lambda: sender.send(graph.log_likelihood(scan, poses))
    )
    child.start()
    try:
        assert receiver.poll(20.0), "the process did not answer"
        np.testing.assert_array_equal(receiver.recv(), here)
    finally:
        child.kill()
        child.join()


def test_likelihood_where_the_system_knows_no_affinity(
    graphs: dict[str, Sensorgraph], monkeypatch: pytest.MonkeyPatch
) -> None:
    graph, poses = graphs["faces"], somewhere(200, np.random.default_rng(1))
    scan = np.full(61, 1.0)
    here = graph.log_likelihood(scan, poses)
    sensor_model._threads.cache_clear()
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)  # as on macOS
    np.testing.assert_array_equal(graph.log_likelihood(scan, poses), here)


def test_a_prediction_is_one_line(graphs: dict[str, Sensorgraph]) -> None:
    assert repr(graphs["faces"].predict(np.array([[1.0, 1.0, 0.0]]))).startswith(
        "Prediction: 1 pose × 61 rays, "
    )
    assert sg.load is not None
