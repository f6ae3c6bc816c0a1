"""Units and codes: lengths, angles and times in other units, limits that are not stated, codes of missing returns."""

from __future__ import annotations

import numpy as np

from benchmarks.fuzz.structure.draft import EPOCH, Draft
from benchmarks.fuzz.structure.start import (
    Kind,
    Start,
    contents,
    kept,
    kind,
    named,
    of,
    readings,
    stamps,
)

LENGTHS = (1000.0, 100.0)
"""Millimetres and centimetres of a metre."""
TIMES = (1e3, 1e6, 1e9)
"""Milliseconds, microseconds and nanoseconds of a second."""
ANGLES = ("angle_min", "angle_max", "angle_increment")


@of(reference=0.0, said="odometry|distance")
def odometry_unit(start: Start, draft: Draft) -> None:
    factor, lengths = start.pick(LENGTHS), np.r_[np.ones(3), np.zeros(4)].astype(bool)
    scale = np.where(lengths, factor, 1.0)
    contents(("/odom",), lambda c: {"pose": c["pose"] * scale, "twist": c["twist"] * scale[:6]})(start, draft)
    draft.edges(lambda a, b, v: [(a, b, v * scale)], child="base_link")
    draft.expects = set()


@of(reference=0.0)
def odometry_scale(start: Start, draft: Draft) -> None:
    """Wheels of another radius or base than the driver has."""
    way, turn = start.pick((0.5, 0.9, 1.1, 2.0)), start.pick((0.8, 0.95, 1.0, 1.2))
    odometry = draft.drive.odometry
    steps, old, phi = np.diff(odometry, axis=0, prepend=odometry[:1]), odometry[:, 2], turn * odometry[:, 2]
    forward = np.cos(old) * steps[:, 0] + np.sin(old) * steps[:, 1]
    xy = np.cumsum(way * forward[:, None] * np.column_stack([np.cos(phi), np.sin(phi)]), axis=0)
    draft.state(np.column_stack([xy, phi]))
    contents(("/odom",), lambda c: {"twist": c["twist"] * [way, 1, 1, 1, 1, turn]})(start, draft)


def stamp_unit(start: Start, draft: Draft) -> None:
    factor = 1 / start.pick(TIMES) if start.chance() else 1e3
    choices = (("/scan",), ("/odom",), ("/scan", "/odom", "/tf", "/pose"))
    stamps(choices, lambda t: (t + 100.0) * factor - EPOCH)(start, draft)
    draft.said = "seconds|rescaled|clock|stamps"


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


# fmt: off
UNITS: dict[str, Kind] = {
    "ranges_unit": kind(readings(lambda c, factor: {name: c[name] * factor for name in ("ranges", "range_min", "range_max")}, LENGTHS),
                        said="millimet|centimet", usable=False),
    "pose_unit": kind(contents(("/pose",), lambda c, factor: {"pose": c["pose"] * np.r_[[factor] * 3, np.ones(4)]}, LENGTHS),
                      reference=1.0, said="pose"),
    # an encoder counts the other way; it may as well be the laser that looks backwards
    "odometry_backwards": kind(
        kept(lambda item: item.topic != "/tf"),
        contents(("/odom",), lambda c: {"pose": c["pose"] * [-1, -1, 1, 1, 1, 1, 1], "twist": c["twist"] * [-1, 1, 1, 1, 1, 1]}),
        reference=0.0, usable=False, said="odometry|distance|wheel|turned|laser"),
    "degrees": kind(readings(lambda c: {name: np.degrees(c[name]) for name in ANGLES}), said="degrees"),
    "increment_unit": kind(readings(lambda c, factor, names: {name: c[name] * factor for name in names}, TIMES,
                                    (("time_increment",), ("scan_time",), ("time_increment", "scan_time"))),
                           spins=True, said="milliseconds|microseconds|nanoseconds|rescaled|was used"),
    "limits": kind(readings(lambda c, limits: {"range_min": limits[0], "range_max": limits[1]}, (
        (0.0, 0.0), (0.05, np.inf), (np.nan, np.nan), (0.05, 1e6), (12.0, 0.05), (0.0, 12.0), (-1.0, 12.0), (0.05, 3.0)))),
    "scan_time": kind(readings(lambda c, value: {"scan_time": value}, (0.0, np.nan, -0.1, 1e9, 0.025, np.inf))),
    "coarse_ranges": kind(readings(lambda c, step: {"ranges": np.round(c["ranges"] / step) * step}, (0.01, 0.05))),
    **named(odometry_unit, odometry_scale, stamp_unit, no_return_code, error_codes, intensities),
}
# fmt: on
