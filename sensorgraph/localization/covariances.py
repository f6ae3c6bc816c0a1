"""Covariances of the key-frame poses of a map, from a bootstrap of the residuals.

Bootstrap sample m solves the reduced normal equations H x_m = g_m again, with

    g_m = sum_c e_cm scores_c / √(1 - h_c) + noise of the wheel edges.

The sum runs over clusters c, with random signs e_cm = ±1. The covariance is the mean of x_m x_mᵀ.

A cluster holds the residuals of one key frame on one patch. These share errors, since walls are not straight
and ranges are rounded; different clusters are independent. This is the wild cluster bootstrap (Cameron,
Gelbach and Miller 2008); the noise need not be known. The leverage h_c corrects for residuals made small by
the fit (MacKinnon and White 1985, HC2).

Poses are relative to the mean of all (inner constraints, Baarda 1973), since the frame of the map is
arbitrary.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.localization.refinement import ReducedSystem, Refined, conjugate_gradients
from sensorgraph.localization.settings import REFINEMENT, RefinementSettings
from sensorgraph.types import Floats

MAX_LEVERAGE = 0.8
"""Upper bound of the leverage of a cluster; near 1 the correction diverges."""


def key_frame_covariances(
    refined: Refined, rng: np.random.Generator, settings: RefinementSettings = REFINEMENT
) -> tuple[Floats, Floats]:
    """Return covariances (n_key, 3, 3) of x, y, phi in map, and their part that is not the frame's own noise."""
    system = refined.system
    n = system.n_frames
    draws = bootstrap_scores(system, rng, settings.samples)
    samples, _ = conjugate_gradients(
        system, draws, refined.preconditioner, settings.tolerance, settings.max_steps
    )
    deviations = without_rigid_motion(samples.reshape(n, 3, -1), refined.poses)
    covariances = np.einsum("fim,fjm->fij", deviations, deviations) / settings.samples
    own = np.linalg.inv(system.blocks + _diagonal(system) + 1e-9 * np.eye(3))
    values, vectors = np.linalg.eigh(covariances - own)
    shared = np.einsum("fij,fj,fkj->fik", vectors, np.maximum(values, 0.0), vectors)
    return covariances, shared


def _diagonal(system: ReducedSystem) -> Floats:
    """Return the diagonal blocks (n_frames, 3, 3) of the wheel information."""
    n = system.n_frames
    diagonals = np.zeros((n, 3, 3))
    for offset in range(-2, 3):
        values = system.wheels.diagonal(offset)
        rows = np.arange(len(values)) + max(-offset, 0)
        columns = rows + offset
        same = rows // 3 == columns // 3
        diagonals[rows[same] // 3, rows[same] % 3, columns[same] % 3] = values[same]
    return diagonals


def bootstrap_scores(system: ReducedSystem, rng: np.random.Generator, n_samples: int) -> Floats:
    """Return right-hand sides (3 n_frames, n_samples) drawn with resampled noise."""
    n, m = system.n_frames, len(system.inverse) // 2
    frames, patches = system.cluster_frame, system.cluster_patch
    leverage = (
        2.0 / np.bincount(patches, minlength=m)[patches] + 3.0 / np.bincount(frames, minlength=n)[frames]
    )
    grown = 1.0 / np.sqrt(1.0 - np.minimum(leverage, MAX_LEVERAGE))
    out = np.zeros((3 * n, n_samples))
    wheels = system.edges
    roots = np.linalg.cholesky(wheels.edges.information + 1e-12 * np.eye(3))
    for k in range(n_samples):
        sign = grown * rng.choice([-1.0, 1.0], size=len(frames))
        pose = np.column_stack([np.bincount(frames, sign * column, n) for column in system.scores.T]).ravel()
        line = np.column_stack(
            [np.bincount(patches, sign * column, m) for column in system.line_scores.T]
        ).ravel()
        out[:, k] = pose - system.coupling @ (system.inverse * line)
        noise = np.einsum("eij,ej->ei", roots, rng.normal(size=(len(wheels.edges), 3)))
        parameters = system.wheel_inverse @ np.einsum("eji,ej->i", wheels.by_parameters, noise)
        out[:, k] += system.edge_rows.T @ noise.ravel() - system.wheel_coupling @ parameters
    return out


def without_rigid_motion(deviations: Floats, poses: Floats) -> Floats:
    """Remove the best-fitting rigid motion from deviations (n, 3, m) of poses (n, 3)."""
    offset = poses[:, :2] - poses[:, :2].mean(axis=0)
    inertia = float((offset**2).sum())
    shift = deviations[:, :2].mean(axis=0)
    turn = np.einsum("fm,f->m", deviations[:, 1], offset[:, 0]) - np.einsum(
        "fm,f->m", deviations[:, 0], offset[:, 1]
    )
    turn = turn / inertia if inertia > 0 else deviations[:, 2].mean(axis=0)
    out = deviations.copy()
    out[:, 0] += turn * offset[:, 1, None] - shift[0]
    out[:, 1] -= turn * offset[:, 0, None] + shift[1]
    out[:, 2] -= turn
    return out
