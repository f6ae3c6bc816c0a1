"""Match one scan to a line map: robust point-to-line registration with a prior.

Gauss-Newton minimises, over the pose x = (x, y, phi),

    sum_k rho(r_k² / v_k)  +  sum_spots rho(t_k² / w_k)  +  |x - prior|²_prior_information.

Here r_k is the distance of point k from the line fitted to the map around it (`line_map`). Its variance is
v_k = sigma² + the variance across the line, and rho is Cauchy's function. Some points lie at a spot of the
map rather than a line. For these the distance t_k along the line counts too, with variance w_k = sigma² + the
variance along it (Censi 2008). A step d solves, with J_k = n_kᵀ (I, R'(phi) p_k) and weights 1 / (1 + r_k² / (4 v_k)),

    (sum_k J_kᵀ J_k weight_k / v_k + prior_information) d = -sum_k J_kᵀ r_k weight_k / v_k - prior_information (x - prior).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.localization.line_map import LineMap, Table, fit_line
from sensorgraph.localization.settings import MATCH, MIN_NOISE, LineMatchSettings
from sensorgraph.types import Floats

ITERATIONS = 12
"""Maximum number of Gauss-Newton steps."""
TOLERANCE = 1e-4
"""[m, rad] Largest component of a step below which the iteration stops."""
ROUNDNESS = 0.15
"""Ratio of the variances across and along a line above which it is a spot; a spot also constrains the tangential direction."""
MIN_WEIGHT = 2.0
"""Sum of neighbour weights below which no line is fitted."""
INLIER = 2.0
"""Number of standard deviations within which a point is an inlier."""
START_OFFSET = 0.25
"""[m] Offset along or across at which a match starts again where the first one does not fit."""
CORRELATION = 2.0
"""Factor by which the information of a match of one scan is reduced, since its residuals are correlated: neighbouring rays, and
scans, share surfaces."""
_Line = tuple[float, float, float, float, float, float, float]
"""Result of `fit_line`: weight, middle x and y, normal x and y, variances across and along."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """Pose of a scan in a line map."""

    pose: Floats
    """(3,) [m, m, rad] base_link in map."""
    information: Floats
    """(3, 3) Information of x, y, phi in map from the scan alone, without the prior. It is scaled by the
    scatter of the residuals, as if these were independent; 0 along directions that the scan does not
    determine."""
    overlap: float
    """Share of the points with a surface of the map near them."""
    inliers: float
    """Share of these that lie on the surfaces."""
    noise: float
    """[m] Standard deviation of the distances of the inliers from their lines."""
    projection: Floats = field(default_factory=lambda: np.eye(3))
    """(3, 3) Projection of a motion x, y, phi in map onto the directions that the scan determines."""

    @property
    def agreement(self) -> float:
        """Share of all points that lie on surfaces of the map."""
        return self.overlap * self.inliers

    @property
    def weak_direction(self) -> tuple[Floats, float]:
        """Direction (2,) in map with the largest position uncertainty, and its standard deviation [m]."""
        place = self.information[:2, :2] - np.outer(self.information[:2, 2], self.information[2, :2]) / max(
            float(self.information[2, 2]), 1e-12
        )
        values, vectors = np.linalg.eigh(place)
        return vectors[:, 0], float(1.0 / np.sqrt(max(float(values[0]), 1e-12)))


def match(
    points: Floats,
    normals: Floats,
    surfaces: LineMap,
    start: Floats,
    *,
    prior_information: Floats | None = None,
    settings: LineMatchSettings = MATCH,
) -> Match:
    """Find the pose of a scan in a line map near a start.

    Parameters
    ----------
    points, normals : (n, 2) Points of the scan in base_link, as in `ScanPoints`.
    surfaces : Line map with buckets of at least `settings.first_radius`.
    start : (3,) [m, m, rad] Initial base_link in map; also the expected one, if there is a prior.
    prior_information : (3, 3) Information of x, y, phi in map; None: no prior.
    """
    out = np.zeros(16)
    radii = np.minimum([settings.first_radius, settings.last_radius], surfaces.side)
    _match(
        np.ascontiguousarray(points),
        np.ascontiguousarray(normals),
        surfaces.table,
        np.asarray(start, dtype=np.float64),
        np.zeros((3, 3)) if prior_information is None else np.asarray(prior_information, dtype=np.float64),
        radii,
        settings.sigma * settings.sigma,
        np.empty(19),
        out,
    )
    information, projection = _determined(out[3:12].reshape(3, 3), points)
    n = max(len(points), 1)
    near, within, square, degrees = out[12:16]
    noise = max(float(np.sqrt(square / max(degrees - 3.0, 1.0))), MIN_NOISE)
    pose = out[:3].copy()
    pose[2] = np.pi - (np.pi - pose[2]) % (2 * np.pi)
    return Match(
        pose=pose,
        information=information / noise**2,
        overlap=float(near / n),
        inliers=float(within / max(near, 1.0)),
        noise=noise,
        projection=projection,
    )


def _determined(normal_matrix: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return JᵀJ (3, 3) without directions that are not determined, and the projection onto the others (3, 3).

    A direction is determined if its eigenvalue exceeds what the errors of the line directions contribute. Turns
    are weighed by the root mean square distance of the points.
    """
    lever = float(np.sqrt((points**2).sum(axis=1).mean())) if len(points) else 1.0
    scale = np.array([1.0, 1.0, 1.0 / max(lever, 1e-3)])
    values, vectors = np.linalg.eigh(normal_matrix * np.outer(scale, scale))
    vectors = vectors[:, values > 0]
    information = (vectors * values[values > 0]) @ vectors.T / np.outer(scale, scale)
    projection = scale[:, None] * (vectors @ vectors.T) / scale
    return information, projection


@outer_kernel
def _match(
    points: Floats,
    normals: Floats,
    table: Table,
    prior: Floats,
    prior_information: Floats,
    radii: Floats,
    variance: float,
    sums: Floats,
    out: Floats,
) -> None:
    """Run Gauss-Newton; `sums` (19,) is memory.

    `out` receives the pose (3), the sum of weighted JᵀJ minus twice the part from errors of the line directions
    (9), the number of points with a line, the number of inliers, the weighted sum of squares and the sum of
    weights.
    """
    last_radius = radii[1]
    x, y, phi = prior[0], prior[1], prior[2]
    radius, shrink = radii[0], (last_radius / radii[0]) ** 0.25
    is_found = False
    for iteration in range(ITERATIONS + 1):
        cos, sin = np.cos(phi), np.sin(phi)
        sums[:] = 0.0
        for k in range(len(points)):
            rx = cos * points[k, 0] - sin * points[k, 1]
            ry = sin * points[k, 0] + cos * points[k, 1]
            mx = cos * normals[k, 0] - sin * normals[k, 1]
            my = sin * normals[k, 0] + cos * normals[k, 1]
            line = _line_at(x + rx, y + ry, mx, my, radius, variance, table)
            if line[0] >= MIN_WEIGHT:
                _add_point(sums, rx, ry, x + rx - line[1], y + ry - line[2], line, variance)
        if is_found or iteration == ITERATIONS:
            break
        d0, d1, d2 = _step(sums, x, y, phi, prior, prior_information)
        x, y, phi = x + d0, y + d1, phi + d2
        is_found = radius <= last_radius * 1.0001 and max(abs(d0), abs(d1), abs(d2)) < TOLERANCE
        radius = max(last_radius, radius * shrink)
    out[0], out[1], out[2] = x, y, phi
    out[3], out[4], out[5], out[6], out[7], out[8] = sums[0], sums[1], sums[2], sums[1], sums[3], sums[4]
    out[9], out[10], out[11] = sums[2], sums[4], sums[5]
    out[12], out[13], out[14], out[15] = sums[15], sums[16], sums[17], sums[18]


@inner_kernel
def _line_at(x: float, y: float, nx: float, ny: float, radius: float, variance: float, table: Table) -> _Line:
    """Fit a line around (x, y) as `fit_line` does; if too few points are near, within the side of a bucket.

    The weight is 0 if the points in the larger radius also belong to other surfaces.
    """
    side = table[0]
    line = fit_line(x, y, nx, ny, radius, table)
    if line[0] >= MIN_WEIGHT or radius >= side:
        return line
    line = fit_line(x, y, nx, ny, side, table)
    if line[5] > variance:
        return 0.0, x, y, 1.0, 0.0, 0.0, 0.0
    return line


@inner_kernel
def _add_point(
    sums: Floats, rx: float, ry: float, dx: float, dy: float, line: _Line, variance: float
) -> None:
    """Add point (rx, ry) relative to the robot, at (dx, dy) from the middle of its line, all in map directions.

    `sums` holds the upper triangles of the information (6) and of the normal equations (6), then their
    right-hand side (3). The numbers of points and of inliers, the weighted sum of squares and the sum of
    weights follow.
    """
    w, _, _, nx, ny, across, along = line
    v = variance + across
    r = nx * dx + ny * dy
    soft = 1.0 / (1.0 + r * r / (4.0 * v))
    j = nx * -ry + ny * rx
    tx, ty = -ny, nx
    jt = tx * -ry + ty * rx
    # twice the variance [rad²] of the line's direction: once for its expected tangential part of JᵀJ, and once
    # for the error of this estimate, so that plain walls never determine the position along them
    tilt = min(2.0 * across / (w * along + 1e-12), 1.0)
    sums[0] += soft * (nx * nx - tilt * tx * tx)
    sums[1] += soft * (nx * ny - tilt * tx * ty)
    sums[2] += soft * (nx * j - tilt * tx * jt)
    sums[3] += soft * (ny * ny - tilt * ty * ty)
    sums[4] += soft * (ny * j - tilt * ty * jt)
    sums[5] += soft * (j * j - tilt * jt * jt)
    sums[15] += 1.0
    if r * r < INLIER * INLIER * v:
        sums[16] += 1.0
        sums[17] += soft * r * r
        sums[18] += soft
    _add_residual(sums, r, soft / v, nx, ny, j)
    if across > ROUNDNESS * along:
        r = tx * dx + ty * dy
        v = variance + along
        _add_residual(sums, r, 1.0 / (1.0 + r * r / (4.0 * v)) / v, tx, ty, jt)


@inner_kernel
def _add_residual(sums: Floats, r: float, weight: float, jx: float, jy: float, jphi: float) -> None:
    """Add a residual with its derivatives to the normal equations."""
    wx, wy, wphi = weight * jx, weight * jy, weight * jphi
    products = (wx * jx, wx * jy, wx * jphi, wy * jy, wy * jphi, wphi * jphi, wx * r, wy * r, wphi * r)
    for i, product in enumerate(products):
        sums[6 + i] += product


@inner_kernel
def _step(
    sums: Floats, x: float, y: float, phi: float, prior: Floats, information: Floats
) -> tuple[float, float, float]:
    """Return the Gauss-Newton step from points and prior."""
    ex, ey = x - prior[0], y - prior[1]
    ephi = np.arctan2(np.sin(phi - prior[2]), np.cos(phi - prior[2]))
    return _solve(
        sums[6] + information[0, 0],
        sums[7] + information[0, 1],
        sums[8] + information[0, 2],
        sums[9] + information[1, 1],
        sums[10] + information[1, 2],
        sums[11] + information[2, 2],
        -sums[12] - (information[0, 0] * ex + information[0, 1] * ey + information[0, 2] * ephi),
        -sums[13] - (information[1, 0] * ex + information[1, 1] * ey + information[1, 2] * ephi),
        -sums[14] - (information[2, 0] * ex + information[2, 1] * ey + information[2, 2] * ephi),
    )


@inner_kernel
def _solve(
    h00: float, h01: float, h02: float, h11: float, h12: float, h22: float, g0: float, g1: float, g2: float
) -> tuple[float, float, float]:
    """Solve the 3 × 3 normal equations by Cholesky; unconstrained directions do not move."""
    l00 = np.sqrt(h00 + 1e-6)
    l10, l20 = h01 / l00, h02 / l00
    l11 = np.sqrt(max(h11 + 1e-6 - l10 * l10, 1e-6))
    l21 = (h12 - l20 * l10) / l11
    l22 = np.sqrt(max(h22 + 1e-6 - l20 * l20 - l21 * l21, 1e-6))
    a0 = g0 / l00
    a1 = (g1 - l10 * a0) / l11
    d2 = (g2 - l20 * a0 - l21 * a1) / (l22 * l22)
    d1 = (a1 - l21 * d2) / l11
    return (a0 - l10 * d1 - l20 * d2) / l00, d1, d2
