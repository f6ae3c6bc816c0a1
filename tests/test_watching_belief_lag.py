"""A believed pose that is right but late: it is named with its age, and is not off."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from localization_samples import looking_about, room_run
from watching_samples import believing, graph

import sensorgraph as sg
from logs.run import Run
from sensorgraph.watching.belief_lag import BeliefLag
from sensorgraph.watching.evidence import doubt_of
from sensorgraph.watching.settings import BELIEF_FAULT
from sensorgraph.watching.summary import WatchSummary

RATE = 10.0
"""[Hz]"""
OFFSET = np.array([0.3, -0.2, 0.05])
"""[m, m, rad] An error of the belief that lasts."""


def collected(age: float, *, seed: int = 0, walk: bool = True, noise: float = 0.0) -> BeliefLag:
    """Return the evidence of a minute of a belief that is `age` [s] old, of a robot that looks about or drives along a corridor.

    Parameters
    ----------
    noise : [m] Standard deviation of the tracked positions, which wavers by a third of it [rad].
    """
    rng, found = np.random.default_rng(seed), BeliefLag()
    error = np.zeros(3)
    for k, t in enumerate(np.arange(0.0, 60.0, 1 / RATE)):
        if k % 5 == 0:  # AMCL corrects twice a second
            error = 0.6 * error + 0.8 * rng.normal(size=3) * [0.05, 0.05, 0.02]
        here, then = (looking_about(np.array([t - dt]))[0] for dt in (0.0, age))
        if not walk:
            here, then = (np.array([0.7 * (t - dt), 0.0, 0.02 * np.sin(0.5 * (t - dt))]) for dt in (0.0, age))
        here = here + noise * rng.normal(size=3) * [1.0, 1.0, 0.3]
        found.add(float(t), here, then + OFFSET + error)
    return found


def lag_of(age: float, *, seed: int = 0) -> tuple[float, float]:
    """Return the estimated age [s] of a belief that is `age` old, and its standard error, after a minute."""
    (value,), (error,) = collected(age, seed=seed).estimates()
    return float(value), float(error)


@pytest.mark.parametrize("age", [0.0, 0.2, 0.5, 1.0])
def test_the_age_of_a_belief_is_within_its_standard_error(age: float) -> None:
    z = [(value - age) / error for value, error in (lag_of(age, seed=seed) for seed in range(20))]
    assert np.mean(np.abs(z) < 2) >= 0.8  # of t with about ten degrees of freedom: 93 %
    assert np.mean(np.abs([lag_of(age, seed=seed)[1] for seed in range(5)])) < 0.03


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_along_a_corridor_the_age_is_not_known(noise: float) -> None:
    for seed in range(10):
        found = collected(0.0, seed=seed, walk=False, noise=noise)
        (value,), (error,) = found.estimates()
        doubt = doubt_of(BELIEF_FAULT, float(value), float(error), math.log(1e-3), freedom=found.freedom)
        assert doubt.p < 0.5


def test_a_lost_pose_begins_anew() -> None:
    found = BeliefLag()
    for t in np.arange(0.0, 20.0, 0.1):
        if 8.0 < t < 12.0:
            continue
        pose = looking_about(np.array([t]))[0]
        found.add(float(t), pose, pose)
    (value,), (error,) = found.estimates()
    assert abs(value) < 3 * error + 1e-3


def late(age: float) -> Run:
    """Return a run of 50 s whose robot believes where it was an `age` [s] ago."""
    poses = looking_about(np.arange(0.0, 50.0, 1 / RATE))
    run = room_run(poses, rate=RATE, seed=3)
    believed = looking_about(run.stamps - age)
    return believing(replace(run, meta={}), believed)


def said_of(run: Run) -> tuple[WatchSummary, list[str]]:
    summary, words = WatchSummary(), list[str]()
    for status in sg.watch(graph(), run):
        summary.add(status, "ok", "")
        words.append(status.pose.status)
    return summary, words


def test_a_late_belief_is_named_and_is_not_off() -> None:
    summary, words = said_of(late(0.5))
    assert summary.last is not None
    (fault,) = summary.last.faults
    assert fault.name == "pose_latency"
    assert abs(fault.parameters["s"] - 0.5) < 2 * fault.stderr["s"]
    assert fault.sentence().startswith("pose latency +")
    assert set(words[30:]) == {"ok"}
    assert not summary.next_step()  # no effect of `diagnose` has this name


def test_an_interval_that_is_off_states_its_largest_offset() -> None:
    """An interval ends when the belief is right again: the last offset would be within the tolerance."""
    poses = looking_about(np.arange(0.0, 20.0, 1 / RATE))
    run = room_run(poses, rate=RATE, seed=3)
    believed = poses + np.exp(-0.5 * (run.stamps[:, None] - 10.0) ** 2) * [0.8, 0.0, 0.0]
    summary, words = said_of(believing(run, believed))
    (span,) = (span for span in summary.spans["pose"] if span.word == "off")
    assert words[-1] == "ok"
    metres = float(span.text.split("up to ")[1].split(" m")[0])
    assert 0.7 < metres < 0.85


@pytest.mark.slow
def test_a_belief_in_time_has_no_latency() -> None:
    summary, words = said_of(late(0.0))
    assert summary.last is not None
    assert not summary.last.faults
    assert set(words) == {"ok"}
