"""Joint adjustment of mount, ray terms and faces: one linear least squares over all returns.

A return of ray j from face k at range rho, n·u = den, differs from what is predicted by

    e = -(n·e_x dx + n·e_y dy) / den + rho (t·u) / den dyaw + dc_0j + dc_1j rho + dS(v, q) + (shift + (s - s_k) turn) / den

The faces' two numbers each are eliminated first (Schur complement); which of the others are worth having is decided
by forward selection on the normal equations (ERR: the term that explains most goes first).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.kernel import kernel
from sensorgraph.models.calibration.matching import Matches, Readings
from sensorgraph.models.calibration.ray_terms import MAX_OPTIC_RANGE, N_INCIDENCE, incidence_terms
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.types import Bools, Floats

MOUNT = slice(0, 3)
COMMON = slice(3, 5)  # constant and slope of all rays together
INCIDENCE = slice(5, 5 + N_INCIDENCE)
N_COMMON = 5 + N_INCIDENCE
ADJUSTMENT = CALIBRATION.adjustment
MIN_REST = ADJUSTMENT.min_rest


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalEquations:
    """Normal equations after the faces were eliminated; unknowns: mount, common, incidence, constants, slopes."""

    matrix: Floats
    """(n, n), n = N_COMMON + 2 n_rays"""
    rhs: Floats
    """(n,)"""
    n_returns: float
    face_inverse: Floats
    """(n_faces, 2, 2) inverse of each face's own block."""
    face_rhs: Floats
    """(n_faces, 2)"""
    coupling: Floats
    """(n_faces, 2, n)"""
    centre: Floats
    """(n_faces,) [m] abscissa about which a face turns."""
    gauge_weights: Floats
    """(n_faces,) weights of the mean shift that stays 0; all 0 where it is free."""

    def faces_moved(self, step: Floats) -> Floats:
        """Return shift [m] and turn [rad] (n_faces, 2) that belong to the step (n,) of the others."""
        free = self.face_rhs - self.coupling @ step
        move: Floats = np.einsum("kij,kj->ki", self.face_inverse, free)
        if not self.gauge_weights.any():
            return move
        stiff = self.face_inverse[:, :, 0] * self.gauge_weights[:, None]  # D^-1 a
        return np.asarray(
            move - stiff * (self.gauge_weights @ move[:, 0]) / (self.gauge_weights @ stiff[:, 0]),
            dtype=np.float64,
        )


def normal_equations(
    readings: Readings, lasers: Floats, matches: Matches, faces: FaceSet, *, hold: bool
) -> NormalEquations:
    """Add up the normal equations; `hold` keeps the mean shift of all faces at 0 (the gauge)."""
    k, n = faces.n_faces, N_COMMON + 2 * len(readings.bearings)
    weight, face = matches.weight, np.maximum(matches.face, 0)
    total = np.maximum(np.bincount(face, weight * matches.den**2, k), 1e-9)
    centre = np.bincount(face, weight * matches.den**2 * np.nan_to_num(matches.at), k) / total
    matrix, right = np.zeros((n, n)), np.zeros(n)
    own, own_right, across = np.zeros((k, 2, 2)), np.zeros((k, 2)), np.zeros((k, 2, n))
    heading = lasers[readings.pose, 2]
    _accumulate(
        readings.ray, np.cos(heading), np.sin(heading), face, matches.rho, matches.den, matches.along, matches.at,
        matches.residual, weight, faces.normals, centre, matrix, right, own, own_right, across,
    )  # fmt: skip
    matrix += np.tril(matrix, -1).T
    own[:, 0, 0] += 1.0  # [1/m²] nothing is known of a face without returns
    own[:, 1, 1] += ADJUSTMENT.turn_arm**2
    inverse = np.asarray(np.linalg.inv(own), dtype=np.float64)
    flat = across.reshape(2 * k, n)
    solved = np.einsum("kij,kjn->kin", inverse, across).reshape(2 * k, n)
    matrix -= flat.T @ solved
    right -= solved.T @ own_right.ravel()
    held = np.zeros(k)
    if hold and k:
        held = total / total.sum()
        stiff = inverse[:, :, 0] * held[:, None]
        pull = np.einsum("ki,kin->n", stiff, across)
        give = float(held @ stiff[:, 0])
        matrix += np.outer(pull, pull) / give
        right += pull * float((stiff * own_right).sum()) / give
    return NormalEquations(
        matrix=matrix,
        rhs=right,
        n_returns=float((weight > 0).sum()),
        face_inverse=inverse,
        face_rhs=own_right,
        coupling=across,
        centre=centre,
        gauge_weights=held,
    )


def step_faces(faces: FaceSet, normal: NormalEquations, step: Floats) -> FaceSet:
    """Shift and turn faces by what belongs to a step of the other unknowns."""
    shift, turn = normal.faces_moved(step).T
    turn = np.clip(turn, -ADJUSTMENT.max_turn, ADJUSTMENT.max_turn)
    normals, tangents, c = faces.normals, faces.tangents, normal.centre
    centre = normals * (faces.offsets + shift)[:, None] + tangents * c[:, None]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    turned = cos * normals - sin * tangents
    along = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
    slide = (along * centre).sum(axis=1) - c
    return faces._replace(
        normals=turned,
        offsets=(turned * centre).sum(axis=1),
        edges=faces.edges + np.repeat(slide, np.diff(faces.first)),
    )


def select_terms(normal: NormalEquations, current: Floats, prices: Floats) -> tuple[Floats, Bools, float]:
    """Choose terms forward, the one that explains most first, as long as it is worth its price.

    Parameters
    ----------
    current : (n,) values of the unknowns that the normal equations are linearised about
    prices : (n,) [nats]; inf: never, -inf: always

    Returns
    -------
    new values (n,), which were chosen, and the nats they are worth over none, prices taken off
    """
    matrix = normal.matrix
    right = normal.rhs + matrix @ current
    chosen, worth = _forward(matrix, right, prices)
    values = np.zeros(len(right))
    if chosen.any():
        part = matrix[np.ix_(chosen, chosen)]
        scale = np.sqrt(np.diag(part))
        scaled = part / scale[:, None] / scale + ADJUSTMENT.ridge * np.eye(len(part))
        values[chosen] = np.linalg.solve(scaled, right[chosen] / scale) / scale
    return values, chosen, float(worth)


def standard_errors(normal: NormalEquations, chosen: Bools) -> Floats:
    """Return the standard errors (n,) of chosen unknowns; nan for the others."""
    part = normal.matrix[np.ix_(chosen, chosen)]
    scale = np.sqrt(np.diag(part))
    inverse = np.linalg.inv(part / scale[:, None] / scale + ADJUSTMENT.ridge * np.eye(len(part)))
    out = np.full(len(chosen), np.nan)
    out[chosen] = np.sqrt(np.diag(inverse)) / scale
    return out


@kernel
def _forward(matrix: Any, right: Any, prices: Any) -> Any:
    """Greedy Cholesky: each step takes the unknown that lowers the squares most and takes it out of all others."""
    n = len(right)
    left, rest, whole = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        left[i] = whole[i] = matrix[i, i]
        rest[i] = right[i]
    chosen = np.zeros(n, np.bool_)
    rows = np.zeros((n, n))  # of the Cholesky factor, one for every chosen unknown
    worth = 0.0
    for step in range(n):
        best, at = 0.0, -1
        for i in range(n):
            if chosen[i] or left[i] < MIN_REST * whole[i] or left[i] <= 0 or prices[i] == np.inf:
                continue
            gain = 1e300 if prices[i] == -np.inf else 0.5 * rest[i] ** 2 / left[i] - prices[i]
            if gain > best:
                best, at = gain, i
        if at < 0:
            break
        row = rows[step]
        for i in range(n):
            row[i] = matrix[at, i]
        for k in range(step):
            for i in range(n):
                row[i] -= rows[k, at] * rows[k, i]
        for i in range(n):
            row[i] /= np.sqrt(left[at])
        amount = rest[at] / np.sqrt(left[at])
        worth += 0.5 * amount**2 - (prices[at] if prices[at] > -1e300 else 0.0)
        chosen[at] = True
        for i in range(n):
            left[i] -= row[i] ** 2
            rest[i] -= row[i] * amount
    return chosen, worth


@kernel
def _accumulate(
    ray: Any,
    cos: Any,
    sin: Any,
    face: Any,
    rho: Any,
    den: Any,
    along: Any,
    at: Any,
    residual: Any,
    weight: Any,
    normals: Any,
    centre: Any,
    matrix: Any,
    right: Any,
    own: Any,
    own_right: Any,
    across: Any,
) -> Any:
    n_rays = (len(right) - N_COMMON) // 2
    x, where = np.empty(N_COMMON + 2), np.empty(N_COMMON + 2, np.int64)
    for a in range(N_COMMON):
        where[a] = a
    for i in range(len(ray)):
        w = weight[i]
        if w <= 0:
            continue
        f = face[i]
        nx, ny = normals[f, 0], normals[f, 1]
        x[0] = -(nx * cos[i] + ny * sin[i]) / den[i]
        x[1] = -(ny * cos[i] - nx * sin[i]) / den[i]
        x[2] = rho[i] * along[i] / den[i]
        x[3], x[4] = 1.0, rho[i]
        incidence_terms(1.0 - abs(den[i]), min(rho[i], MAX_OPTIC_RANGE) / MAX_OPTIC_RANGE, x[5:N_COMMON])
        x[N_COMMON], x[N_COMMON + 1] = 1.0, rho[i]
        where[N_COMMON], where[N_COMMON + 1] = N_COMMON + ray[i], N_COMMON + n_rays + ray[i]
        y0, y1 = 1.0 / den[i], (at[i] - centre[f]) / den[i]
        e = w * residual[i]
        own[f, 0, 0] += w * y0 * y0
        own[f, 0, 1] += w * y0 * y1
        own[f, 1, 0] += w * y0 * y1
        own[f, 1, 1] += w * y1 * y1
        own_right[f, 0] += e * y0
        own_right[f, 1] += e * y1
        for a in range(N_COMMON + 2):
            v = w * x[a]
            right[where[a]] += e * x[a]
            across[f, 0, where[a]] += v * y0
            across[f, 1, where[a]] += v * y1
            row = matrix[where[a]]
            for b in range(a + 1):
                row[where[b]] += v * x[b]
