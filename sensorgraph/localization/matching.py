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
    """Run Gauss-Newton; one loop, so that nothing is allocated within.

    `out` takes the pose (3), the sum of weighted JᵀJ (9), the points with a line, the inliers, the weighted sum of
    squares and the weights.
    """
    first_radius, last_radius, sigma = numbers[0], numbers[1], numbers[2]
    n_iterations, tolerance, roundness = int(numbers[3]), numbers[4], numbers[5]
    min_points, same_side, inlier = numbers[6], numbers[7], numbers[8]
    x, y, phi = start[0], start[1], start[2]
    radius, shrink = first_radius, (last_radius / first_radius) ** 0.25
    variance = sigma * sigma
    is_found = False
    for iteration in range(n_iterations + 1):
        cos, sin = np.cos(phi), np.sin(phi)
        u00, u01, u02, u11, u12, u22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # of the information alone
        h00, h01, h02, h11, h12, h22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        g0, g1, g2 = 0.0, 0.0, 0.0
        near, within, square, weights = 0.0, 0.0, 0.0, 0.0
        for k in range(len(points)):
            rx = cos * points[k, 0] - sin * points[k, 1]
            ry = sin * points[k, 0] + cos * points[k, 1]
            mx = cos * normals[k, 0] - sin * normals[k, 1]
            my = sin * normals[k, 0] + cos * normals[k, 1]
            w, cx, cy, nx, ny, across, along = fit_line(
                x + rx, y + ry, mx, my, radius, same_side, side, keys, first, counts, map_points, map_normals
            )
            if w < min_points and radius < side:  # far away, where the rays lie apart
                w, cx, cy, nx, ny, across, along = fit_line(
                    x + rx,
                    y + ry,
                    mx,
                    my,
                    side,
                    same_side,
                    side,
                    keys,
                    first,
                    counts,
                    map_points,
                    map_normals,
                )
                if across > variance:  # other surfaces, too
                    continue
            if w < min_points:
                continue
            near += 1.0
            dx, dy = x + rx - cx, y + ry - cy
            v = variance + across
            r = nx * dx + ny * dy
            soft = 1.0 / (1.0 + r * r / (4.0 * v))
            is_in = r * r < inlier * inlier * v
            if is_in:
                within += 1.0
            j = nx * -ry + ny * rx
            tx, ty = -ny, nx
            jt = tx * -ry + ty * rx
            tilt = min(
                across / (w * along + 1e-12), 1.0
            )  # variance [rad²] of the line's direction: the share of JᵀJ that it makes
            # along the line is no information
            u00, u01 = u00 + soft * (nx * nx - tilt * tx * tx), u01 + soft * (nx * ny - tilt * tx * ty)
            u02, u11 = u02 + soft * (nx * j - tilt * tx * jt), u11 + soft * (ny * ny - tilt * ty * ty)
            u12, u22 = u12 + soft * (ny * j - tilt * ty * jt), u22 + soft * (j * j - tilt * jt * jt)
            if is_in:
                square, weights = square + soft * r * r, weights + soft
            q = soft / v
            h00, h01, h02 = h00 + q * nx * nx, h01 + q * nx * ny, h02 + q * nx * j
            h11, h12, h22 = h11 + q * ny * ny, h12 + q * ny * j, h22 + q * j * j
            g0, g1, g2 = g0 + q * nx * r, g1 + q * ny * r, g2 + q * j * r
            if across > roundness * along:
                r = tx * dx + ty * dy
                v = variance + along
                q = 1.0 / (1.0 + r * r / (4.0 * v)) / v
                h00, h01, h02 = h00 + q * tx * tx, h01 + q * tx * ty, h02 + q * tx * jt
                h11, h12, h22 = h11 + q * ty * ty, h12 + q * ty * jt, h22 + q * jt * jt
                g0, g1, g2 = g0 + q * tx * r, g1 + q * ty * r, g2 + q * jt * r
        out[3], out[4], out[5], out[6], out[7], out[8] = u00, u01, u02, u01, u11, u12
        out[9], out[10], out[11] = u02, u12, u22
        out[12], out[13], out[14], out[15] = near, within, square, weights
        if is_found or iteration == n_iterations:
            break
        ex, ey = x - prior[0], y - prior[1]
        ephi = np.arctan2(np.sin(phi - prior[2]), np.cos(phi - prior[2]))
        g0 += prior_information[0, 0] * ex + prior_information[0, 1] * ey + prior_information[0, 2] * ephi
        g1 += prior_information[1, 0] * ex + prior_information[1, 1] * ey + prior_information[1, 2] * ephi
        g2 += prior_information[2, 0] * ex + prior_information[2, 1] * ey + prior_information[2, 2] * ephi
        h00, h01, h02 = (
            h00 + prior_information[0, 0],
            h01 + prior_information[0, 1],
            h02 + prior_information[0, 2],
        )
        h11, h12, h22 = (
            h11 + prior_information[1, 1],
            h12 + prior_information[1, 2],
            h22 + prior_information[2, 2],
        )
        d0, d1, d2 = _solve(h00, h01, h02, h11, h12, h22, -g0, -g1, -g2)
        x, y, phi = x + d0, y + d1, phi + d2
        is_found = radius <= last_radius * 1.0001 and max(abs(d0), abs(d1), abs(d2)) < tolerance
        radius = max(last_radius, radius * shrink)
    out[0], out[1], out[2] = x, y, phi


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
