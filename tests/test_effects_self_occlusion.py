"""Which rays a part of the robot hides is told by what is likeliest, not by which rays are often short."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from logs.run import RangeSensor
from sensorgraph.effects.self_occlusion import propose

N_SCANS, BEARINGS = 100, np.radians(np.arange(-90.0, 91.0, 2.0))


def seen(z: np.ndarray[Any, Any], short: np.ndarray[Any, Any]) -> Any:
    """Residuals of scans that should all read 5 m: a reading is likely where expected, and anywhere with a small chance."""
    every = np.ones(z.shape, dtype=np.bool_)

    def likely(mu: Any, some: Any) -> Any:
        hit = np.exp(-0.5 * ((z[some] - mu) / 0.02) ** 2) / (np.sqrt(2 * np.pi) * 0.02)
        return np.log(hit + 0.1 / 8.0)

    wall = np.full(z.shape, 5.0)
    return SimpleNamespace(
        sensor=RangeSensor(bearings=BEARINGS), z=z, mu=wall, aimed=every, short=short, likely=likely,
        log_p=likely(wall[every], every).reshape(z.shape),
    )  # fmt: skip


@pytest.mark.parametrize("n_rays", [1, 3], ids=["one ray", "three rays"])
@pytest.mark.parametrize("side", [-1, 1], ids=["clutter before", "clutter after"])
def test_a_ray_that_clutter_shortens_at_times_is_not_hidden(n_rays: int, side: int) -> None:
    rng = np.random.default_rng(3)
    z = 5.0 + 0.01 * rng.normal(size=(N_SCANS, len(BEARINGS)))
    z[:, 40 : 40 + n_rays] = 0.3 + 0.01 * rng.normal(size=(N_SCANS, n_rays))
    beside = 39 if side < 0 else 40 + n_rays
    z[:40, beside] = rng.uniform(0.5, 4.0, 40)
    (found,) = propose(seen(z, z < 4.9))
    assert found.values["r0"] == pytest.approx(0.3, abs=0.01)
    inside = (found.values["theta1"] <= BEARINGS) & (found.values["theta2"] >= BEARINGS)
    assert np.flatnonzero(inside).tolist() == list(range(40, 40 + n_rays))
    assert found.gain > 4 * N_SCANS * n_rays


def test_clutter_alone_gains_nothing() -> None:
    rng = np.random.default_rng(4)
    z = 5.0 + 0.01 * rng.normal(size=(N_SCANS, len(BEARINGS)))
    z[:40, 39] = rng.uniform(0.5, 4.0, 40)
    assert all(proposal.gain < 0 for proposal in propose(seen(z, z < 4.9)))
