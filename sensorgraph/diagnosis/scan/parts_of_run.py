"""Normal equations of parts of a run, in time: whether what the whole run says is what its parts say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solution, Solver
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Floats, Ints

Parts = Sequence[tuple[Floats, Floats]]
"""Normal equations (matrix (m, m), right (m,)) of parts of a run."""


def parts_of_run(fitted: Fitted) -> list[Ints]:
    """Return the scans of each part of the run."""
    return np.array_split(np.arange(fitted.solver.data.n_scans), SCAN.constancy.n_parts)


def equations_of_parts(solver: Solver, solution: Solution, rows: Sequence[Ints]) -> Parts:
    """Return the normal equations of parts of the run."""
    weight, scale = solution.responsibilities.weight, solution.state.pose_scale
    systems = [solver.of_scans(some).assemble(weight[some], scale) for some in rows]
    return [(system.matrix, system.right) for system in systems]


def inverse_of_whole(parts: Parts, solver: Solver, solution: Solution) -> Floats:
    """Return the inverse (m, m) of the whole system with its priors; 0 for what is held or at its bound."""
    tau, g = solver.scaled(solution.state), solution.state.g
    total = np.sum([matrix for matrix, _ in parts], axis=0)
    n, k = len(tau), len(total)
    total[np.arange(k), np.arange(k)] += np.concatenate([1 / tau**2, np.full(k - n, 1e-9)])
    at_bound = np.abs(g) > SCAN.constancy.at_bound * SCAN.nuisance.max_tolerances * tau
    free = np.concatenate([~(solver.locked | at_bound), np.ones(k - n, dtype=np.bool_)])
    out = np.zeros((k, k))
    out[np.ix_(free, free)] = np.linalg.inv(total[np.ix_(free, free)])
    return out
