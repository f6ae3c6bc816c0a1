"""How the noise of wheels and reference is told apart, and that ticks which last look like nothing that wheels do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from diagnosis_samples import ROBOT, make_run
from scipy.signal import lfilter

from logs.run import Run
from planners.arena import wrap
from planners.types import Floats
from sensorgraph.diagnosis.motion.odometry_channel import diagnose_odometry
from sensorgraph.diagnosis.motion.reference_noise import (
    difference_autocovariance,
    robust_log_likelihood,
)
from sensorgraph.diagnosis.motion.whitening import HUBER_LIMIT, filter_of, robust_misfit

STEP = 0.02


def integrated(way: Floats, turn: Floats) -> Floats:
    """Return the poses (n, 3) after increments (n,), from the origin."""
    phi = np.cumsum(turn)
    middle = phi - turn / 2
    ends = np.cumsum(way[:, None] * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)
    return np.column_stack([ends, wrap(phi)])


def counted(seed: int, tick: float, slip: float = 0.01) -> Run:
    """Return a run seen 50 times a second, whose wheels count ticks [m] on a floor where slip lasts a quarter of a second."""
    rng, run = np.random.default_rng(seed), make_run(seed)
    t = np.arange(0.0, run.odom_stamps[-1], STEP)
    held = run.commands[np.searchsorted(run.cmd_stamps, t, side="right") - 1]
    lag = float(np.exp(-STEP / 0.1))
    v, omega = lfilter([1 - lag], [1.0, -lag], held, axis=0).T
    base, keep = ROBOT.wheels.base, float(np.exp(-STEP / 0.25))
    ends = []
    for side in (-0.5, 0.5):
        lasting = lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], rng.normal(size=len(t)))
        ends.append(np.cumsum((v + side * base * omega) * (1 + slip * lasting) * STEP))
    left, right = (np.diff(np.round(end / tick) * tick, prepend=0.0) for end in ends)
    way, turn = (left + right) / 2, (right - left) / base
    noise = rng.normal(size=(len(t), 3)) * [0.0005, 0.0005, 0.0004]
    poses = integrated(v * STEP, omega * STEP) + noise
    twists = np.column_stack([way / STEP, turn / STEP])
    return replace(
        run, pose_stamps=t, poses=poses, odom_stamps=t, odometry=integrated(way, turn), odom_twists=twists
    )


@pytest.mark.parametrize(("seed", "tick"), [(4, 0.002), *further((1, 0.0005), (5, 0.001))])
def test_ticks_and_slip_that_lasts_are_no_wheels_that_spin(seed: int, tick: float) -> None:
    """Where the noisy speed itself chose the moments at which wheels gain speed, they seemed to lose way then."""
    result = diagnose_odometry(counted(seed, tick), ROBOT)
    assert result.unknown is None, result.unknown.statement


@pytest.mark.parametrize("seed", range(4))
def test_compiled_misfit_and_filter_equal_the_plain_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    white, wander, memory, walk = rng.uniform([1e-3, 1e-3, 0.1, 1e-3], [5e-3, 5e-3, 0.9, 5e-3])
    gamma = difference_autocovariance(white, wander, memory, walk, period=0.05)
    gamma[0] *= 1 + 1e-6
    rows, valid = 0.01 * rng.standard_t(3, size=700), rng.random(700) > 0.1
    plain = filter_of(gamma, min_innovation=1e-6)
    misfit = robust_misfit(gamma, 1e-6, rows, valid, HUBER_LIMIT)
    assert misfit == pytest.approx(-robust_log_likelihood(plain, rows, valid), abs=1e-6)
    columns = rng.normal(size=(9000, 3))
    expected = lfilter(plain.taps, [1.0], columns, axis=0) / plain.sigma
    np.testing.assert_allclose(plain(columns), expected, rtol=1e-9, atol=1e-9)
    assert plain(columns[:, :0]).shape == (9000, 0)
