"""Add new runs to faces that were fitted before, without the rays of the old runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.models.faces.change_points import Looks, is_seen, looks_at, sharpen, subset
from sensorgraph.models.faces.corners import join_corners, with_errors
from sensorgraph.models.faces.fit import FEW, WORTH
from sensorgraph.models.faces.forward_selection import Lines, select_lines
from sensorgraph.models.faces.hit_moments import Surfaces
from sensorgraph.models.faces.observed_space import Crossed
from sensorgraph.models.faces.ray_march import FAINT, FaceSet
from sensorgraph.models.faces.sufficient_statistics import Memory, merged, rebased, unsorted
from sensorgraph.models.faces.visibility import Expectation, Noise, Rays, expect, faces_of, moved, spread_of
from sensorgraph.types import Floats, Ints

NEAR = 0.03
"""[m] a hit this near to a face is explained by it, once it is there."""
PASSES = 3
"""Of EM over the new rays, old sums held."""
BEHIND = 0.1
"""[m] before and behind a new face where old rays are looked for that went through its place."""


def update_faces(
    faces: FaceSet, noise: Noise, memory: Memory, crossed: Crossed, rays: Rays, *, n_rays: int
) -> tuple[FaceSet, Noise, Memory]:
    """Return faces, noise and memory with new rays added.

    Old faces keep their sums: new rays add to them, move lines and edges as much as they weigh, and lower the
    visibility of what is no longer there. New faces are selected among the hits that none explains, old and new;
    where old rays went through the place of a new face, those count as passes.

    Parameters
    ----------
    crossed : what the old rays went through
    rays : a sample of the `n_rays` new ones
    """
    scale = n_rays / max(len(rays), 1)
    seen = expect(rays, faces, noise)
    left = (seen.unexplained > 0.5) & np.isfinite(rays.ranges)
    hits = Surfaces.of(rays.hits[left], rays.directions[left])
    lines = select_lines(hits.merge(memory.left), sigma=noise.sigma, least=FEW, shortest=0.02, gap=0.05)
    held = _widened(memory, lines, crossed)
    n_old = faces.n_faces
    faces = _joined(faces, faces_of(lines))
    for _ in range(PASSES):
        seen = expect(rays, faces, noise)
        faces = faces._replace(levels=_levels(faces, seen, held, scale))
    keep = np.flatnonzero((np.arange(faces.n_faces) < n_old) | (seen.lines[:, 7] > WORTH))
    faces, held = _kept(faces, held, keep)
    seen = expect(rays, faces, noise)
    before = faces
    faces = moved(faces, held.lines + scale * seen.lines)
    slide = faces.edges[faces.first[:-1]] - before.edges[before.first[:-1]]
    fresh = unsorted(looks_at(rays, faces, noise), scale)
    looks = merged([held.as_looks(before, slide), fresh], faces.n_faces)
    single = merged([(held.face, held.t + slide[held.face], held.stop, held.weight), fresh], faces.n_faces)
    held_lines = rebased(held.lines, before, faces)
    faces = sharpen(faces, looks)
    index = np.flatnonzero(is_seen(faces))
    faces, held_lines = subset(faces, index), held_lines[index]
    looks, single = looks.of_faces(index), single.of_faces(index)
    faces = join_corners(faces, looks)
    seen = expect(rays, faces, noise)
    new = Memory.of(rays, faces, seen, single, n_rays=n_rays)
    total = _total(held, new, held_lines, faces, looks)
    noise = spread_of(
        noise, total.spread, float(np.clip(total.stray[0] / max(total.stray[1], 1.0), 1e-6, 0.05))
    )
    return with_errors(faces, total.lines), noise, total


def _joined(a: FaceSet, b: FaceSet) -> FaceSet:
    """Return the faces of both, those of `a` first; neighbours stay those of `a`."""
    return FaceSet(
        normals=np.concatenate([a.normals, b.normals]),
        offsets=np.concatenate([a.offsets, b.offsets]),
        first=np.concatenate([a.first, a.first[-1] + b.first[1:]]),
        edges=np.concatenate([a.edges, b.edges]),
        levels=np.concatenate([a.levels, b.levels]),
        blur=np.concatenate([a.blur, b.blur]),
        neighbour=np.concatenate([a.neighbour, b.neighbour]),
    )


def _widened(memory: Memory, lines: Lines, crossed: Crossed) -> Memory:
    """Return the memory with room for new faces: no stops of old, but passes where old rays went through."""
    new = faces_of(lines)
    owner = np.repeat(np.arange(new.n_faces), np.diff(new.first))
    middle = new.edges + 0.005
    points = new.normals[owner] * new.offsets[owner, None] + new.tangents[owner] * middle[:, None]
    through = np.minimum(
        _count(crossed, points + BEHIND * new.normals[owner]),
        _count(crossed, points - BEHIND * new.normals[owner]),
    )
    return replace(
        memory,
        lines=np.concatenate([memory.lines, np.zeros((new.n_faces, 8))]),
        stops=np.concatenate([memory.stops, np.zeros(len(new.edges))]),
        looks=np.concatenate([memory.looks, through]),
    )


def _count(crossed: Crossed, points: Floats) -> Floats:
    """Return how many rays went through the cells of points (n, 2) [m]."""
    i, j = np.floor((points - crossed.origin) / crossed.cell).astype(np.intp).T
    nx, ny = crossed.counts.shape
    inside = (i >= 0) & (j >= 0) & (i < nx) & (j < ny)
    out = np.zeros(len(points))
    out[inside] = crossed.counts[i[inside], j[inside]]
    return out


def _levels(faces: FaceSet, seen: Expectation, held: Memory, scale: float) -> Floats:
    """Return the visibility of every stretch from old and new stops and looks."""
    stops, looks = held.stops + scale * seen.stops, held.looks + scale * seen.looks
    levels = np.where(looks > 0, (stops + 0.02) / (looks + 0.04), 0.0)
    levels[faces.first[1:] - 1] = 0.0
    return np.asarray(levels)


def _kept(faces: FaceSet, held: Memory, index: Ints) -> tuple[FaceSet, Memory]:
    """Return some faces and what is remembered of them; only new faces are ever left out."""
    place = np.concatenate([np.arange(faces.first[k], faces.first[k + 1]) for k in index])
    return subset(faces, index), replace(
        held, lines=held.lines[index], stops=held.stops[place], looks=held.looks[place]
    )


def _total(held: Memory, new: Memory, lines: Floats, faces: FaceSet, looks: Looks) -> Memory:
    """Add what is remembered of old and new rays; stops and looks are those of the new stretches."""
    owner = np.repeat(np.arange(faces.n_faces), np.diff(faces.first))
    stops, total = np.zeros(len(owner)), np.zeros(len(owner))
    for k in range(faces.n_faces):
        t, stop, weight = looks.at(k)
        a, b = int(faces.first[k]), int(faces.first[k + 1])
        j = np.clip(np.searchsorted(faces.edges[a:b], t, side="right") - 1, 0, b - a - 1)
        total[a:b] = np.bincount(j, weights=weight, minlength=b - a)
        stops[a:b] = np.bincount(j, weights=weight * stop, minlength=b - a)
    return replace(
        new,
        lines=lines + new.lines,
        stops=stops,
        looks=total,
        spread=held.spread + new.spread,
        stray=held.stray + new.stray,
        left=_unexplained(held.left, faces).merge(new.left),
    )


def _unexplained(left: Surfaces, faces: FaceSet) -> Surfaces:
    """Return the hits that no visible stretch of a face is near."""
    where = left.centres + left.moments[:, 1:3] / np.maximum(left.counts, 1e-9)[:, None]
    near = np.zeros(len(where), dtype=np.bool_)
    for k in range(faces.n_faces):
        part = slice(faces.first[k], faces.first[k + 1])
        off = np.abs(where @ faces.normals[k] - faces.offsets[k])
        t = where @ faces.tangents[k]
        j = np.clip(np.searchsorted(faces.edges[part], t, side="right") - 1, 0, None)
        near |= (off < NEAR) & (t > faces.edges[part][0]) & (faces.levels[part][j] > FAINT)
    return Surfaces(cells=left.cells[~near], moments=left.moments[~near])
