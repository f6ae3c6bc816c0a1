"""Estimate the tolerances of a site from a run that is known to be good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted, fit, solver_for, start_state
from sensorgraph.diagnosis.scan.gauss_newton import Solver, State
from sensorgraph.diagnosis.scan.likelihood import e_step
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Tolerances


def pose_tolerances(data: ScanData, null: Fitted) -> Tolerances:
    """Return the pose tolerances with which one half of the bearings predicts the other half best.

    Parameters
    ----------
    null : Fit of the run without effects.
    """
    nominal = data.tolerances
    solver, _ = solver_for(data, ())
    bearings = data.sensor.bearings
    half = np.floor((bearings - bearings[0]) / SCAN.site.sector).astype(np.intp) % 2 == 0
    factor = {"pose_xy": 1.0, "pose_yaw": 1.0}
    scores: dict[tuple[float, ...], float] = {}

    def score(trial: dict[str, float]) -> float:
        key = tuple(trial.values())
        if key not in scores:
            tolerances = replace(nominal, **{k: v * getattr(nominal, k) for k, v in trial.items()})
            solver.data = replace(data, tolerances=tolerances)
            scores[key] = sum(_predictive_log_likelihood(solver, null.state, rays) for rays in (half, ~half))
        return scores[key]

    for _ in range(2):
        for name in factor:
            factor[name] = max(SCAN.site.pose_factors, key=lambda f: score({**factor, name: f}))
    return replace(nominal, **{k: v * getattr(nominal, k) for k, v in factor.items()})


def _predictive_log_likelihood(solver: Solver, state: State, rays: Bools) -> float:
    """Fit the pose of each scan to some rays (n_rays,); return the log-likelihood [nats] of the other rays."""
    data, expected, none = solver.data, solver.expected, np.zeros(0)
    state = state.copy()
    state.delta = data.pose_start
    for _ in range(4):
        responsibilities = e_step(data, expected, solver.shift(state, none), state.noise)
        weight: Floats = np.where(rays, responsibilities.weight, 0.0)
        state.delta = solver.assemble(weight, 1.0).poses_at(state.g)
    log_p = e_step(data, expected, solver.shift(state, none), state.noise).log_p
    return float(log_p[:, ~rays].sum())


def shift_tolerances(data: ScanData, cuts: Sequence[int]) -> Tolerances:
    """Widen the tolerances of mount and stamps to the apparent shifts in a known-good run.

    The clock is fitted separately: while a robot turns in one direction only, a late clock looks like a yaw.

    Parameters
    ----------
    cuts : Numbers of windows into which the run is divided.
    """
    mount = [MOUNT_XY(dx=0.0, dy=0.0), MOUNT_YAW(delta=0.0)]
    clock = [LATENCY(tau=0.0)]
    nominal, noise, squares = data.tolerances, SCAN.site.wide_noise, []
    for window in (window for n in cuts for window in data.windows(n)):
        xy, yaw = fit(window, mount, start_state(window, noise), noise, outer=3, inner=5).model
        (late,) = fit(window, clock, start_state(window, noise), noise, outer=3, inner=5).model
        squares.append([xy["dx"] ** 2 / 2 + xy["dy"] ** 2 / 2, yaw["delta"] ** 2, late["tau"] ** 2])
    shift, turn, stamp = np.sqrt(np.mean(squares, axis=0))
    return replace(
        nominal,
        mount_xy=max(nominal.mount_xy, float(shift)),
        mount_yaw=max(nominal.mount_yaw, float(turn)),
        stamp=max(nominal.stamp, float(stamp) / SCAN.nuisance.steady_stamp_share),
    )
