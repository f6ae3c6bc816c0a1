"""Update of fitted faces with new runs, without the rays of the old runs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.models.faces.change_points import (
    Crossings,
    crossings_of,
    fit_stretches,
    joined_faces,
    take_faces,
)
from sensorgraph.models.faces.corners import joined_visible, with_edge_errors
from sensorgraph.models.faces.fit import PASSES
from sensorgraph.models.faces.forward_selection import Lines, coarseness, select_small_lines
from sensorgraph.models.faces.hit_moments import HitMoments
from sensorgraph.models.faces.maximisation import STRAY_RANGE, estimate_noise, refit_lines, stretch_visibility
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.ray_march import MIN_VISIBILITY, FaceSet
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.sufficient_statistics import (
    SufficientStatistics,
    columns_of,
    merge_crossings,
    rebase_line_sums,
    scale_of,
)
from sensorgraph.models.faces.visibility import (
    FIRST_BIN,
    Expectation,
    Rays,
    ReturnNoise,
    binned_faces,
    e_step,
)
from sensorgraph.types import Floats, Ints

EXPLAINED_WITHIN = 0.03
"""[m] Distance to a visible stretch below which a stored hit is explained."""


def update_faces(
    faces: FaceSet, noise: ReturnNoise, statistics: SufficientStatistics, observed: ObservedSpace,
    rays: Rays, *, n_rays: int, pose_errors: tuple[float, float] = (0.0, 0.0),
) -> tuple[FaceSet, ReturnNoise, SufficientStatistics]:  # fmt: skip
    """Return faces, noise and statistics with new rays added.

    New rays add to the sums of old faces: they move lines and edges according to their weight, and lower the visibility
    of surfaces that are gone. New faces are selected among the unexplained hits, old and new. Old rays through the
    place of a new face count as passes.

    Parameters
    ----------
    observed : Space that the old rays crossed.
    rays : A sample of the `n_rays` new rays.
    pose_errors : [m, rad] Errors of poses that were refined with these rays.
    """
    scale = scale_of(rays, n_rays)
    alone = _refitted(faces, statistics, rays, noise, pose_errors, scale).faces
    expectation = e_step(rays, alone, noise)  # edges that few old rays met may have moved
    unexplained = (expectation.unexplained > 0.5) & np.isfinite(rays.ranges)
    fresh = HitMoments.by_direction(rays.hits[unexplained], rays.directions[unexplained])
    stored = statistics.unexplained_hits.split_by_direction()
    sides = [a.merge(b) for a, b in zip(fresh, stored, strict=True)]
    sigma = noise.typical(rays)
    lines = select_small_lines(sides, sigma=sigma, coarse=coarseness(sigma))
    old = _with_new_faces(statistics, lines, observed)
    n_old = faces.n_faces
    faces = joined_faces(faces, binned_faces(lines))
    for _ in range(PASSES):
        expectation = e_step(rays, faces, noise)
        faces = faces._replace(levels=_visibility(faces, expectation, old, scale))
    keep = np.flatnonzero(
        (np.arange(faces.n_faces) < n_old) | (expectation.line_sums[:, 7] > FACES.min_face_gain)
    )
    faces, old = _take(faces, old, keep)
    refit = _refitted(faces, old, rays, noise, pose_errors, scale)
    faces, crossings, index = joined_visible(refit.faces, refit.crossings)
    expectation = e_step(rays, faces, noise)
    new = SufficientStatistics.of(rays, faces, expectation, refit.stored.of_faces(index), n_rays=n_rays)
    total = _merge_statistics(old, new, refit.held_lines[index], faces, crossings)
    stray = np.clip(total.stray[0] / max(total.stray[1], 1.0), *STRAY_RANGE)
    noise = estimate_noise(noise, total.noise_sums, float(stray))
    return with_edge_errors(faces, total.line_sums), noise, total


@dataclass(frozen=True, kw_only=True, eq=False)
class _Refit:
    """Faces refitted to old and new rays."""

    faces: FaceSet
    crossings: Crossings
    stored: Crossings
    """Crossings for the statistics: the old ones as they were stored."""
    held_lines: Floats
    """(n_faces, 8) Sums of the old rays about the refitted lines."""


def _refitted(
    faces: FaceSet,
    old: SufficientStatistics,
    rays: Rays,
    noise: ReturnNoise,
    pose_errors: tuple[float, float],
    scale: float,
) -> _Refit:
    """Refit lines and stretches of faces to their old statistics and to new rays, which count `scale` each."""
    before = faces
    faces = refit_lines(faces, old.line_sums + scale * e_step(rays, faces, noise).line_sums)
    slide = faces.edges[faces.first[:-1]] - before.edges[before.first[:-1]]
    new = columns_of(crossings_of(rays, faces, noise, pose_errors), scale)
    crossings = merge_crossings([old.as_crossings(before, slide), new], faces.n_faces)
    stored = merge_crossings(
        [(old.face, old.t + slide[old.face], old.stop, old.weight, old.error), new], faces.n_faces
    )
    held_lines = rebase_line_sums(old.line_sums, before, faces)
    return _Refit(
        faces=fit_stretches(faces, crossings), crossings=crossings, stored=stored, held_lines=held_lines
    )


def _with_new_faces(
    statistics: SufficientStatistics, lines: Lines, observed: ObservedSpace
) -> SufficientStatistics:
    """Return the statistics extended by new faces; old rays through their place count as passes."""
    new = binned_faces(lines)
    owner = new.owners
    points = new.points(owner, new.edges + FIRST_BIN / 2)
    beside = observed.cell * new.normals[owner]  # in the cells on both sides of the face
    passes = np.minimum(_rays_through(observed, points + beside), _rays_through(observed, points - beside))
    return replace(
        statistics,
        line_sums=np.concatenate([statistics.line_sums, np.zeros((new.n_faces, 8))]),
        stops=np.concatenate([statistics.stops, np.zeros(len(new.edges))]),
        reached=np.concatenate([statistics.reached, passes]),
    )


def _rays_through(observed: ObservedSpace, points: Floats) -> Floats:
    """Return the number of rays through the cells of points (n, 2) [m]."""
    i, j = np.floor((points - observed.origin) / observed.cell).astype(np.intp).T
    nx, ny = observed.counts.shape
    inside = (i >= 0) & (j >= 0) & (i < nx) & (j < ny)
    out = np.zeros(len(points))
    out[inside] = observed.counts[i[inside], j[inside]]
    return out


def _visibility(faces: FaceSet, expectation: Expectation, old: SufficientStatistics, scale: float) -> Floats:
    """Return the visibility of every stretch from old and new stops and crossings."""
    stops, reached = old.stops + scale * expectation.stops, old.reached + scale * expectation.reached
    return stretch_visibility(faces, stops, reached)


def _take(faces: FaceSet, old: SufficientStatistics, index: Ints) -> tuple[FaceSet, SufficientStatistics]:
    """Return some faces and their statistics; only new faces may be omitted."""
    place = np.concatenate([np.arange(faces.first[k], faces.first[k + 1]) for k in index])
    return take_faces(faces, index), replace(
        old, line_sums=old.line_sums[index], stops=old.stops[place], reached=old.reached[place]
    )


def _merge_statistics(
    old: SufficientStatistics, new: SufficientStatistics, lines: Floats, faces: FaceSet, crossings: Crossings
) -> SufficientStatistics:
    """Add the statistics of old and new rays; stops and crossings are recounted for the new stretches."""
    owner = faces.owners
    stops, total = np.zeros(len(owner)), np.zeros(len(owner))
    for k in range(faces.n_faces):
        t, stop, weight, _ = crossings.at(k)
        a, b = int(faces.first[k]), int(faces.first[k + 1])
        j = np.clip(np.searchsorted(faces.edges[a:b], t, side="right") - 1, 0, b - a - 1)
        total[a:b] = np.bincount(j, weights=weight, minlength=b - a)
        stops[a:b] = np.bincount(j, weights=weight * stop, minlength=b - a)
    return replace(
        new, line_sums=lines + new.line_sums, stops=stops, reached=total,
        noise_sums=old.noise_sums + new.noise_sums, stray=old.stray + new.stray,
        unexplained_hits=_still_unexplained(old.unexplained_hits, faces).merge(new.unexplained_hits),
    )  # fmt: skip


def _still_unexplained(unexplained: HitMoments, faces: FaceSet) -> HitMoments:
    """Return the hits without a visible stretch of a face nearby."""
    where = unexplained.centres + unexplained.moments[:, 1:3] / np.maximum(unexplained.counts, 1e-9)[:, None]
    near = np.zeros(len(where), dtype=np.bool_)
    for k in range(faces.n_faces):
        part = slice(faces.first[k], faces.first[k + 1])
        off = np.abs(where @ faces.normals[k] - faces.offsets[k])
        t = where @ faces.tangents[k]
        j = np.clip(np.searchsorted(faces.edges[part], t, side="right") - 1, 0, None)
        near |= (
            (off < EXPLAINED_WITHIN) & (t > faces.edges[part][0]) & (faces.levels[part][j] > MIN_VISIBILITY)
        )
    return HitMoments(cells=unexplained.cells[~near], moments=unexplained.moments[~near])
