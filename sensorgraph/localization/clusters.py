"""Clusters of residuals: the points of one key frame on one surface patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.localization.point_rows import PointRows, sums_by
from sensorgraph.types import Floats, Ints


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
