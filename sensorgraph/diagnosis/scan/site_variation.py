"""What a site shows by itself, estimated from fits: sizes of single effects, and how far parts of a run agree on them.

A name takes a size beyond the spread over windows of good runs (`site_sizes`), each as sure as its parts agree: where
the parts of a run disagree on a number, it is no number of the sensor but something at a few places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solver
from sensorgraph.diagnosis.scan.normal_equations import boxed
from sensorgraph.diagnosis.scan.nuisance import effects_with_nuisances
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats, Ints

Parts = list[tuple[Floats, Floats]]
"""Normal equations (matrix, right) of each part."""


def is_within_baseline(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether an effect lies within the baseline of the site, as surely as the parts of the run agree on it."""
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
    """Return the standard errors of the parameters of an effect of a fit over parts of the run and of the rays."""
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
    """Add each smooth effect of the whole sensor to a fit, alone.

    Returns
    -------
    effect -> parameter -> size, and effect -> parameter -> jackknife standard error
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
    """Solve the sum of normal equations under priors `tau` and their bounds, (k,)."""
    matrices, rights = zip(*parts, strict=True)
    bounds = SCAN.nuisance.max_tolerances * tau
    return np.concatenate(boxed(np.sum(matrices, axis=0), np.sum(rights, axis=0), tau, bounds, locked))


def larger_stderrs(partitions: Sequence[Parts], tau: Floats, locked: Bools, chosen: Ints) -> Floats:
    """Return the larger of the standard errors of the `chosen` unknowns, by parts of the way and by parts of the rays.

    A number of the whole sensor is the same everywhere and at every bearing; what one wall or one sector brings is none.
    """
    return np.asarray(np.max([jackknife_stderrs(parts, tau, locked, chosen) for parts in partitions], axis=0))


def jackknife_stderrs(parts: Parts, tau: Floats, locked: Bools, chosen: Ints) -> Floats:
    """Return the jackknife's standard errors of the `chosen` unknowns, parts being left out (Efron and Stein 1981)."""
    n = len(parts)
    rest = [[p for k, p in enumerate(parts) if k != left] for left in range(n)]
    values = np.array([solve_sum(some, tau, locked)[chosen] for some in rest])
    return np.asarray(np.sqrt((n - 1) * values.var(axis=0)))
