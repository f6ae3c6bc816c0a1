"""Equations of one ray as text: each face as a rational function of the pose, and its visible stretches."""

from __future__ import annotations

import math

import numpy as np

from sensorgraph.models.calibration.ray_terms import RayTerms
from sensorgraph.models.faces.ray_march import MIN_VISIBILITY, FaceSet
from sensorgraph.models.faces.visibility import ReturnNoise
from sensorgraph.types import Floats


def face_equations(
    faces: FaceSet,
    hits: Floats,
    noise: ReturnNoise,
    terms: RayTerms,
    mount: Floats,
    *,
    ray: int,
    bearing: float,
) -> list[str]:
    """Return the equations of a ray as text, face by face, in the order of the returns that the faces explain.

    Parameters
    ----------
    hits : (n_faces,) Training returns of each face.
    mount : (3,) [m, m, rad] Pose of the laser in the frame of the poses.
    bearing : [rad] Bearing of the ray in the laser frame.
    """
    lines = [
        f"ray {ray}, bearing {math.degrees(bearing):.2f}°: the first of these faces that stops it",
        "(x, y, phi: pose; c = cos phi, s = sin phi; only faces with a negative denominator count)",
    ]
    for k in np.argsort(-hits, kind="stable").tolist():
        lines.append(f"face {k}: r = {_rational(faces, k, mount, float(bearing + mount[2]))}")
        lines.append(f"    stops it where {_visible_stretches(faces, k)}")
    spread = f"{noise.sigma:.4f} m"
    if noise.sigma_xy > 0 or noise.sigma_yaw > 0:
        spread += f" of range, {noise.sigma_xy:.4f} m and {noise.sigma_yaw:.5f} rad of pose"
    return [*lines, *_laser_terms(terms, ray), f"the standard deviation of a return is {spread}"]


def _laser_terms(terms: RayTerms, ray: int) -> list[str]:
    """Return what the laser adds to the range of a face as text; empty for a perfect laser."""
    added = terms.equation(ray)
    if not added:
        return []
    line = f"the laser shows r{added.replace('rho', 'r')}"
    if terms.has_incidence:
        line += " (v = 1 - |denominator|, q = min(r, 4 m) / 4 m)"
    return [line]


def _rational(faces: FaceSet, k: int, mount: Floats, bearing: float) -> str:
    """Return r = (d - n·q) / (n·u) as text in x, y, c, s, for a ray at `bearing` [rad] in the frame of the poses."""
    (nx, ny), d = faces.normals[k], faces.offsets[k]
    mx, my = mount[:2]
    cos, sin = math.cos(bearing), math.sin(bearing)
    above = sum_text([(d, ""), (-nx, "x"), (-ny, "y"), (-(nx * mx + ny * my), "c"), (nx * my - ny * mx, "s")])
    below = sum_text([(nx * cos + ny * sin, "c"), (ny * cos - nx * sin, "s")])
    return f"({above}) / ({below})"


def _visible_stretches(faces: FaceSet, k: int) -> str:
    """Return the visible stretches of a face as text, in terms of the abscissa t along it."""
    a, b = faces.first[k], faces.first[k + 1] - 1
    (nx, ny), edges, levels = faces.normals[k], faces.edges, faces.levels
    parts = [
        f"{edges[j]:.3f} < t < {edges[j + 1]:.3f} (probability {levels[j]:.3f})"
        for j in range(a, b)
        if levels[j] > MIN_VISIBILITY
    ]
    return f"{', '.join(parts)}; t = {sum_text([(-ny, 'x_hit'), (nx, 'y_hit')])}"


def sum_text(parts: list[tuple[float, str]]) -> str:
    """Return a sum of products as text, without terms that are 0."""
    text = ""
    for value, name in parts:
        if abs(value) < 5e-6:
            continue
        sign = "-" if value < 0 else "+"
        text += f" {sign} " if text else ("-" if value < 0 else "")
        text += f"{abs(value):.5f}" + (f" {name}" if name else "")
    return text or "0"
