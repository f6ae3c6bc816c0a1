"""M step of the EM: visibility of stretches, lines of faces and noise from the sums of an E step (`visibility`).

Visibility of a stretch: (stops + prior_stops) / (reached + prior_crossings). Lines: weighted least squares. Noise: the
variances sigma², sigma_xy², sigma_yaw² and growth² of a return, which are not negative.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import (
    MIN_VARIANCE,
    PRIOR_CROSSINGS,
    PRIOR_STOPS,
    Expectation,
    ReturnNoise,
)
from sensorgraph.types import Floats

MIN_HITS = 2.0
"""Number of hits below which a line is not moved."""
MAX_TURN = 0.2
"""[rad] Maximum turn of a line in one step."""
STRAY_RANGE = 1e-6, 0.05
"""[1/m] Limits of the density of outliers."""


def m_step(
    faces: FaceSet, expectation: Expectation, noise: ReturnNoise, *, refit: bool
) -> tuple[FaceSet, ReturnNoise]:
    """Set visibility, lines (if `refit`) and noise to the maximum of the expected likelihood (M step)."""
    better = faces._replace(levels=stretch_visibility(faces, expectation.stops, expectation.reached))
    if refit:
        better = refit_lines(better, expectation.line_sums)
    returned = float(expectation.unexplained.sum())
    stray = float(np.clip((returned + 1.0) / max(expectation.distance, 1.0), *STRAY_RANGE))
    return better, estimate_noise(noise, expectation.noise_sums, stray)


def stretch_visibility(faces: FaceSet, stops: Floats, reached: Floats) -> Floats:
    """Return the visibility (n_edges,) = (stops + prior_stops) / (reached + prior_crossings) of every stretch."""
    levels = np.where(reached > 0, (stops + PRIOR_STOPS) / (reached + PRIOR_CROSSINGS), 0.0)
    levels[faces.first[1:] - 1] = 0.0
    return np.asarray(levels)


def refit_lines(faces: FaceSet, sums: Floats) -> FaceSet:
    """Shift and turn every line by weighted least squares: e' = shift + (s - c) turn.

    With W = sum w, the mean abscissa is c = sum w s / W. The shift is sum w e' / W. Turn:
    ((sum w s e' / W - c shift) / (sum w s² / W - c² + 1 / (W turn_prior²))).
    """
    w, ws, wss, we, wse = sums[:, 0], sums[:, 1], sums[:, 2], sums[:, 3], sums[:, 4]
    enough = (sums[:, 5] > MIN_HITS) & (w > 0)
    w = np.where(enough, w, 1.0)
    c = ws / w
    shift = np.where(enough, we / w, 0.0)
    variance_along = np.maximum(wss / w - c**2, 0.0)
    # the prior on the turn, scaled by the weight, keeps faces with few hits from rotating freely
    prior = 1.0 / (w * FACES.turn_prior**2)
    turn = np.where(enough, (wse / w - c * shift) / (variance_along + prior + 1e-9), 0.0)
    return moved_lines(faces, shift, turn, c)


def moved_lines(faces: FaceSet, shift: Floats, turn: Floats, centre: Floats) -> FaceSet:
    """Shift lines (n_faces,) [m] along their normals, and turn them by up to `MAX_TURN` about abscissae `centre` (n_faces,)."""
    turn = np.clip(turn, -MAX_TURN, MAX_TURN)
    normals, tangents = faces.normals, faces.tangents
    centres = normals * (faces.offsets + shift)[:, None] + tangents * centre[:, None]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    turned = cos * normals - sin * tangents
    moved = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
    slide = (moved * centres).sum(axis=1) - centre
    return faces._replace(
        normals=turned,
        offsets=(turned * centres).sum(axis=1),
        edges=faces.edges + np.repeat(slide, np.diff(faces.first)),
    )


def estimate_noise(noise: ReturnNoise, spread: Floats, stray: float) -> ReturnNoise:
    """Estimate noise of range and pose from e² = sigma² + (growth r)² + (sigma_xy² + (r u·t sigma_yaw)²) / (n·u)², by NNLS."""
    scale = np.sqrt(np.maximum(np.diag(spread[:, :4]), 1e-300))
    if spread[0, 0] <= 0:
        return replace(noise, stray=stray)
    solution = nnls(spread[:, :4] / scale[:, None] / scale, spread[:, 4] / scale)[0] / scale
    return ReturnNoise(
        sigma=float(np.sqrt(max(solution[0], MIN_VARIANCE))),
        sigma_xy=float(np.sqrt(solution[1])),
        sigma_yaw=float(np.sqrt(solution[2])),
        stray=stray,
        growth=float(np.sqrt(solution[3])),
    )
