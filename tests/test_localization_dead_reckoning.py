"""Rooms that look the same along a corridor or at any turn: stated deviations cover the errors, with rays cast in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from logs.run import Run
from sensorgraph.localization.dead_reckoning import _variances
from sensorgraph.localization.mapping import map_run
from sensorgraph.localization.result import Localization
from sensorgraph.localization.wheels import identify_wheels
from tests.localization_samples import Floats, room_run

Walls = list[tuple[float, float, float, float]]


def polygon(radius: float, n: int) -> Walls:
    """Return the walls of a regular polygon around the origin."""
    angle = 2 * np.pi * np.arange(n + 1) / n
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return list(zip(x[:-1], y[:-1], x[1:], y[1:], strict=True))


def n_wrong(found: Localization, truth: Floats) -> tuple[int, int]:
    """Return how many located scans are beyond 5 cm or 2 degrees more than three standard deviations, and how many there are.

    The frame of a map is free: the rigid motion with the least absolute errors is removed.
    """
    ok = np.array(found.status) == "ok"
    if not ok.any():
        return 0, 0
    poses, true = found.poses[ok], truth[ok]
    weight = np.ones(len(poses))
    for _ in range(30):
        share = weight / weight.sum()
        a, b = poses[:, :2] - share @ poses[:, :2], true[:, :2] - share @ true[:, :2]
        c = (share[:, None] * a * b).sum() + 0.1 * share @ np.cos(true[:, 2] - poses[:, 2])
        s = share @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) + 0.1 * share @ np.sin(true[:, 2] - poses[:, 2])
        turn = np.arctan2(s, c)
        matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        place = np.hypot(*(a @ matrix - b).T)
        heading = np.abs(np.angle(np.exp(1j * (poses[:, 2] + turn - true[:, 2]))))
        weight = 1.0 / (1.0 + (place / 0.03) ** 2 + (heading / 0.02) ** 2)
    sigma = np.sqrt(np.einsum("nii->ni", found.covariances[ok]))
    wrong = (place > 3 * sigma[:, :2].max(axis=1) + 0.05) | (heading > 3 * sigma[:, 2] + np.radians(2.0))
    return int(wrong.sum()), int(ok.sum())


def hall_run(*, lifted: bool) -> tuple[Run, Floats]:
    """Return a run in a hall of 48 sides; after 8 s somebody lifts the wheels and pushes the robot around."""
    t = np.arange(300) / 5.0
    poses = np.column_stack(
        [1.5 * np.sin(0.23 * t), 1.1 * np.sin(0.17 * t + 0.5) - 0.5, 0.05 * t + 0.9 * np.sin(0.31 * t)]
    )
    run = room_run(poses, walls=polygon(4.0, 48), n_rays=360)
    if lifted:
        odometry = run.odometry.copy()
        odometry[40:] = odometry[40]
        object.__setattr__(run, "odometry", odometry)
    return run, poses


@pytest.mark.slow
def test_a_robot_that_is_pushed_in_a_round_hall_is_not_sure_of_its_heading() -> None:
    run, truth = hall_run(lifted=True)
    wrong, _ = n_wrong(map_run(run), truth)
    assert wrong <= 0.02 * run.n_scans  # it was two thirds of them


@pytest.mark.slow
def test_a_robot_that_drives_in_a_round_hall_is_located_by_its_wheels() -> None:
    run, truth = hall_run(lifted=False)
    wrong, located = n_wrong(map_run(run), truth)
    assert wrong == 0 and located > 0.9 * run.n_scans


@pytest.mark.slow
def test_the_place_in_a_corridor_that_is_a_ring_is_as_uncertain_as_the_wheels() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi * 1.3, 420)
    poses = np.column_stack([7.0 * np.cos(angle), 7.0 * np.sin(angle), angle + np.pi / 2])
    run = room_run(poses, walls=polygon(6.0, 96) + polygon(8.0, 96), n_rays=360, way_scale=1.01)
    found = map_run(run)
    wrong, _ = n_wrong(found, poses)
    assert wrong == 0  # it was a quarter of them
    drift = (
        0.01 * 7.0 * angle[-1] / 4
    )  # [m] mean error of wheels that are 1 % wrong, about the middle of the drive
    assert np.sqrt(found.covariances[:, :2, :2].max(axis=(1, 2))).mean() > drift


@pytest.mark.parametrize("is_held", [(False, False), (True, False), (False, True), (True, True)])
def test_deviations_of_a_walk_are_those_of_its_samples(is_held: tuple[bool, bool]) -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(0.5, 2.0, 12)
    by = rng.normal(size=(12, 3))
    sd = np.array([0.3, 0.2, 0.1])
    steps = rng.normal(size=(40_000, 12)) * np.sqrt(q) + (rng.normal(size=(40_000, 3)) * sd) @ by.T
    way = np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, axis=1)], axis=1)
    if all(is_held):  # condition on the end: move each sample by its gap, in proportion to the variance
        share = np.concatenate([[0.0], np.cumsum(q)]) / q.sum()
        way = (way - share * way[:, -1:])[:, 1:-1]
    elif is_held[0]:
        way = way[:, 1:]
    elif is_held[1]:
        way = (way - way[:, -1:])[:, :-1]
    else:
        way = way - way.mean(axis=1, keepdims=True)
    # 40,000 samples give a variance to 0.7 %
    assert _variances(q, by, sd, is_held) == pytest.approx(way.var(axis=0), rel=0.05)


def test_wheels_that_stand_while_the_robot_is_carried_say_nothing_about_their_scale() -> None:
    rng = np.random.default_rng(1)
    true = np.column_stack([rng.uniform(0.2, 0.4, 200), np.zeros(200), rng.normal(scale=0.2, size=200)])
    steps = true / [1.05, 1.0, 0.97]
    steps[60:] = 0.0
    found = identify_wheels(steps, true)
    assert found.way_scale == pytest.approx(1.05, abs=0.01)
    assert found.turn_scale == pytest.approx(0.97, abs=0.01)
