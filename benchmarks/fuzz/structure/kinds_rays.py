"""The order of the rays, their bearings and their times, as drivers state them and as they get them wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import Draft, flip, reverse, reverse_times, start_of
from benchmarks.fuzz.structure.drives import PERIOD
from benchmarks.fuzz.structure.start import (
    SPINNING,
    TURNING,
    Kind,
    Start,
    kind,
    named,
    of,
    readings,
)


def _clockwise(start: Start) -> Draft:
    """Return a log of a laser that measures the same rays the other way."""
    laser = start.pick(SPINNING)
    return start.draft(replace(laser, sweep=-1, first=laser.first + laser.stride * (laser.n - 1)))


def clockwise(start: Start) -> Draft:
    """It spins clockwise, and says so: the increment of the bearings is negative."""
    return _clockwise(start)


def reversed_array(start: Start, *, with_times: bool = False) -> Draft:
    """It spins clockwise; the driver reverses the array and keeps the time increment, or negates it."""
    draft = _clockwise(start)
    for item in draft.scans:
        reverse(item.content)
        if with_times:
            reverse_times(item)
    return draft


def silent(start: Start) -> Draft:
    """It spins either way and states no times of rays."""
    draft = start.draft(start.pick(SPINNING)) if start.chance() else reversed_array(start)
    for reading in draft.readings:
        reading |= {"time_increment": 0.0, "scan_time": start.pick((0.0, PERIOD))}
    return draft


@of(spins=True)
def stamp_at_end(start: Start, draft: Draft) -> None:
    """The driver stamps a scan when it is complete, or in its middle."""
    share = start.pick((1.0, 0.5))
    for item in draft.scans:
        item.stamp += share * item.content["time_increment"] * len(item.content["ranges"])
    if not start.chance(0.7):
        draft.drop_odometry()


def any_start(start: Start) -> Draft:
    """Bearings that begin anywhere and go all around, beyond pi."""
    return start.draft(start.pick(TURNING), first=int(start.rng.integers(-180, 180)))


def _going_on(draft: Draft, n: int) -> Draft:
    """Let each scan go on with its first n rays."""
    for reading in draft.readings:
        for name in ("ranges", "intensities"):
            reading[name] = np.append(reading[name], reading[name][:n])
        last = len(reading["ranges"]) - 1
        reading["angle_max"] = reading["angle_min"] + reading["angle_increment"] * last
    return draft


def zero_to_turn(start: Start) -> Draft:
    """Bearings from 0 to 2 pi."""
    return _going_on(start.draft(start.pick(TURNING), first=0), int(start.chance()))


def repeated_end(start: Start) -> Draft:
    """The first ray is repeated at the end: from -pi to pi inclusive."""
    return _going_on(start.draft(start.pick(TURNING)), 1)


def overlapping(start: Start) -> Draft:
    """A scan is a little more than one turn."""
    return _going_on(start.draft(start.pick(TURNING)), start.pick((3, 20)))


def turning_start(start: Start) -> Draft:
    """The laser takes scans of a little more or less than a turn, so that each begins elsewhere."""
    n = start.pick((350, 340))
    draft = start.draft(TURNING[0], first=0, n=n, reference=0.0)
    draft.is_stream = True
    drive, laser = draft.drive, draft.laser
    for k, item in enumerate(draft.scans):
        j = k * n
        z = drive.turns[1][j : j + n] + 0.01 * draft.rng.normal(size=n)
        low = (np.radians(j) + np.pi) % (2 * np.pi) - np.pi
        item.content |= {
            "ranges": np.where(z > laser.range_max, np.inf, np.round(z, 3)), "angle_min": low,
            "angle_max": low + np.radians(n - 1), "scan_time": PERIOD * n / 360,
        }  # fmt: skip
        item.stamp = start_of(laser, 0) + PERIOD * j / 360
        item.log = item.arrival = item.stamp + 0.11
        draft.true_times[item.scan], draft.first_rays[item.scan] = item.stamp, j
    return draft


def uneven_ends(start: Start, draft: Draft) -> None:
    """The last bearing disagrees with the first, the step and the number of rays."""
    form = start.pick(("one_more", "degrees_rounded", "no_step", "no_end"))
    for c in draft.readings:
        step = c["angle_increment"]
        c |= {
            "one_more": {"angle_max": c["angle_max"] + step}, "no_step": {"angle_increment": 0.0},
            "degrees_rounded": {"angle_increment": np.sign(step) * round(abs(step), 4)}, "no_end": {"angle_max": 0.0},
        }[form]  # fmt: skip
    draft.usable = form not in ("no_step", "no_end")


@of(reference=0.0, usable=False, said="mirror|turn")
def mirrored(start: Start, draft: Draft) -> None:
    """A driver that reverses the array and keeps the bearings: the room is seen in a mirror."""
    for reading in draft.readings:
        flip(reading)


@of(reference=0.0)
def older_part(start: Start, draft: Draft) -> None:
    """A node merges two lasers, and the scan of one is the last or the last but one of it."""
    n, scans, lag = draft.laser.n, draft.scans, start.pick((1, 2))
    part = slice(int(n * start.rng.uniform(0.0, 0.4)), int(n * start.rng.uniform(0.5, 1.0)))
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


def _times(*factors: float) -> Kind:
    """Let the driver of a spinning laser state times between rays that are wrong by one of some factors."""
    return kind(
        readings(lambda c, factor: {"time_increment": c["time_increment"] * factor}, factors), spins=True
    )


# fmt: off
RAYS: dict[str, Kind] = {
    "reversed_increment": lambda start: reversed_array(start, with_times=True),
    "wrong_sign": _times(-1),
    "too_long": _times(1.5, 2.0, 10.0, 100.0, 360.0, 1e4),
    "too_short": _times(0.5, 0.1, 1e-3),
    # all rays are measured at once; the driver states a sweep
    "invented_increment": kind(readings(lambda c: {"time_increment": PERIOD / len(c["ranges"])}), spins=False),
    **named(clockwise, silent, stamp_at_end, zero_to_turn, any_start, repeated_end, overlapping, turning_start,
            uneven_ends, mirrored, older_part, first_times),
    "reversed_array": reversed_array,
}
# fmt: on
