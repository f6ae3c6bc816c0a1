"""Joint refinement of poses and surfaces: all key frames share the surface patches.

Gauss-Newton minimises, over the poses x_f, the lines l_p of the patches and the wheel parameters q,

    sum_k weight_k residual_k(x_f, l_p)²  +  sum_e |r_e(x_a, x_b, q)|²_I_e  +  |q - q_0|²_prior.

Here k runs over points with Cauchy weights, and e over the wheel edges. The parameters q_0 are those of wheels
without error; each step linearises about the q that are identified from the current poses. Lines and wheel parameters are
eliminated exactly (Ruhnke et al. 2011; Liu and Zhang 2021), so that only poses remain. The reduced normal matrix, with the names of `ReducedSystem`, is

    blocks - coupling inverse couplingᵀ + wheels - wheel_coupling wheel_inverse wheel_couplingᵀ.

It is never formed: conjugate gradients solve the system H x = rhs, with the pose graph M as preconditioner (Hestenes and
Stiefel 1952). From the residual r = rhs - H x and z = M⁻¹ r, a step is

    α = rᵀz / pᵀH p,  x += α p,  r -= α H p,  z = M⁻¹ r,  p = z + (rᵀz / r'ᵀz') p,

where r' and z' are those before the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from logs.transforms import compose, difference, invert, wrap
from sensorgraph.localization.point_rows import (
    FramePoints,
    PointRows,
    ResidualClusters,
    clusters_of,
    point_rows,
    sums_by,
)
from sensorgraph.localization.pose_graph import PoseEdges
from sensorgraph.localization.scan_track import step_derivatives
from sensorgraph.localization.wheel_edges import WheelEdges, WheelSteps
from sensorgraph.types import Floats, Ints, Progress

ITERATIONS = 8
"""Number of Gauss-Newton steps; the patches are cut anew before each."""
SIDE = (0.30, 0.20)
"""[m] Initial spacing of the surface patches, and that in the last iterations."""
GATE = (0.25, 0.10)
"""[m] Distances from a patch's line within which points belong to it, in the same order."""
SIGMA = (0.10, 0.02)
"""[m] Scales of Cauchy's weight, which is 1/2 at twice this distance, in the same order. The first is large so that displaced
visits attract each other; the last is larger where a patch is rougher."""
TOLERANCE = 1e-3
"""Relative residual at which conjugate gradients stop ..."""
MAX_STEPS = 300
"""... and their maximum number of steps."""
MAX_TURN = 0.5
"""[rad] Largest turn of a key frame in one step: sin and cos are off their linearisation by an eighth."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedSystem:
    """Linearised problem at given poses. Points are summed by cluster (a key frame on a patch), wheels by edge."""

    n_frames: int
    blocks: Floats
    """(n_frames, 3, 3) Sum of weighted JᵀJ over the points of each frame."""
    coupling: sparse.csr_array
    """(3 n_frames, 2 n_patches) Weighted JᵀJ between poses and lines."""
    inverse: Floats
    """(2 n_patches,) Inverse of the diagonal normal matrix of the lines."""
    wheels: sparse.csr_array
    """(3 n_frames, 3 n_frames) Normal matrix of the wheel edges."""
    gradient: Floats
    """(3 n_frames,) Gradient of the cost after elimination."""
    clusters: ResidualClusters
    wheel_coupling: Floats
    """(3 n_frames, 3) Normal matrix between poses and wheel parameters."""
    wheel_inverse: Floats
    """(3, 3) Inverse of the normal matrix of the wheel parameters, including their prior."""
    edges: WheelEdges
    edge_rows: sparse.csr_array
    """(3 n_edges, 3 n_frames) Derivatives of the residuals of the edges."""
    edge_residuals: Floats
    """(n_edges, 3)"""
    rows: PointRows
    """The points on patches."""

    @cached_property
    def transposed_coupling(self) -> sparse.csc_array:
        """(2 n_patches, 3 n_frames) The transposed `coupling`."""
        return self.coupling.T

    def times(self, x: Floats) -> Floats:
        """Return the product of the reduced normal matrix and x (3 n_frames, m)."""
        own = np.einsum("fij,fjm->fim", self.blocks, x.reshape(self.n_frames, 3, -1)).reshape(x.shape)
        lines = self.inverse[:, None] * (self.transposed_coupling @ x)
        parameters = self.wheel_inverse @ (self.wheel_coupling.T @ x)
        out: Floats = own - self.coupling @ lines + self.wheels @ x - self.wheel_coupling @ parameters
        return out


def edge_system(poses: Floats, edges: PoseEdges) -> tuple[sparse.csr_array, Floats, sparse.csr_array]:
    """Return derivatives, residuals (n, 3) and weighted normal matrix of edges at given poses, in map axes.

    The residual of an edge is inv(x_a) ∘ x_b - relative.
    """
    n, m = len(poses), len(edges)
    a, b = poses[edges.first], poses[edges.second]
    residuals = difference(compose(invert(a), b), edges.relative)
    first, second = step_derivatives(a, b)
    rows = _block_matrix(np.arange(m), edges.first, first, (m, n)) + _block_matrix(
        np.arange(m), edges.second, second, (m, n)
    )
    weights = _block_matrix(np.arange(m), np.arange(m), edges.information, (m, m))
    return rows, residuals, sparse.csr_array(rows.T @ weights @ rows)


def _block_matrix(row: Ints, column: Ints, blocks: Floats, shape: tuple[int, int]) -> sparse.csr_array:
    """Return the sparse matrix of `shape` blocks with blocks (n, a, b) at (row, column)."""
    _, a, b = blocks.shape
    i = (a * row[:, None, None] + np.arange(a)[None, :, None] + np.zeros(b, dtype=np.intp)).ravel()
    j = (b * column[:, None, None] + np.arange(b)[None, None, :] + np.zeros((a, 1), dtype=np.intp)).ravel()
    return sparse.csr_array(sparse.coo_array((blocks.ravel(), (i, j)), shape=(a * shape[0], b * shape[1])))


def reduced_system(rows: PointRows, poses: Floats, wheels: WheelEdges) -> ReducedSystem:
    """Eliminate the lines of the patches and the wheel parameters."""
    n, m = len(poses), rows.n_patches
    frame, patch, weight = rows.frame, rows.patch, rows.weight
    jacobian, lines = rows.by_pose, rows.by_line
    blocks: Floats = np.stack(
        [sums_by(frame, weight * jacobian[:, i] * jacobian[:, j], n) for i in range(3) for j in range(3)],
        axis=-1,
    ).reshape(n, 3, 3)
    clusters, cluster = clusters_of(rows, poses)
    c = len(clusters.frame)
    mixed = np.stack(
        [sums_by(cluster, weight * jacobian[:, i] * lines[:, j], c) for i in range(3) for j in range(2)],
        axis=-1,
    ).reshape(c, 3, 2)
    own = np.column_stack([sums_by(patch, weight * lines[:, j] ** 2, m) for j in range(2)]).ravel()
    inverse = np.where(own > 0, 1.0 / np.where(own > 0, own, 1.0), 0.0)
    coupling = _block_matrix(clusters.frame, clusters.patch, mixed, (n, m))
    edge_rows, edge_residuals, wheel_matrix = edge_system(poses, wheels.edges)
    weighted = np.einsum("eij,ej->ei", wheels.edges.information, edge_residuals)
    by = wheels.by_parameters
    weighted_by = np.einsum("eij,ejk->eik", wheels.edges.information, by)
    wheel_coupling = edge_rows.T @ weighted_by.reshape(-1, 3)
    wheel_inverse = np.linalg.inv(np.einsum("eji,ejk->ik", by, weighted_by) + wheels.prior)
    wheel_gradient = edge_rows.T @ weighted.ravel() - wheel_coupling @ (
        wheel_inverse @ (np.einsum("eji,ej->i", by, weighted) + wheels.pull)
    )
    gradient = sums_of(clusters.scores, clusters.frame, n) - coupling @ (
        inverse * sums_of(clusters.line_scores, clusters.patch, m)
    )
    return ReducedSystem(
        n_frames=n,
        blocks=blocks,
        coupling=coupling,
        inverse=inverse,
        wheels=wheel_matrix,
        wheel_coupling=wheel_coupling,
        wheel_inverse=np.asarray(wheel_inverse, dtype=np.float64),
        gradient=gradient + wheel_gradient,
        clusters=clusters,
        edges=wheels,
        edge_rows=edge_rows,
        edge_residuals=edge_residuals,
        rows=rows,
    )


def sums_of(values: Floats, index: Ints, n: int) -> Floats:
    """Return the sums (d n,) of rows (k, d) by index."""
    return np.column_stack([sums_by(index, column, n) for column in values.T]).ravel()


def conjugate_gradients(
    system: ReducedSystem,
    rhs: Floats,
    preconditioner: sparse.csc_array,
    tolerance: float = TOLERANCE,
    max_steps: int = MAX_STEPS,
) -> Floats:
    """Return x (3 n_frames, m) of H x = rhs, with the reduced normal matrix H, by preconditioned conjugate gradients."""
    solve = splu(preconditioner).solve
    x = np.zeros_like(rhs)
    r = rhs.copy()
    z = solve(r)
    p = z.copy()
    rz = (r * z).sum(axis=0)
    limit = tolerance**2 * np.maximum(rz, 1e-300)
    for _ in range(max_steps):
        q = system.times(p)
        alpha = rz / np.maximum((p * q).sum(axis=0), 1e-300)
        x += alpha * p
        r -= alpha * q
        z = solve(r)
        new = (r * z).sum(axis=0)
        if (new <= limit).all():
            break
        p = z + (new / np.maximum(rz, 1e-300)) * p
        rz = new
    return x


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """Key frames after the joint refinement."""

    poses: Floats
    """(n_key, 3) [m, m, rad]"""
    last_step: Floats
    """(n_key, 3) [m, m, rad] The last step: how far the poses are from having converged."""
    system: ReducedSystem
    """Linearised problem at these poses."""
    preconditioner: sparse.csc_array
    frames: FramePoints


def refine(
    frames: FramePoints,
    poses: Floats,
    wheels: WheelSteps,
    graph: tuple[PoseEdges, PoseEdges],
    progress: Progress,
) -> Refined:
    """Refine poses (n_key, 3) and surfaces jointly.

    Parameters
    ----------
    wheels : Odometry steps between neighbouring key frames; each iteration estimates the wheel parameters
        again.
    graph : Steps of the track and closures of the pose graph; only the preconditioner depends on them.
    """
    poses, taken = poses.copy(), np.zeros_like(poses)
    for iteration in range(ITERATIONS + 1):
        share = min(iteration / (ITERATIONS - 3), 1.0)
        side, gate, sigma = (first * (last / first) ** share for first, last in (SIDE, GATE, SIGMA))
        rows = point_rows(frames, poses, side, gate, sigma)
        system = reduced_system(rows, poses, wheels.at(poses))
        preconditioner = pose_graph_matrix(system, poses, graph)
        if iteration == ITERATIONS:
            break
        step = conjugate_gradients(system, -system.gradient[:, None], preconditioner)
        taken = step.reshape(-1, 3)
        taken = taken * min(1.0, MAX_TURN / max(float(np.abs(taken[:, 2]).max()), 1e-9))
        poses = poses + taken
        poses[:, 2] = wrap(poses[:, 2])
        progress(iteration + 1, ITERATIONS + 1)
    return Refined(poses=poses, last_step=taken, system=system, preconditioner=preconditioner, frames=frames)


def pose_graph_matrix(
    system: ReducedSystem, poses: Floats, graph: tuple[PoseEdges, PoseEdges]
) -> sparse.csc_array:
    """Return the normal matrix of the pose graph, with weak priors that make it regular."""
    matrix = system.wheels
    for edges in graph:
        if len(edges):
            matrix = matrix + edge_system(poses, edges)[2]
    ties = np.einsum("fii->fi", system.blocks).ravel() * 1e-3 + 1e-3
    return sparse.csc_array(matrix + sparse.diags_array(ties))
