"""Prediction of cones from faces, and the equations of one cone as text."""

from __future__ import annotations

import math

import numpy as np

from sensorgraph.models.cones.kernels import BACK_SLOT, list_cones, predict_cones
from sensorgraph.models.distribution import Mixture
from sensorgraph.models.faces.data import FacesData
from sensorgraph.models.faces.equations import sum_text
from sensorgraph.models.faces.ray_march import MIN_VISIBILITY, FaceSet
from sensorgraph.models.faces.visibility import MIN_COSINE
from sensorgraph.types import Bools, Floats, Ints


def visible_stretches(faces: FaceSet) -> tuple[Floats, Floats]:
    """Return the visible stretches (n, 5) as n_x, n_y, d, low, high, and the probability (n,) that each returns."""
    owner = faces.owners
    at = np.flatnonzero(faces.levels > MIN_VISIBILITY)
    k = owner[at]
    table = (
        np.column_stack([faces.normals[k], faces.offsets[k], faces.edges[at], faces.edges[at + 1]])
        if len(at)
        else np.zeros((0, 5))
    )
    return np.ascontiguousarray(table), faces.levels[at]


def cone_table(
    model: FacesData, lasers: tuple[Floats, Floats, Floats, Floats], rays: Ints, which: int
) -> tuple[Floats, Bools]:
    """Return summaries (n_poses, n_rays, 6) as `mixture.summarise` does, and whether the cones lie in observed space.

    Parameters
    ----------
    lasers : x, y, cos and sin (n_poses,) of the poses from which the rays start.
    """
    table = np.empty((len(lasers[0]), len(rays), 6))
    supported = np.empty(table.shape[:2], dtype=np.bool_)
    bearings = model.sensor.bearings[rays]
    stretches, levels = visible_stretches(model.faces)
    predict_cones(
        *lasers, np.cos(bearings), np.sin(bearings), 0.5 * model.sensor.cones[rays], model.sensor.range_max,
        stretches, levels, model.noise.sigma, model.observed.origin, model.observed.cell,
        model.observed.distance_to_unobserved, which, table, supported,
    )  # fmt: skip
    return table, supported


def cone_mixtures(model: FacesData, lasers: tuple[Floats, Floats, Floats, Floats], rays: Ints) -> Mixture:
    """Return the mixtures of cones (n_rays,) from `lasers`, as `cone_table` takes them."""
    shape = (len(lasers[0]), len(rays), BACK_SLOT + 1)
    means, weights, passed = np.empty(shape), np.empty(shape), np.empty(shape[:2])
    bearings = model.sensor.bearings[rays]
    most = list_cones(
        *lasers, np.cos(bearings), np.sin(bearings), 0.5 * model.sensor.cones[rays], model.sensor.range_max,
        *visible_stretches(model.faces), means, weights, passed,
    )  # fmt: skip
    means = means[..., : max(most, 1)]
    return Mixture(
        means=means,
        weights=weights[..., : max(most, 1)],
        widths=np.full(means.shape, model.noise.sigma),
        sources=np.full(means.shape, -1),
        p_no_return=passed,
    )


def cone_equations(model: FacesData, start: Floats, ray: int) -> list[str]:
    """Return the equations of a cone as text, face by face, in the order of the returns that the faces explain.

    Parameters
    ----------
    start : (3,) [m, m, rad] Pose of the sensor in the frame of the poses.
    """
    half, bearing = 0.5 * float(model.sensor.cones[ray]), float(model.sensor.bearings[ray])
    faces = model.faces
    lines = [
        f"ray {ray}, bearing {math.degrees(bearing):.2f}°, a cone of {math.degrees(2 * half):.2f}°: "
        "r is the smallest of these r_k, the distance of the nearest surface in the cone",
        "(x, y, phi: pose; c = cos phi, s = sin phi)",
        "each face k has h: distance of the sensor from its line; f: abscissa of the foot of the perpendicular; "
        "a: angle of the axis against the perpendicular (in -pi to pi)",
        f"    r_k = sqrt(h^2 + v^2), v = the value nearest 0 that lies in [-h tan(a + {half:.5f}), -h tan(a - {half:.5f})] "
        "and in [low - f, high - f]",
        f"    where both overlap and h > 0; the angles of the tangents are limited to {math.degrees(math.acos(MIN_COSINE)):.1f}°",
        "v = 0 and r_k = h if the foot is in the cone and on the face; otherwise v is at an edge of the cone or end of the face",
    ]
    mx, my, yaw = map(float, start)
    for k in np.argsort(-model.hits, kind="stable").tolist():
        (nx, ny), d = faces.normals[k], faces.offsets[k]
        h = sum_text([(-d, ""), (nx, "x"), (ny, "y"), (nx * mx + ny * my, "c"), (ny * mx - nx * my, "s")])
        f = sum_text([(-ny, "x"), (nx, "y"), (nx * my - ny * mx, "c"), (nx * mx + ny * my, "s")])
        turn = math.remainder(bearing + yaw - math.atan2(-ny, -nx), 2 * math.pi)
        lines.append(f"face {k}: h = {h}; f = {f}; a = phi {'-' if turn < 0 else '+'} {abs(turn):.5f}")
        for j in range(faces.first[k], faces.first[k + 1] - 1):
            if faces.levels[j] > MIN_VISIBILITY:
                low, high = faces.edges[j], faces.edges[j + 1]
                lines.append(f"    low {low:.3f}, high {high:.3f} (probability {faces.levels[j]:.3f})")
    return [*lines, f"the standard deviation of a return is {model.noise.sigma:.4f} m of range"]
