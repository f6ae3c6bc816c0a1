"""Estimate the times of the rays in track pieces with many turns: Gauss-Newton steps with their covariances.

A time t of a ray moves its point by the velocity of the robot times t. With the residual r_k (`point_rows`), its derivative D_k
by the times in a basis, projected on the complement of poses and lines, and weights w_k, the change of the times and its
covariance, cluster-robust over the pieces p (Liang and Zeger 1986), are

    M = sum_k w_k D_kᵀ D_k + I / DELAY_SD²,  change = -M⁻¹ sum_k w_k D_kᵀ r_k,
    covariance = M⁻¹ (n / (n - 1) sum_p s_p s_pᵀ + I / DELAY_SD²) M⁻¹,  s_p = sum_(k in p) w_k D_kᵀ (r_k + D_k change).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.localization.point_rows import FramePoints, PointRows, sums_by
from sensorgraph.localization.pose_graph import PoseEdges
from sensorgraph.localization.refinement import ReducedSystem, conjugate_gradients, refine, sums_of
from sensorgraph.localization.scan_track import ScanTrack, turn_matrices
from sensorgraph.localization.scans import scan_points
from sensorgraph.localization.wheel_edges import WheelSteps
from sensorgraph.types import Floats, Ints

CLASSES = 4
"""Number of ray classes, by ray number modulo this: the maximum number of interlaced sweeps."""
PIECES = 40
"""Maximum number of track pieces used; the fastest-turning ones are chosen."""
MIN_PIECES = 8
"""Minimum number of pieces; fewer give no standard errors."""
PIECE_FRAMES = 12
"""Maximum number of key frames of a piece: about two turns of the robot, or 4 m."""
MIN_PIECE_FRAMES = 5
"""Minimum number of key frames of a piece; fewer do not determine its surfaces."""
MAX_RATE = 1.0
"""[rad/s] Upper limit of the turn rate that ranks a piece, because wheels slip in fast turns."""
MIN_RATE = 0.1
"""[rad/s] Minimum turn rate; at this rate 10 ms correspond to 0.06°."""
PIECE_OFFSET = 1000.0
"""[m] Offset between the maps of two pieces."""
VELOCITY_INTERVAL = 0.01
"""[s] Interval over which the velocity at a scan is computed."""
MAX_STEPS = 10
"""Maximum number of Gauss-Newton steps. Points are deskewed again before each, because smeared surfaces hide a fifth of the
effect; from the opposite direction most of it."""
DELAY_SD = 0.2
"""[s] Prior standard deviation of a delay."""
MIN_GAIN = 25.0
"""Minimum advantage, as twice the log likelihood, of times over all others: five standard errors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeEstimate:
    """Gauss-Newton step of the times of rays."""

    change: Floats
    """(k,) [s]"""
    covariance: Floats
    """(k, k) [s²] cluster-robust over the pieces."""
    information: Floats
    """(k, k) [1/s²] normal equations after projection on poses, lines and the offset of the ranges."""
    range_offset: float
    """[m] What the ranges are too long by ..."""
    range_offset_sd: float
    """[m] ... and its standard error."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedPieces:
    """Equations of the times of the rays around delays, n of them."""

    delays: Floats
    """(n_rays,) [s]"""
    poses: Floats
    """(n_frames, 3)"""
    n_pieces: int
    piece: Ints
    """(n,)"""
    rays: Ints
    """(n,)"""
    system: ReducedSystem
    preconditioner: sparse.csc_array
    speeds: Floats
    """(n,) [m/s] Derivatives of the residuals with respect to the time of their ray ..."""
    turned: Floats
    """(n,) [m/rad] ... its bearing ..."""
    facing: Floats
    """(n,) ... and its range."""

    @property
    def noise(self) -> float:
        """[m] Standard deviation of a point about its patch."""
        return float(1.0 / np.sqrt(np.median(self.system.rows.weight)))

    def estimate(self, basis: Floats, bearings: Floats | None = None) -> TimeEstimate:
        """Return the change of the delays in a basis (n_rays, k); with `bearings`, also that of these angles.

        The ranges may all have the same offset.

        Parameters
        ----------
        bearings : (n_rays, m) [rad] Further columns, of which the bearings have a sum.
        """
        rows, system = self.system.rows, self.system
        by = self.speeds[:, None] * basis[self.rays]
        if bearings is not None:
            by = np.column_stack([by, self.turned[:, None] * bearings[self.rays]])
        by = np.column_stack([by, self.facing])
        n, m, weight = system.n_frames, rows.n_patches, rows.weight
        k = by.shape[1]
        by_pose = np.column_stack(
            [sums_of(weight[:, None] * rows.by_pose * c[:, None], rows.frame, n) for c in by.T]
        )
        by_line = np.column_stack(
            [sums_of(weight[:, None] * rows.by_line * c[:, None], rows.patch, m) for c in by.T]
        )
        rhs = by_pose - system.coupling @ (system.inverse[:, None] * by_line)
        moved = conjugate_gradients(system, rhs, self.preconditioner)
        lines = system.inverse[:, None] * (by_line - system.transposed_coupling @ moved)
        own = (
            by
            - np.einsum("ni,nij->nj", rows.by_pose, moved.reshape(n, 3, k)[rows.frame])
            - np.einsum("ni,nij->nj", rows.by_line, lines.reshape(m, 2, k)[rows.patch])
        )  # derivatives after projection on poses and lines
        ridge = np.eye(k) * DELAY_SD**-2.0
        matrix = np.einsum("n,ni,nj->ij", weight, own, own) + ridge
        change = -np.linalg.solve(matrix, np.einsum("n,ni,n->i", weight, own, rows.residual))
        left = weight * (rows.residual + own @ change)
        scores = np.stack([sums_by(self.piece, left * own[:, j], self.n_pieces) for j in range(k)])
        inverse = np.linalg.inv(matrix)
        covariance = inverse @ (scores @ scores.T * self.n_pieces / (self.n_pieces - 1) + ridge) @ inverse
        return TimeEstimate(
            change=change[:-1],
            covariance=covariance[:-1, :-1],
            information=np.linalg.inv(inverse[:-1, :-1]),
            range_offset=-float(change[-1]),
            range_offset_sd=float(np.sqrt(covariance[-1, -1])),
        )


def sweep_basis(n_rays: int) -> Floats:
    """Return the share of each ray (n_rays, 4) in the sweep time and in the delays of ray classes 1 to 3."""
    ray = np.arange(n_rays)
    return np.column_stack([ray / n_rays, *(ray % CLASSES == k for k in range(1, CLASSES))])


@dataclass(frozen=True, kw_only=True, eq=False)
class TurningPieces:
    """Short track pieces with many turns, placed far apart so that each has its own map."""

    run: Run
    """The run, reduced to the key frames of the pieces."""
    piece: Ints
    """(n_frames,)"""
    poses: Floats
    """(n_frames, 3)"""
    wheels: WheelSteps
    graph: PoseEdges

    @staticmethod
    def of(run: Run, odometry: Floats | None, tracked: ScanTrack) -> TurningPieces | None:
        """Choose the pieces with the fastest turns; None if the robot hardly turned.

        In a short log the pieces are shorter, as their number determines the standard errors.
        """
        keys = tracked.key_frames
        m = min(PIECE_FRAMES, len(keys) // MIN_PIECES)
        if m < MIN_PIECE_FRAMES:
            return None
        heading = np.unwrap(tracked.poses[:, 2]) if odometry is None else odometry[:, 2]
        rate = np.abs(np.gradient(heading, np.arange(len(heading))))[keys] * run.sensor.rate
        starts = [k for k in range(0, len(keys) - m + 1, m) if tracked.piece[k] == tracked.piece[k + m - 1]]
        turning = np.array([(np.minimum(rate[k : k + m], MAX_RATE) ** 2).mean() for k in starts])
        chosen = np.sort(np.argsort(-turning)[:PIECES])
        if len(chosen) < MIN_PIECES or np.sqrt(np.median(turning[chosen])) < MIN_RATE:
            return None
        index = np.array([starts[k] for k in chosen])[:, None] + np.arange(m)
        frames, piece = index.ravel(), np.repeat(np.arange(len(chosen)), m)
        poses = tracked.poses[keys[frames]].copy()
        origin = poses[::m][piece]
        poses[:, :2] -= origin[:, :2]
        poses[:, 0] += PIECE_OFFSET * piece
        inner = np.flatnonzero(np.diff(piece) == 0)
        relative = compose(invert(poses[inner]), poses[inner + 1])
        steps = np.zeros((len(inner), 3))
        if odometry is not None:
            at = keys[frames[inner]], keys[frames[inner + 1]]
            steps = compose(invert(odometry[at[0]]), odometry[at[1]])
        return TurningPieces(
            run=replace(run, stamps=run.stamps[keys[frames]], ranges=run.ranges[keys[frames]]),
            piece=piece,
            poses=poses,
            wheels=WheelSteps(first=inner, steps=steps, has_odometry=odometry is not None),
            graph=PoseEdges(
                first=inner,
                second=inner + 1,
                relative=relative,
                information=tracked.edge_information[frames[inner]],
            ),
        )

    def linearised(self, delays: Floats, motion: Motion) -> LinearisedPieces:
        """Fit poses and lines, with delays (n_rays,) [s], and return the equations of the times of the rays."""
        scans = scan_points(self.run, motion, delays=delays)
        frames = FramePoints.of(scans, np.arange(scans.n_scans))
        graph = (self.graph, PoseEdges.of([]))
        refined = refine(frames, self.poses, self.wheels, graph, lambda done, total: None)
        poses, rows = refined.poses, refined.system.rows
        return LinearisedPieces(
            delays=delays,
            poses=poses,
            n_pieces=int(self.piece[-1]) + 1,
            piece=self.piece[rows.frame],
            rays=scans.rays[rows.index],
            system=refined.system,
            preconditioner=refined.preconditioner,
            speeds=self._speeds(rows, poses, motion),
            turned=_turned(rows, poses, scans.starts[rows.index]),
            facing=np.einsum("ni,ni->n", rows.normals, frames.placed(poses)[2][rows.index]),
        )

    def _speeds(self, rows: PointRows, poses: Floats, motion: Motion) -> Floats:
        """Return the derivatives (n,) [m/s] of the residuals with respect to the time of their ray."""
        now, after = motion.at(self.run.stamps), motion.at(self.run.stamps + VELOCITY_INTERVAL)
        velocity = compose(invert(now), after) / VELOCITY_INTERVAL
        in_map = np.einsum("nij,nj->ni", turn_matrices(poses[:, 2]), velocity)
        return np.asarray(np.einsum("ni,ni->n", rows.by_pose, in_map[rows.frame]))


def _turned(rows: PointRows, poses: Floats, starts: Floats) -> Floats:
    """Return the derivatives (n,) [m/rad] of the residuals with respect to the bearing, by the origins (n, 2) of rays."""
    heading = poses[rows.frame, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = cos * starts[:, 0] - sin * starts[:, 1], sin * starts[:, 0] + cos * starts[:, 1]
    return np.asarray(rows.by_pose[:, 2] + rows.by_pose[:, 0] * y - rows.by_pose[:, 1] * x)
