"""The mean of a reference's error that lasts: how far it may be off, against draws of an autoregression."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import further

from sensorgraph.diagnosis.scan.nuisance import prior_widths
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.standard_errors import error_of_mean, evidence_beside_wander, wander_widths
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Floats
from sensorgraph.world.robot import Tolerances


def wandering(n: int, memory: float, rng: np.random.Generator) -> Floats:
    """Draw an autoregression of first order with variance 1."""
    out = rng.normal(size=n)
    for k in range(1, n):
        out[k] = memory * out[k - 1] + np.sqrt(1 - memory**2) * out[k]
    return out


def fitted_of(
    delta: Floats, poses: Floats | None = None, speed: Floats | float = 0.5, turning: Floats | float = 0.0
) -> Any:
    """Return what `wander` reads of a fit with pose errors (n, 3) [m, m, rad].

    Parameters
    ----------
    poses : (n, 3) of the reference; default: the heading is held
    speed, turning : (n,) or of all scans [m/s, rad/s]
    """
    n = len(delta)
    twists = np.zeros((n, 3))
    twists[:, 2] = turning
    data = SimpleNamespace(
        price=lambda k: 4.0 * k,
        poses=np.zeros((n, 3)) if poses is None else poses,
        speed=np.broadcast_to(speed, n),
        twists=twists,
        tolerances=Tolerances(),
    )
    return SimpleNamespace(solver=SimpleNamespace(data=data), state=SimpleNamespace(delta=delta))


@pytest.mark.parametrize("memory", [0.5, 0.9, 0.97])
def test_the_error_of_the_mean_is_that_of_many_draws(memory: float) -> None:
    """What a fit already has, as if errors were independent, is not counted twice."""
    rng, n = np.random.default_rng(0), 400
    draws = [wandering(n, memory, rng) for _ in range(300)]
    true = np.sqrt(np.var([d.mean() for d in draws]) - 1 / n)
    told = np.sqrt(np.mean([error_of_mean(d) ** 2 for d in draws]))
    assert 0.8 * true < told < 1.25 * true


def test_errors_that_do_not_last_add_little() -> None:
    rng = np.random.default_rng(1)
    told = [error_of_mean(rng.normal(size=400)) for _ in range(100)]
    assert np.sqrt(np.mean(np.square(told))) < 0.7 / np.sqrt(400)


def test_an_error_that_turns_with_the_robot_is_one_of_the_mount_and_one_of_the_map_is_none() -> None:
    rng, n = np.random.default_rng(2), 600
    turning = np.linspace(0.0, 40 * np.pi, n)
    error = 0.02 * wandering(n, 0.995, rng)
    c, s = np.cos(turning), np.sin(turning)
    on_robot, on_map = np.column_stack([c * error, s * error, 0 * c]), np.column_stack([error, 0 * c, 0 * c])
    poses = np.column_stack([c, s, turning])
    widths = [wander_widths(fitted_of(delta, poses)) for delta in (on_robot, on_map)]
    assert widths[0][Nuisance.MOUNT_X] > 3 * widths[1][Nuisance.MOUNT_X]
    assert widths[0][Nuisance.MOUNT_YAW] == 0.0
    assert widths[0][Nuisance.DELAY] == pytest.approx(widths[0][Nuisance.MOUNT_X] / 0.5)


def test_a_delay_of_a_robot_that_turns_on_the_spot_is_told_by_its_turns() -> None:
    rng, n = np.random.default_rng(3), 400
    delta = np.column_stack(
        [0.003 * wandering(n, 0.95, rng) for _ in range(2)] + [0.001 * wandering(n, 0.95, rng)]
    )
    turning = np.cumsum(np.where(np.arange(n) // 40 % 2, 0.05, -0.05))
    poses = np.column_stack([np.zeros((n, 2)), turning])
    fitted = fitted_of(delta, poses, speed=0.002 * rng.normal(size=n), turning=np.gradient(turning) / 0.1)
    assert wander_widths(fitted)[Nuisance.DELAY] < 0.002


def mount_by(delta: Floats, dx: float) -> float:
    """Return the evidence [nats] of a mount dx [m] ahead that a fit of independent errors has found beside pose errors (n, 3)."""
    n, fitted = len(delta), fitted_of(delta)
    set_up, wander = prior_widths(Tolerances())[Nuisance.MOUNT_X], wander_widths(fitted)[Nuisance.MOUNT_X]
    error = float(np.sqrt(set_up**2 + wander**2 + np.var(delta[:, 0]) / n))
    return evidence_beside_wander(
        fitted, replace(EFFECTS["mount_xy"](dx=dx, dy=0.0), stderr={"dx": error, "dy": error})
    )


@pytest.mark.parametrize("memory", [0.9, *further(0.5, 0.97)])
def test_the_mean_of_a_wandering_reference_tells_no_mount(memory: float) -> None:
    """The heading is held: whatever the errors of the poses have for a mean is taken for a mount."""
    rng = np.random.default_rng(4)
    told = 0
    for _ in range(200):
        delta = 0.02 * np.stack([wandering(300, memory, rng) for _ in range(3)], axis=1)
        told += mount_by(delta - delta.mean(axis=0), float(delta[:, 0].mean())) > SCAN.naming.rival_margin
    assert told <= 2


def test_a_mount_stands_out_of_errors_that_do_not_last_and_other_effects_are_not_asked() -> None:
    rng = np.random.default_rng(5)
    delta = 0.02 * rng.normal(size=(300, 3))
    assert mount_by(delta, 0.015) > 50.0
    assert evidence_beside_wander(fitted_of(delta), EFFECTS["range_bias"](b=0.01)) == np.inf
