"""Fit additional columns on top of a fit, with the scores of each part of the run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solution, Solver, iterate
from sensorgraph.diagnosis.scan.normal_equations import with_prior
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools, Floats, Ints

Parts = Sequence[tuple[Floats, Floats]]
"""Normal equations (matrix (m, m), right (m,)) of the parts of a run."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ColumnFit:
    """Coefficients of additional columns, fitted jointly with all unknowns of a fit."""

    values: Floats
    """(k,)"""
    solution: Solution
    gain: float
    """[nats] increase of the penalised log-likelihood."""
    each: Floats
    """(n_parts, k) Change of the values that each part of the run would cause."""
    information: Floats
    """(k, k) Information on the values if rays are independent: the inverse of their covariance."""


def fit_columns(
    fitted: Fitted, columns: Floats, start: Floats, *, rounds: int, noise_free: bool = True
) -> ColumnFit:
    """Fit columns (n_scans, k, n_rays) in addition to a fit, from a start (k,).

    Poses and map restart within their tolerances, or within the tolerances that the fit has widened, because the fit may
    have absorbed the columns in them.
    """
    k, solver, state = len(start), fitted.solver.with_columns(columns), fitted.state.copy()
    bounds = replace(
        SCAN.noise,
        min_pose_scale=min(1.0, state.pose_scale),
        max_scale=max(1.0, state.pose_scale, state.map_scale),
    )
    state.delta = solver.data.pose_start
    state.pose_scale, state.map_scale = bounds.min_pose_scale, 1.0
    p = np.concatenate([fitted.solution.p, start])
    solution = iterate(solver, state, p, bounds, rounds=rounds, noise_free=noise_free)
    parts = equations_of_parts(solver, solution, parts_of_run(fitted))
    x = np.concatenate([solution.state.g, solution.p])
    scores = np.array([right - matrix @ x for matrix, right in parts])
    inverse = inverse_of_whole(parts, solver, solution)
    return ColumnFit(
        values=solution.p[-k:],
        solution=solution,
        gain=solution.j - fitted.j,
        each=(scores - scores.mean(axis=0)) @ inverse[:, -k:],
        information=information_of_last(parts, solver, solution, k),
    )


def is_better_alone(alone: float, null: Fitted, beside: float, fitted: Fitted) -> bool:
    """Return whether a structure explains more without any effect than together with the effects.

    The effects then only imitate the structure.

    Parameters
    ----------
    alone : [nats] Gain of the structure over the fit without effects.
    beside : [nats] Gain of the structure over the fit with effects.
    """
    return null.j + alone > fitted.j + beside + SCAN.selection.threshold


def parts_of_run(fitted: Fitted) -> list[Ints]:
    """Return the scan indices of each part of the run."""
    return np.array_split(np.arange(fitted.solver.data.n_scans), SCAN.constancy.n_parts)


def equations_of_parts(solver: Solver, solution: Solution, rows: Sequence[Ints]) -> Parts:
    """Return the normal equations of each part of the run."""
    weight, scale = solution.responsibilities.weight, solution.state.pose_scale
    systems = [solver.of_scans(some).assemble(weight[some], scale) for some in rows]
    return [(system.matrix, system.right) for system in systems]


def inverse_of_whole(parts: Parts, solver: Solver, solution: Solution) -> Floats:
    """Return the inverse (m, m) of the whole system with its priors; 0 for unknowns that are held or at a bound."""
    total, free = _whole(parts, solver, solution)
    out = np.zeros(total.shape)
    out[np.ix_(free, free)] = np.linalg.inv(total[np.ix_(free, free)])
    return out


def information_of_last(parts: Parts, solver: Solver, solution: Solution, k: int) -> Floats:
    """Return the information (k, k) on the last k unknowns of the whole system, with all others integrated out.

    It is the inverse of their covariance. The covariance itself does not exist if another unknown is collinear with them.
    """
    total, free = _whole(parts, solver, solution)
    rest = free.copy()
    rest[-k:] = False
    across = total[rest][:, -k:]
    return np.asarray(total[-k:, -k:] - across.T @ np.linalg.solve(total[np.ix_(rest, rest)], across))


def _whole(parts: Parts, solver: Solver, solution: Solution) -> tuple[Floats, Bools]:
    """Return the whole system (m, m) with its priors, and the unknowns that are neither held nor at a bound."""
    tau, g = solver.scaled(solution.state), solution.state.g
    total = with_prior(np.sum([matrix for matrix, _ in parts], axis=0), tau)
    at_bound = np.abs(g) > SCAN.constancy.at_bound * SCAN.nuisance.max_tolerances * tau
    return total, np.concatenate(
        [~(solver.locked | at_bound), np.ones(len(total) - len(tau), dtype=np.bool_)]
    )
