"""Statistics that a graph of faces keeps of its rays, so that new runs can be added without the old ones.

All statistics are sums: weighted sums of every line, stops and crossings of every stretch, moments of unexplained
hits. Single crossings are kept only next to edges, since they determine the edges' positions.
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
from sensorgraph.models.faces.visibility import Expectation, Rays
from sensorgraph.types import Floats, Ints

KEPT_CROSSINGS, REPRESENTATIVES = 12, 16
"""Number of crossings kept on each side of an edge, and number that represent all others of a stretch."""
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
    """(n_edges,) stops on the stretch after each edge."""
    reached: Floats
    """(n_edges,) crossings of the stretch after each edge."""
    noise_sums: Floats
    """(4, 5) as `Expectation.noise_sums`."""
    stray: Floats
    """(2,) number of outliers, which no face explains, and metres that all rays travelled."""
    unexplained_hits: HitMoments
    """Hits that no face explains."""
    face: Ints
    """(n_near,) face of each crossing next to an edge; `t`, `stop`, `weight` are its other columns (`Crossings`)."""
    t: Floats
    stop: Floats
    weight: Floats
    error: Floats
    """(n_near,) [m] standard error of the abscissae."""

    @classmethod
    def of(
        cls, rays: Rays, faces: FaceSet, expectation: Expectation, crossings: Crossings, *, n_rays: int
    ) -> SufficientStatistics:
        """Return the statistics of `n_rays` rays from a sample, counted by its weights, or equally without weights."""
        scale = scale_of(rays, n_rays)
        face, place = _next_to_edges(faces, crossings)
        unexplained = expectation.unexplained > 0.5
        counts = np.ones(len(rays)) if rays.weights is None else rays.weights
        hits = HitMoments.of(rays.hits[unexplained], rays.directions[unexplained], counts[unexplained])
        return cls(
            line_sums=scale * expectation.line_sums, stops=scale * expectation.stops,
            reached=scale * expectation.reached, noise_sums=scale * expectation.noise_sums,
            stray=scale * np.array([counts @ expectation.unexplained, expectation.distance]),
            unexplained_hits=HitMoments(cells=hits.cells, moments=scale * hits.moments), face=face,
            t=crossings.t[place], stop=crossings.stop[place], weight=crossings.weight[place],
            error=crossings.error[place],
        )  # fmt: skip

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
        """Return face, abscissa, stop, weight and error of crossings that represent all statistics.

        Crossings next to edges are returned as they are; representatives of the others are spread evenly over their
        stretch. `slide` (n_faces,) [m] is added to the abscissae.
        """
        owner = faces.owners
        at = np.flatnonzero(
            (self.reached > 2 * KEPT_CROSSINGS) & (np.arange(len(owner)) + 1 != faces.first[owner + 1])
        )
        step = (np.arange(REPRESENTATIVES) + 0.5) / REPRESENTATIVES
        low, high = faces.edges[at], faces.edges[at + 1]
        t = low[:, None] + (high - low)[:, None] * step
        stop = np.repeat(np.clip(self.stops[at] / self.reached[at], 0, 1), REPRESENTATIVES)
        weight = np.repeat(
            (self.reached[at] - 2 * KEPT_CROSSINGS) / REPRESENTATIVES,
            REPRESENTATIVES,
        )
        face = np.concatenate([self.face, np.repeat(owner[at], REPRESENTATIVES)])
        t = np.concatenate([self.t, t.ravel()]) + slide[face]
        error = np.concatenate([self.error, np.zeros(len(stop))])
        return face, t, np.concatenate([self.stop, stop]), np.concatenate([self.weight, weight]), error

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return compact arrays for a file, by name."""
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
        """Recreate the statistics from the output of `arrays`.

        Raises
        ------
        ValueError : An array has a wrong shape.
        """
        fields = {**SUMS, "t": "t", "stop": "stop", "weight": "weight"}
        found = {field: np.asarray(arrays[stored], dtype=np.float64) for stored, field in fields.items()}
        n_edges, n_near = len(faces.edges), len(found["t"])
        # older graphs store no errors: their crossings count as exact
        if found["noise_sums"].shape == (3, 4):  # and no sums for noise that grows with the range
            found["noise_sums"] = np.insert(np.pad(found["noise_sums"], ((0, 1), (0, 0))), 3, 0.0, axis=1)
        found["error"] = np.asarray(arrays.get("error", np.zeros(n_near)), dtype=np.float64)
        fields["error"] = "error"
        shapes = {stored: found[field].shape for stored, field in fields.items()}
        expected = {
            "lines": (faces.n_faces, 8), "stops": (n_edges,), "looks": (n_edges,), "spread": (4, 5),
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
    """Return the factor from sums over a sample to sums over `n_rays`; 1 if the rays have weights."""
    return n_rays / max(len(rays), 1) if rays.weights is None else 1.0


def merge_crossings(parts: list[Columns], n_faces: int) -> Crossings:
    """Merge and sort crossings (face, abscissa, stop, weight, error) from several sources."""
    face, t, stop, weight, error = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return sorted_crossings(face, t, stop, weight, error, n_faces)


def columns_of(crossings: Crossings, scale: float = 1.0) -> Columns:
    """Return crossings as columns, with weights multiplied by `scale`."""
    face = np.repeat(np.arange(len(crossings.bounds) - 1), np.diff(crossings.bounds))
    return face, crossings.t, crossings.stop, scale * crossings.weight, crossings.error


def rebase_line_sums(lines: Floats, before: FaceSet, after: FaceSet) -> Floats:
    """Transform sums (n_faces, 8) exactly to lines that moved rigidly: moments of (s, e, 1) become T moments T'."""
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
    )  # (n_faces, 3, 3) T: (s, e, 1) relative to the old line -> the new line
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
    """Return the faces and the indices of the crossings next to edges."""
    found, owners = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
    for k in range(faces.n_faces):
        start, end = int(crossings.bounds[k]), int(crossings.bounds[k + 1])
        edges = faces.edges[faces.first[k] : faces.first[k + 1]]
        middle = start + np.searchsorted(crossings.t[start:end], edges)
        near = (middle[:, None] + np.arange(-KEPT_CROSSINGS, KEPT_CROSSINGS)).ravel()
        near = np.unique(near[(near >= start) & (near < end)])
        found.append(near)
        owners.append(np.full(len(near), k, dtype=np.intp))
    return np.concatenate(owners), np.concatenate(found)
