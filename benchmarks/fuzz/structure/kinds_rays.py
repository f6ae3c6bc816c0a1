"""The order of the rays, their bearings and their times, as drivers state them and as they get them wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import Draft, Laser, flip, reverse, reverse_times, start_of
from benchmarks.fuzz.structure.drives import PERIOD
from benchmarks.fuzz.structure.start import LASERS, Start, named, of

TURN = (Laser(sweep=1, first=-180, n=360), Laser(sweep=1, first=-180, n=180, stride=2))
"""Lasers with rays all around."""
SPINNING = LASERS[:3]


def _clockwise(laser: Laser) -> Laser:
    """Return the laser that measures the same rays the other way."""
    return replace(laser, sweep=-1, first=laser.first + laser.stride * (laser.n - 1))


def clockwise(start: Start) -> Draft:
    """It spins clockwise, and says so: the increment of the bearings is negative."""
    return start.draft(_clockwise(start.pick(SPINNING)))


def reversed_array(start: Start) -> Draft:
    """It spins clockwise; the driver reverses the array and keeps the time increment."""
    draft = start.draft(_clockwise(start.pick(SPINNING)))
    for reading in draft.readings:
        reverse(reading)
    return draft


def reversed_increment(start: Start) -> Draft:
    """It spins clockwise; the driver reverses the array and negates the time increment."""
    draft = start.draft(_clockwise(start.pick(SPINNING)))
    for item in draft.scans:
        reverse(item.content)
        reverse_times(item)
    return draft


def silent(start: Start) -> Draft:
    """It spins either way and states no times of rays."""
    laser = start.pick(SPINNING)
    ahead = start.chance()
    draft = start.draft(laser if ahead else _clockwise(laser))
    for reading in draft.readings:
        if not ahead:
            reverse(reading)
        reading |= {"time_increment": 0.0, "scan_time": start.pick((0.0, PERIOD))}
    return draft


def _scale_times(draft: Draft, factor: float) -> None:
    for reading in draft.readings:
        reading["time_increment"] *= factor


@of(spins=True)
def wrong_sign(start: Start, draft: Draft) -> None:
    """It spins counter-clockwise; the driver states a negative time increment."""
    _scale_times(draft, -1)


@of(spins=False)
def invented_increment(start: Start, draft: Draft) -> None:
    """All rays are measured at once; the driver states a sweep."""
    for reading in draft.readings:
        reading["time_increment"] = PERIOD / len(reading["ranges"])


@of(spins=True)
def too_long(start: Start, draft: Draft) -> None:
    _scale_times(draft, start.pick((1.5, 2.0, 10.0, 100.0, 360.0, 1e4)))


@of(spins=True)
def too_short(start: Start, draft: Draft) -> None:
    _scale_times(draft, start.pick((0.5, 0.1, 1e-3)))


@of(spins=True)
def stamp_at_end(start: Start, draft: Draft) -> None:
    """The driver stamps a scan when it is complete, or in its middle."""
    share = start.pick((1.0, 0.5))
    for item in draft.scans:
        item.stamp += share * item.content["time_increment"] * len(item.content["ranges"])
    has_wheels = start.chance(0.7)
    if not has_wheels:
        draft.drop_odometry()


def zero_to_turn(start: Start) -> Draft:
    """Bearings from 0 to 2 pi."""
    laser = replace(start.pick(TURN), first=0)
    draft = start.draft(laser)
    if start.chance():
        _go_on(draft, 1)
    return draft


def any_start(start: Start) -> Draft:
    """Bearings that begin anywhere and go all around, beyond pi."""
    return start.draft(replace(start.pick(TURN), first=int(start.rng.integers(-180, 180))))


def _go_on(draft: Draft, n: int) -> None:
    """Let each scan go on with its first n rays."""
    for reading in draft.readings:
        for name in ("ranges", "intensities"):
            reading[name] = np.append(reading[name], reading[name][:n])
        last = len(reading["ranges"]) - 1
        reading["angle_max"] = reading["angle_min"] + reading["angle_increment"] * last


def repeated_end(start: Start) -> Draft:
    """The first ray is repeated at the end: from -pi to pi inclusive."""
    draft = start.draft(start.pick(TURN))
    _go_on(draft, 1)
    return draft


def overlapping(start: Start) -> Draft:
    """A scan is a little more than one turn."""
    draft = start.draft(start.pick(TURN))
    _go_on(draft, start.pick((3, 20)))
    return draft


def turning_start(start: Start) -> Draft:
    """The laser takes scans of a little more or less than a turn, so that each begins elsewhere."""
    n = start.pick((350, 340))
    draft = start.draft(replace(TURN[0], first=0, n=n), reference=0.0)
    draft.is_stream = True
    drive, laser = draft.drive, draft.laser
    scans = draft.scans
    for k, item in enumerate(scans):
        j = k * n
        z = drive.turns[1][j : j + n] + 0.01 * draft.rng.normal(size=n)
        z = np.where(z > laser.range_max, np.inf, np.round(z, 3))
        low = (np.radians(j) + np.pi) % (2 * np.pi) - np.pi
        c = item.content
        c |= {
            "ranges": z,
            "angle_min": low,
            "angle_max": low + np.radians(n - 1),
            "scan_time": PERIOD * n / 360,
        }
        item.stamp = start_of(laser, 0) + PERIOD * j / 360
        item.log = item.arrival = item.stamp + 0.11
        draft.true_times[item.scan], draft.first_rays[item.scan] = item.stamp, j
    return draft


def uneven_ends(start: Start, draft: Draft) -> None:
    """The last bearing disagrees with the first, the step and the number of rays."""
    form = start.pick(("one_more", "degrees_rounded", "no_step", "no_end"))
    for c in draft.readings:
        step = c["angle_increment"]
        if form == "one_more":
            c["angle_max"] += step
        elif form == "degrees_rounded":
            c["angle_increment"] = np.sign(step) * round(abs(step), 4)
        elif form == "no_step":
            c["angle_increment"] = 0.0
        else:
            c["angle_max"] = 0.0
    draft.usable = form not in ("no_step", "no_end")


@of(reference=0.0)
def mirrored(start: Start, draft: Draft) -> None:
    """A driver that reverses the array and keeps the bearings: the room is seen in a mirror."""
    for reading in draft.readings:
        flip(reading)
    draft.usable = False
    draft.said = "mirror|turn"


@of(reference=0.0)
def older_part(start: Start, draft: Draft) -> None:
    """A node merges two lasers, and the scan of one is the last or the last but one of it."""
    n, scans, lag = draft.laser.n, draft.scans, start.pick((1, 2))
    first = int(n * start.rng.uniform(0.0, 0.4))
    part = slice(first, int(n * start.rng.uniform(0.5, 1.0)))
    ranges = [item.content["ranges"].copy() for item in scans]
    for k in range(lag, len(scans)):
        new = ranges[k].copy()
        new[part] = ranges[k - lag][part]
        scans[k].content = scans[k].content | {"ranges": new}


@of(reference=0.0, spins=True)
def first_times(start: Start, draft: Draft) -> None:
    """The first scan states the times of a motor that starts."""
    factor = start.pick((8.0, 0.05, -1.0))
    for name in ("time_increment", "scan_time"):
        draft.scans[0].content[name] *= factor
    if start.chance():
        draft.drop_odometry()


RAYS = named(
    clockwise, reversed_array, reversed_increment, silent, wrong_sign, invented_increment, too_long,
    too_short, stamp_at_end, zero_to_turn, any_start, repeated_end, overlapping, turning_start,
    uneven_ends, mirrored, older_part, first_times,
)  # fmt: skip
