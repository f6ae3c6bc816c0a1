"""Equations of one ray as text: each face as a rational function of the pose, and its visible stretches."""

from __future__ import annotations

import math

import numpy as np

from sensorgraph.models.calibration.ray_terms import RayTerms
from sensorgraph.models.faces.data import FacesData
from sensorgraph.models.faces.ray_march import MIN_VISIBILITY, FaceSet
from sensorgraph.models.faces.stops import stop_shares
from sensorgraph.types import Floats

SHOWN_SHARE = 0.01
"""Share of poses below which a face or a stretch of it is printed only on request."""
SHOWN_GROWTH = 5e-4
"""[m/m] Growth of the noise with the range that is printed: 0.5 mm at 1 m."""


def face_equations(model: FacesData, start: Floats, *, ray: int, every: bool) -> list[str]:
    """Return the equations of a ray as text, face by face, those first that stop it at the most poses.

    Parameters
    ----------
    start : (3,) [m, m, rad] Start of the ray in the frame of the poses.
    every : Print every face and stretch. False: those that stop the ray at 1 % of the poses or more.
    """
    faces, bearing = model.faces, float(model.sensor.bearings[ray])
    shares = stop_shares(faces, model.observed, start, bearing, model.sensor.range_max)
    of_faces = np.add.reduceat(shares, faces.first[:-1]) if faces.n_faces else np.zeros(0)
    least = -1.0 if every else SHOWN_SHARE
    lines = [
        f"ray {ray}, bearing {math.degrees(bearing):.2f}°: the first of these faces that stops it",
        "(x, y, phi: pose; c = cos phi, s = sin phi; only faces with a negative denominator count)",
    ]
    for k in np.lexsort((-model.hits, -of_faces)).tolist():
        if of_faces[k] >= least:
            lines.append(f"face {k}: r = {_rational(faces, k, start, bearing + float(start[2]))}")
            lines += _visible_stretches(faces, k, shares, least)
    if rare := int((of_faces < least).sum()):
        lines.append(
            f"{rare} more face{'s' * (rare > 1)}, each at less than {100 * least:g} % of poses, "
            f"{100 * of_faces[of_faces < least].sum():.1f} % together; `every` prints them"
        )
    noise = model.noise
    spread = f"{noise.sigma:.4f} m"
    if noise.growth > SHOWN_GROWTH:
        spread = f"sqrt({noise.sigma:.4f}² + ({noise.growth:.4f} r)²) m"
    if noise.sigma_xy > 0 or noise.sigma_yaw > 0:
        spread += f" of range, {noise.sigma_xy:.4f} m and {noise.sigma_yaw:.5f} rad of pose"
    terms = _laser_terms(model.calibration.terms, ray)
    return [*lines, *terms, f"the standard deviation of a return is {spread}"]


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


def _visible_stretches(faces: FaceSet, k: int, shares: Floats, least: float) -> list[str]:
    """Return two lines: where a face stops the ray, in map and at which share of poses; and the same along it (t)."""
    edges, levels = faces.edges, faces.levels
    own = np.arange(faces.first[k], faces.first[k + 1] - 1)
    own = own[levels[own] > MIN_VISIBILITY]
    if len(own) == 0:
        return ["    stops it nowhere"]
    if (shares[own] >= least).any():
        own = own[shares[own] >= least]
    printed = edges.round(3) + 0.0  # without a negative zero
    if (is_wide := printed[own + 1] > printed[own]).any():
        own = own[is_wide]
    (nx, ny), foot = faces.normals[k], faces.normals[k] * faces.offsets[k]
    ends = [foot + edges[j] * faces.tangents[k] for j in (own[0], own[-1] + 1)]
    a, b = (", ".join(f"{value + 0.0:.2f}" for value in end.round(2)) for end in ends)
    share = 100 * float(shares[faces.first[k] : faces.first[k + 1]].sum())
    length = float(edges[own[-1] + 1] - edges[own[0]])
    where = f"near ({a})" if length < 0.1 else f"from ({a}) to ({b})"
    along = ", ".join(
        f"{printed[j]:.3f} < t < {printed[j + 1]:.3f} (probability {levels[j]:.3f})" for j in own
    )
    return [
        f"    stops it at {share:.1f} % of poses, {where}",
        f"    stops it where {along}; t = {sum_text([(-ny, 'x_hit'), (nx, 'y_hit')])}",
    ]


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
