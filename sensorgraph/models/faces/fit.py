"""Fit of faces to rays: select lines on moments, estimate visibility by EM, split bent faces, repeat for the rest."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.models.faces.change_points import crossings_of, fit_stretches, has_length, take_faces
from sensorgraph.models.faces.corners import joined_visible, with_edge_errors
from sensorgraph.models.faces.forward_selection import Lines, select_lines, select_small_lines
from sensorgraph.models.faces.hit_moments import HitMoments
from sensorgraph.models.faces.maximisation import m_step
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.redundant import without_redundant_faces
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.splits import split_bent_faces
from sensorgraph.models.faces.strata import spread_evenly
from sensorgraph.models.faces.sufficient_statistics import SufficientStatistics
from sensorgraph.models.faces.visibility import Expectation, Rays, ReturnNoise, binned_faces, e_step
from sensorgraph.types import Floats, Progress
from sensorgraph.work_counter import WorkCounter

logger = logging.getLogger(__name__)

DRAFT_RAYS = 300_000
"""Maximum number of rays in the first rounds."""
ROUNDS = 3
"""Rounds of splitting and of selecting among unexplained hits; also the largest number of first selections."""
PASSES, ROUND_PASSES = 3, 4
"""EM iterations after a selection, and in each round."""
WIDE_RATIO = 1.5
"""Ratio of the observed to the assumed spread across faces above which the first selection is repeated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedFaces:
    """Result of `fit_faces`."""

    faces: FaceSet
    noise: ReturnNoise
    expectation: Expectation
    """Expectation of the last pass, over `n_rays` rays."""
    n_rays: int
    statistics: SufficientStatistics | None = None
    """Statistics to which new runs are added; None for drafts."""

    @property
    def hits(self) -> Floats:
        """(n_faces,) expected returns from each face, among the rays that the fitted ones represent."""
        return (self.expectation if self.statistics is None else self.statistics).line_sums[:, 5]


def fit_faces(
    rays: Rays,
    *,
    hit_moments: HitMoments | None = None,
    sigma: float = FACES.first_sigma,
    coarse: int = 1,
    pose_errors: tuple[float, float] = (0.0, 0.0),
    progress: Progress | None = None,
) -> FittedFaces:
    """Fit faces to rays.

    Parameters
    ----------
    rays : Rays whose weights count in the statistics; in the fit all rays count equally.
    hit_moments : Pooled hits of all rays, of which `rays` are a sample. None: those of `rays`.
    sigma : [m] Initial spread of hits across a face; the noise of ranges and poses is estimated.
    coarse : `coarseness` of the laser, by which cells and gaps of the selection grow.
    pose_errors : [m, rad] Errors of poses that were refined with these rays; the estimated noise does not include them.
    """
    work = WorkCounter(progress, ROUNDS + 3)  # stages of similar duration
    if hit_moments is None:
        hit_moments = HitMoments.of(rays.hits, rays.directions)
    final = replace(rays, weights=None)
    draft = _thinned(final, DRAFT_RAYS)
    faces, noise, expectation = _select_and_fit(draft, hit_moments, sigma, coarse)
    work.add(1)
    for k in range(ROUNDS):
        more = _select_unexplained(draft, expectation, noise, coarse, small=k == ROUNDS - 1)
        faces = take_faces(faces, np.flatnonzero(expectation.line_sums[:, 7] > FACES.min_face_gain))
        faces = binned_faces(split_bent_faces(draft, faces, noise).joined(more))
        faces, noise, expectation = _em(draft, faces, noise, passes=ROUND_PASSES)
        work.add(1)
        logger.info("%d faces, %.4f nats per ray", faces.n_faces, expectation.log_likelihood / len(draft))
    faces = without_redundant_faces(draft, faces, noise)
    logger.info("%d faces, none redundant", faces.n_faces)
    faces = fit_stretches(faces, crossings_of(draft, faces, noise, pose_errors))
    faces = take_faces(faces, np.flatnonzero(has_length(faces)))
    work.add(1)
    faces, noise, expectation = _em(final, faces, noise, passes=1)
    faces = take_faces(faces, np.flatnonzero(expectation.line_sums[:, 7] > FACES.min_face_gain))
    crossings = crossings_of(final, faces, noise, pose_errors)
    faces, crossings, _ = joined_visible(fit_stretches(faces, crossings), crossings)
    expectation = e_step(final, faces, noise)
    counted = final if rays.weights is None else rays
    summed = expectation if counted is final else e_step(counted, faces, noise)
    statistics = SufficientStatistics.of(counted, faces, summed, crossings, n_rays=len(counted))
    faces = with_edge_errors(faces, expectation.line_sums)
    work.add(1)
    return FittedFaces(
        faces=faces, noise=noise, expectation=expectation, n_rays=len(final), statistics=statistics
    )


def draft_faces(rays: Rays, *, sigma: float, coarse: int) -> FittedFaces:
    """Fit straight faces to a subset of the rays, whose returns have the standard deviation `sigma` [m].

    Bent faces are not split, since the sensor may cause the bend.
    """
    draft = _thinned(replace(rays, weights=None), DRAFT_RAYS)
    hit_moments = HitMoments.of(rays.hits, rays.directions)
    faces, noise, expectation = _select_and_fit(draft, hit_moments, sigma, coarse)
    return FittedFaces(faces=faces, noise=noise, expectation=expectation, n_rays=len(draft))


def moved_faces(rays: Rays, faces: FaceSet, noise: ReturnNoise) -> tuple[FaceSet, ReturnNoise]:
    """Move fitted faces to a subset of the rays, for instance after these were corrected; none appears or vanishes."""
    draft = _thinned(replace(rays, weights=None), DRAFT_RAYS)
    return _em(draft, faces, noise, passes=PASSES)[:2]


def _select_and_fit(
    rays: Rays, hit_moments: HitMoments, sigma: float, coarse: int
) -> tuple[FaceSet, ReturnNoise, Expectation]:
    """Select faces; repeat with a wider band if the hits spread more than assumed, due to noise of the poses."""
    sigma = max(sigma, coarse * FACES.first_sigma)
    for _ in range(ROUNDS):
        lines = select_lines(hit_moments, sigma=sigma, coarse=coarse)
        faces, noise, expectation = _em(
            rays, binned_faces(lines), ReturnNoise(sigma=2 * sigma), passes=PASSES
        )
        spread = _spread_across_faces(expectation, noise)
        if spread < WIDE_RATIO * sigma:
            break
        sigma = spread
    return faces, noise, expectation


def _spread_across_faces(expectation: Expectation, noise: ReturnNoise) -> float:
    """Return the standard deviation [m] of hits across their faces."""
    sums = expectation.line_sums
    total = sums[:, 5].sum()
    if total <= 0:
        return noise.sigma
    across = np.where(sums[:, 0] > 0, sums[:, 6] / np.maximum(sums[:, 0], 1e-300), 0.0)
    return float(np.sqrt((sums[:, 5] * across).sum() / total))


def _em(
    rays: Rays, faces: FaceSet, noise: ReturnNoise, *, passes: int
) -> tuple[FaceSet, ReturnNoise, Expectation]:
    """Alternate E and M steps; in the first of several passes only visibility is updated, not the lines."""
    for i in range(passes):
        expectation = e_step(rays, faces, noise)
        faces, noise = m_step(faces, expectation, noise, refit=i > 0 or passes == 1)
    return faces, noise, expectation


def _select_unexplained(
    rays: Rays, expectation: Expectation, noise: ReturnNoise, coarse: int, *, small: bool
) -> Lines:
    """Select lines among the returns that no face explains: those with a clear normal, or `small` ones."""
    left = (expectation.unexplained > 0.5) & np.isfinite(rays.ranges)
    hits, directions = rays.hits[left], rays.directions[left]
    if small:
        sides = HitMoments.by_direction(hits, directions)
        return select_small_lines(sides, sigma=noise.typical(rays), coarse=coarse)
    moments = HitMoments.of(hits, directions)
    return select_lines(moments, sigma=noise.typical(rays), coarse=coarse, limits=FACES.later_lines)


def _thinned(rays: Rays, most: int) -> Rays:
    """Return at most `most` rays, with up to the same number from each place and direction.

    Further rays from the same place in the same direction add little information, while rays from a place visited once
    are all there is.
    """
    if len(rays) <= most:
        return rays
    turn = np.arctan2(rays.directions[:, 1], rays.directions[:, 0])
    return rays.take(spread_evenly(rays.origins, turn, most)[0])
