"""Rays that are older than the others of their scan, as where a node merges two lasers: found from the run itself.

The field of view has `SECTORS` parts. The times of the rays in each, relative to the first part, are estimated as those of a
sweep are (`turning_pieces`). Two merged lasers have times with one step at each end of a part: of the normal equations
M c = g of the sectors, the part b with the largest

    gain(b) = (b'g)² / b'M b

must explain nearly all of g'M⁻¹g. A sweep is a ramp, of which a step explains at most 3/4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.run import RangeSensor
from sensorgraph.localization.time_settings import RAY_TIMES, SCAN_LAG, RayTimeSettings
from sensorgraph.localization.turning_pieces import TimeEstimate, TurningPieces
from sensorgraph.types import Bools, Floats, Ints

SECTORS = 12
"""Number of parts of the field of view."""
MAX_STEPS = 30
"""Maximum number of Gauss-Newton steps: a part of most rays takes the poses with it, at first, and steps are short."""
ENDS = 20
"""Number of groups of rays about each end of a part, of which each gets a time of its own."""
STEPS = 4
"""Number of Gauss-Newton steps of these times; each finds half of the rest, or more."""
MIN_EXPLAINED = 0.9
"""Share of the gain of all sectors that a part must explain, well above that of a sweep (3/4)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OlderRays:
    """A part of the rays that is older than the others."""

    sensor: RangeSensor
    """With the times of its rays."""
    rays: Bools
    """(n_rays,) the older ones."""
    age: float
    """[s]"""
    stderr: float
    """[s]"""

    @property
    def line(self) -> str:
        """One line for the user."""
        part = self.rays if not (self.rays[0] and self.rays[-1]) else ~self.rays
        first, last = np.degrees(self.sensor.bearings[np.flatnonzero(part)[[0, -1]]])
        which = "rays from" if part is self.rays else "rays not from"
        return (
            f"the {which} {first:.0f}° to {last:.0f}° are {1e3 * self.age:.0f} ± {1e3 * self.stderr:.1f} ms older than the "
            "others of their scan, as where two lasers are merged: corrected"
        )


def identify_older_rays(
    sensor: RangeSensor,
    pieces: TurningPieces,
    motion: Motion,
    widening: float,
    settings: RayTimeSettings = RAY_TIMES,
) -> OlderRays | None:
    """Return the part of the rays that is older than the others; None if the run shows none.

    Parameters
    ----------
    motion : Motion of base_link, from the odometry or the track.
    widening : Factor of the covariances, as there are few pieces.
    """
    if sensor.n_rays < 2 * SECTORS:
        return None
    sector = np.arange(sensor.n_rays) * SECTORS // sensor.n_rays
    basis = (sector[:, None] == np.arange(1, SECTORS)).astype(np.float64)
    values = np.zeros(SECTORS - 1)
    for step in range(MAX_STEPS):
        found = pieces.estimate(sensor.ray_delays + basis @ values, motion, basis)
        values = values + found.change
        if (
            step == 0 and np.ptp(np.append(values, 0.0)) < 0.5 * SCAN_LAG.min_lag
        ):  # a step finds half, or more
            return None
        if np.abs(found.change).max() < 0.1 * SCAN_LAG.min_lag:
            break
    is_settled = np.abs(found.change).max() < SCAN_LAG.min_lag
    if not is_settled or not _is_one_part(values, found, widening, settings):
        return None
    late, delay = _part_of(values, sector)
    if abs(delay) < SCAN_LAG.min_lag or (np.diff(late.astype(np.int8)) != 0).sum() > 2:
        return None
    late = _with_sharp_ends(late, delay, sensor, pieces, motion)
    older, age = late if delay < 0 else ~late, abs(delay)
    delays = sensor.ray_delays - sensor.ray_delays[0] - age * older
    timed = replace(
        sensor, delays=delays - delays[0], first_ray_delay=sensor.first_ray_delay + float(delays[0]),
        sweep_time=0.0, interlaced_sweeps=1, sweep_period=0.0,
    )  # fmt: skip
    stderr = float(np.sqrt(np.median(np.diag(found.covariance))))
    return OlderRays(sensor=timed, rays=older, age=age, stderr=stderr)


def _is_one_part(values: Floats, found: TimeEstimate, widening: float, settings: RayTimeSettings) -> bool:
    """Tell whether one part of the sectors explains their times (SECTORS - 1,) [s], and surely has another time."""
    g = found.information @ values
    total, robust = float(g @ values), found.information @ found.covariance @ found.information
    parts = [slice(first, end) for first in range(SECTORS - 1) for end in range(first + 1, SECTORS)]
    best = max(parts, key=lambda part: float(g[part].sum()) ** 2 / float(found.information[part, part].sum()))
    square = float(g[best].sum()) ** 2
    explained = square / float(found.information[best, best].sum()) / total
    return (
        explained > MIN_EXPLAINED and square / float(robust[best, best].sum()) > widening * settings.min_gain
    )


def _part_of(values: Floats, sector: Ints) -> tuple[Bools, float]:
    """Return the rays (n_rays,) of the sectors whose times are the other ones, and these [s] relative to the first sector."""
    values = np.append(0.0, values)
    delay = float(np.median(values[np.abs(values) > 0.5 * np.abs(values).max()]))
    return np.asarray(values[sector] / delay > 0.5), delay


def _with_sharp_ends(
    late: Bools, delay: float, sensor: RangeSensor, pieces: TurningPieces, motion: Motion
) -> Bools:
    """Return the rays (n_rays,) of a part whose ends are sought a sector to either side, by the times of single rays there."""
    n, size = sensor.n_rays, sensor.n_rays // SECTORS
    begin, end = np.flatnonzero(late)[[0, -1]] + [0, 1]
    near = [np.arange(max(at - size, 0), min(at + size, n)) for at in (begin, end)]
    step = max(2 * size // ENDS, 1)  # rays of a column
    groups = [rays[first : first + step] for rays in near for first in range(0, len(rays), step)]
    basis = np.zeros((n, len(groups)))
    for k, group in enumerate(groups):
        basis[group, k] = 1.0
    times = np.zeros(len(groups))
    for _ in range(STEPS):
        times += pieces.estimate(sensor.ray_delays + delay * late + basis @ times, motion, basis).change
    beyond = np.zeros(n)  # share of `delay` beyond half of it
    for group, time in zip(groups, times / delay, strict=True):
        beyond[group] = time + late[group] - 0.5
    out = late.copy()
    for rays, cut_of, is_begin in zip(near, (np.argmin, np.argmax), (True, False), strict=True):
        cut = int(cut_of(np.concatenate([[0.0], np.cumsum(beyond[rays])])))
        out[rays] = (np.arange(len(rays)) >= cut) == is_begin
    return out
