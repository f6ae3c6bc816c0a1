"""Splits are the same for building and evaluating; every number equals its plain recomputation."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from hypothesis import given
from hypothesis import strategies as st

from logs.run import RangeSensor, Run
from sensorgraph import graph as graph_module
from sensorgraph.building.build import build
from sensorgraph.building.split import SPLITS, held_out
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.evaluate import evaluate
from sensorgraph.evaluation.metrics import MetricSums
from sensorgraph.loading import load_arena
from sensorgraph.world.raycast import cast

pytestmark = pytest.mark.usefixtures("trusted_scans")

KEYS = [
    "median_m",
    "mae_m",
    "rmse_m",
    "within_0.1m",
    "within_0.5m",
    "within_3sigma",
    "wrong_5cm",
    "pearson_r",
    "chamfer_m",
    "f_score",
    "no_return_recall",
    "no_return_precision",
]
BEARINGS = np.radians([-60.0, -20.0, 10.0, 45.0, 80.0])


def make_run(seed: int = 0, n: int = 300) -> Run:
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 0.1
    poses = np.column_stack([2 + np.cos(t), 2 + np.sin(0.7 * t), np.pi * np.sin(0.31 * t)])
    ranges = 2 + np.abs(np.sin(poses[:, 2:3] + BEARINGS)) * poses[:, 0:1] + 0.03 * rng.normal(size=(n, 5))
    ranges[poses[:, 0] > 2.7, 4] = np.inf
    ranges[rng.random((n, 5)) < 0.02] = np.nan
    ranges[rng.random((n, 5)) < 0.02] = -np.inf
    return Run(
        sensor=RangeSensor(bearings=BEARINGS, sigma=0.02), stamps=t, ranges=ranges, pose_stamps=t, poses=poses
    )


@pytest.fixture(scope="module")
def run() -> Run:
    return make_run()


def test_a_prediction_in_parts_is_that_of_all_and_counts_the_poses(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = build([run], model="polynomial", degree=1, harmonics=1)
    whole = model.predict(run.poses)
    monkeypatch.setattr(graph_module, "POSES_AT_A_TIME", 128)
    shown: list[tuple[int, int]] = []
    parts = model.predict(run.poses, progress=lambda done, total: shown.append((done, total)))
    assert shown == [(0, 300), (128, 300), (256, 300)]
    for name in ("ranges", "mean", "sigma", "p_no_return", "answered"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


@given(st.integers(10, 5000), st.sampled_from(SPLITS))
def test_split_holds_out_its_share_of_distinct_scans(n: int, split: str) -> None:
    held = held_out(n, split)
    assert held.shape == (n,)
    if split == "every10":
        assert np.flatnonzero(held).tolist() == list(range(9, n, 10))
    else:
        length = max(1, round(0.02 * n))
        edges = np.flatnonzero(np.diff(np.r_[0, held.astype(int), 0]))
        assert (edges[1::2] - edges[::2]).tolist() == [length] * 5
        assert held.sum() == 5 * length < n


def test_no_split_holds_out_nothing_and_short_log_is_refused() -> None:
    assert not held_out(5, None).any()
    with pytest.raises(SensorgraphError, match="too few"):
        held_out(5, "block")


@pytest.mark.parametrize("split", ["block", *further("every10")])
def test_held_out_scans_do_not_touch_the_graph_and_are_what_is_evaluated(run: Run, split: str) -> None:
    held = held_out(run, split)
    spoiled = replace(run, ranges=np.where(held[:, None], 0.3, run.ranges))
    graph, other = (
        build([r], split=split, model="polynomial", degree=2, harmonics=2) for r in (run, spoiled)
    )
    np.testing.assert_array_equal(graph.predict(run.poses).mode, other.predict(run.poses).mode)
    result = evaluate(graph, run, split=split)
    np.testing.assert_array_equal(result.scan_indices, np.flatnonzero(held))
    assert result.settings["training"].startswith("held out")
    assert "were trained on" in evaluate(graph, run).settings["training"]
    assert "not seen this run" in evaluate(graph, make_run(1)).settings["training"]


def plain_numbers(graph, run: Run, cap: float, answered_only: bool) -> dict[str, float | None]:
    """Recompute every number ray by ray, scan by scan, in plain Python."""
    p = graph.predict(run.poses)
    errors, pairs, chamfers, scores = [], [], [], []
    nothing = said = both = 0
    for i in range(run.n_scans):
        seen, told = [], []
        for j, bearing in enumerate(BEARINGS):
            r, answered = run.ranges[i, j], p.answered[i, j]
            if answered_only and not answered:
                continue
            if not math.isnan(r):
                nothing += r == math.inf
                said += p.ranges[i, j] == math.inf
                both += r == math.inf and p.ranges[i, j] == math.inf
            if 0.1 < r < cap:
                errors.append(r - p.mode[i, j])
                pairs.append((r, p.mean[i, j]))
                seen.append((r * math.cos(bearing), r * math.sin(bearing)))
                told.append((p.mode[i, j] * math.cos(bearing), p.mode[i, j] * math.sin(bearing)))
        if seen:
            there = [min(math.dist(a, b) for b in told) for a in seen]
            back = [min(math.dist(a, b) for b in seen) for a in told]
            chamfers.append((sum(there) / len(there) + sum(back) / len(back)) / 2)
            recall = sum(d <= 0.1 for d in there) / len(there)
            precision = sum(d <= 0.1 for d in back) / len(back)
            scores.append(2 * recall * precision / (recall + precision) if recall + precision else 0.0)
    size = [abs(e) for e in errors]
    share = lambda limit: sum(e <= limit for e in size) / len(size)  # noqa: E731
    return {
        "median_m": float(np.median(size)),
        "mae_m": sum(size) / len(size),
        "rmse_m": math.sqrt(sum(e * e for e in errors) / len(errors)),
        "within_0.1m": share(0.1),
        "within_0.5m": share(0.5),
        "within_3sigma": share(0.06),
        "wrong_5cm": 1 - share(0.05),
        "pearson_r": float(np.corrcoef(np.array(pairs).T)[0, 1]),
        "chamfer_m": sum(chamfers) / len(chamfers),
        "f_score": sum(scores) / len(scores),
        "no_return_recall": both / nothing if nothing else None,
        "no_return_precision": both / said if said else None,
    }


@pytest.mark.parametrize("cap", [2.9, 8.0])
def test_every_number_equals_its_plain_recomputation(run: Run, cap: float) -> None:
    graph = build([make_run(3, 200)], model="polynomial", degree=2, harmonics=1, n_terms=8)
    result = evaluate(graph, run, cap=cap)
    for block, only in ((result.all, False), (result.answered_only, True)):
        expected = plain_numbers(graph, run, cap, only)
        assert set(KEYS) <= set(block)
        for key in KEYS:
            assert block[key] == pytest.approx(expected[key], abs=1e-12), key
    finite = np.isfinite(run.ranges) & (run.ranges > 0.1) & (run.ranges < cap)
    np.testing.assert_array_equal(np.isfinite(result.residual), finite)
    assert result.n_rays == finite.sum()
    assert result.answered == pytest.approx(result.prediction.answered[finite].mean())
    per_ray = np.sqrt(np.nanmean(result.residual**2, axis=0))
    np.testing.assert_allclose(result.rmse_per_ray, per_ray)


def test_calibration_counts_every_scored_ray_once(run: Run) -> None:
    result = evaluate(build([run], model="polynomial", degree=2, harmonics=1), run)
    assert sum(row["n"] for row in result.calibration) == result.n_rays
    seen = sum(row["seen"] * row["n"] for row in result.calibration) / result.n_rays
    assert seen == pytest.approx(result.all["wrong_5cm"])


@pytest.mark.parametrize("size", [0.003, *further(0.01)])
def test_errors_of_the_poses_are_in_what_the_graph_expects(size: float) -> None:
    """A ray beside an edge shows another surface from a pose that is some millimetres off."""
    arena = load_arena("square")
    sensor = RangeSensor(bearings=np.linspace(-np.pi / 2, np.pi / 2, 91), range_max=12.0, sigma=0.005)

    def drive(n: int, seed: int, *, errors: float) -> Run:
        rng, stamps = np.random.default_rng(seed), np.arange(n) / 10
        x0, y0, x1, y1 = arena.bounds
        poses = rng.uniform([x0, y0, -np.pi], [x1, y1, np.pi], (20 * n, 3))
        poses = poses[arena.contains(poses[:, :2])][:n]
        ranges = cast(arena, poses, sensor).ranges
        ranges = ranges + sensor.sigma * rng.normal(size=ranges.shape)
        poses = poses + errors * rng.normal(size=poses.shape)  # [m, m, rad]
        return Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)

    graph = build([drive(800, 1, errors=0.0)], calibrate=False)
    exact, result = (evaluate(graph, drive(400, 2, errors=errors)) for errors in (0.0, size))
    assert exact.settings["pose_errors"] == {"xy_m": 0.0, "yaw_rad": 0.0}
    found = result.settings["pose_errors"]
    assert found["xy_m"] == pytest.approx(size, rel=0.15) and found["yaw_rad"] == pytest.approx(
        size, rel=0.15
    )
    expected, seen = result.all["wrong_5cm_expected"], result.all["wrong_5cm"]
    assert expected is not None and seen is not None
    assert seen / 1.5 < expected < 1.5 * seen  # without the errors of the poses, a third and less
    inside = result.all["within_3sigma_said"]
    assert inside is not None and inside > 0.99


def test_report_is_json_with_the_promised_keys(run: Run) -> None:
    data = json.loads(
        json.dumps(
            evaluate(build([run], model="polynomial", degree=1, harmonics=1), run).to_dict(), allow_nan=False
        )
    )
    assert {"n_rays", "answered", "all", "answered_only", "calibration", "scored", "point"} <= set(data)
    assert set(KEYS) <= set(data["all"]) and set(KEYS) <= set(data["answered_only"])
    assert data["point"]["mae_m"] == "median" and data["point"]["rmse_m"] == "mean"
    assert data["point"]["within_0.1m"] == "mode"
    one = evaluate(build([run], model="polynomial", degree=1, harmonics=1), run, point="mean").to_dict()
    assert set(one["point"].values()) == {"mean"}


def test_graph_of_base_poses_evaluates_a_run_of_laser_poses(run: Run) -> None:
    mount = np.array([0.3, -0.1, 0.4])
    graph = build([run], model="polynomial", degree=3, harmonics=3)
    c, s = np.cos(run.poses[:, 2]), np.sin(run.poses[:, 2])
    laser = np.column_stack(
        [
            run.poses[:, 0] + 0.3 * c + 0.1 * s,
            run.poses[:, 1] + 0.3 * s - 0.1 * c,
            run.poses[:, 2] + 0.4,
        ]
    )
    sensor = replace(run.sensor, mount=mount)
    there = evaluate(graph, replace(run, sensor=sensor, poses=laser, pose_frame="laser"))
    here = evaluate(graph, run)
    assert there.all["rmse_m"] == pytest.approx(here.all["rmse_m"], rel=1e-9)


def test_nothing_to_score_is_said(run: Run) -> None:
    graph = build([run], model="polynomial", degree=1, harmonics=1)
    with pytest.raises(SensorgraphError, match="nothing to score"):
        evaluate(graph, replace(run, ranges=np.full_like(run.ranges, np.inf)))
    with pytest.raises(SensorgraphError, match="nothing to evaluate"):
        evaluate(graph, replace(run, pose_stamps=np.zeros(0), poses=np.zeros((0, 3))))
    with pytest.raises(SensorgraphError, match="cap"):
        evaluate(graph, run, cap=0.05)


@pytest.mark.parametrize(
    "bearings",
    [np.linspace(-np.pi, np.pi, 40), np.random.default_rng(3).uniform(-6, 6, 40), np.repeat([0.5, -2.0], 20)],
    ids=["full turn, the first ray twice", "in no order", "two bearings"],
)
def test_end_points_are_compared_with_the_nearest_whatever_the_order_of_the_rays(bearings) -> None:
    rng = np.random.default_rng(7)
    seen, told = rng.uniform(0.05, 3.0, (2, 5, 40))
    scored = rng.random((5, 40)) < 0.7
    scored[4] = False
    sums = MetricSums(bearings=bearings, point=None, sigma=0.01)
    sums._add_shape(seen, told, scored)
    ray = np.column_stack([np.cos(bearings), np.sin(bearings)])
    for i in range(4):
        a, b = (values[i, scored[i], None] * ray[scored[i]] for values in (seen, told))
        apart = np.linalg.norm(a[:, None] - b[None], axis=-1)
        there, back = apart.min(axis=1), apart.min(axis=0)
        assert sums.chamfer[i] == pytest.approx((there.mean() + back.mean()) / 2, rel=1e-9)
        recall, precision = (there <= 0.1).mean(), (back <= 0.1).mean()
        assert sums.f_score[i] == pytest.approx(2 * recall * precision / max(recall + precision, 1e-9))
    assert len(sums.chamfer) == 4
