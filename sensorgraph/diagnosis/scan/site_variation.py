"""What a site shows by itself, estimated from fits: sizes of single effects, and how far parts of a run agree on them.

A name takes a size beyond the spread over windows of good runs (`site_sizes`). And where the parts of a run disagree
on a number far more than the parts of good runs do, it is no number of the sensor but something at a few places: then
it must stand out of its own scatter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.special import stdtrit

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solver, boxed
from sensorgraph.diagnosis.scan.nuisance import effects_with_nuisances
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.site_sizes import in_materialities
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats, Ints


def is_within_baseline(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether an effect lies within the baseline of the site, or shows at a few places only."""
    baseline = fitted.solver.data.baseline_intervals.get(amendment.name)
    if baseline is None:
        return False
    if baseline.contains(amendment):
        return True
    if baseline.jackknife_stderr is None or amendment.name not in fitted.names():
        return False
    stderr = cached_jackknife_stderr(fitted, amendment)
    if not baseline.is_exceeded_by(stderr):
        return False
    off = {k: amendment[k] - baseline.mean[k] for k in baseline.half_width}
    t = float(stdtrit(SCAN.site.n_parts - 2, SCAN.site.confidence))
    return in_materialities(amendment.name, off) < stderr * t


def cached_jackknife_stderr(fitted: Fitted, amendment: Amendment) -> float:
    """Return `jackknife_stderr`, computed once per fit."""
    memo = fitted.solver.data.memo
    key = f"jackknife|{amendment.name}|{fitted.model!r}".encode()
    if key not in memo:
        memo[key] = jackknife_stderr(fitted, amendment)
    kept = memo[key]
    assert isinstance(kept, float)
    return kept


def jackknife_stderr(fitted: Fitted, amendment: Amendment) -> float:
    """Return the standard error of an effect of a fit over parts of the run [materialities]."""
    solver, names, place = fitted.solver, list[str](), 0
    for index, other in enumerate(fitted.model):
        smooth = list(other.steps)
        if other.name == amendment.name:
            names = smooth
            place = solver.n_g + sum(len(a.steps) for a in fitted.model[:index])
    chosen = np.arange(place, place + len(names))
    tau = solver.scaled(fitted.state)
    stderrs = jackknife_stderrs(equations_by_part(fitted), tau, solver.locked, chosen)
    return in_materialities(amendment.name, dict(zip(names, stderrs, strict=True)))


def single_effects(fitted: Fitted) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """Add each smooth effect of the whole sensor to a fit, alone.

    Returns
    -------
    effect -> parameter -> size, and effect -> jackknife standard error [materialities]
    """
    solver, parts = fitted.solver, equations_by_part(fitted)
    sizes, stderrs = {}, {}
    for effect in effects_with_nuisances():
        name, names = effect.name, effect.steps
        chosen = np.array(effect.nuisances)
        if solver.locked[chosen].any():
            continue
        tau = solver.scaled(fitted.state)
        tau[chosen] = SCAN.site.free_width
        size = solve_sum(parts, tau, solver.locked)[chosen]
        errors = jackknife_stderrs(parts, tau, solver.locked, chosen)
        sizes[name] = dict(zip(names, map(float, size), strict=True))
        stderrs[name] = in_materialities(name, dict(zip(names, errors, strict=True)))
    return sizes, stderrs


def equations_by_part(fitted: Fitted) -> list[tuple[Floats, Floats]]:
    """Return the normal equations (matrix, right) of each part of the run, in time."""
    solver: Solver = fitted.solver
    weight = fitted.solution.responsibilities.weight
    out = []
    for rows in np.array_split(np.arange(len(weight)), SCAN.site.n_parts):
        some = np.zeros_like(weight)
        some[rows] = weight[rows]
        system = solver.assemble(some, fitted.state.pose_scale)
        out.append((system.matrix, system.right))
    return out


def solve_sum(parts: Iterable[tuple[Floats, Floats]], tau: Floats, locked: Bools) -> Floats:
    """Solve the sum of normal equations under priors `tau` and their bounds, (k,)."""
    matrices, rights = zip(*parts, strict=True)
    bounds = SCAN.nuisance.max_tolerances * tau
    return np.concatenate(boxed(np.sum(matrices, axis=0), np.sum(rights, axis=0), tau, bounds, locked))


def jackknife_stderrs(
    parts: Sequence[tuple[Floats, Floats]], tau: Floats, locked: Bools, chosen: Ints
) -> Floats:
    """Return the jackknife's standard errors of the `chosen` unknowns, parts being left out (Efron and Stein 1981)."""
    n = len(parts)
    rest = [[p for k, p in enumerate(parts) if k != left] for left in range(n)]
    values = np.array([solve_sum(some, tau, locked)[chosen] for some in rest])
    return np.asarray(np.sqrt((n - 1) * values.var(axis=0)))
