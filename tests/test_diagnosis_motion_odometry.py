"""Odometry channel: silent on nothing, right on wheels, patches and clocks, frank about what it lacks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import further
from diagnosis_samples import ROBOT, make_run, without_odometry

from logs.run import Run
from planners.arena import wrap
from planners.types import Floats
from sensorgraph.diagnosis.motion import whitening
from sensorgraph.diagnosis.motion.odometry_channel import aligned_rows, diagnose_odometry
from sensorgraph.diagnosis.motion.structure_test import StructureFamily, StructureTest
from sensorgraph.diagnosis.motion.wheel_rows import motion_signals, rows_at
from sensorgraph.diagnosis.motion.wheel_structure import odometry_families
from sensorgraph.diagnosis.motion.whitening import WhiteningFilter

PLANTED: list[tuple[str, dict[str, Any], dict[str, float]]] = [
    ("wheel_radius_diff", {"diff": 0.012}, {"s": 0.012}),
    ("wheel_radius", {"radius": 0.02}, {"s": 0.02}),
    ("wheel_base", {"base": -0.025}, {"s": -0.025}),
    ("pose_clock_offset", {"clock": 0.04}, {"tau": 0.04}),
]


@pytest.mark.parametrize("seed", [1, *further(2)])
@pytest.mark.parametrize("memory", [0.9, *further(0.0)])
def test_nothing_planted_nothing_named(memory: float, seed: int) -> None:
    result = diagnose_odometry(make_run(seed, memory=memory), ROBOT)
    assert result.effects == () and result.unknown is None and result.skipped == ""


@pytest.mark.parametrize(
    ("name", "effect", "truth"), [PLANTED[0], *further(*PLANTED[1:])], ids=[name for name, _, _ in PLANTED]
)
def test_planted_effect_is_named_with_its_size(
    name: str, effect: dict[str, Any], truth: dict[str, float]
) -> None:
    result = diagnose_odometry(make_run(3, **effect), ROBOT)
    assert [a.name for a in result.effects] == [name] and result.unknown is None
    for key, value in truth.items():
        assert abs(result.effects[0][key] - value) < 3 * result.effects[0].stderr[key]
    assert result.gap is not None and result.gap.after.rmse_m < result.gap.before.rmse_m


@pytest.mark.parametrize(
    "track", [ROBOT.wheels.base, *further(0.0)], ids=["each wheel slips", "the body slips"]
)
def test_slippery_patch_is_found_where_it_is(track: float) -> None:
    run = make_run(4)
    moving = run.poses[600]
    run = make_run(4, slip=(0.3, moving[0], moving[1], 0.5), track=track)
    result = diagnose_odometry(run, ROBOT)
    assert [a.name for a in result.effects] == ["wheel_slip"]
    assert result.unknown is None
    found = result.effects[0]
    assert abs(found["s"] - 0.3) < max(3 * found.stderr["s"], 0.03)
    assert np.hypot(found["x"] - moving[0], found["y"] - moving[1]) < 0.3  # place, as the issue asks


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, *further(5)])
def test_the_same_floor_does_not_slip_twice(seed: int) -> None:
    """Poses that a filter has smoothed, as those of a localization, blur the rim of a patch: no second one mends it."""
    spot, window = make_run(seed).poses[600], 9
    run = make_run(seed, slip=(0.3, spot[0], spot[1], 0.5), track=ROBOT.wheels.base)
    poses = np.column_stack([run.poses[:, :2], np.unwrap(run.poses[:, 2])])
    wide = np.pad(poses, ((window // 2, window // 2), (0, 0)), "edge")
    smooth = np.column_stack([np.convolve(c, np.ones(window) / window, "valid") for c in wide.T])
    result = diagnose_odometry(replace(run, poses=smooth), ROBOT)
    slips = [a for a in result.effects if a.name == "wheel_slip"]
    assert len(slips) == 1 and abs(slips[0]["s"] - 0.3) < 0.03


@pytest.mark.parametrize("share", [0.03, *further(0.07)])
def test_a_faint_patch_is_no_reason_to_doubt(share: float) -> None:
    spot = make_run(4).poses[600]
    result = diagnose_odometry(make_run(4, slip=(share, spot[0], spot[1], 0.5)), ROBOT)
    found = [*result.effects, *result.within_tolerance]
    assert result.unknown is None
    assert [a.name for a in found] == ["wheel_slip"]
    assert abs(found[0]["s"] - share) < 0.01


@pytest.mark.parametrize(("memory", "low", "high"), [(0.0, 1.0, 1.5), (0.9, 5.0, 30.0)])
def test_dispersion_is_one_for_white_rows_and_more_where_neighbours_agree(
    memory: float, low: float, high: float
) -> None:
    rng = np.random.default_rng(0)
    n, plain = 4000, WhiteningFilter.white(24, 1.0)
    rows = np.zeros((2, n))
    for k in range(1, n):
        rows[:, k] = memory * rows[:, k - 1] + np.sqrt(1 - memory**2) * rng.normal(size=2)
    test = StructureTest(np.ones(n, dtype=np.bool_), rows.ravel(), lambda *_: plain)
    family = StructureFamily(kind="any", columns=rng.normal(size=(2 * n, 1)), sigma=0.1, statement="")
    test.evidence(np.ones((2 * n, 1)), family)
    assert low <= test.dispersion(4.0, 0.1) < high


def test_structure_is_judged_under_the_same_noise_as_what_it_competes_with() -> None:
    """The noise of what is fitted first is found with a poor start: what came later looked better by thousands of nats."""
    n, rng, calls = 600, np.random.default_rng(5), [0]
    patch = (np.arange(n) % 150 < 40).astype(float)  # what an effect does
    hump = np.sin(np.arange(n) * 2 * np.pi / 150)  # what a family makes of it
    y = 0.05 * patch + 0.01 * rng.normal(size=n)
    family = StructureFamily(kind="any", columns=hump[:, None], sigma=0.1, statement="")
    one = np.ones((n, 1))

    def slow_to_learn(_kind: int, residual: Floats, _valid: object) -> WhiteningFilter:
        calls[0] += 1
        return WhiteningFilter.white(0, float(residual.std()) * (4.0 if calls[0] < 6 else 1.0))

    def at_once(_kind: int, residual: Floats, _valid: object) -> WhiteningFilter:
        return WhiteningFilter.white(0, float(residual.std()))

    leads = []
    for fit_noise in (slow_to_learn, at_once):
        test = StructureTest(np.ones(n, dtype=np.bool_), y, fit_noise)
        test.best(one, [family])
        leads.append(test.lead(one, family, np.column_stack([one, patch])))
    assert leads[0] == pytest.approx(leads[1], abs=1.0) and leads[1] < -100


def test_two_effects_are_both_named() -> None:
    result = diagnose_odometry(make_run(5, base=0.03, clock=0.05), ROBOT)
    assert {a.name for a in result.effects} == {"wheel_base", "pose_clock_offset"}


@pytest.mark.parametrize("seed", [13, *further(14)])
def test_camera_louder_than_said_is_no_structure(seed: int) -> None:
    run = make_run(seed, memory=0.9)
    louder = run.poses + np.random.default_rng(3).normal(size=run.poses.shape) * [0.005, 0.005, 0.004]
    result = diagnose_odometry(replace(run, poses=louder), ROBOT)
    assert result.effects == () and result.unknown is None


def test_a_reference_that_is_stretched_evenly_is_a_wheel_radius_and_nothing_more() -> None:
    """Columns of a distorted place hold no noise of the reference: what stretches x and y alike is the wheels' way."""
    signals = motion_signals(make_run(3))
    rows = aligned_rows(signals)
    families = {family.kind: family for family in odometry_families(rows, signals.wheels, ROBOT.wheels)}
    place = families["reference place"].columns[: rows.n]
    distance = np.where(rows.valid, rows.D_along @ signals.wheels.distance, 0.0)
    of_y, of_x = place[:, 9], place[:, 3]  # sin φ dy, cos φ dx
    size = np.ptp((rows.averages[1:, :2] + rows.averages[:-1, :2]) / 2, axis=0).max()
    np.testing.assert_allclose(size * (of_x + of_y), distance, atol=1e-12)


def cruising_run(seed: int, *, duration: float = 400.0, period: float = 0.1) -> Run:
    """Return a run of straights at one speed, spins at one rate and rests, with nothing hidden."""
    rng, step = np.random.default_rng(seed), 0.01
    n = round(duration / step)
    leg = np.repeat(rng.permuted(np.resize([0, 1, 1, 1, -1, 2], n // 200 + 1)), 200)[:n]
    goal = np.stack([0.22 * (leg == 2), 1.57 * leg * (np.abs(leg) == 1)], axis=1)
    ramp = np.stack(
        [np.convolve(g, np.ones(50) / 50)[:n] for g in goal.T], axis=1
    )  # of constant acceleration
    v, omega = ramp.T
    phi = np.concatenate([[0.0], np.cumsum(omega * step)])
    middle = (phi[1:] + phi[:-1]) / 2
    xy = np.cumsum((v * step)[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=1), axis=0)
    fine, truth = np.arange(n + 1) * step, np.column_stack([np.vstack([np.zeros(2), xy]), phi])
    moved = np.concatenate([np.zeros((1, 2)), np.cumsum(ramp * step, axis=0)])
    stamps, pose_stamps = np.arange(0.0, duration, period), np.arange(0.0, duration, 1 / 30)
    twists = np.diff(np.stack([np.interp(stamps, fine, c) for c in moved.T], axis=1), axis=0) / period
    twists += rng.normal(size=twists.shape) * [0.004, 0.006]
    seen = np.stack([np.interp(pose_stamps, fine, c) for c in truth.T], axis=1)
    seen += rng.normal(size=seen.shape) * [0.002, 0.002, 0.0015]
    heading = np.concatenate([[0.0], np.cumsum(twists[:, 1] * period)])
    between = (heading[1:] + heading[:-1]) / 2
    chord = twists[:, 0] * period * np.sinc(np.diff(heading) / (2 * np.pi))
    track = np.cumsum(chord[:, None] * np.stack([np.cos(between), np.sin(between)], axis=1), axis=0)
    return replace(
        make_run(1, duration=1.0),
        pose_stamps=pose_stamps,
        poses=np.column_stack([seen[:, :2], wrap(seen[:, 2])]),
        odom_stamps=stamps,
        odometry=np.column_stack([np.vstack([np.zeros(2), track]), wrap(heading)]),
        odom_twists=np.vstack([np.zeros(2), twists]),
    )


@pytest.mark.parametrize("period", [0.05, *further(0.1)], ids=["20 Hz", "10 Hz"])
def test_spins_and_straights_at_one_speed_are_no_structure(period: float) -> None:
    """At the cut of a column by speed, or at rest, noise of the wheels must not choose the increments."""
    result = diagnose_odometry(cruising_run(1, period=period), ROBOT)
    assert result.effects == () and result.unknown is None


def test_a_robot_that_turns_ever_faster_is_compared_exactly() -> None:
    """Where the rate changes linearly, increments of 70 ms give every row to rounding."""
    signals = motion_signals(cruising_run(1, duration=20.0))
    t, p = signals.stamps, np.arange(0.0, 20.0, 0.07)
    heading = np.column_stack([np.zeros((len(t), 2)), 0.3 * t**2])
    turn = np.diff(0.3 * p**2)
    wheels = replace(signals.wheels, start=p[:-1], end=p[1:], distance=0 * turn, turn=turn)
    rows = rows_at(replace(signals, poses=heading, wheels=wheels), 0.0)
    assert rows is not None
    np.testing.assert_allclose((rows.D_yaw @ turn)[3:-3], rows.yaw[3:-3], atol=1e-9)  # float64 at 100 rad


def test_run_without_odometry_is_skipped_with_reason() -> None:
    assert "odometry" in diagnose_odometry(without_odometry(make_run(1, duration=10.0)), ROBOT).skipped


@pytest.mark.parametrize("source", ["odometry /odom", "odometry", "/wheels"])
def test_odometry_is_not_compared_with_itself(source: str) -> None:
    run = make_run(1, duration=10.0, radius=0.05)
    itself = replace(run, pose_stamps=run.odom_stamps, poses=run.odometry, meta={"pose_source": source})
    result = diagnose_odometry(itself, ROBOT)
    assert "are its odometry" in result.skipped and source in result.skipped and result.effects == ()


def test_poses_that_stop_early_are_used_and_said() -> None:
    run = make_run(6, radius=0.03)
    n = len(run.poses) // 2
    run = replace(run, poses=run.poses[:n], pose_stamps=run.pose_stamps[:n])
    result = diagnose_odometry(run, ROBOT)
    assert "overlap" in result.notes and [a.name for a in result.effects] == ["wheel_radius"]


def test_reference_that_does_not_move_is_skipped_with_reason() -> None:
    run = make_run(7, duration=10.0)
    assert "do not move" in diagnose_odometry(replace(run, poses=run.poses * 0), ROBOT).skipped


def test_twists_stand_in_for_poses_that_do_not_move() -> None:
    run = make_run(8, radius=0.03)
    result = diagnose_odometry(replace(run, odometry=np.zeros_like(run.odometry)), ROBOT)
    assert result.notes["odometry_from"] == "twists" and [a.name for a in result.effects] == ["wheel_radius"]


def test_long_columns_are_whitened_in_blocks_as_the_filter_says() -> None:
    rng = np.random.default_rng(0)
    n = 2 * whitening.ROWS_AT_A_TIME + 100
    first, second = (
        WhiteningFilter(taps=np.array([1.0, *rng.normal(scale=0.3, size=3)]), sigma=sigma)
        for sigma in (0.5, 2.0)
    )
    columns, y, valid = rng.normal(size=(2 * n, 5)), rng.normal(size=2 * n), rng.random(n) < 0.9
    whitener = whitening.Whitener(filters=(first, second), valid=valid, weights=rng.random(2 * n))
    Z = np.concatenate(
        [
            np.stack([np.convolve(column, noise.taps)[:n] / noise.sigma for column in part.T], axis=1)
            for noise, part in ((first, columns[:n]), (second, columns[n:]))
        ]
    )
    Z *= (whitener.weights * np.tile(valid, 2))[:, None]
    np.testing.assert_allclose(whitener(columns), Z, atol=1e-12)
    G, b = whitener.normal_equations([columns[:, :2], columns[:, 2:]], y)
    np.testing.assert_allclose(G, Z.T @ Z, atol=1e-9)
    np.testing.assert_allclose(b, Z.T @ whitener(y), atol=1e-9)


def test_floor_that_takes_left_turns_alone_is_unknown_and_no_wheelbase() -> None:
    result = diagnose_odometry(make_run(3, asym=0.06), ROBOT)
    assert result.unknown is not None
    assert "to the left and to the right" in result.unknown.statement
    assert result.effects == ()


def test_a_wheelbase_keeps_its_name_beside_structure_that_is_small() -> None:
    result = diagnose_odometry(make_run(3, base=0.05, asym=0.01), ROBOT)
    assert [a.name for a in result.effects] == ["wheel_base"]


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ({"play": 0.012}, "wheel counts that were lost"),
        *further(({"pile": 0.03}, "depends on the heading")),
    ],
    ids=["play in a gear", "pile of a carpet"],
)
def test_what_no_wheel_effect_is_is_told_by_what_it_hangs_on(effect: dict[str, float], words: str) -> None:
    result = diagnose_odometry(make_run(3, **effect), ROBOT)
    assert result.effects == ()
    assert result.unknown is not None
    assert words in result.unknown.statement
