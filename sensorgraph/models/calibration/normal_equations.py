"""Joint adjustment of mount, ray terms and faces: one linear least-squares problem over all returns.

Residual of a return of ray j from face k at range rho, with den = n·u:

    e = e_mount + e_ray + e_face.
    Mount: e_mount = -(n·e_x dx + n·e_y dy) / den + rho (t·u) / den dyaw.
    Ray terms: e_ray = dc_0j + dc_1j rho + dS(v, q).
    Face: e_face = (shift + (s - s_k) turn) / den.

Unknowns: x of the sensor, y_k = (shift, turn) of face k. Normal equations:

    (matrix x + sum_k coupling_k' y_k = rhs),
    (coupling_k x + D_k y_k = face_rhs_k), with D_k = `face_matrix`.

Elimination of the faces (Schur complement):

    (matrix - sum_k coupling_k' D_k⁻¹ coupling_k) x = (rhs - sum_k coupling_k' D_k⁻¹ face_rhs_k).

Forward selection on these equations decides which unknowns of x are used: the term that reduces the squares most
comes first (error reduction ratio).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.kernel import outer_kernel
from sensorgraph.models.calibration.matching import Matches, Readings
from sensorgraph.models.calibration.pose_refinement import pose_slopes
from sensorgraph.models.calibration.ray_terms import MAX_OPTIC_RANGE, N_INCIDENCE, incidence_terms
from sensorgraph.models.faces.maximisation import moved_lines
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.types import Bools, Floats

MOUNT = slice(0, 3)
COMMON = slice(3, 5)  # constant and slope shared by all rays
INCIDENCE = slice(5, 5 + N_INCIDENCE)
N_COMMON = 5 + N_INCIDENCE
RIDGE = 1e-9
"""Added to the unit diagonal of the scaled equations, for nearly collinear unknowns."""
MIN_REMAINING = 1e-6
"""Minimum share of a term's information that is not explained by the selected terms."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalEquations:
    """Normal equations with the faces eliminated; unknowns: mount, common, incidence, constants, slopes."""

    matrix: Floats
    """(n, n) with n = N_COMMON + 2 n_rays."""
    rhs: Floats
    """(n,)"""
    n_returns: float
    face_inverse: Floats
    """(n_faces, 2, 2) inverse D_k⁻¹ of each face's block."""
    face_rhs: Floats
    """(n_faces, 2) right-hand side of each face."""
    coupling: Floats
    """(n_faces, 2, n) block between each face and the other unknowns."""
    centre: Floats
    """(n_faces,) [m] abscissa about which a face turns."""
    gauge_weights: Floats
    """(n_faces,) weights of the mean shift that is held at 0; all 0 where it is free."""

    def faces_moved(self, step: Floats) -> Floats:
        """Return y_k = D_k⁻¹ (face_rhs_k - coupling_k step): shift [m] and turn [rad] (n_faces, 2) for a step (n,)."""
        free = self.face_rhs - self.coupling @ step
        move: Floats = np.einsum("kij,kj->ki", self.face_inverse, free)
        if not self.gauge_weights.any():
            return move
        compliance = self.face_inverse[:, :, 0] * self.gauge_weights[:, None]  # D^-1 a
        return np.asarray(
            move - compliance * (self.gauge_weights @ move[:, 0]) / (self.gauge_weights @ compliance[:, 0]),
            dtype=np.float64,
        )


def normal_equations(
    readings: Readings, lasers: Floats, matches: Matches, faces: FaceSet, *, hold: bool
) -> NormalEquations:
    """Accumulate the normal equations; `hold` keeps the mean shift of all faces at 0 (the gauge)."""
    k, n = faces.n_faces, N_COMMON + 2 * len(readings.bearings)
    weight, face = matches.weight, np.maximum(matches.face, 0)
    total = np.maximum(np.bincount(face, weight * matches.den**2, k), 1e-9)
    centre = np.bincount(face, weight * matches.den**2 * np.nan_to_num(matches.at), k) / total
    matrix, rhs = np.zeros((n, n)), np.zeros(n)
    face_matrix, face_rhs, coupling = np.zeros((k, 2, 2)), np.zeros((k, 2)), np.zeros((k, 2, n))
    heading = lasers[readings.pose, 2]
    _accumulate(
        readings.ray, np.cos(heading), np.sin(heading), face, matches.rho, matches.den, matches.along, matches.at,
        matches.residual, weight, faces.normals, centre, matrix, rhs, face_matrix, face_rhs, coupling,
        np.empty(N_COMMON + 2), np.empty(N_COMMON + 2, np.int64),
    )  # fmt: skip
    matrix += np.tril(matrix, -1).T
    face_matrix += np.eye(2)  # [1/m², 1/rad²] prior that makes the block of a face without returns invertible
    inverse = np.asarray(np.linalg.inv(face_matrix), dtype=np.float64)
    flat = coupling.reshape(2 * k, n)
    solved = np.einsum("kij,kjn->kin", inverse, coupling).reshape(2 * k, n)
    matrix -= flat.T @ solved
    rhs -= solved.T @ face_rhs.ravel()
    gauge_weights = np.zeros(k)
    if hold and k:
        gauge_weights = total / total.sum()
        compliance = inverse[:, :, 0] * gauge_weights[:, None]
        constraint = np.einsum("ki,kin->n", compliance, coupling)
        constraint_norm = float(gauge_weights @ compliance[:, 0])
        matrix += np.outer(constraint, constraint) / constraint_norm
        rhs += constraint * float((compliance * face_rhs).sum()) / constraint_norm
    return NormalEquations(
        matrix=matrix, rhs=rhs, n_returns=float((weight > 0).sum()), face_inverse=inverse,
        face_rhs=face_rhs, coupling=coupling, centre=centre, gauge_weights=gauge_weights,
    )  # fmt: skip


def step_faces(faces: FaceSet, normal: NormalEquations, step: Floats) -> FaceSet:
    """Shift and turn the faces according to a step of the other unknowns."""
    shift, turn = normal.faces_moved(step).T
    return moved_lines(faces, shift, turn, normal.centre)


def select_terms(normal: NormalEquations, current: Floats, penalties: Floats) -> tuple[Floats, Bools, float]:
    """Select terms by forward selection, as long as the gain exceeds the complexity penalty.

    Parameters
    ----------
    current : (n,) Values of the unknowns at which the equations are linearised.
    penalties : (n,) [nats] Complexity penalties; inf: never select, -inf: always select.

    Returns
    -------
    new values (n,), mask of the selected terms (n,), and their gain over no terms [nats] minus the penalties
    """
    matrix = normal.matrix
    rhs = normal.rhs + matrix @ current
    chosen, total_gain = _forward(matrix, rhs, penalties)
    values = np.zeros(len(rhs))
    if chosen.any():
        part = matrix[np.ix_(chosen, chosen)]
        scale = np.sqrt(np.diag(part))
        scaled = part / scale[:, None] / scale + RIDGE * np.eye(len(part))
        values[chosen] = np.linalg.solve(scaled, rhs[chosen] / scale) / scale
    return values, chosen, float(total_gain)


def standard_errors(normal: NormalEquations, chosen: Bools) -> Floats:
    """Return the standard errors (n,) of the selected unknowns; nan for the others."""
    part = normal.matrix[np.ix_(chosen, chosen)]
    scale = np.sqrt(np.diag(part))
    inverse = np.linalg.inv(part / scale[:, None] / scale + RIDGE * np.eye(len(part)))
    out = np.full(len(chosen), np.nan)
    out[chosen] = np.sqrt(np.diag(inverse)) / scale
    return out


def _forward(matrix: Floats, rhs: Floats, penalties: Floats) -> tuple[Bools, float]:
    """Select unknowns by a greedy Cholesky factorisation: gain_i = residual_rhs_i² / (2 remaining_i) - penalties_i.

    Each step takes the unknown with the largest gain and eliminates it from all others.
    """
    remaining, residual_rhs = np.diag(matrix).copy(), rhs.copy()
    least, chosen = np.maximum(MIN_REMAINING * remaining, 1e-300), np.zeros(len(rhs), dtype=np.bool_)
    rows = np.zeros((len(rhs), len(rhs)))  # of the Cholesky factor, one for each selected unknown
    total_gain = 0.0
    for step in range(len(rhs)):
        can_be = ~chosen & (remaining >= least)
        gain = 0.5 * residual_rhs**2 / np.where(can_be, remaining, 1.0) - penalties
        at = int(np.argmax(np.where(can_be, gain, -np.inf)))
        if not (can_be[at] and gain[at] > 0):
            break
        scale = np.sqrt(remaining[at])
        rows[step] = (matrix[at] - rows[:step, at] @ rows[:step]) / scale
        amount = residual_rhs[at] / scale
        total_gain += 0.5 * amount**2 - (penalties[at] if np.isfinite(penalties[at]) else 0.0)
        chosen[at] = True
        remaining -= rows[step] ** 2
        residual_rhs -= rows[step] * amount
    return chosen, total_gain


@outer_kernel
def _accumulate(
    ray: Any, cos: Any, sin: Any, face: Any, rho: Any, den: Any, along: Any, at: Any, residual: Any,
    weight: Any, normals: Any, centre: Any, matrix: Any, rhs: Any, face_matrix: Any, face_rhs: Any,
    coupling: Any, x: Any, where: Any,
) -> Any:  # fmt: skip
    """Add the returns to the normal equations of the module: row (x, y0, y1) of a return, weight w and residual e.

    The upper half of `matrix` stays 0. `x` and `where` (N_COMMON + 2,) are memory.
    """
    n_rays = (len(rhs) - N_COMMON) // 2
    for a in range(N_COMMON):
        where[a] = a
    for i in range(len(ray)):
        w = weight[i]
        if w <= 0:
            continue
        f = face[i]
        x[0], x[1], x[2] = pose_slopes(normals[f], cos[i], sin[i], rho[i], den[i], along[i])
        x[3], x[4] = 1.0, rho[i]
        incidence_terms(1.0 - abs(den[i]), min(rho[i], MAX_OPTIC_RANGE) / MAX_OPTIC_RANGE, x[5:N_COMMON])
        x[N_COMMON], x[N_COMMON + 1] = 1.0, rho[i]
        where[N_COMMON], where[N_COMMON + 1] = N_COMMON + ray[i], N_COMMON + n_rays + ray[i]
        y0, y1 = 1.0 / den[i], (at[i] - centre[f]) / den[i]
        e = w * residual[i]
        face_matrix[f, 0, 0] += w * y0 * y0
        face_matrix[f, 0, 1] += w * y0 * y1
        face_matrix[f, 1, 0] += w * y0 * y1
        face_matrix[f, 1, 1] += w * y1 * y1
        face_rhs[f, 0] += e * y0
        face_rhs[f, 1] += e * y1
        for a in range(N_COMMON + 2):
            v = w * x[a]
            rhs[where[a]] += e * x[a]
            coupling[f, 0, where[a]] += v * y0
            coupling[f, 1, where[a]] += v * y1
            row = matrix[where[a]]
            for b in range(a + 1):
                row[where[b]] += v * x[b]
