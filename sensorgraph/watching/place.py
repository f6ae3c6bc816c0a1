"""What stands in the place that the graph lacks, and what is gone: evidence in cells over several passes.

A reading that ends before the predicted surface is evidence for something new where it ends. A reading that ends beyond
the predicted surface is evidence that this is gone. Rays that pass through a cell, or end at the predicted surface, are
evidence against. People do not stay. The evidence of one pass is limited, so that several must agree. Whoever stood there at the last
pass is still there after a time t with the probability exp(-t / stay), so that the next one counts only the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.ndimage import label
from scipy.special import expit

from sensorgraph.models.base import Prediction
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.watching.readings import GraphReadings, ReadingEvidence
from sensorgraph.watching.scan_input import ScanInput
from sensorgraph.watching.settings import PLACE, PlacePriors
from sensorgraph.world.cell_outline import outline

ChangeKind = Literal["new", "gone"]
RECENT = 1000.0
"""Number of independent readings over which the share that the graph predicts is averaged."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceChange:
    """One connected thing that came or is gone."""

    kind: ChangeKind
    centre: Floats
    """(2,) [m, map]"""
    size: Floats
    """(2,) [m] along x and y"""
    outlines: tuple[Floats, ...]
    """Closed lines (n, 2) [m, map]"""
    first_seen: float
    """[s]"""
    last_seen: float
    passes: int
    """Number of passes that show it."""
    p: float
    """Mean probability of its cells."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "xy": [round(float(v), 3) for v in self.centre],
            "size_m": [round(float(v), 3) for v in self.size],
            "outline": [[[round(float(v), 3) for v in point] for point in line] for line in self.outlines],
            "first_seen": round(self.first_seen, 3),
            "last_seen": round(self.last_seen, 3),
            "passes": self.passes,
            "p": round(self.p, 4),
        }


class _Cells:
    """Evidence of one kind in all cells."""

    def __init__(self, shape: tuple[int, int], priors: PlacePriors) -> None:
        self.priors = priors
        self.before = np.zeros(shape, dtype=np.float32)  # evidence of earlier passes
        self.now = np.zeros(shape, dtype=np.float32)  # of the current pass
        self.most = np.full(shape, priors.per_pass, dtype=np.float32)  # evidence of the current pass, at most
        self.passes = np.zeros(shape, dtype=np.int16)  # earlier passes for the change
        self.touched = np.full(shape, -np.inf)
        self.began = np.full(shape, -np.inf)
        self.first = np.full(shape, np.nan)
        self.last = np.full(shape, np.nan)

    def add(self, cells: Ints, nats: float, stamp: float) -> None:
        """Add evidence to cells (n, 2)."""
        if len(cells) == 0:
            return
        s, (i, j) = self.priors, np.unique(cells, axis=0).T
        is_new = (stamp - self.touched[i, j] > s.pass_gap) | (stamp - self.began[i, j] > s.stay)
        a, b = i[is_new], j[is_new]
        self.passes[a, b] += self.now[a, b] > 0.5 * self.most[a, b]
        self.most[a, b] = s.per_pass * -np.expm1((self.began[a, b] - stamp) / s.stay)
        self.began[a, b] = stamp
        limit = 3.0 * s.per_pass
        self.before[a, b] = np.clip(self.before[a, b] + self.now[a, b], -limit, limit)
        self.now[a, b] = 0.0
        self.touched[i, j] = stamp
        self.now[i, j] = np.clip(self.now[i, j] + nats, -s.per_pass, self.most[i, j])
        if nats > 0:
            self.first[i, j] = np.where(np.isnan(self.first[i, j]), stamp, self.first[i, j])
            self.last[i, j] = stamp

    def probabilities(self) -> tuple[Floats, Ints]:
        """Return the probability of a change and the number of passes that show it, for all cells."""
        s = self.priors
        prior = np.log(s.changed / (1.0 - s.changed))
        passes = self.passes + (self.now > 0.5 * self.most)
        return expit(prior + self.before + self.now), passes.astype(np.intp)


class Place:
    """Collects changes of the place of a graph; `update` takes a scan at a pose that is sure."""

    def __init__(
        self, readings: GraphReadings, low: Floats, high: Floats, priors: PlacePriors = PLACE
    ) -> None:
        self.readings, self.priors = readings, priors
        self.low = low
        nx, ny = (np.ceil((high - low) / priors.cell).astype(int) + 1).tolist()
        self.new, self.gone = _Cells((nx, ny), priors), _Cells((nx, ny), priors)
        self.shape = nx, ny
        self.predicted, self.counted = 0.0, 0.0

    @property
    def share_predicted(self) -> float | None:
        """Share of the recent readings that the graph predicts, where it answers; None before any."""
        return self.predicted / self.counted if self.counted > 0 else None

    def update(
        self, now: ScanInput, pose: Floats, expected: Prediction, found: ReadingEvidence, usable: Bools
    ) -> None:
        """Take the readings of a scan at a pose (3,), with those expected there and their evidence."""
        s, r = self.priors, self.readings
        stamp, weight, z = now.observation.stamp, now.weight, now.observation.ranges[r.rays]
        predicted, answered = expected.mode[0], expected.answered[0] & found.known[0] & usable
        fits = found.fits[0]
        returned = answered & np.isfinite(z) & (z < r.sensor.range_max)
        if returned.any():
            keep = max(1.0 - weight * returned.sum() * r.priors.independent / RECENT, 0.0)
            self.predicted = keep * self.predicted + weight * float(fits[returned].sum())
            self.counted = keep * self.counted + weight * float(returned.sum())
        explained = self._explained(z, predicted)
        odd = returned & (fits < 0.2) & ~explained
        laser = self._laser(pose)
        phi = laser[2] + r.sensor.bearings[r.rays]
        way = np.column_stack([np.cos(phi), np.sin(phi)])
        is_sure = expected.p_no_return[0] < 0.5
        short = odd & (z < predicted - s.least_difference)
        beyond = odd & is_sure & (z > predicted + s.least_difference)
        agrees = returned & is_sure & (np.abs(z - predicted) < s.least_difference)
        self.new.add(self._cells(laser[:2] + z[short, None] * way[short]), s.for_change, stamp)
        self.new.add(
            self._passed(laser[:2], way[returned], z[returned] - 2 * s.cell), -s.against_change, stamp
        )
        self.gone.add(self._cells(laser[:2] + predicted[beyond, None] * way[beyond]), s.for_change, stamp)
        self.gone.add(
            self._cells(laser[:2] + predicted[agrees, None] * way[agrees]), -s.against_change, stamp
        )

    def changes(self) -> list[PlaceChange]:
        """Return what came and what is gone, the most certain first."""
        found = [*self._components("new", self.new), *self._components("gone", self.gone)]
        return sorted(found, key=lambda change: -change.p)

    def _laser(self, pose: Floats) -> Floats:
        x, y, phi = self.readings.sensor.mount
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        return np.array([pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y, pose[2] + phi])

    def _explained(self, z: Floats, predicted: Floats) -> Bools:
        """Tell which readings the prediction of a neighbouring ray explains, as at the edge of a surface."""
        n = self.priors.edge_rays
        padded = np.pad(predicted, n, constant_values=np.nan)
        near = np.stack([padded[k : k + len(z)] for k in range(2 * n + 1)])
        with np.errstate(invalid="ignore"):
            close = np.abs(near - z) < self.priors.least_difference
            between = (z > np.nanmin(near, axis=0)) & (z < np.nanmax(near, axis=0))
        return np.asarray(close.any(axis=0) | between)

    def _cells(self, points: Floats) -> Ints:
        """Return the cells (n, 2) of points (n, 2), without those outside."""
        cells = np.floor((points - self.low) / self.priors.cell).astype(np.intp)
        inside = ((cells >= 0) & (cells < self.shape)).all(axis=1)
        return np.asarray(cells[inside])

    def _passed(self, start: Floats, way: Floats, length: Floats) -> Ints:
        """Return the cells with evidence for something new that rays pass through."""
        steps = np.arange(0.3, max(float(length.max(initial=0.0)), 0.3), self.priors.cell)
        points = start + steps[:, None, None] * way  # (n_steps, n_rays, 2)
        cells = self._cells(points[steps[:, None] < length])
        some = self.new.now[cells[:, 0], cells[:, 1]] + self.new.before[cells[:, 0], cells[:, 1]] > 0
        return np.asarray(cells[some])

    def _components(self, kind: ChangeKind, cells: _Cells) -> list[PlaceChange]:
        s = self.priors
        p, passes = cells.probabilities()
        is_changed = p > 0.5
        if not is_changed.any():
            return []
        numbers, n = label(is_changed, structure=np.ones((3, 3)))
        out = []
        for k in range(1, n + 1):
            own = np.argwhere(numbers == k)
            if len(own) < s.least_cells:
                continue
            i, j = own.T
            first, last = own.min(axis=0), own.max(axis=0) + 1
            part = numbers[first[0] : last[0], first[1] : last[1]] == k
            shape = outline(part, self.low + first * s.cell, s.cell)
            out.append(
                PlaceChange(
                    kind=kind, centre=self.low + (own.mean(axis=0) + 0.5) * s.cell, size=(last - first) * s.cell,
                    outlines=tuple(np.asarray(one.exterior.coords) for one in shape.geoms),
                    first_seen=float(np.nanmin(cells.first[i, j])), last_seen=float(np.nanmax(cells.last[i, j])),
                    passes=int(passes[i, j].max()), p=float(p[i, j].mean()),
                )
            )  # fmt: skip
        return out
