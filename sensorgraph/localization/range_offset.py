"""Ranges that are all too long or too short by the same distance: found from the run itself.

A laser that looks ahead and measures 3 cm too long seems to stand 3 cm further back. When the robot has turned, this is another
place, so that poses absorb the error, but no map fits them all. The offset b of the ranges is one more unknown of the equations
of the ray times (`turning_pieces`). A residual r = n · (point - centre) has the derivative n · u with respect to the range along
the ray u. Without this unknown, an offset is taken for wrong bearings, or for a laser that is mounted elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.run import RangeSensor, Run
from sensorgraph.localization.scans import is_used
from sensorgraph.localization.turning_pieces import (
    MAX_STEPS,
    MIN_GAIN,
    LinearisedPieces,
    TurningPieces,
    sweep_basis,
)
from sensorgraph.types import Floats

LEAST = 2.0
"""Smallest offset that is corrected, in standard deviations of a range. Below, other errors of real lasers matter as much, which
depend on distance and incidence: corrected by 2.1 cm, the map of aces is less sharp, 1.41 instead of 1.37 cm."""
RANGE_OFFSET = "range_offset"
"""Key of the offset [m] in `meta` of a located run."""


@dataclass(frozen=True, kw_only=True)
class OffsetOfRanges:
    """Reading minus true range."""

    value: float = 0.0
    """[m] 0: the run shows none that matters."""
    stderr: float = 0.0
    """[m]"""

    def notes(self, name: str = "the map", corrected: float | None = None) -> tuple[str, ...]:
        """Return a note for the user, if there is an offset.

        Parameters
        ----------
        name : Of the map ...
        corrected : ... against which this part of the offset is seen [m]; None: all.
        """
        if not self.value:
            return ()
        shown = f"the ranges are {100 * abs(self.value):.1f} ± {100 * self.stderr:.1f} cm too {'long' if self.value > 0 else 'short'}"
        shared = 0.0 if corrected is None else abs(self.value - corrected)
        if shared < 2.0 * self.stderr:
            return (f"{shown}: corrected for the poses; the readings stay as they were logged",)
        return (
            f"{shown}, and so is {name} by {100 * shared:.1f} cm of this, as if the same laser had measured it: corrected by "
            f"{100 * (abs(self.value) - shared):.1f} cm for the poses",
        )


def identify_range_offset(
    sensor: RangeSensor, pieces: TurningPieces, start: LinearisedPieces, motion: Motion, widening: float
) -> OffsetOfRanges:
    """Return the offset of the ranges.

    Parameters
    ----------
    sensor : With the ray times and the bearings that the run shows.
    start : `pieces`, linearised with these.
    motion : Motion of base_link, from the odometry or the track.
    widening : Factor of the covariances, as there are few pieces.
    """
    value, equations, basis = 0.0, start, sweep_basis(sensor.n_rays)
    for _ in range(MAX_STEPS):
        found = equations.estimate(basis)
        value += found.range_offset
        stderr = found.range_offset_sd
        is_small = 2.0 * abs(value) < LEAST * equations.noise  # a step finds half, or more
        if is_small or abs(found.range_offset) < stderr:
            break
        there = with_ranges(replace(pieces.run, sensor=sensor), value)
        equations = replace(pieces, run=there).linearised(sensor.ray_delays, motion)
    if abs(value) < LEAST * equations.noise or value**2 <= widening * MIN_GAIN * stderr**2:
        return OffsetOfRanges()
    return OffsetOfRanges(value=value, stderr=stderr)


def without_offset(run: Run, offset: float) -> Floats:
    """Return the ranges (n_scans, n_rays) [m] of a run without an offset [m]; those that `scan_points` leaves out are no returns."""
    left_out = np.where(np.isfinite(run.ranges), np.nan, run.ranges)
    return np.where(is_used(run), run.ranges - offset, left_out)


def with_right_ranges(run: Run, located: Run) -> Run:
    """Return a run without the offset of its ranges that `locate` found."""
    return with_ranges(run, float(located.meta.get(RANGE_OFFSET, 0.0)))


def with_ranges(run: Run, offset: float) -> Run:
    """Return a run whose ranges are corrected by an offset [m]; 0: as it is."""
    return replace(run, ranges=without_offset(run, offset)) if offset else run
