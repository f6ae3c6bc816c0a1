"""What a graph of faces remembers of its rays, so that new runs can be added without the old ones.

All of it adds up: weighted sums of every line, stops and looks of every stretch, moments of the hits that no face
explains. Of the single looks only those next to edges are kept: they are what an edge's place hangs on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensorgraph.models.faces.change_points import Looks, sorted_looks
from sensorgraph.models.faces.hit_moments import Surfaces
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.visibility import Expectation, Rays
from sensorgraph.types import Floats, Ints

BESIDE = 12
"""Looks kept on each side of an edge."""
SPREAD_OVER = 16
"""Looks that stand for all others of a stretch."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """Sums over all rays so far, and the looks next to edges."""

    lines: Floats
    """(n_faces, 8) as `Expectation.lines`."""
    stops: Floats
    """(n_edges,) on the stretch after each edge."""
    looks: Floats
    """(n_edges,)"""
    spread: Floats
    """(3, 4) as `Expectation.spread`."""
    stray: Floats
    """(2,) returns that no face explains, and metres that all rays travelled."""
    left: Surfaces
    """Hits that no face explains."""
    face: Ints
    """(n_near,) face, abscissa [m], chance of stopping and weight of the looks next to edges."""
    t: Floats
    stop: Floats
    weight: Floats

    @classmethod
    def of(cls, rays: Rays, faces: FaceSet, seen: Expectation, looks: Looks, *, n_rays: int) -> Memory:
        """Remember rays that are a sample of `n_rays`."""
        scale = n_rays / max(len(rays), 1)
        face, place = _beside(faces, looks)
        left = seen.unexplained > 0.5
        hits = Surfaces.of(rays.hits[left], rays.directions[left])
        return cls(
            lines=scale * seen.lines,
            stops=scale * seen.stops,
            looks=scale * seen.looks,
            spread=scale * seen.spread,
            stray=scale * np.array([seen.unexplained.sum(), seen.metres]),
            left=Surfaces(cells=hits.cells, moments=scale * hits.moments),
            face=face,
            t=looks.t[place],
            stop=looks.stop[place],
            weight=looks.weight[place],
        )

    def scaled(self, scale: float) -> Memory:
        """Return the memory of `scale` times as many rays."""
        return replace(
            self,
            lines=scale * self.lines,
            stops=scale * self.stops,
            looks=scale * self.looks,
            spread=scale * self.spread,
            stray=scale * self.stray,
            left=Surfaces(cells=self.left.cells, moments=scale * self.left.moments),
        )

    def as_looks(self, faces: FaceSet, slide: Floats) -> tuple[Ints, Floats, Floats, Floats]:
        """Return face, abscissa, stop and weight of looks that stand for all that is remembered.

        Those next to edges are themselves; the others of a stretch are spread evenly over it. `slide` (n_faces,)
        [m] is added to abscissae.
        """
        owner = np.repeat(np.arange(faces.n_faces), np.diff(faces.first))
        at = np.flatnonzero((self.looks > 2 * BESIDE) & (np.arange(len(owner)) + 1 != faces.first[owner + 1]))
        step = (np.arange(SPREAD_OVER) + 0.5) / SPREAD_OVER
        low, high = faces.edges[at], faces.edges[at + 1]
        t = low[:, None] + (high - low)[:, None] * step
        stop = np.repeat(np.clip(self.stops[at] / self.looks[at], 0, 1), SPREAD_OVER)
        weight = np.repeat((self.looks[at] - 2 * BESIDE) / SPREAD_OVER, SPREAD_OVER)
        face = np.concatenate([self.face, np.repeat(owner[at], SPREAD_OVER)])
        t = np.concatenate([self.t, t.ravel()]) + slide[face]
        return face, t, np.concatenate([self.stop, stop]), np.concatenate([self.weight, weight])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return arrays for a file, as small as they need to be."""
        cells = self.left.cells.astype(np.int32)
        out: dict[str, NDArray[Any]] = {
            "left.cells": cells,
            "left.moments": self.left.moments.astype(np.float32),
        }
        out |= {name: getattr(self, name) for name in ("lines", "stops", "looks", "spread", "stray")}
        out |= {"face": self.face.astype(np.int32), "t": self.t}
        return out | {name: getattr(self, name).astype(np.float32) for name in ("stop", "weight")}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], faces: FaceSet) -> Memory:
        """Rebuild what `arrays` gave; a wrong shape is a ValueError."""
        whole = {
            name: np.asarray(arrays[name], dtype=np.float64)
            for name in ("lines", "stops", "looks", "spread", "stray", "t", "stop", "weight")
        }
        n_edges, n_near = len(faces.edges), len(whole["t"])
        shapes = [whole[name].shape for name in ("lines", "stops", "looks", "spread", "stray", "stop")]
        right = [(faces.n_faces, 8), (n_edges,), (n_edges,), (3, 4), (2,), (n_near,)]
        if shapes != right:
            raise ValueError(f"the memory has shapes {shapes}, expected {right}")
        left = Surfaces(
            cells=np.asarray(arrays["left.cells"], dtype=np.int64),
            moments=np.asarray(arrays["left.moments"], dtype=np.float64),
        )
        return cls(left=left, face=np.asarray(arrays["face"], dtype=np.intp), **whole)


def merged(parts: list[tuple[Ints, Floats, Floats, Floats]], n_faces: int) -> Looks:
    """Put looks (face, abscissa, stop, weight) of several sources together and sort them."""
    face, t, stop, weight = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return sorted_looks(face, t, stop, weight, n_faces)


def unsorted(looks: Looks, scale: float = 1.0) -> tuple[Ints, Floats, Floats, Floats]:
    """Return looks as columns, each counted `scale` times."""
    face = np.repeat(np.arange(len(looks.bounds) - 1), np.diff(looks.bounds))
    return face, looks.t, looks.stop, scale * looks.weight


def rebased(lines: Floats, before: FaceSet, after: FaceSet) -> Floats:
    """Return sums (n_faces, 8) about lines that have moved: exact, since both frames are rigid."""
    out = lines.copy()
    d, moved_d = before.offsets, after.offsets
    along = (before.tangents * after.tangents).sum(axis=1)
    across = (before.normals * after.tangents).sum(axis=1)
    zero, one = np.zeros(len(d)), np.ones(len(d))
    turn = np.stack(
        [
            np.stack([along, across, d * across], axis=1),
            np.stack([-across, along, d * along - moved_d], axis=1),
            np.stack([zero, zero, one], axis=1),
        ],
        axis=1,
    )  # (n_faces, 3, 3): (s, e, 1) about the old line -> about the new
    w, ws, wss, we, wse, wee = (lines[:, i] for i in (0, 1, 2, 3, 4, 6))
    moments = np.stack(
        [
            np.stack([wss, wse, ws], axis=1),
            np.stack([wse, wee, we], axis=1),
            np.stack([ws, we, w], axis=1),
        ],
        axis=1,
    )
    moved = turn @ moments @ turn.transpose(0, 2, 1)
    out[:, 1], out[:, 2], out[:, 3] = moved[:, 0, 2], moved[:, 0, 0], moved[:, 1, 2]
    out[:, 4], out[:, 6] = moved[:, 0, 1], moved[:, 1, 1]
    return out


def _beside(faces: FaceSet, looks: Looks) -> tuple[Ints, Ints]:
    """Return the faces and the places of the looks next to edges."""
    found, owners = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
    for k in range(faces.n_faces):
        start, end = int(looks.bounds[k]), int(looks.bounds[k + 1])
        edges = faces.edges[faces.first[k] : faces.first[k + 1]]
        middle = start + np.searchsorted(looks.t[start:end], edges)
        near = (middle[:, None] + np.arange(-BESIDE, BESIDE)).ravel()
        near = np.unique(near[(near >= start) & (near < end)])
        found.append(near)
        owners.append(np.full(len(near), k, dtype=np.intp))
    return np.concatenate(owners), np.concatenate(found)
