"""What a graph of faces remembers of its rays, so that new runs can be added without the old ones.

All of it adds up: weighted sums of every line, stops and crossings of every stretch, moments of the hits that no face
explains. Of the single crossings only those next to edges are kept: they are what an edge's place hangs on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensorgraph.models.faces.change_points import Crossings, sorted_crossings
from sensorgraph.models.faces.hit_moments import HitMoments
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import Expectation, Rays
from sensorgraph.types import Floats, Ints

SUMS = {
    "lines": "line_sums",
    "stops": "stops",
    "looks": "reached",
    "spread": "noise_sums",
    "stray": "stray",
}
"""Name in a file -> field of `SufficientStatistics`."""
Columns = tuple[Ints, Floats, Floats, Floats, Floats]
"""Face, abscissa, stop, weight and error of crossings, each (n,), as in `Crossings`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SufficientStatistics:
    """Sums over all rays so far, and the crossings next to edges."""

    line_sums: Floats
    """(n_faces, 8) as `Expectation.line_sums`."""
    stops: Floats
    """(n_edges,) on the stretch after each edge."""
    reached: Floats
    """(n_edges,)"""
    noise_sums: Floats
    """(3, 4) as `Expectation.noise_sums`."""
    stray: Floats
    """(2,) returns that no face explains, and metres that all rays travelled."""
    unexplained_hits: HitMoments
    """Hits that no face explains."""
    face: Ints
    """(n_near,) face, abscissa [m], chance of stopping and weight of the crossings next to edges."""
    t: Floats
    stop: Floats
    weight: Floats
    error: Floats
    """(n_near,) [m] standard error of their abscissae."""

    @classmethod
    def of(
        cls, rays: Rays, faces: FaceSet, expectation: Expectation, crossings: Crossings, *, n_rays: int
    ) -> SufficientStatistics:
        """Remember rays that are a sample of `n_rays`: by their weights, or else all alike."""
        scale = scale_of(rays, n_rays)
        face, place = _next_to_edges(faces, crossings)
        left = expectation.unexplained > 0.5
        counts = np.ones(len(rays)) if rays.weights is None else rays.weights
        hits = HitMoments.of(rays.hits[left], rays.directions[left], counts[left])
        return cls(
            line_sums=scale * expectation.line_sums,
            stops=scale * expectation.stops,
            reached=scale * expectation.reached,
            noise_sums=scale * expectation.noise_sums,
            stray=scale * np.array([counts @ expectation.unexplained, expectation.distance]),
            unexplained_hits=HitMoments(cells=hits.cells, moments=scale * hits.moments),
            face=face,
            t=crossings.t[place],
            stop=crossings.stop[place],
            weight=crossings.weight[place],
            error=crossings.error[place],
        )

    def scaled(self, scale: float) -> SufficientStatistics:
        """Return the statistics of `scale` times as many rays."""
        return replace(
            self,
            line_sums=scale * self.line_sums,
            stops=scale * self.stops,
            reached=scale * self.reached,
            noise_sums=scale * self.noise_sums,
            stray=scale * self.stray,
            unexplained_hits=HitMoments(
                cells=self.unexplained_hits.cells, moments=scale * self.unexplained_hits.moments
            ),
        )

    def as_crossings(self, faces: FaceSet, slide: Floats) -> Columns:
        """Return face, abscissa, stop, weight and error of crossings that stand for all that is remembered.

        Those next to edges are themselves; the others of a stretch are spread evenly over it. `slide` (n_faces,)
        [m] is added to abscissae.
        """
        owner = np.repeat(np.arange(faces.n_faces), np.diff(faces.first))
        at = np.flatnonzero(
            (self.reached > 2 * FACES.reduction.kept_crossings)
            & (np.arange(len(owner)) + 1 != faces.first[owner + 1])
        )
        step = (np.arange(FACES.reduction.stand_ins) + 0.5) / FACES.reduction.stand_ins
        low, high = faces.edges[at], faces.edges[at + 1]
        t = low[:, None] + (high - low)[:, None] * step
        stop = np.repeat(np.clip(self.stops[at] / self.reached[at], 0, 1), FACES.reduction.stand_ins)
        weight = np.repeat(
            (self.reached[at] - 2 * FACES.reduction.kept_crossings) / FACES.reduction.stand_ins,
            FACES.reduction.stand_ins,
        )
        face = np.concatenate([self.face, np.repeat(owner[at], FACES.reduction.stand_ins)])
        t = np.concatenate([self.t, t.ravel()]) + slide[face]
        error = np.concatenate([self.error, np.zeros(len(stop))])
        return face, t, np.concatenate([self.stop, stop]), np.concatenate([self.weight, weight]), error

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return compact arrays for a file, by their names there."""
        hits = self.unexplained_hits
        out: dict[str, NDArray[Any]] = {
            "left.cells": hits.cells.astype(np.int32),
            "left.moments": hits.moments.astype(np.float32),
        }
        out |= {stored: getattr(self, field) for stored, field in SUMS.items()}
        out |= {"face": self.face.astype(np.int32), "t": self.t}
        return out | {name: getattr(self, name).astype(np.float32) for name in ("stop", "weight", "error")}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], faces: FaceSet) -> SufficientStatistics:
        """Rebuild what `arrays` gave.

        Raises
        ------
        ValueError : an array has the wrong shape
        """
        fields = {**SUMS, "t": "t", "stop": "stop", "weight": "weight"}
        found = {field: np.asarray(arrays[stored], dtype=np.float64) for stored, field in fields.items()}
        n_edges, n_near = len(faces.edges), len(found["t"])
        # a graph written before 0.5 has no errors: its crossings count as exact
        found["error"] = np.asarray(arrays.get("error", np.zeros(n_near)), dtype=np.float64)
        fields["error"] = "error"
        shapes = {stored: found[field].shape for stored, field in fields.items()}
        expected = {
            "lines": (faces.n_faces, 8), "stops": (n_edges,), "looks": (n_edges,), "spread": (3, 4),
            "stray": (2,), "t": (n_near,), "stop": (n_near,), "weight": (n_near,), "error": (n_near,),
        }  # fmt: skip
        if shapes != expected:
            raise ValueError(f"the statistics have shapes {shapes}, expected {expected}")
        hits = HitMoments(
            cells=np.asarray(arrays["left.cells"], dtype=np.int64),
            moments=np.asarray(arrays["left.moments"], dtype=np.float64),
        )
        return cls(unexplained_hits=hits, face=np.asarray(arrays["face"], dtype=np.intp), **found)


def scale_of(rays: Rays, n_rays: int) -> float:
    """Return what sums over a sample of `n_rays` are to be multiplied by; 1 where weights have counted them."""
    return n_rays / max(len(rays), 1) if rays.weights is None else 1.0


def merge_crossings(parts: list[Columns], n_faces: int) -> Crossings:
    """Put crossings (face, abscissa, stop, weight, error) of several sources together and sort them."""
    face, t, stop, weight, error = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return sorted_crossings(face, t, stop, weight, error, n_faces)


def columns_of(crossings: Crossings, scale: float = 1.0) -> Columns:
    """Return crossings as columns, each counted `scale` times."""
    face = np.repeat(np.arange(len(crossings.bounds) - 1), np.diff(crossings.bounds))
    return face, crossings.t, crossings.stop, scale * crossings.weight, crossings.error


def rebase_line_sums(lines: Floats, before: FaceSet, after: FaceSet) -> Floats:
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


def _next_to_edges(faces: FaceSet, crossings: Crossings) -> tuple[Ints, Ints]:
    """Return the faces and the places of the crossings next to edges."""
    found, owners = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
    for k in range(faces.n_faces):
        start, end = int(crossings.bounds[k]), int(crossings.bounds[k + 1])
        edges = faces.edges[faces.first[k] : faces.first[k + 1]]
        middle = start + np.searchsorted(crossings.t[start:end], edges)
        near = (
            middle[:, None] + np.arange(-FACES.reduction.kept_crossings, FACES.reduction.kept_crossings)
        ).ravel()
        near = np.unique(near[(near >= start) & (near < end)])
        found.append(near)
        owners.append(np.full(len(near), k, dtype=np.intp))
    return np.concatenate(owners), np.concatenate(found)
