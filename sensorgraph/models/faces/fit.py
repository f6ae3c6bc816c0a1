"""Fit faces to rays: select on moments, explain by EM, split what bends, select again among what is left."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from sensorgraph.models.faces.change_points import is_seen, looks_at, sharpen, subset
from sensorgraph.models.faces.corners import join_corners, with_errors
from sensorgraph.models.faces.forward_selection import Lines, select_lines
from sensorgraph.models.faces.hit_moments import Surfaces
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.splits import split_bent
from sensorgraph.models.faces.sufficient_statistics import Memory
from sensorgraph.models.faces.visibility import Expectation, Noise, Rays, expect, faces_of, improve
from sensorgraph.types import Floats, Progress

logger = logging.getLogger(__name__)

DRAFT_RAYS = 300_000
"""Rays that lines and bins are fitted to in the first rounds."""
FINAL_RAYS = 1_500_000
"""Rays that edges and visibility are taken from in the end."""
ROUNDS = 3
"""Of splitting and of selecting among what no face explains."""
STEPS = 5 + 2 * ROUNDS
"""That `fit_faces` reports to its progress."""
WORTH = 8.0
"""[nats] that a face must be worth to stay."""
FEW = 4.0
"""Hits that make a face of their own in the later rounds: a chair's leg has few."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedFaces:
    """What `fit_faces` found."""

    faces: FaceSet
    noise: Noise
    seen: Expectation
    """Of the last pass, over `n_rays` rays."""
    n_rays: int
    memory: Memory | None = None
    """What new runs are added to; None in drafts."""

    @property
    def hits(self) -> Floats:
        """(n_faces,) expected returns from each face."""
        return self.seen.lines[:, 5]


def fit_faces(
    rays: Rays, *, surfaces: Surfaces | None = None, sigma: float = 0.01, progress: Progress | None = None
) -> FittedFaces:
    """Find the faces that explain rays.

    Parameters
    ----------
    surfaces : pooled hits of all rays that `rays` are a sample of; None: of `rays` themselves
    sigma : [m] range noise to begin with; it is then estimated, and so is the noise of the poses
    """
    steps = Steps(progress, STEPS)
    if surfaces is None:
        surfaces = Surfaces.of(rays.hits, rays.directions)
    steps.tick()
    draft = _sample(rays, DRAFT_RAYS)
    faces, noise, seen = _start(draft, surfaces, sigma)
    steps.tick()
    for _ in range(ROUNDS):
        more = _left(draft, seen, noise)
        faces = subset(faces, np.flatnonzero(seen.lines[:, 7] > WORTH))
        faces = faces_of(split_bent(draft, faces, noise).joined(more))
        steps.tick()
        faces, noise, seen = _em(draft, faces, noise, passes=4)
        steps.tick()
        logger.info("%d faces, %.4f nats a ray", faces.n_faces, seen.nats / len(draft))
    final = _sample(rays, FINAL_RAYS)
    faces = sharpen(faces, looks_at(draft, faces, noise))
    faces = subset(faces, np.flatnonzero(is_seen(faces)))
    steps.tick()
    faces, noise, seen = _em(final, faces, noise, passes=1)
    looks = looks_at(final, faces, noise)
    faces = sharpen(faces, looks)
    seen_faces = np.flatnonzero(is_seen(faces))
    faces, looks = subset(faces, seen_faces), looks.of_faces(seen_faces)
    steps.tick()
    faces = join_corners(faces, looks)
    seen = expect(final, faces, noise)
    memory = Memory.of(final, faces, seen, looks, n_rays=len(final))
    faces = with_errors(faces, seen.lines)
    steps.tick()
    return FittedFaces(faces=faces, noise=noise, seen=seen, n_rays=len(final), memory=memory)


def draft_faces(rays: Rays, *, sigma: float) -> FittedFaces:
    """Find straight faces of a draft of the rays, whose returns may be off by `sigma` [m] for any reason.

    Nothing is split: what bends a face may be the sensor.
    """
    draft = _sample(rays, DRAFT_RAYS)
    faces, noise, seen = _start(draft, Surfaces.of(rays.hits, rays.directions), sigma)
    return FittedFaces(faces=faces, noise=noise, seen=seen, n_rays=len(draft))


def _start(rays: Rays, surfaces: Surfaces, sigma: float) -> tuple[FaceSet, Noise, Expectation]:
    """Select faces; once more with a wider band if hits spread wider than was thought (noise of the poses)."""
    for _ in range(3):
        lines = select_lines(surfaces, sigma=sigma)
        faces, noise, seen = _em(rays, faces_of(lines), Noise(sigma=2 * sigma), passes=3)
        wide = _spread(seen, noise)
        if wide < 1.5 * sigma:
            break
        sigma = wide
    return faces, noise, seen


def _spread(seen: Expectation, noise: Noise) -> float:
    """Return the standard deviation [m] of hits across their faces."""
    sums = seen.lines
    total = sums[:, 5].sum()
    if total <= 0:
        return noise.sigma
    across = np.where(sums[:, 0] > 0, sums[:, 6] / np.maximum(sums[:, 0], 1e-300), 0.0)
    return float(np.sqrt((sums[:, 5] * across).sum() / total))


def _em(rays: Rays, faces: FaceSet, noise: Noise, *, passes: int) -> tuple[FaceSet, Noise, Expectation]:
    """Alternate E and M steps; the lines rest in the first of several, until visibility has settled."""
    for i in range(passes):
        seen = expect(rays, faces, noise)
        faces, noise = improve(faces, seen, noise, refit=i > 0 or passes == 1)
    return faces, noise, seen


def _left(rays: Rays, seen: Expectation, noise: Noise) -> Lines:
    """Select lines among the returns that no face explains."""
    left = (seen.unexplained > 0.5) & np.isfinite(rays.ranges)
    surfaces = Surfaces.of(rays.hits[left], rays.directions[left])
    return select_lines(surfaces, sigma=noise.sigma, least=FEW, shortest=0.02, gap=0.05)


def _sample(rays: Rays, most: int) -> Rays:
    """Take evenly spaced rays if there are too many; an odd step meets every bearing."""
    step = -(-len(rays) // most)
    return rays if step == 1 else rays.take(slice(None, None, step + 1 - step % 2))


class Steps:
    """Count steps for a progress bar."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress, self.total, self.done = progress, total, 0

    def tick(self) -> None:
        self.to(self.done + 1)

    def to(self, done: int) -> None:
        self.done = done
        if self.progress is not None:
            self.progress(self.done, self.total)
