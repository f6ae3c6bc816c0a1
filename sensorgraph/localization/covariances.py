"""Covariances of the key-frame poses of a map, from a bootstrap of the residuals.

Bootstrap sample m solves the reduced normal equations H x_m = g_m again, with

    g_m = sum_c e_cm scores_c / √(1 - h_c) + shared errors + noise of the wheel edges.

The sum runs over clusters c, with random signs e_cm = ±1. The covariance is the mean of x_m x_mᵀ.

A cluster holds the residuals of one key frame on one patch. This is the wild cluster bootstrap (Cameron, Gelbach
and Miller 2008); the noise need not be known. The leverage h_c corrects for residuals made small by the fit
(MacKinnon and White 1985, HC2). `surface_errors` draws the errors that neighbouring clusters share. The noise of
the wheel edges is multiplied by its long-run variance, since slip persists (Newey and West 1987).

Poses are relative to the mean of all key frames of their map (inner constraints, Baarda 1973), since the frame of a
map is arbitrary. Where the refinement has not converged, its last step is an error, too. The samples of the wheel
parameters are those that the poses x_m imply.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.localization.refinement import ReducedSystem, Refined, conjugate_gradients, sums_of
from sensorgraph.localization.settings import SIGNIFICANT
from sensorgraph.localization.surface_errors import SurfaceErrors, map_surface_errors, right_hand_sides
from sensorgraph.types import Floats, Ints

SAMPLES = 48
"""Number of bootstrap samples; the relative error of a standard deviation is about 1 / sqrt(2 · SAMPLES)."""
MAX_LAG = 12
"""[steps] Longest lag of the autocorrelation of the wheels."""
OPEN = 1e-3
"""Weight of a direction that scans do not determine, in the choice of the frame of a map."""
TURN_LENGTH = 0.1
"""[m/rad] Weight of headings relative to positions in that choice; it matters for a robot that stays in one place."""
MAX_LEVERAGE = 0.8
"""Upper bound of the leverage of a cluster; near 1 the correction diverges."""


def key_frame_covariances(
    refined: Refined, maps: Ints, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Return the covariances of the key frames and the standard deviations of the wheel parameters.

    Parameters
    ----------
    maps : (n_key,) Number of the map of each key frame; each has its own frame.

    Returns
    -------
    covariances : (n_key, 3, 3) Of x, y, phi in map.
    shared : (n_key, 3, 3) Their part that is not the frame's own noise.
    wheels : (3,) Standard deviations of distance scale, turn scale and heading bias.
    """
    system = refined.system
    n = system.n_frames
    errors = map_surface_errors(system, refined.preconditioner, rng)
    draws, wheel_draws = bootstrap_scores(system, errors, rng, SAMPLES)
    samples = conjugate_gradients(system, draws, refined.preconditioner)
    parameters = system.wheel_inverse @ (wheel_draws - system.wheel_coupling.T @ samples)
    deviations = np.concatenate([samples.reshape(n, 3, -1), refined.last_step[:, :, None]], axis=2)
    seen = system.rows.projections
    for number in np.unique(maps):
        own = maps == number
        counted = None if seen is None else seen[own]
        deviations[own] = without_rigid_motion(deviations[own], refined.poses[own], counted)
    drawn, step = deviations[:, :, :-1], deviations[:, :, -1]
    unsettled = np.einsum("fi,fj->fij", step, step)
    covariances = np.einsum("fim,fjm->fij", drawn, drawn) / SAMPLES
    alone = np.linalg.inv(system.blocks + _diagonal(system) + 1e-9 * np.eye(3))
    values, vectors = np.linalg.eigh(covariances - alone)
    shared = np.einsum("fij,fj,fkj->fik", vectors, np.maximum(values, 0.0), vectors)
    return covariances + unsettled, shared + unsettled, np.sqrt(np.square(parameters).mean(axis=1))


def _diagonal(system: ReducedSystem) -> Floats:
    """Return the diagonal blocks (n_frames, 3, 3) of the wheel information."""
    blocks = system.wheels.tobsr((3, 3))
    row = np.repeat(np.arange(system.n_frames), np.diff(blocks.indptr))
    out = np.zeros((system.n_frames, 3, 3))
    is_own = row == blocks.indices
    out[row[is_own]] = blocks.data[is_own]
    return out


def bootstrap_scores(
    system: ReducedSystem, errors: SurfaceErrors, rng: np.random.Generator, n_samples: int
) -> tuple[Floats, Floats]:
    """Return right-hand sides (3 n_frames, n_samples) drawn with resampled noise, and those (3, n_samples) of the wheel parameters."""
    n, m = system.n_frames, len(system.inverse) // 2
    clusters, wheels = system.clusters, system.edges
    frames, patches = clusters.frame, clusters.patch
    leverage = (
        2.0 / np.bincount(patches, minlength=m)[patches] + 3.0 / np.bincount(frames, minlength=n)[frames]
    )
    grown = np.sqrt(errors.white / (1.0 - np.minimum(leverage, MAX_LEVERAGE)))
    out, _ = right_hand_sides(system, errors.draw(clusters.middle, frames, rng, n_samples))
    roots = np.linalg.cholesky(wheels.edges.information + 1e-12 * np.eye(3))
    by_wheels = np.zeros((3, n_samples))
    scale = np.sqrt(long_run_variance(np.einsum("eji,ej->ei", roots, system.edge_residuals)))
    for k in range(n_samples):
        sign = (grown * rng.choice([-1.0, 1.0], size=len(frames)))[:, None]
        pose = sums_of(sign * clusters.scores, frames, n)
        line = sums_of(sign * clusters.line_scores, patches, m)
        out[:, k] += pose - system.coupling @ (system.inverse * line)
        noise = np.einsum("eij,ej->ei", roots, scale * rng.normal(size=(len(wheels.edges), 3)))
        prior = np.sqrt(np.diag(wheels.prior)) * rng.normal(size=3)
        by_wheels[:, k] = np.einsum("eji,ej->i", wheels.by_parameters, noise) - prior
        out[:, k] += system.edge_rows.T @ noise.ravel()
    return out - system.wheel_coupling @ (system.wheel_inverse @ by_wheels), by_wheels


def long_run_variance(steps: Floats) -> Floats:
    """Return the variance of a sum of steps (n, 3), relative to independent steps; at least 1.

    The estimate is 1 + 2 sum_l (1 - l / (L + 1)) r_l with the autocorrelations r_l up to lag L (Newey and West 1987).
    """
    out = np.ones(steps.shape[1])
    last = min(MAX_LAG, len(steps) // 4)
    clipped = np.clip(steps, -SIGNIFICANT, SIGNIFICANT)
    clipped = clipped - clipped.mean(axis=0, keepdims=True) if len(steps) else clipped
    square = (clipped**2).sum(axis=0)
    for lag in range(1, last + 1):
        products = (clipped[lag:] * clipped[:-lag]).sum(axis=0)
        out += 2 * (1 - lag / (last + 1)) * products / np.maximum(square, 1e-300)
    return np.maximum(out, 1.0)


def without_rigid_motion(deviations: Floats, poses: Floats, projections: Floats | None = None) -> Floats:
    """Remove the best-fitting rigid motion from deviations (n, 3, m) of poses (n, 3).

    Parameters
    ----------
    projections : (n, 3, 3) Projections of x, y, phi in map onto the directions that count; None: all directions.
    """
    n = len(poses)
    weights = np.broadcast_to(np.eye(3), (n, 3, 3)) if projections is None else projections + OPEN * np.eye(3)
    weights = weights * np.array([1.0, 1.0, TURN_LENGTH**2])
    offset = poses[:, :2] - poses[:, :2].mean(axis=0)
    rows = np.broadcast_to(np.eye(3), (n, 3, 3)).copy()
    rows[:, 0, 2], rows[:, 1, 2] = -offset[:, 1], offset[:, 0]
    matrix = np.einsum("nji,njk,nkl->il", rows, weights, rows)
    moment = np.einsum("nji,njk,nkm->im", rows, weights, deviations)
    motion = np.linalg.solve(matrix, moment)
    return np.asarray(deviations - np.einsum("nij,jm->nim", rows, motion))
