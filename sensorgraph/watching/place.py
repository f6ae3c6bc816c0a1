"""What stands in the place that the graph lacks, and what is gone: evidence of readings in cells.

With p_0, the density of any reading in the place, and s, the share of readings that the place explains (`readings`), a reading z
that ends in a cell has the density

    s / c + (1 - s) p_0                      if something new is in the cell, whose side is c,
    s p_0 / S_0(d) + (1 - s) p_0             if the surface predicted at d < z is gone; S_0 is the survival function of p_0,
    s p + (1 - s) p_0                        if the place is as the graph knows it.

The last one is a mean over the distribution of the pose, since at an edge, centimetres decide which surface a ray meets. The
logarithm of the ratio is evidence for a change. Only readings that the graph does not predict count, since it does not state how it
errs. What is new must be away from the outline of the predicted scan: at grazing incidence, centimetres of a wall are decimetres of a
reading. What is gone must be away from the outline of the scan, by a cell at least: the graph knows the end of a surface as well as its
rays were dense, and a ray that passes it by centimetres ends metres behind. A ray that passes through a cell is evidence against
something new there, and a reading that ends at the predicted surface is never evidence that it is gone.

What changes for a while is no change of the place (`place_cells`): people are new for a while, and surfaces that the graph predicts
wrongly from one side are gone until the robot sees them from another.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from logs.transforms import compose, wrap
from sensorgraph.models.base import Prediction
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.watching.modes import Mode
from sensorgraph.watching.place_cells import ChangeCells, ThingCells
from sensorgraph.watching.place_changes import ChangeKind, MovedThing, PlaceChange, moved_things, things_in
from sensorgraph.watching.readings import GraphReadings, ReadingEvidence
from sensorgraph.watching.scan_input import ScanInput
from sensorgraph.watching.settings import PLACE, PlacePriors

RECENT = 1000.0
"""Number of independent readings over which the share that the graph predicts is averaged."""
PASSES: Final = math.log(0.5)
"""[nats] Evidence of a ray that passes through a cell with the rim of a thing, which fills half of it in the mean."""
SIDE = 1.0
"""[m] Side of the cells in which the area is measured that rays have crossed."""
CLOSEST = 0.3
"""[m] A cell closer to the laser is not judged by rays that pass."""


class Place:
    """Collects changes of the place of a graph; `update` takes a scan at a pose that is sure."""

    def __init__(
        self, readings: GraphReadings, low: Floats, high: Floats, priors: PlacePriors = PLACE
    ) -> None:
        self.readings, self.priors = readings, priors
        self.low = low
        nx, ny = (np.ceil((high - low) / priors.cell).astype(int) + 1).tolist()
        self.shape = nx, ny
        self.new = ThingCells(self.shape, priors)
        self.gone = ThingCells(self.shape, priors)
        # [s] when a reading last ended at a surface in the cell, or next to it
        self._seen = np.full(nx * ny, -np.inf)
        self._crossed = np.zeros(np.ceil((high - low) / SIDE).astype(int), dtype=np.bool_)
        bearings = wrap(readings.sensor.bearings[readings.rays])
        self._order = np.argsort(bearings)
        self._sorted = bearings[self._order]
        self.predicted, self.counted = 0.0, 0.0

    @property
    def share_predicted(self) -> float | None:
        """Share of the recent readings that the graph predicts, where it answers; None before any."""
        return self.predicted / self.counted if self.counted > 0 else None

    def update(
        self, now: ScanInput, mode: Mode, expected: Prediction, found: ReadingEvidence, usable: Bools
    ) -> None:
        """Take the readings of a scan at the pose of a mode, with those expected there and their evidence."""
        s, r = self.priors, self.readings
        stamp, weight, z = now.observation.stamp, now.weight, now.observation.ranges[r.rays]
        fits = found.fits[0]
        returned = expected.answered[0] & found.known[0] & usable & np.isfinite(z) & (z < r.sensor.range_max)
        if not returned.any():
            return
        z, d = np.where(returned, z, 0.0), np.where(returned, expected.mode[0], 0.0)
        keep = max(1.0 - weight * returned.sum() * r.priors.independent / RECENT, 0.0)
        self.predicted = keep * self.predicted + weight * float(fits[returned].sum())
        self.counted = keep * self.counted + weight * float(returned.sum())
        laser, way = self._directions(mode.pose)
        ratios, is_odd = self._odd(now.observation.ranges, mode, found, returned)
        share = found.predicted
        of_new = np.logaddexp(math.log(share / s.cell) - r.anywhere.log_density(z), math.log(1 - share))
        of_gone = np.logaddexp(math.log(share) - r.anywhere.log_survival(d), math.log(1 - share))
        self._cross(laser, way[returned], z[returned])
        ends, surfaces = laser[:2] + z[:, None] * way, laser[:2] + d[:, None] * way
        is_new = is_odd & (z < d) & r.seen.contains(ends)
        is_new[is_new] = distance_to_outline(ends[is_new], surfaces, returned) > s.least_difference
        cells, which = self._cells(ends, is_new)
        self.new.add(cells, weight * (of_new - ratios)[which], stamp)
        for some in (self.new.cells, self.new.things):
            passed = self._passed(some, laser, z, returned, stamp)
            some.add(passed, np.full(len(passed), weight * PASSES), stamp)
        is_sure = returned & (expected.p_no_return[0] < 0.5)
        is_gone = is_odd & is_sure & (z > d)
        is_gone[is_gone] = distance_to_outline(surfaces[is_gone], ends, returned) > s.cell
        cells, which = self._cells(surfaces, is_gone)
        agreeing, agrees = self._cells(surfaces, is_sure & (np.abs(z - d) < s.least_difference))
        self._seen[self.gone.around(agreeing)] = stamp
        is_asked = np.isin(agreeing, cells) | self.gone.is_doubtful(agreeing)
        of_gone = weight * (of_gone - ratios)
        nats = np.concatenate([of_gone[which], np.minimum(of_gone[agrees][is_asked], 0.0)])
        self.gone.add(np.concatenate([cells, agreeing[is_asked]]), nats, stamp)

    def stands(self, stamp: float, pose: Floats, expected: Prediction) -> Bools:
        """Return of which rays (n_rays,) from a pose (3,) the predicted surface was seen lately: it is still there.

        Lately is within the mean time of a change for a while.
        """
        laser, way = self._directions(pose)
        is_surface = expected.answered[0] & np.isfinite(expected.mode[0])
        surfaces = laser[:2] + np.where(is_surface, expected.mode[0], 0.0)[:, None] * way
        cells, which = self._cells(surfaces, is_surface)
        found = np.zeros(len(way), dtype=np.bool_)
        found[which] = stamp - self._seen[cells] < self.priors.stay
        return found

    def changes(self) -> list[PlaceChange]:
        """Return what came and what is gone, the most certain first."""
        both: tuple[tuple[ChangeKind, ThingCells], ...] = (("new", self.new), ("gone", self.gone))
        found = [
            one for kind, cells in both for one in things_in(kind, cells, self.shape, self.low, self.priors)
        ]
        return sorted(found, key=lambda change: -change.p)

    def moved(self, changes: list[PlaceChange]) -> list[MovedThing]:
        """Return the pairs of changes that are probably one thing."""
        return moved_things(changes, float(self._crossed.sum()) * SIDE**2, self.priors)

    def _odd(
        self, ranges: Floats, mode: Mode, found: ReadingEvidence, returned: Bools
    ) -> tuple[Floats, Bools]:
        """Return the evidence (n_rays,) of a scan for the graph, and which readings the graph does not predict.

        Of readings that it does not predict at the mean pose, it is that of the whole distribution of the pose.
        """
        ratios, least = found.ratios[0].copy(), 1.0 - found.predicted
        odd = np.flatnonzero(returned & (found.fits[0] < least))
        if len(odd):
            parts = self.readings.evidence(ranges, mode.parts(), odd)
            likelihoods = np.exp(np.where(parts.known, parts.ratios, 0.0))
            ratios[odd] = np.log(likelihoods.mean(axis=0))
        fits = 1.0 - (1.0 - found.predicted) * np.exp(-ratios)
        return ratios, returned & (fits < least)

    def _cross(self, laser: Floats, way: Floats, z: Floats) -> None:
        """Note the area that rays with directions (n, 2) and lengths (n,) [m] cross."""
        steps = np.arange(0.5 * SIDE, float(z.max()), SIDE)
        points = (laser[:2] + steps[:, None, None] * way)[steps[:, None] < z]
        at = np.floor((points - self.low) / SIDE).astype(np.intp)
        inside = ((at >= 0) & (at < self._crossed.shape)).all(axis=1)
        self._crossed[tuple(at[inside].T)] = True

    def _directions(self, pose: Floats) -> tuple[Floats, Floats]:
        """Return the laser (3,) at a pose (3,) of base_link, and the directions (n_rays, 2) of its rays, in map."""
        r = self.readings
        laser = np.asarray(compose(pose, r.sensor.mount))
        phi = laser[2] + r.sensor.bearings[r.rays]
        return laser, np.column_stack([np.cos(phi), np.sin(phi)])

    def _cells(self, points: Floats, which: Bools) -> tuple[Ints, Bools]:
        """Return the cells (n,) of some points (n_rays, 2), and which points (n_rays,) have one that is not at the border."""
        at = np.floor((np.where(which[:, None], points, np.inf) - self.low) / self.priors.cell)
        inside: Bools = np.asarray(((at >= 1) & (at < np.array(self.shape) - 1)).all(axis=1))
        return np.ravel_multi_index(tuple(at[inside].astype(np.intp).T), self.shape), inside

    def _passed(self, some: ChangeCells, laser: Floats, z: Floats, returned: Bools, stamp: float) -> Ints:
        """Return the doubtful cells that rays pass through, at least two cells before they end."""
        side, cells = self.priors.cell, some.shown
        cells = cells[some.is_doubtful(cells) & (some.looked[cells] < stamp)]
        off = self.low + (np.column_stack(np.unravel_index(cells, self.shape)) + 0.5) * side - laser[:2]
        distance, bearing = np.hypot(*off.T), wrap(np.arctan2(off[:, 1], off[:, 0]) - laser[2])
        after = np.searchsorted(self._sorted, bearing) % len(self._sorted)
        beside = np.stack([self._order[after - 1], self._order[after]])
        aside = np.abs(wrap(self.readings.sensor.bearings[self.readings.rays][beside] - bearing))
        nearest = np.where(aside[0] < aside[1], beside[0], beside[1])
        meets = (aside.min(axis=0) * distance < side / 2) & (distance > CLOSEST) & returned[nearest]
        return np.asarray(cells[meets & (z[nearest] > distance + 2 * side)])


def distance_to_outline(points: Floats, outline: Floats, is_known: Bools) -> Floats:
    """Return the distances [m] (n,) of points (n, 2) to the line through the known ones of some points (m, 2)."""
    line = outline[is_known]
    start, way = line[:-1], np.diff(line, axis=0)
    if len(points) == 0 or len(start) == 0:
        return np.full(len(points), np.inf)
    off = points[:, None] - start  # (n, n_pieces, 2)
    share = (off * way).sum(axis=2) / np.maximum((way**2).sum(axis=1), 1e-12)
    return np.asarray(np.linalg.norm(off - np.clip(share, 0.0, 1.0)[..., None] * way, axis=2).min(axis=1))
