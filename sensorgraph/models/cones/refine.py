"""Refinement of stretches given all others: lines, ends, and whether each raises the likelihood of the readings."""

from __future__ import annotations

import numpy as np

from sensorgraph.models.cones.kernels import END_BLUR
from sensorgraph.models.cones.readings import ConeReadings, Stretch, loss
from sensorgraph.models.cones.settings import CONES
from sensorgraph.models.faces.visibility import FIT_SIGMAS
from sensorgraph.types import Bools, Floats, Ints, Progress

END_SEARCH = 0.16
"""[m] Half width of the search for an end, which ends with a step of its standard error."""


class Refiner:
    """Stretches, and the range of each reading to each stretch."""

    def __init__(self, readings: ConeReadings, stretches: list[Stretch], sigma: float) -> None:
        self.readings, self.stretches, self.sigma = readings, list(stretches), sigma
        shape = (len(stretches), len(readings))
        self.ranges = np.empty(shape, dtype=np.float32)
        """(n_stretches, n) [m] ranges; inf where a stretch is not in the cone."""
        for k, stretch in enumerate(stretches):
            self.ranges[k] = readings.to(stretch)[0]

    def nearest(self) -> Floats:
        """(n,) [m] predicted ranges: those to the nearest stretch."""
        if len(self.stretches) == 0:
            return np.full(len(self.readings), np.inf)
        return np.asarray(self.ranges.min(axis=0), dtype=np.float64)

    def is_explained(self) -> Bools:
        """(n,) whether a stretch predicts the reading."""
        nearest, measured = self.nearest(), self.readings.ranges
        both = np.isfinite(nearest) & np.isfinite(measured)
        e = np.where(both, measured, 0.0) - np.where(both, nearest, 0.0)
        return np.asarray(both & (np.abs(e) < FIT_SIGMAS * self.sigma))

    def sweep(self, progress: Progress | None = None) -> None:
        """Refine each stretch given the others, and remove stretches with too little gain."""
        total = len(self.stretches)
        k = 0
        for done in range(total):
            better = self._refined(k)
            if better is None:
                del self.stretches[k]
                self.ranges = np.delete(self.ranges, k, axis=0)
            else:
                self.stretches[k] = better
                self.ranges[k] = self.readings.to(better)[0]
                k += 1
            if progress is not None:
                progress(done + 1, total)

    def _refined(self, k: int) -> Stretch | None:
        """Return the refined stretch k; None if the readings are as likely without it."""
        stretch, reach = self.stretches[k], END_SEARCH
        widest = stretch._replace(low=stretch.low - reach, high=stretch.high + reach)
        there = np.flatnonzero(np.isfinite(self.readings.to(widest)[0]))
        some = self.readings.take(there)
        others = self._others(k, there)
        for with_ends in (False, True, True):
            r, _ = some.to(stretch)
            stretch = some.take(r < others).refit(stretch, self.sigma, with_ends=with_ends)
            if not stretch.low < stretch.high:
                return None
        stretch = self._search_ends(stretch, some, others)
        r, _ = some.to(stretch)
        gain = self._loss(some, others) - self._loss(some, np.minimum(r, others))
        return stretch if gain > CONES.min_gain else None

    def _others(self, k: int, there: Ints) -> Floats:
        """Return the predicted ranges (n,) of some readings without stretch k."""
        if len(self.stretches) == 1:
            return np.full(len(there), np.inf)
        rows = np.delete(np.arange(len(self.stretches)), k)
        return np.asarray(self.ranges[np.ix_(rows, there)].min(axis=0), dtype=np.float64)

    def _loss(self, some: ConeReadings, predicted: Floats) -> float:
        return float(loss(some.ranges, predicted, self.sigma, some.range_max).sum())

    def _search_ends(self, stretch: Stretch, some: ConeReadings, others: Floats) -> Stretch:
        """Move each end to the maximum of the likelihood, by search with a decreasing step."""
        for end in ("low", "high"):
            step = END_SEARCH / 2
            sign = 1 if end == "high" else -1
            at = float(getattr(stretch, end))
            shortest, longest = (
                some.to(stretch._replace(**{end: at + sign * reach}))[0]
                for reach in (-END_SEARCH, END_SEARCH)
            )
            depends = shortest != longest
            mine, rest = some.take(depends), others[depends]
            while step > END_BLUR / 2:
                places = at + step * np.array([0.0, -2.0, -1.0, 1.0, 2.0])
                places = (
                    places[places < stretch.high - END_BLUR]
                    if end == "low"
                    else places[places > stretch.low + END_BLUR]
                )
                costs = [
                    self._loss(mine, np.minimum(mine.to(stretch._replace(**{end: float(p)}))[0], rest))
                    for p in places
                ]
                at = float(places[int(np.argmin(costs))]) if len(places) else at
                step /= 2
            stretch = stretch._replace(**{end: at})
        return stretch
