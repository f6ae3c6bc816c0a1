"""Estimate apparent sizes of single effects at a site, and the agreement between parts of a run.

An effect is named only if its size exceeds the spread over windows of known-good runs (`site_sizes`). Each
size counts with the precision with which parts of the run agree. If they disagree on a parameter, it does not
describe the sensor but a few places.

The tolerances of the site are estimated from a run that is known to be good.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted, fit, solver_for, start_state
from sensorgraph.diagnosis.scan.gauss_newton import Solver, State
from sensorgraph.diagnosis.scan.likelihood import e_step
from sensorgraph.diagnosis.scan.normal_equations import boxed
from sensorgraph.diagnosis.scan.nuisance import effects_with_nuisances
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.robot import Tolerances

Parts = list[tuple[Floats, Floats]]
"""Normal equations (matrix, right) of each part."""


def is_within_baseline(fitted: Fitted, amendment: Amendment) -> bool:
    """Return whether an effect is within the baseline of the site, given the agreement between parts of the run."""
    baseline = fitted.solver.data.baseline_intervals.get(amendment.name)
    if baseline is None:
        return False
    if baseline.contains(amendment):
        return True
    if not amendment.effect.nuisances or amendment.name not in fitted.names():
        return False
    return baseline.contains(amendment, cached_jackknife(fitted, amendment))


def cached_jackknife(fitted: Fitted, amendment: Amendment) -> dict[str, float]:
    """Return `jackknife`, computed once per fit."""
    key = f"jackknife|{amendment.name}|{fitted.model!r}".encode()
    return fitted.solver.data.kept(key, lambda: jackknife(fitted, amendment))


def jackknife(fitted: Fitted, amendment: Amendment) -> dict[str, float]:
    """Return the standard errors of the parameters of a fitted effect, over parts of the run and of the rays."""
    solver, names, place = fitted.solver, list[str](), 0
    for index, other in enumerate(fitted.model):
        smooth = list(other.steps)
        if other.name == amendment.name:
            names = smooth
            place = solver.n_g + sum(len(a.steps) for a in fitted.model[:index])
    chosen = np.arange(place, place + len(names))
    tau = solver.scaled(fitted.state)
    stderrs = larger_stderrs(equations_by_part(fitted), tau, solver.locked, chosen)
    return dict(zip(names, map(float, stderrs), strict=True))


def single_effects(fitted: Fitted) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """Add each smooth effect of the whole sensor to a fit separately.

    Returns
    -------
    Effect -> parameter -> size, and effect -> parameter -> jackknife standard error.
    """
    solver, partitions = fitted.solver, equations_by_part(fitted)
    sizes, stderrs = {}, {}
    for effect in effects_with_nuisances():
        chosen = np.array(effect.nuisances)
        if solver.locked[chosen].any():
            continue
        tau = solver.scaled(fitted.state)
        tau[chosen] = SCAN.site.free_width
        size = solve_sum(partitions[0], tau, solver.locked)[chosen]
        errors = larger_stderrs(partitions, tau, solver.locked, chosen)
        sizes[effect.name] = dict(zip(effect.steps, map(float, size), strict=True))
        stderrs[effect.name] = dict(zip(effect.steps, map(float, errors), strict=True))
    return sizes, stderrs


def equations_by_part(fitted: Fitted) -> list[Parts]:
    """Return the normal equations of each part of the run in time, and of each part of its rays by bearing."""
    solver: Solver = fitted.solver
    weight = fitted.solution.responsibilities.weight
    n_scans, n_rays = weight.shape
    scan, ray = np.indices(weight.shape)
    partitions = []
    for part, count in ((scan, n_scans), (ray, n_rays)):
        n_parts = min(SCAN.site.n_parts, count)
        equations = []
        for k in range(n_parts):
            system = solver.assemble(
                np.where(part * n_parts // count == k, weight, 0.0), fitted.state.pose_scale
            )
            equations.append((system.matrix, system.right))
        partitions.append(equations)
    return partitions


def solve_sum(parts: Parts, tau: Floats, locked: Bools) -> Floats:
    """Solve the sum of normal equations under priors `tau` and their bounds; return the solution (k,)."""
    matrices, rights = zip(*parts, strict=True)
    bounds = SCAN.nuisance.max_tolerances * tau
    return np.concatenate(boxed(np.sum(matrices, axis=0), np.sum(rights, axis=0), tau, bounds, locked))


def larger_stderrs(partitions: Sequence[Parts], tau: Floats, locked: Bools, chosen: Ints) -> Floats:
    """Return the larger standard error of the `chosen` unknowns: over parts of the run, or over parts of the rays.

    A parameter of the whole sensor is the same at all times and at all bearings, unlike the effect of one
    wall or one sector.
    """
    return np.asarray(np.max([jackknife_stderrs(parts, tau, locked, chosen) for parts in partitions], axis=0))


def jackknife_stderrs(parts: Parts, tau: Floats, locked: Bools, chosen: Ints) -> Floats:
    """Return the jackknife standard errors of the `chosen` unknowns (Efron and Stein 1981).

        stderr = sqrt((n - 1) var(values))

    The values are those of the n solutions that each leave out one part.
    """
    n = len(parts)
    rest = [[p for k, p in enumerate(parts) if k != left] for left in range(n)]
    values = np.array([solve_sum(some, tau, locked)[chosen] for some in rest])
    return np.asarray(np.sqrt((n - 1) * values.var(axis=0)))


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
