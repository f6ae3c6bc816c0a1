"""One scan against a line map: robust point-to-line match with a prior.

Each point's residual is its distance from the line that fits the map around it (`line_map`), with Cauchy weights;
where the map is a spot rather than a line, the distance along counts, too (Censi 2008; POSES of the study).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.kernel import inner_kernel, kernel
from sensorgraph.localization.line_map import LineMap, fit_line
from sensorgraph.localization.settings import MATCH, LineMatchSettings
from sensorgraph.types import Floats, Ints

_Line = tuple[float, float, float, float, float, float, float]
"""As `fit_line` returns it: weight, middle x and y, normal x and y, variances across and along."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """Where a scan lies in a line map."""

    pose: Floats
    """(3,) [m, m, rad] base_link in map."""
    information: Floats
    """(3, 3) of x, y, phi in map from the scan alone, without the prior; by the scatter of its residuals, as if those
    were independent."""
    overlap: float
    """Share of the points that have surfaces of the map near them."""
    inliers: float
    """Share of these that lie on the surfaces."""
    noise: float
    """[m] standard deviation of the inliers' distances from their lines."""

    @property
    def agreement(self) -> float:
        """Share of all points that lie on surfaces of the map."""
        return self.overlap * self.inliers

    @property
    def weak_direction(self) -> tuple[Floats, float]:
        """Return the direction (2,) in map in which the place is known worst, and its standard deviation [m]."""
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
    prior: Floats | None = None,
    prior_information: Floats | None = None,
    settings: LineMatchSettings = MATCH,
) -> Match:
    """Find the pose of a scan in a line map near a start.

    Parameters
    ----------
    points, normals : (n, 2) of the scan in base_link, as in `ScanPoints`
    surfaces : of the map, with buckets of `settings.first_radius` at least
    start : (3,) [m, m, rad] base_link in map from which to search
    prior : (3,) [m, m, rad] base_link in map as expected; None: the start
    prior_information : (3, 3) of x, y, phi in map; None: no prior
    """
    out = np.zeros(16)
    _match(
        np.ascontiguousarray(points),
        np.ascontiguousarray(normals),
        surfaces.side,
        surfaces.keys,
        surfaces.first,
        surfaces.counts,
        surfaces.points,
        surfaces.normals,
        np.asarray(start, dtype=np.float64),
        np.asarray(start if prior is None else prior, dtype=np.float64),
        np.zeros((3, 3)) if prior_information is None else np.asarray(prior_information, dtype=np.float64),
        np.array(
            [
                min(settings.first_radius, surfaces.side),
                min(settings.last_radius, surfaces.side),
                settings.sigma,
                settings.iterations,
                settings.tolerance,
                settings.roundness,
                settings.min_points,
                settings.same_side,
                settings.inlier,
                surfaces.facing,
            ]
        ),
        out,
    )
    n = max(len(points), 1)
    near, within, square, degrees = out[12:16]
    noise = max(float(np.sqrt(square / max(degrees - 3.0, 1.0))), settings.min_noise)
    pose = out[:3].copy()
    pose[2] = np.pi - (np.pi - pose[2]) % (2 * np.pi)
    return Match(
        pose=pose,
        information=out[3:12].reshape(3, 3) / noise**2,
        overlap=float(near / n),
        inliers=float(within / max(near, 1.0)),
        noise=noise,
    )


@kernel
def _match(
    points: Floats,
    normals: Floats,
    side: float,
    keys: Ints,
    first: Ints,
    counts: Ints,
    map_points: Floats,
    map_normals: Floats,
    start: Floats,
    prior: Floats,
    prior_information: Floats,
    numbers: Floats,
    out: Floats,
) -> None:
    """Run Gauss-Newton.

    `out` takes the pose (3), the sum of weighted JᵀJ (9), the points with a line, the inliers, the weighted sum of
    squares and the weights.
    """
    first_radius, last_radius = numbers[0], numbers[1]
    n_iterations, tolerance = int(numbers[3]), numbers[4]
    x, y, phi = start[0], start[1], start[2]
    radius, shrink = first_radius, (last_radius / first_radius) ** 0.25
    sums = np.zeros(19)
    is_found = False
    for iteration in range(n_iterations + 1):
        cos, sin = np.cos(phi), np.sin(phi)
        sums[:] = 0.0
        for k in range(len(points)):
            rx = cos * points[k, 0] - sin * points[k, 1]
            ry = sin * points[k, 0] + cos * points[k, 1]
            mx = cos * normals[k, 0] - sin * normals[k, 1]
            my = sin * normals[k, 0] + cos * normals[k, 1]
            line = _line_at(
                x + rx, y + ry, mx, my, radius, numbers, side, keys, first, counts, map_points, map_normals
            )
            if line[0] >= numbers[6]:
                _add_point(sums, rx, ry, x + rx - line[1], y + ry - line[2], line, numbers)
        if is_found or iteration == n_iterations:
            break
        d0, d1, d2 = _step(sums, x, y, phi, prior, prior_information)
        x, y, phi = x + d0, y + d1, phi + d2
        is_found = radius <= last_radius * 1.0001 and max(abs(d0), abs(d1), abs(d2)) < tolerance
        radius = max(last_radius, radius * shrink)
    out[0], out[1], out[2] = x, y, phi
    out[3], out[4], out[5], out[6], out[7], out[8] = sums[0], sums[1], sums[2], sums[1], sums[3], sums[4]
    out[9], out[10], out[11] = sums[2], sums[4], sums[5]
    out[12:16] = sums[15:19]


@inner_kernel
def _line_at(
    x: float,
    y: float,
    nx: float,
    ny: float,
    radius: float,
    numbers: Floats,
    side: float,
    keys: Ints,
    first: Ints,
    counts: Ints,
    points: Floats,
    normals: Floats,
) -> _Line:
    """Fit a line around (x, y) as `fit_line` does; far away, where the rays lie apart, within a bucket's side.

    Its weight is 0 where the points in there are of other surfaces, too.
    """
    variance, min_points, same_side, facing = numbers[2] * numbers[2], numbers[6], numbers[7], numbers[9]
    line = fit_line(x, y, nx, ny, radius, same_side, side, keys, first, counts, points, normals, facing)
    if line[0] >= min_points or radius >= side:
        return line
    line = fit_line(x, y, nx, ny, side, same_side, side, keys, first, counts, points, normals, facing)
    if line[5] > variance:
        return 0.0, x, y, 1.0, 0.0, 0.0, 0.0
    return line


@inner_kernel
def _add_point(
    sums: Floats, rx: float, ry: float, dx: float, dy: float, line: _Line, numbers: Floats
) -> None:
    """Add a point (rx, ry) from the robot that is (dx, dy) from the middle of its line, all in the map's directions.

    `sums` holds upper triangles of the information alone (6) and of the normal equations (6), their right side (3),
    the points, the inliers, the weighted sum of squares and the weights.
    """
    w, _, _, nx, ny, across, along = line
    variance, roundness, inlier = numbers[2] * numbers[2], numbers[5], numbers[8]
    v = variance + across
    r = nx * dx + ny * dy
    soft = 1.0 / (1.0 + r * r / (4.0 * v))
    j = nx * -ry + ny * rx
    tx, ty = -ny, nx
    jt = tx * -ry + ty * rx
    tilt = min(
        across / (w * along + 1e-12), 1.0
    )  # variance [rad²] of the line's direction: the share of JᵀJ that it makes along the line is no information
    sums[0] += soft * (nx * nx - tilt * tx * tx)
    sums[1] += soft * (nx * ny - tilt * tx * ty)
    sums[2] += soft * (nx * j - tilt * tx * jt)
    sums[3] += soft * (ny * ny - tilt * ty * ty)
    sums[4] += soft * (ny * j - tilt * ty * jt)
    sums[5] += soft * (j * j - tilt * jt * jt)
    sums[15] += 1.0
    if r * r < inlier * inlier * v:
        sums[16] += 1.0
        sums[17] += soft * r * r
        sums[18] += soft
    _add_residual(sums, r, soft / v, nx, ny, j)
    if across > roundness * along:
        r = tx * dx + ty * dy
        v = variance + along
        _add_residual(sums, r, 1.0 / (1.0 + r * r / (4.0 * v)) / v, tx, ty, jt)


@inner_kernel
def _add_residual(sums: Floats, r: float, weight: float, jx: float, jy: float, jphi: float) -> None:
    """Add a residual with its derivatives to the normal equations."""
    wx, wy, wphi = weight * jx, weight * jy, weight * jphi
    sums[6] += wx * jx
    sums[7] += wx * jy
    sums[8] += wx * jphi
    sums[9] += wy * jy
    sums[10] += wy * jphi
    sums[11] += wphi * jphi
    sums[12] += wx * r
    sums[13] += wy * r
    sums[14] += wphi * r


@inner_kernel
def _step(
    sums: Floats, x: float, y: float, phi: float, prior: Floats, information: Floats
) -> tuple[float, float, float]:
    """Return the Gauss-Newton step by the points and the prior."""
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
    """Solve three normal equations by Cholesky; directions without information stay where they are."""
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
