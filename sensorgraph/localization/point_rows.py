"""Linearised residuals of points on surface patches, with respect to poses and lines.

With patch p of point k, the residual is r_k = n_p · (T(pose) point_k - centre_p). `by_pose` and `by_line`
hold its derivatives. A cluster holds the residuals of the points of one key frame on one patch.

A range has an error e along its ray u, so that r_k = e n_p · u. A derivative at the measured point contains e, too: by the turn of
the robot, n_p x (point_k - position) has e n_p x u. The product of both has the mean var(e) (n_p · u) (n_p x u), however many
points there are (errors in variables; Fuller 1987, Measurement Error Models). So derivatives are taken where the ray meets the
line, at the distance r_k / (n_p · u) before the point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.localization.patches import assign, cut_patches
from sensorgraph.localization.scan_track import determines_all
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import MIN_NOISE, SIGNIFICANT
from sensorgraph.robust import robust_sigma
from sensorgraph.types import Floats, Ints

SHRINKAGE = 10.0
"""Weight, in points, of the noise of all patches in the noise of one."""
ROUNDNESS = 0.25
"""Ratio of the variances across and along above which points form no patch."""
MIN_POINTS = 4.0
"""Minimum number of points of a patch."""
LEAST_FACING = 0.1
"""Cosine of the largest angle of incidence, 84°, at which all of a residual is an error of the range."""
NEAR = 16
"""Number of key frames before and after whose patches determine the direction of a corridor."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FramePoints:
    """Points of all key frames, in order."""

    frame: Ints
    """(n,) Number of the key frame."""
    points: Floats
    """(n, 2) [m] in base_link."""
    normals: Floats
    """(n, 2) Normals in base_link."""
    rays: Floats
    """(n, 2) Unit vectors along the rays, in base_link."""
    projections: Floats | None = None
    """(n_frames, 3, 3) Projection of a motion ahead, left and turn onto the directions that the scan determines;
    None: all."""

    @staticmethod
    def of(scans: ScanPoints, key_frames: Ints, projections: Floats | None = None) -> FramePoints:
        """Take the points of some scans."""
        slices = [scans.of(int(k)) for k in key_frames]
        index = np.concatenate([np.arange(s.start, s.stop) for s in slices] or [np.zeros(0, np.intp)])
        counts = [s.stop - s.start for s in slices]
        rays = scans.points[index] - scans.starts[index]
        return FramePoints(
            frame=np.repeat(np.arange(len(key_frames)), counts),
            points=scans.points[index],
            normals=scans.normals[index],
            rays=rays / np.maximum(np.hypot(*rays.T), 1e-9)[:, None],
            projections=None if projections is None or determines_all(projections).all() else projections,
        )

    def placed(self, poses: Floats) -> tuple[Floats, Floats, Floats]:
        """Return points, normals and rays (n, 2) in map."""
        pose = poses[self.frame]
        cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        points, normals, rays = (
            np.column_stack([cos * x - sin * y, sin * x + cos * y])
            for x, y in (self.points.T, self.normals.T, self.rays.T)
        )
        return points + pose[:, :2], normals, rays


@dataclass(frozen=True, kw_only=True, eq=False)
class PointRows:
    """Points on patches, with the derivatives of their residuals with respect to pose and line."""

    index: Ints
    """(n,) Index among the points of all frames."""
    frame: Ints
    """(n,)"""
    patch: Ints
    """(n,)"""
    n_patches: int
    points: Floats
    """(n, 2) [m] in map."""
    normals: Floats
    """(n, 2) Normals of the lines of the patches."""
    weight: Floats
    """(n,) [1/m²]"""
    residual: Floats
    """(n,) [m] Distance from the line."""
    by_pose: Floats
    """(n, 3) Derivative of the residual with respect to the pose."""
    by_line: Floats
    """(n, 2) Derivative with respect to offset and direction of the line."""
    surface: Floats
    """(n_points, 2) [m] All points in map; a point with a patch is projected onto its line."""
    projections: Floats | None
    """(n_frames, 3, 3) Projection of a motion x, y, phi in map onto the directions that the scan determines; None:
    all."""


def point_rows(frames: FramePoints, poses: Floats, side: float, gate: float, sigma: float) -> PointRows:
    """Cut the surfaces into patches, and linearise the residuals of the points at the poses (n_frames, 3)."""
    points, normals, rays = frames.placed(poses)
    surface = points.copy()
    patch_map = cut_patches(points, normals, side, ROUNDNESS)
    patch = assign(points, normals, patch_map, gate)
    used = np.flatnonzero(patch >= 0)
    patch, frame, points = patch[used], frames.frame[used], points[used]
    weight, residual, along, normal = _fit_patches(points, patch, frame, patch_map.normals, sigma)
    kept = weight > 0
    surface[used[kept]] -= residual[kept, None] * normal[kept]
    patch, frame, points = patch[kept], frame[kept], points[kept]
    weight, residual, along, normal = weight[kept], residual[kept], along[kept], normal[kept]
    error = _range_errors(residual, normal, rays[used[kept]])
    along = _centred(along + error[:, 0] * normal[:, 1] - error[:, 1] * normal[:, 0], patch, weight)
    lever = points - error - poses[frame, :2]
    turn = normal[:, 1] * lever[:, 0] - normal[:, 0] * lever[:, 1]
    by_pose = np.column_stack([normal, turn])
    projections = None
    if frames.projections is not None:
        distance = np.hypot(*lever.T)
        projections = _projections(by_pose, weight, frame, distance, frames.projections, poses)
        by_pose = np.einsum("ni,nij->nj", by_pose, projections[frame])
    return PointRows(
        index=used[kept],
        frame=frame,
        patch=patch,
        n_patches=len(patch_map.middles),
        points=points,
        normals=normal,
        weight=weight,
        residual=residual,
        by_pose=by_pose,
        by_line=np.column_stack([-np.ones(len(along)), -along]),
        surface=surface,
        projections=projections,
    )


def _range_errors(residual: Floats, normal: Floats, ray: Floats) -> Floats:
    """Return the vectors (n, 2) [m] from the line of a patch to its points, along their rays (n, 2)."""
    facing = (normal * ray).sum(axis=1)
    facing = np.copysign(np.maximum(np.abs(facing), LEAST_FACING), facing)
    return np.asarray((residual / facing)[:, None] * ray)


def _centred(values: Floats, patch: Ints, weight: Floats) -> Floats:
    """Return values (n,) without the weighted mean of their patch: offset and direction of a line become independent."""
    total = np.bincount(patch, weight)
    return values - (np.bincount(patch, weight * values) / np.where(total > 0, total, 1.0))[patch]


def _projections(
    by_pose: Floats, weight: Floats, frame: Ints, distance: Floats, tracked: Floats, poses: Floats
) -> Floats:
    """Return the projections (n_frames, 3, 3) of a motion x, y, phi in map onto the directions that scans determine.

    The number of open directions is that of the track (n_frames, 3, 3). One of them is estimated from the patches around
    `NEAR` key frames, since a small error would let a long motion along a wall cross it. It is a motion along straight walls,
    or a turn about a point, as in a corridor that is a ring and in a round hall.

    Parameters
    ----------
    poses : (n_frames, 3) [m, m, rad]
    """
    n, scaled = len(tracked), np.sqrt(weight)[:, None] * by_pose
    open_frames = np.flatnonzero(~determines_all(tracked))
    blocks, square = np.zeros((n, 3, 3)), sums_by(frame, distance**2, n)
    count = np.maximum(np.bincount(frame, minlength=n), 1)
    for i in range(3):
        for j in range(3):
            blocks[:, i, j] = sums_by(frame, scaled[:, i] * scaled[:, j], n)
    out = np.broadcast_to(np.eye(3), (n, 3, 3)).copy()
    for k in open_frames:
        n_open = 3 - round(float(np.trace(tracked[k])))
        near = open_frames[np.abs(open_frames - k) <= NEAR] if n_open == 1 else np.array([k])
        moved = np.broadcast_to(np.eye(3), (len(near), 3, 3)).copy()  # by a turn about key frame k
        moved[:, 0, 2], moved[:, 1, 2] = -(poses[near, 1] - poses[k, 1]), poses[near, 0] - poses[k, 0]
        each = moved.transpose(0, 2, 1) @ blocks[near] @ moved
        is_straight = n_open == 1 and tracked[k, 2, 2] > 0.5 and _is_straight(each)
        used = 2 if is_straight else 3
        lever = np.sqrt(square[k] / count[k])
        scale = np.array([1.0, 1.0, 1.0 / max(lever, 1e-3)])[:used]
        around = each[:, :used, :used].sum(axis=0)
        vectors = np.linalg.eigh(around * np.outer(scale, scale))[1][:, :n_open]
        out[k, :used, :used] -= scale[:, None] * (vectors @ vectors.T) / scale
    return out


def _is_straight(blocks: Floats) -> bool:
    """Tell whether the open motion of key frames does not turn, by their normal matrices (m, 3, 3) of one twist.

    The turn that fits the motion along the walls best is compared with its standard error. Neighbouring key frames see the
    same patches with the same errors, so that the scores of m frames count as one.
    """
    total = blocks.sum(axis=0)
    along = np.append(np.linalg.eigh(total[:2, :2])[1][:, 0], 0.0)
    turn = -total[2] @ along / max(total[2, 2], 1e-12)
    scores = blocks[:, 2] @ (along + [0.0, 0.0, turn])
    error = np.sqrt(len(blocks) * (scores**2).sum()) / max(total[2, 2], 1e-12)
    return bool(abs(turn) < SIGNIFICANT * error)


def _fit_patches(
    points: Floats, patch: Ints, frame: Ints, normals: Floats, sigma: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Fit the line of each patch to its points by iteratively reweighted least squares.

    The weight of a point is 1 / (1 + r² / (4 max(scale, sigma²))); the variance `scale` of a patch shrinks
    towards that of all patches.

    Returns
    -------
    Weights (n,) [1/m²], residuals (n,) [m], positions along the patch (n,) [m], and normals (n, 2).
    """
    m = len(normals)
    soft = np.ones(len(points))
    scale = np.full(m, sigma**2)
    residual = along = np.zeros(len(points))
    normal = normals[patch]
    for _ in range(3):
        total = np.bincount(patch, soft, m) + 1e-12
        centre = np.column_stack([np.bincount(patch, soft * points[:, i], m) / total for i in range(2)])
        off = points - centre[patch]
        xx, xy, yy = (
            np.bincount(patch, soft * off[:, i] * off[:, j], m) / total for i, j in ((0, 0), (0, 1), (1, 1))
        )
        angle = 0.5 * np.arctan2(2 * xy, xx - yy)
        line_normals = np.column_stack([-np.sin(angle), np.cos(angle)])
        half, spread = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
        across, length = np.maximum(half - spread, 0.0), half + spread
        normal = line_normals[patch]
        residual = np.einsum("ij,ij->i", off, normal)
        along = -off[:, 0] * normal[:, 1] + off[:, 1] * normal[:, 0]
        noise = min(max(robust_sigma(residual) if len(residual) else sigma, MIN_NOISE), sigma)
        count = np.bincount(patch, minlength=m)
        scale = (SHRINKAGE * noise**2 + total * across) / (SHRINKAGE + total)
        soft = 1.0 / (1.0 + residual**2 / (4.0 * np.maximum(scale, sigma**2)[patch]))
    # a patch of one frame does not constrain poses, a round one has no direction
    pairs = np.unique(frame * m + patch)
    n_frames = np.bincount(pairs % m, minlength=m)
    good = (n_frames > 1) & (across < ROUNDNESS * length) & (count >= MIN_POINTS)
    residual = _centred(residual, patch, soft)  # with the last weights
    weight = np.where(good[patch], soft / np.maximum(scale, MIN_NOISE**2)[patch], 0.0)
    return weight, residual, along, normal


def sums_by(index: Ints, values: Floats, n: int) -> Floats:
    """Return the sums (n,) of values (k,) by index."""
    return np.asarray(np.bincount(index, values, n), dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class MeanResiduals:
    """Mean residual of each cluster, in the order of frame and patch."""

    frame: Ints
    """(n,) Key frame."""
    patch: Ints
    """(n,) Patch."""
    count: Ints
    """(n,) Number of points."""
    middle: Floats
    """(n, 2) [m] Mean of the points in map."""
    facing: Floats
    """(n, 2) Unit normal of the patch towards the robot."""
    residual: Floats
    """(n,) Mean residual towards the robot, in standard deviations of a point."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualClusters(MeanResiduals):
    """Sums over the points of each cluster."""

    weight: Floats
    """(n,) [1/m²] Sum of the weights."""
    scores: Floats
    """(n, 3) Sum of weighted residuals times the derivative with respect to the pose."""
    line_scores: Floats
    """(n, 2) The same for the line."""
    by_pose: Floats
    """(n, 3) Sum of weighted derivatives with respect to the pose."""
    by_line: Floats
    """(n, 2) The same for the line."""
    side: Floats
    """(n,) 1 where a positive residual is towards the robot, else -1."""

    @property
    def deviation(self) -> Floats:
        """(n,) [m] Standard deviation of a point."""
        return np.sqrt(self.count / self.weight)


def clusters_of(rows: PointRows, poses: Floats) -> tuple[ResidualClusters, Ints]:
    """Return the clusters at poses (n_frames, 3), and the cluster of each row (n_rows,)."""
    keys, cluster = np.unique(rows.frame * rows.n_patches + rows.patch, return_inverse=True)
    frame, patch = keys // max(rows.n_patches, 1), keys % max(rows.n_patches, 1)
    n, w = len(keys), rows.weight

    def sums(columns: Floats) -> Floats:
        return np.column_stack([sums_by(cluster, column, n) for column in columns.T])

    count, weight = np.bincount(cluster, minlength=n), sums_by(cluster, w, n)
    middle = sums(rows.points) / count[:, None]
    normal = np.zeros((n, 2))
    normal[cluster] = rows.normals
    side = np.where(np.einsum("ni,ni->n", poses[frame, :2] - middle, normal) < 0, -1.0, 1.0)
    weighted = w * rows.residual
    return ResidualClusters(
        frame=frame,
        patch=patch,
        count=count,
        weight=weight,
        scores=sums(weighted[:, None] * rows.by_pose),
        line_scores=sums(weighted[:, None] * rows.by_line),
        by_pose=sums(w[:, None] * rows.by_pose),
        by_line=sums(w[:, None] * rows.by_line),
        middle=middle,
        facing=normal * side[:, None],
        side=side,
        residual=side * sums_by(cluster, weighted, n) / np.sqrt(weight * count),
    ), cluster
