"""Search for stretches of wall in readings of cones: a Hough transform of the tangents to each reading's arc.

Each reading votes for the lines that are perpendicular to a ray of its cone, at its range. A line is fitted to a peak
by least squares. It is visible where readings end on it and few readings pass it.

Source: Tardos, Neira, Newman and Leonard 2002, Robust Mapping and Localization in Indoor Environments Using Sonar Data.
"""

from __future__ import annotations

import numpy as np

from planners.groups import members
from sensorgraph.models.cones.kernels import count_along_line
from sensorgraph.models.cones.readings import ConeReadings, Stretch
from sensorgraph.models.cones.settings import CONES
from sensorgraph.models.faces.forward_selection import OFFSET_BIN
from sensorgraph.models.faces.visibility import FIT_SIGMAS
from sensorgraph.types import Bools, Floats, Ints, Progress

UNBOUNDED = (-1e9, 1e9)
N_ANGLES = 720
"""Number of normal angles over the full circle in the Hough transform."""
BIN = 0.04
"""[m] Size of the bins along a line in which readings that end there and that pass are counted."""
FIRST_BAND = 3 * OFFSET_BIN
"""[m] Initial half width of the band about a peak's line whose readings are used for the fit: the bins of a peak."""
PASS_MARGIN = 0.01
"""[m] Distance, in addition to `FIT_SIGMAS`, by which a reading must be longer to pass a stretch."""
MIN_HIT_RATIO = 0.25
"""Minimum ratio of readings that end in a bin to readings that pass it, for the bin to be occupied."""
MAX_FAILURES = 40
"""Number of successive peaks without a new stretch after which a search ends."""


class TangentVotes:
    """Votes of readings for lines, in bins of normal angle and offset."""

    def __init__(self, readings: ConeReadings, voters: Ints) -> None:
        """Collect the votes of the readings with these indices."""
        self.centre = 0.5 * (readings.origins.min(axis=0) + readings.origins.max(axis=0))
        self.radius = float(np.hypot(*(readings.origins - self.centre).T).max()) + readings.range_max
        self.n_offsets = int(2 * self.radius / OFFSET_BIN) + 2
        step = 2 * np.pi / N_ANGLES
        some = readings.take(voters)
        backward = np.arctan2(-some.directions[:, 1], -some.directions[:, 0])
        home = np.rint(backward / step).astype(np.intp)
        angles = step * np.arange(N_ANGLES)
        cos, sin = np.cos(angles), np.sin(angles)
        width = int(np.ceil(some.halves.max(initial=0.0) / step))
        bins, owners = [], []
        for k in range(-width, width + 1):
            off = step * (home + k) - backward
            inside = np.flatnonzero(np.abs(off) <= np.maximum(some.halves, 0.5 * step))
            a = (home[inside] + k) % N_ANGLES
            x, y = (some.origins[inside] - self.centre).T
            d = x * cos[a] + y * sin[a] - some.ranges[inside]
            bins.append(a * self.n_offsets + np.floor((d + self.radius) / OFFSET_BIN).astype(np.intp))
            owners.append(inside)
        bin_of, owner = np.concatenate(bins), np.concatenate(owners)
        order = np.argsort(owner, kind="stable")
        self._bins = bin_of[order]
        self._first = np.searchsorted(owner[order], np.arange(len(voters) + 1))
        self._rank = np.full(len(readings), -1, dtype=np.intp)
        self._rank[voters] = np.arange(len(voters))
        self.counts = np.bincount(self._bins, minlength=N_ANGLES * self.n_offsets)

    def peak(self) -> tuple[int, Stretch]:
        """Return the number of votes of the line with most votes, and the line; its votes are set to 0."""
        at = int(self.counts.argmax())
        votes = int(self.counts[at])
        a, j = divmod(at, self.n_offsets)
        angle = 2 * np.pi * a / N_ANGLES
        offset = (j + 0.5) * OFFSET_BIN - self.radius
        offset += float(self.centre @ [np.cos(angle), np.sin(angle)])
        near = [(a + k) % N_ANGLES for k in (-1, 0, 1)]
        self.counts.reshape(N_ANGLES, -1)[near, max(j - 1, 0) : j + 2] = 0
        return votes, Stretch(angle, offset, *UNBOUNDED)

    def withdraw(self, readings: Ints) -> None:
        """Remove the votes of readings that are explained."""
        rank = self._rank[readings]
        first, last = self._first[rank], self._first[rank + 1]
        reading, within = members(last - first)
        places = first[reading] + within
        self.counts -= np.bincount(self._bins[places], minlength=len(self.counts))


def search(
    readings: ConeReadings, unexplained: Bools, sigma: float, *, progress: Progress | None = None
) -> list[Stretch]:
    """Find stretches that explain readings of the mask `unexplained` (n,), in the order of their votes."""
    unexplained = unexplained & readings.returned
    found: list[Stretch] = []
    n_unexplained = int(unexplained.sum())
    if n_unexplained < CONES.min_hits:
        return found
    votes = TangentVotes(readings, np.flatnonzero(unexplained))
    failures = 0
    while failures < MAX_FAILURES:
        count, line = votes.peak()
        if count < CONES.min_hits:
            break
        failures += 1
        line = _line_of_peak(readings.take(unexplained), line, sigma)
        for stretch in _visible_stretches(readings, line, unexplained, sigma):
            r, _ = readings.to(stretch)
            with np.errstate(invalid="ignore"):
                explained = unexplained & (np.abs(readings.ranges - r) < FIT_SIGMAS * sigma)
            if explained.sum() < CONES.min_hits:
                continue
            found.append(stretch)
            unexplained = unexplained & ~explained
            votes.withdraw(np.flatnonzero(explained))
            failures = 0
        if progress is not None:
            progress(n_unexplained - int(unexplained.sum()), n_unexplained)
    return found


def _line_of_peak(unexplained: ConeReadings, line: Stretch, sigma: float) -> Stretch:
    """Fit the line of a peak to the unexplained readings near it, in a band of decreasing width."""
    for share in (1.0, 0.5, 0.25, 0.0, 0.0):
        line = unexplained.refit(line, max(sigma, share * FIRST_BAND / FIT_SIGMAS))
    return line


def _visible_stretches(
    readings: ConeReadings, line: Stretch, unexplained: Bools, sigma: float
) -> list[Stretch]:
    """Return the stretches of a line on which readings end and that few readings pass."""
    size, tolerance = BIN, FIT_SIGMAS * sigma
    r, t = readings.to(line)
    with np.errstate(invalid="ignore"):
        mine = unexplained & (np.abs(readings.ranges - r) < tolerance)
    if mine.sum() < CONES.min_hits:
        return []
    start = (np.floor(t[mine].min() / size) - 1) * size
    n = int((t[mine].max() - start) / size) + 2
    hits, new_hits, passes = np.zeros(n), np.zeros(n), np.zeros(n + 1)
    count_along_line(
        readings.origins, readings.directions, readings.halves, readings.ranges, readings.reach, unexplained,
        float(np.cos(line.angle)), float(np.sin(line.angle)), line.offset, tolerance,
        tolerance + PASS_MARGIN, start, size, hits, new_hits, passes,
    )  # fmt: skip
    passed = np.cumsum(passes)[:n]
    occupied = np.flatnonzero((hits > MIN_HIT_RATIO * passed) & (new_hits > 0))
    out: list[Stretch] = []
    for run in _joined_bins(occupied, hits, passed):
        if new_hits[run].sum() >= CONES.min_hits:
            out.append(line._replace(low=start + run.start * size, high=start + run.stop * size))
    return out


def _joined_bins(occupied: Ints, hits: Floats, passed: Floats) -> list[slice]:
    """Join occupied bins across gaps without information."""
    runs: list[slice] = []
    for i in occupied.tolist():
        if runs:
            gap = slice(runs[-1].stop, i)
            is_open = (passed[gap] > np.maximum(2.0, 0.5 * hits[gap])).any()
            if not is_open and (i - runs[-1].stop) * BIN <= CONES.max_gap:
                runs[-1] = slice(runs[-1].start, i + 1)
                continue
        runs.append(slice(i, i + 1))
    return runs
