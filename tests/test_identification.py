"""Signals out of runs and tables, scores that know of autocorrelation, and a model that finds what was planted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.run import RangeSensor, Run
from robotmodic_ident import Record
from sensorgraph.errors import SensorgraphError
from sensorgraph.identification.behaviour import track_dimension
from sensorgraph.identification.identify import IdentificationSpec, identify, split_records
from sensorgraph.identification.signals import SignalData, rays_of, signals_of_run, signals_of_table, variable
from sensorgraph.recording.controllers import PolynomialController, controller_named
from sensorgraph.recording.identified_world import ArenaWorld
from sensorgraph.world.drive import react
from sensorgraph.world.robot import Robot, default_robot
from sensorgraph.world.wall_distance import WallDistance

DEGREES = np.radians(np.arange(181.0) - 90.0)


def turning_run(n: int = 60) -> Run:
    """Return a run whose ray i reads i centimetres plus the scan's number, with a command every 0.1 s."""
    stamps = np.arange(n) / 10
    ranges = 0.01 * np.arange(181.0)[None, :] + np.arange(n)[:, None]
    ranges[3, 67], ranges[4, 45:91] = np.inf, np.nan
    poses = np.column_stack([stamps, 2 * stamps, np.full(n, np.pi / 2)])
    return Run(
        sensor=RangeSensor(bearings=DEGREES, range_max=100.0), stamps=stamps, ranges=ranges,
        pose_stamps=stamps, poses=poses,
        odom_stamps=stamps, odometry=poses, odom_twists=np.column_stack([stamps, -stamps]),
        cmd_stamps=stamps, commands=np.column_stack([np.full(n, 0.2), stamps]),
    )  # fmt: skip


def test_rays_are_counted_from_the_robots_right() -> None:
    sensor = RangeSensor(bearings=DEGREES)
    assert rays_of(sensor, "L67").tolist() == [67]
    assert rays_of(sensor, "L45-90").tolist() == list(range(45, 91))
    turned = RangeSensor(bearings=DEGREES, mount=np.array([0.0, 0.0, np.radians(10.0)]))
    assert rays_of(turned, "L67").tolist() == [57]
    with pytest.raises(SensorgraphError, match="from 0° to 180°"):
        rays_of(sensor, "L200")
    with pytest.raises(SensorgraphError, match="L45-90"):
        rays_of(sensor, "L90-45")
    with pytest.raises(SensorgraphError, match="L45-900 spans 855°"):
        rays_of(sensor, "L45-900")


def test_each_ray_of_a_full_turn_has_a_name() -> None:
    sensor = RangeSensor(bearings=np.radians(np.arange(360.0) - 180.0))
    named = [rays_of(sensor, f"L{k}").tolist() for k in range(360)]
    assert named == [[(k + 90) % 360] for k in range(360)]
    assert rays_of(sensor, "L350-370").tolist() == list(range(80, 101))
    assert rays_of(sensor, "L300-315").tolist() == list(range(30, 46))


def test_signals_of_a_run_are_those_at_its_scans() -> None:
    data = signals_of_run(turning_run(), ["L67", "L45-90", "x", "sin_phi", "v", "cmd_omega"], every=2)
    (record,) = data.records
    assert data.period == pytest.approx(0.2)
    assert data.names == {
        "L67": "L67", "L45_90": "L45-90", "x": "x", "sin_phi": "sin_phi", "v": "v", "cmd_omega": "cmd_omega",
    }  # fmt: skip
    k = np.arange(0, 60, 2)
    mean = record.signals["L45_90"]
    assert np.isnan(mean[2])
    np.testing.assert_allclose(np.delete(record.signals["L67"], 2), np.delete(0.67 + k, 2))
    np.testing.assert_allclose(np.delete(mean, 2), np.delete(0.675 + k, 2))
    np.testing.assert_allclose(record.signals["x"], k / 10)
    np.testing.assert_allclose(record.signals["v"], k / 10)
    np.testing.assert_allclose(record.signals["cmd_omega"], k / 10)
    np.testing.assert_allclose(record.signals["sin_phi"], 1.0)
    assert data.held == {"cmd_v": pytest.approx(0.2)}


def test_odometry_is_unknown_in_its_gaps() -> None:
    run = turning_run()
    there = (run.odom_stamps < 1.99) | (run.odom_stamps > 3.99)
    some = replace(
        run,
        odom_stamps=run.odom_stamps[there],
        odometry=run.odometry[there],
        odom_twists=run.odom_twists[there],
    )
    (record,) = signals_of_run(some, ["v", "x"]).records
    assert np.flatnonzero(np.isnan(record.signals["v"])).tolist() == list(range(20, 40))
    assert np.isfinite(record.signals["x"]).all()


def test_no_command_counts_before_it_is_given() -> None:
    run = turning_run()
    late = run.stamps[::20] + 0.03  # every 2 s, as a person steers
    some = replace(run, cmd_stamps=late, commands=np.column_stack([np.zeros(3), np.arange(3.0)]))
    (record,) = signals_of_run(some, ["cmd_omega"]).records
    np.testing.assert_array_equal(record.signals["cmd_omega"][:45], np.repeat([0.0, 1.0, 2.0], [20, 20, 5]))


def test_scans_that_are_unevenly_spaced_or_have_gaps_are_a_note() -> None:
    run = turning_run()
    assert not signals_of_run(run, ["L67"]).notes
    late = np.where(np.arange(run.n_scans) % 2, 0.03, 0.0) + 5.0 * (run.stamps > 3.0)
    uneven, gap = signals_of_run(replace(run, stamps=run.stamps + late), ["L67"]).notes[::-1]
    assert (
        uneven
        == "samples are unevenly spaced (0.54 to 1 of the median step): lags count samples, not seconds"
    )
    assert gap == "1 gap in the scans; no lag crosses it"


def test_no_return_is_not_known() -> None:
    (record,) = signals_of_run(turning_run(), ["L67", "x"]).records
    assert np.flatnonzero(np.isnan(record.signals["L67"])).tolist() == [3, 4]


def test_names_that_a_term_cannot_hold_are_replaced() -> None:
    assert [variable(n) for n in ("L45-90", "speed [m/s]", "cos", "2nd")] == [
        "L45_90", "speed__m_s_", "s_cos", "s_2nd",
    ]  # fmt: skip


def test_records_of_a_table_are_never_joined(tmp_path: Path) -> None:
    rows = [f"{'ab'[k // 5]},{k % 5},{k},{k * k}" for k in range(10)]
    (tmp_path / "data.csv").write_text("record,t,u,speed [m/s]\n" + "\n".join(rows) + "\n")
    data = signals_of_table(tmp_path / "data.csv", ["speed [m/s]", "u"])
    assert [r.signals["u"].tolist() for r in data.records] == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]
    assert data.names["speed__m_s_"] == "speed [m/s]"
    assert data.period == 1.0


@pytest.mark.parametrize(("split", "shares"), [("half", (0.5, 0.5)), ("block", (0.5, 0.5)), ("none", (1, 1))])
def test_a_split_holds_every_sample_once(split: str, shares: tuple[float, float]) -> None:
    record = Record(signals={"y": np.arange(100.0)}, stamps=np.arange(100.0))
    train, test = split_records([record], split)
    assert (sum(map(len, train)), sum(map(len, test))) == (100 * shares[0], 100 * shares[1])
    kept = np.concatenate([r.signals["y"] for r in (train if split == "none" else [*train, *test])])
    assert sorted(kept) == list(range(100))


def planted(n: int = 600) -> SignalData:
    rng = np.random.default_rng(10)
    u, w = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
    y = np.zeros(n)
    for k in range(2, n):
        y[k] = 0.3 + 0.5 * y[k - 1] + 0.8 * u[k - 1] - 0.4 * u[k] * w[k - 2]
    return SignalData(
        records=[Record(signals={"y": y + 0.01 * rng.normal(size=n), "u": u, "w": w})],
        names={"y": "y", "u": "u", "w": "w"}, period=None,
    )  # fmt: skip


def test_a_planted_polynomial_is_found_and_scored() -> None:
    found = identify(
        planted(), IdentificationSpec(output="y", inputs=("u", "w"), output_lags=1, criterion="ebic")
    )
    assert set(found.model.terms.names) == {"1", "y(k-1)", "u(k-1)", "u(k)*w(k-2)"}
    report = found.report()
    assert report["one_step"]["r"] > 0.999
    assert report["free_run"]["r"] > 0.999
    assert report["free_run"]["rmse"] < report["baselines"]["persistence"]["rmse"] / 20
    assert report["noise_terms"] == []
    assert {v["test"] for v in report["validation"]} >= {"e-e", "e-u", "e-w"}
    assert all(0 <= v["p_value"] <= 1 for v in report["validation"])
    assert report["n_train"] == 298  # half of 600, less the look back of 2


def test_noise_lags_take_the_bias_of_moving_average_noise_away() -> None:
    rng = np.random.default_rng(13)
    u, e = rng.uniform(-1, 1, 4000), 0.5 * rng.normal(size=4000)
    y = np.zeros(4000)
    for k in range(1, 4000):
        y[k] = 0.6 * y[k - 1] + 0.9 * u[k - 1] + e[k] + 0.8 * e[k - 1]
    data = SignalData(records=[Record(signals={"y": y, "u": u})], names={"y": "y", "u": "u"}, period=None)
    plain, with_noise = (
        identify(
            data, IdentificationSpec(output="y", inputs=("u",), output_lags=1, degree=1, noise_lags=n)
        ).model
        for n in (0, 1)
    )
    slope = [float(m.theta[m.terms.names.index("y(k-1)")]) for m in (plain, with_noise)]
    assert slope[0] > 0.75
    assert slope[1] == pytest.approx(0.6, abs=0.04)
    assert with_noise.noise_terms.names == ("e(k-1)",)


def test_a_free_run_knows_nothing_of_the_noise_before() -> None:
    rng = np.random.default_rng(12)
    u, e = rng.normal(size=2000), rng.normal(size=2000)
    y = u + np.convolve(e, [1.0, 0.9])[:2000]
    data = SignalData(records=[Record(signals={"u": u, "y": y})], names={"u": "u", "y": "y"}, period=None)
    found = identify(data, IdentificationSpec(output="y", inputs=("u",), lags=0, degree=1, noise_lags=1))
    assert found.scores["one_step"].rmse == pytest.approx(1.0, rel=0.06)
    assert found.scores["free_run"].rmse == pytest.approx(np.sqrt(1 + 0.9**2), rel=0.06)


def test_a_free_run_that_leaves_for_infinity_is_reported_as_such() -> None:
    rng = np.random.default_rng(15)
    y = np.array([0.5 * 1.3 ** (k % 12) for k in range(400)]) + 1e-3 * rng.normal(size=400)
    y[np.arange(400) % 12 == 0] = np.nan
    data = SignalData(records=[Record(signals={"y": y})], names={"y": "y"}, period=None)
    found = identify(data, IdentificationSpec(output="y", inputs=(), output_lags=1, degree=3))
    assert found.scores["one_step"].r > 0.99
    report = found.report()["free_run"]
    assert report["rmse"] is None or report["rmse"] > 0


def test_stretches_shorter_than_the_tested_lags_are_left_out() -> None:
    data = planted(2000)
    values = {name: v.copy() for name, v in data.records[0].signals.items()}
    stamps = np.arange(2000.0)
    stamps[1500:] += 100.0  # a gap, and pieces of 7 samples after it
    stamps[1500:] += 10.0 * (np.arange(500) // 7)
    record = Record(signals=values, stamps=stamps, max_gap=1.5)
    data = SignalData(records=[record], names=data.names, period=1.0)
    found = identify(data, IdentificationSpec(output="y", inputs=("u", "w"), output_lags=1))
    assert {v["max_lag"] for v in found.validation} == {20}


QUESTIONS = {
    "constant output": ({"y": np.ones(90)}, {}, "constant"),
    "too short": ({"y": np.arange(6.0)}, {"lags": 5}, "longest interval"),
    "nothing known": ({"u": np.full(90, np.nan)}, {}, "no known sample"),
    "fewer samples than terms": ({"u": np.r_[np.full(70, np.nan), np.arange(20.0)]}, {}, "u 78 % unknown"),
    "too large": ({}, {"lags": 40, "degree": 4}, "candidate terms"),
}


@pytest.mark.parametrize(("signals", "options", "said"), QUESTIONS.values(), ids=QUESTIONS)
def test_what_cannot_be_answered_is_refused(
    signals: dict[str, np.ndarray], options: dict[str, int], said: str
) -> None:
    n = len(next(iter(signals.values()), np.zeros(90)))
    rng = np.random.default_rng(11)
    values = {"y": rng.normal(size=n), "u": rng.normal(size=n), **signals}
    data = SignalData(records=[Record(signals=values)], names={"y": "y", "u": "u"}, period=None)
    with pytest.raises(SensorgraphError, match=said):
        identify(data, IdentificationSpec(output="y", inputs=("u",), **options))  # type: ignore[arg-type]


def law(readings: np.ndarray) -> tuple[float, float]:
    """Turn right where the wall is far, left where it is near: a controller that is a polynomial."""
    d = float(readings[20:51].mean())
    return 0.12, float(np.clip(0.9 - 1.3 * d + 0.1 * d * d, -0.9, 0.9))


@pytest.fixture(scope="module")
def recorded(room: object) -> tuple[Robot, ArenaWorld, WallDistance, SignalData, np.ndarray]:
    """Return a drive of `law` as signals, with the poses of the drive."""
    robot = default_robot()
    world = ArenaWorld(room, robot, seed=3)  # type: ignore[arg-type]
    clearance = WallDistance(room)  # type: ignore[arg-type]
    seen: list[np.ndarray] = []
    turns: list[float] = []

    def watched(readings: np.ndarray) -> tuple[float, float]:
        command = law(readings)
        seen.append(readings)
        turns.append(command[1])
        return command

    driven = react(watched, world.scan, np.array([1.0, 0.6, 0.0]), 60.0, robot, clearance=clearance)
    near = np.array([r[20:51].mean() for r in seen])
    data = SignalData(
        records=[Record(signals={"cmd_omega": np.array(turns), "L20_50": near})],
        names={"cmd_omega": "cmd_omega", "L20_50": "L20-50"}, period=0.1, held={"cmd_v": 0.12},
    )  # fmt: skip
    return robot, world, clearance, data, driven.poses


def test_a_recorded_polynomial_controller_is_identified_and_drives_the_same_way(
    recorded: tuple[Robot, ArenaWorld, WallDistance, SignalData, np.ndarray],
) -> None:
    robot, world, clearance, data, poses = recorded
    question = IdentificationSpec(output="cmd_omega", inputs=("L20-50",), lags=1, split="none", n_terms=3)
    found = identify(data, question)
    assert dict(zip(found.model.terms.names, found.model.theta, strict=True)) == pytest.approx(
        {"1": 0.9, "L20_50(k)": -1.3, "L20_50(k)^2": 0.1}, abs=1e-6
    )
    steer = PolynomialController(found.model, found.report(), robot, name="law")
    driven = react(steer, world.scan, poses[0], 60.0, robot, clearance=clearance)
    np.testing.assert_allclose(driven.poses, poses, atol=1e-3)  # 60 s closed loop on the same noise


def test_a_model_steps_at_its_own_period(recorded: tuple[Robot, object, object, SignalData, object]) -> None:
    robot, data = recorded[0], recorded[3]
    found = identify(
        data, IdentificationSpec(output="cmd_omega", inputs=("L20-50",), lags=0, split="none", n_terms=2)
    )
    slow = {**found.report(), "period_s": 0.3}
    steer = PolynomialController(found.model, slow, robot, name="slow")
    rng = np.random.default_rng(12)
    commands = [steer(rng.uniform(0.3, 1.0, robot.sensor.n_rays)) for _ in range(9)]
    assert len(set(commands[:3])) == len(set(commands[3:6])) == 1
    assert len(set(commands)) == 3
    with pytest.raises(SensorgraphError, match="multiple"):
        PolynomialController(found.model, {**slow, "period_s": 0.25}, robot, name="odd")


def test_a_scan_without_return_leaves_the_command_in_force(
    recorded: tuple[Robot, object, object, SignalData, object],
) -> None:
    robot, data = recorded[0], recorded[3]
    found = identify(
        data, IdentificationSpec(output="cmd_omega", inputs=("L20-50",), lags=1, split="none", n_terms=3)
    )
    steer = PolynomialController(found.model, found.report(), robot, name="law")
    before = steer(np.full(robot.sensor.n_rays, 0.5))
    assert before == pytest.approx((0.12, 0.9 - 0.65 + 0.025), abs=1e-5)
    assert steer(np.full(robot.sensor.n_rays, np.inf)) == before


def test_a_model_of_poses_is_no_controller() -> None:
    model = identify(planted(), IdentificationSpec(output="y", inputs=("u",))).model
    with pytest.raises(SensorgraphError, match="predicts y"):
        PolynomialController(model, {}, default_robot(), name="m.json")
    with pytest.raises(SensorgraphError, match="expected wall_following"):
        controller_named("sideways", default_robot(), 0)
    with pytest.raises(SensorgraphError, match="does not exist"):
        controller_named("gone.json", default_robot(), 0)


def test_laps_have_dimension_one_and_wandering_has_more() -> None:
    t = np.arange(0, 1500, 0.1)
    rng = np.random.default_rng(14)
    wobble = 0.002 * rng.normal(size=(len(t), 2))
    laps = np.column_stack([2 * np.cos(0.11 * t), 2 * np.sin(0.11 * t)]) + wobble
    value, low, high = track_dimension(t, laps)
    assert value is not None
    assert low is not None
    assert high is not None
    assert low <= 1.0 <= high
    assert value < 1.25
    steps = np.cumsum(0.05 * rng.normal(size=(len(t), 2)), axis=0)
    wander = np.abs((steps + 2.0) % 8.0 - 4.0)  # walls turn it back
    far = track_dimension(t, wander)[0]
    assert far is not None
    assert far > 2.0  # four delays of two coordinates that forget within their 2 s
    assert track_dimension(t[:300], laps[:300]) == (None, None, None)
