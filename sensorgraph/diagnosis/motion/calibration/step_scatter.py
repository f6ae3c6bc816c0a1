"""Covariance of the steps between key frames that the scans alone have measured."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from logs.transforms import invert
from sensorgraph.localization.pose_graph import PoseEdges
from sensorgraph.localization.refinement import ReducedSystem, Refined, edge_system
from sensorgraph.types import Floats


def step_scatter(found: Refined, steps: Floats, mount: Floats) -> Floats:
    """Return the covariance (3, n, n) [m², m², rad²] of ahead, left and turn of all n steps, in the laser frame.

        covariance = E (H⁻¹ + H⁻¹ G Gᵀ H⁻¹) Eᵀ

    H is the normal matrix of the poses, with the lines of the patches eliminated, and E the derivative of the steps.
    The columns of G are the scores of the clusters (a key frame on a patch), whose residuals share errors. H⁻¹ alone
    is the covariance of independent points: it remains where a corridor has no residuals along itself.

    Parameters
    ----------
    steps : (n, 3) [m, m, rad] from key frame to key frame, in base_link.
    mount : (3,) [m, m, rad]
    """
    system, n = found.system, len(steps)
    inverse = np.linalg.inv(_normal_matrix(system) + 1e-9 * np.eye(3 * system.n_frames))
    first = np.arange(n)
    chain = PoseEdges(
        first=first, second=first + 1, relative=steps, information=np.tile(np.eye(3), (n, 1, 1))
    )
    rows = _at_laser(edge_system(found.poses, chain)[0].toarray().reshape(n, 3, -1), steps, mount)
    moved = rows.transpose(1, 0, 2) @ inverse  # (3, n, 3 n_frames)
    shared = moved @ _cluster_scores(system)
    return np.asarray(moved @ rows.transpose(1, 2, 0) + shared @ shared.transpose(0, 2, 1))


def _normal_matrix(system: ReducedSystem) -> Floats:
    """Return the reduced normal matrix of the poses (3 n_frames, 3 n_frames), dense."""
    return system.times(np.eye(3 * system.n_frames))


def _cluster_scores(system: ReducedSystem) -> Floats:
    """Return the score of each cluster by the poses (3 n_frames, n_clusters), with the lines eliminated."""
    c = np.arange(len(system.clusters.frame))
    own = sparse.csr_array(
        (
            system.clusters.scores.ravel(),
            ((3 * system.clusters.frame[:, None] + np.arange(3)).ravel(), np.repeat(c, 3)),
        ),
        shape=(3 * system.n_frames, len(c)),
    )
    lines = sparse.csr_array(
        (
            system.clusters.line_scores.ravel(),
            ((2 * system.clusters.patch[:, None] + np.arange(2)).ravel(), np.repeat(c, 2)),
        ),
        shape=(len(system.inverse), len(c)),
    )
    return np.asarray((own - system.coupling @ (sparse.diags_array(system.inverse) @ lines)).toarray())


def _at_laser(rows: Floats, steps: Floats, mount: Floats) -> Floats:
    """Convert derivatives (n, 3, k) of steps of base_link into those of the steps of the laser."""
    at = invert(mount[None])[0]
    cos, sin = np.cos(at[2]), np.sin(at[2])
    c, s = np.cos(steps[:, 2]), np.sin(steps[:, 2])
    lever = np.stack([-s * mount[0] - c * mount[1], c * mount[0] - s * mount[1]], axis=1)
    shift = rows[:, :2] + lever[:, :, None] * rows[:, 2:]
    turned = np.einsum("ij,njk->nik", np.array([[cos, -sin], [sin, cos]]), shift)
    return np.concatenate([turned, rows[:, 2:]], axis=1)
