"""Units and codes: lengths, angles and times in other units, limits that are not stated, codes of missing returns."""

from __future__ import annotations

import numpy as np

from benchmarks.fuzz.structure.draft import EPOCH, Draft
from benchmarks.fuzz.structure.start import Start, named, of

LENGTHS = {"mm": 1000.0, "cm": 100.0}
TIMES = {"ms": 1e3, "us": 1e6, "ns": 1e9}


def ranges_unit(start: Start, draft: Draft) -> None:
    factor = start.pick(list(LENGTHS.values()))
    for reading in draft.readings:
        for name in ("ranges", "range_min", "range_max"):
            reading[name] = reading[name] * factor
    draft.said = "millimet|centimet"
    draft.usable = False


@of(reference=0.0)
def odometry_unit(start: Start, draft: Draft) -> None:
    factor = start.pick(list(LENGTHS.values()))
    for item in draft.items:
        if item.kind == "Odometry":
            item.content["pose"] = item.content["pose"] * np.r_[[factor] * 3, np.ones(4)]
            item.content["twist"] = item.content["twist"] * np.r_[[factor] * 3, np.ones(3)]
    draft.edges(lambda a, b, v: [(a, b, v * np.r_[[factor] * 3, np.ones(4)])], child="base_link")
    draft.said = "odometry|distance"
    draft.expects = set()


@of(reference=1.0)
def pose_unit(start: Start, draft: Draft) -> None:
    factor = start.pick(list(LENGTHS.values()))
    for item in draft.on("/pose"):
        item.content["pose"] = item.content["pose"] * np.r_[[factor] * 3, np.ones(4)]
    draft.said = "pose"


@of(reference=0.0)
def odometry_scale(start: Start, draft: Draft) -> None:
    """Wheels of another radius or base than the driver has."""
    way, turn = start.pick((0.5, 0.9, 1.1, 2.0)), start.pick((0.8, 0.95, 1.0, 1.2))
    steps = np.diff(draft.drive.odometry, axis=0, prepend=draft.drive.odometry[:1])
    forward = (
        np.cos(draft.drive.odometry[:, 2]) * steps[:, 0] + np.sin(draft.drive.odometry[:, 2]) * steps[:, 1]
    )
    phi = turn * draft.drive.odometry[:, 2]
    xy = np.cumsum(way * forward[:, None] * np.column_stack([np.cos(phi), np.sin(phi)]), axis=0)
    draft.state(np.column_stack([xy, phi]))
    for item in draft.on("/odom"):
        item.content["twist"] = item.content["twist"] * [way, 1, 1, 1, 1, turn]


@of(reference=0.0)
def odometry_backwards(start: Start, draft: Draft) -> None:
    """An encoder counts the other way, so that driving ahead counts as back."""
    draft.drop("/tf")
    for item in draft.on("/odom"):
        item.content["pose"] = item.content["pose"] * [-1, -1, 1, 1, 1, 1, 1]
        item.content["twist"] = item.content["twist"] * [-1, 1, 1, 1, 1, 1]
    draft.usable = False  # it may as well be the laser that looks backwards
    draft.said = "odometry|distance|wheel|turned|laser"


def degrees(start: Start, draft: Draft) -> None:
    for reading in draft.readings:
        for name in ("angle_min", "angle_max", "angle_increment"):
            reading[name] = np.degrees(reading[name])
    draft.said = "degrees"


@of(spins=True)
def increment_unit(start: Start, draft: Draft) -> None:
    factor = start.pick(list(TIMES.values()))
    names = start.pick((("time_increment",), ("scan_time",), ("time_increment", "scan_time")))
    for reading in draft.readings:
        for name in names:
            reading[name] *= factor
    draft.said = "milliseconds|microseconds|nanoseconds|rescaled|was used"


def stamp_unit(start: Start, draft: Draft) -> None:
    factor = 1 / start.pick(list(TIMES.values())) if start.chance() else start.pick((1e3,))
    topics = start.pick((("/scan",), ("/odom",), ("/scan", "/odom", "/tf", "/pose")))
    for item in draft.items:
        if item.topic in topics:
            item.stamp = (item.stamp + 100.0) * factor - EPOCH
    draft.said = "seconds|rescaled|clock|stamps"


def limits(start: Start, draft: Draft) -> None:
    usual = ((0.0, 0.0), (0.05, np.inf), (np.nan, np.nan), (0.05, 1e6))
    low, high = start.pick((*usual, (12.0, 0.05), (0.0, 12.0), (-1.0, 12.0), (0.05, 3.0)))
    for reading in draft.readings:
        reading |= {"range_min": low, "range_max": high}


def scan_time(start: Start, draft: Draft) -> None:
    value = start.pick((0.0, np.nan, -0.1, 1e9, 0.025, np.inf))
    for reading in draft.readings:
        reading["scan_time"] = value


def no_return_code(start: Start) -> Draft:
    draft = start.draft(range_max=start.pick((3.0, 5.0)), spins=start.chance())
    high = draft.laser.range_max
    code = start.pick(
        (0.0, np.nan, np.inf, -1.0, high, high + 1.0, 65.533, 1e30, -np.inf, 0.001, high - 0.001)
    )
    for reading in draft.readings:
        reading["ranges"] = np.where(np.isfinite(reading["ranges"]), reading["ranges"], code)
        if code in (65.533, high - 0.001):
            reading["range_max"] = 65.533 if code > 60 else high
    return draft


def error_codes(start: Start, draft: Draft) -> None:
    """Hokuyo writes codes of errors as millimetres."""
    for reading in draft.readings:
        z = reading["ranges"]
        bad = start.rng.random(len(z)) < 0.05
        reading["ranges"] = np.where(bad, start.rng.integers(1, 20, len(z)) / 1000, z)
        reading["range_min"] = start.pick((0.0, 0.02))


def intensities(start: Start, draft: Draft) -> None:
    form = start.pick(("constant", "nan", "short", "long", "huge"))
    for reading in draft.readings:
        n = len(reading["ranges"])
        reading["intensities"] = {
            "constant": np.full(n, 47.0), "nan": np.full(n, np.nan), "short": np.ones(n - 3), "long": np.ones(2 * n),
            "huge": 1e38 * start.rng.random(n),
        }[form]  # fmt: skip


def coarse_ranges(start: Start, draft: Draft) -> None:
    step = start.pick((0.01, 0.05))
    for reading in draft.readings:
        reading["ranges"] = np.round(reading["ranges"] / step) * step


UNITS = named(
    ranges_unit, odometry_unit, pose_unit, odometry_scale, odometry_backwards, degrees, increment_unit,
    stamp_unit, limits, scan_time, no_return_code, error_codes, intensities, coarse_ranges,
)  # fmt: skip
