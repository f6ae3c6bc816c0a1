"""Units, codes and limits; the order, the bearings and the times of the rays; lasers in other messages than LaserScan, odd poses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fuzz.structure.draft import (
    EPOCH,
    Draft,
    Item,
    Laser,
    flip,
    logged,
    reverse,
    reverse_times,
    start_of,
    vec7,
)
from benchmarks.fuzz.structure.drives import PERIOD, Floats
from benchmarks.fuzz.structure.start import (
    ODOM,
    RNG,
    SCANS,
    SPINNING,
    TURNING,
    Kind,
    Span,
    Start,
    call,
    changed,
    contents,
    dropped,
    edges,
    either,
    kind,
    readings,
    sometimes,
    stamps,
)  # fmt: skip

LENGTHS = (1000.0, 100.0)
"""Millimetres and centimetres of a metre."""
TIMES = (1e3, 1e6, 1e9)
"""Milliseconds, microseconds and nanoseconds of a second."""
ANGLES = ("angle_min", "angle_max", "angle_increment")
PLACE = np.r_[np.ones(3), np.zeros(4)]
"""Which parts of a transform are lengths."""
NO_WHEELS = sometimes(call(Draft.drop_odometry), share=0.3)


def odometry_scale(draft: Draft, way: float, turn: float) -> None:
    """Wheels of another radius or base than the driver has."""
    old = draft.drive.odometry
    steps, phi = np.diff(old, axis=0, prepend=old[:1]), turn * old[:, 2]
    forward = np.cos(old[:, 2]) * steps[:, 0] + np.sin(old[:, 2]) * steps[:, 1]
    xy = np.cumsum(way * forward[:, None] * np.column_stack([np.cos(phi), np.sin(phi)]), axis=0)
    draft.state(np.column_stack([xy, phi]))
    for item in draft.on("/odom"):
        item.content |= {"twist": item.content["twist"] * [way, 1, 1, 1, 1, turn]}


def no_return(c: dict[str, Any], code: float, of_range_max: float) -> dict[str, Any]:
    """Return a scan whose missing returns are written as a code, perhaps relative to range_max."""
    value = code + of_range_max * c["range_max"]
    ranges = np.where(np.isfinite(c["ranges"]), c["ranges"], value)
    return {"ranges": ranges, "range_max": max(c["range_max"], 65.533 * (value == 65.533))}


UNITS: dict[str, Kind] = {
    "ranges_unit": kind(readings(lambda c, factor: {name: c[name] * factor for name in ("ranges", "range_min", "range_max")}, LENGTHS),
                        said="millimet|centimet", usable=False),
    "pose_unit": kind(contents(("/pose",), lambda c, factor: {"pose": c["pose"] * np.r_[[factor] * 3, np.ones(4)]}, LENGTHS),
                      reference=1.0, said="pose"),
    "odometry_unit": kind(*(
        change for factor in LENGTHS[:1] for scale in [np.where(PLACE > 0, factor, 1.0)] for change in (
            contents(ODOM, lambda c, s=scale: {"pose": c["pose"] * s, "twist": c["twist"] * s[:6]}),
            edges(lambda a, b, v, s=scale: [(a, b, v * s)], child="base_link"),
        )
    ), reference=0.0, said="odometry|distance", lacks=("odom",)),
    "odometry_scale": kind(call(odometry_scale, (0.5, 0.9, 1.1, 2.0), (0.8, 0.95, 1.0, 1.2)), reference=0.0),
    # an encoder counts the other way; it may as well be the laser that looks backwards
    "odometry_backwards": kind(
        dropped("/tf"),
        contents(ODOM, lambda c: {"pose": c["pose"] * [-1, -1, 1, 1, 1, 1, 1], "twist": c["twist"] * [-1, 1, 1, 1, 1, 1]}),
        reference=0.0, usable=False, said="odometry|distance|wheel|turned|laser"),
    "stamp_unit": kind(stamps((SCANS, ODOM, ("/scan", "/odom", "/tf", "/pose")), lambda t, factor: (t + 100.0) * factor - EPOCH,
                              (1e-3, 1e-6, 1e-9, 1e3)), said="seconds|rescaled|clock|stamps"),
    "degrees": kind(readings(lambda c: {name: np.degrees(c[name]) for name in ANGLES}), said="degrees"),
    "increment_unit": kind(readings(lambda c, factor, names: {name: c[name] * factor for name in names}, TIMES,
                                    (("time_increment",), ("scan_time",), ("time_increment", "scan_time"))),
                           spins=True, said="milliseconds|microseconds|nanoseconds|rescaled|was used"),
    "limits": kind(readings(lambda c, limits: {"range_min": limits[0], "range_max": limits[1]}, (
        (0.0, 0.0), (0.05, np.inf), (np.nan, np.nan), (0.05, 1e6), (12.0, 0.05), (0.0, 12.0), (-1.0, 12.0), (0.05, 3.0)))),
    "scan_time": kind(readings(lambda c, value: {"scan_time": value}, (0.0, np.nan, -0.1, 1e9, 0.025, np.inf))),
    "coarse_ranges": kind(readings(lambda c, step: {"ranges": np.round(c["ranges"] / step) * step}, (0.01, 0.05))),
    "no_return_code": kind(
        readings(lambda c, code: no_return(c, *code), (
            (0.0, 0), (np.nan, 0), (-1.0, 0), (0.0, 1), (1.0, 1), (65.533, 0), (1e30, 0), (-np.inf, 0), (0.001, 0), (-0.001, 1))),
        range_max=(3.0, 5.0)),
    # Hokuyo writes codes of errors as millimetres
    "error_codes": kind(readings(lambda c, low, rng: {"range_min": low, "ranges": np.where(
        rng.random(len(c["ranges"])) < 0.05, rng.integers(1, 20, len(c["ranges"])) / 1000, c["ranges"])}, (0.0, 0.02), RNG)),
    "intensities": kind(readings(lambda c, form, rng: {"intensities": form(len(c["ranges"]), rng)}, (
        lambda n, rng: np.full(n, 47.0), lambda n, rng: np.full(n, np.nan), lambda n, rng: np.ones(n - 3),
        lambda n, rng: np.ones(2 * n), lambda n, rng: 1e38 * rng.random(n)), RNG)),
}  # fmt: skip


def clockwise(start: Start) -> Laser:
    """Draw a laser that measures the same rays the other way."""
    laser = start.draw(SPINNING)
    return replace(laser, sweep=-1, first=laser.first + laser.stride * (laser.n - 1))


def reversed_array(draft: Draft, *, with_times: bool) -> None:
    """The driver reverses the array and keeps the time increment, or negates it."""
    for item in draft.scans:
        reverse(item.content)
        if with_times:
            reverse_times(item)


def going_on(draft: Draft, n: int) -> None:
    """Each scan goes on with its first n rays."""
    for c in draft.readings:
        c |= {name: np.append(c[name], c[name][:n]) for name in ("ranges", "intensities")}
        c["angle_max"] = c["angle_min"] + c["angle_increment"] * (len(c["ranges"]) - 1)


def turning_start(draft: Draft) -> None:
    """The laser takes scans of a little less than a turn, so that each begins elsewhere."""
    draft.is_stream = True
    drive, laser, n = draft.drive, draft.laser, draft.laser.n
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


def older_part(draft: Draft, lag: int, low: float, high: float) -> None:
    """A node merges two lasers, and the scan of one is the last or the last but one of it."""
    n, scans = draft.laser.n, draft.scans
    part = slice(int(n * low), int(n * high))
    ranges = [item.content["ranges"].copy() for item in scans]
    for k in range(lag, len(scans)):
        new = ranges[k].copy()
        new[part] = ranges[k - lag][part]
        scans[k].content = scans[k].content | {"ranges": new}


def ray_times(*factors: float, **options: Any) -> Kind:
    """Return a driver that states times between rays that are wrong by one of some factors."""
    wrong = readings(lambda c, factor: {"time_increment": c["time_increment"] * factor}, factors)
    return kind(wrong, spins=True, **options)


STEPS = (
    lambda c: {"angle_max": c["angle_max"] + c["angle_increment"]},
    lambda c: {"angle_increment": np.sign(c["angle_increment"]) * round(abs(c["angle_increment"]), 4)},
)
"""The last bearing is one step too far; the step is rounded."""
NO_TIMES = readings(lambda c, scan_time: {"time_increment": 0.0, "scan_time": scan_time}, (0.0, PERIOD))
KEPT = call(reversed_array, with_times=False)
RAYS: dict[str, Kind] = {
    "clockwise": kind(laser=clockwise),
    "reversed_array": kind(KEPT, laser=clockwise),
    "reversed_increment": kind(call(reversed_array, with_times=True), laser=clockwise),
    "silent": kind(NO_TIMES, laser=SPINNING),
    "silent_reversed": kind(KEPT, NO_TIMES, laser=clockwise),
    "wrong_sign": ray_times(-1),
    "too_long": ray_times(1.5, 2.0, 10.0, 100.0, 360.0, 1e4),
    "too_short": ray_times(0.5, 0.1, 1e-3),
    # all rays are measured at once; the driver states a sweep
    "invented_increment": kind(readings(lambda c: {"time_increment": PERIOD / len(c["ranges"])}), spins=False),
    # the driver stamps a scan when it is complete, or in its middle
    "stamp_at_end": kind(changed(SCANS, lambda m, share: {
        "stamp": m.stamp + share * m.content["time_increment"] * len(m.content["ranges"])
    }, (1.0, 0.5)), NO_WHEELS, spins=True),
    # bearings that begin anywhere and go all around, beyond pi; from 0 to 2 pi; a little more than one turn
    "any_start": kind(laser=TURNING, first=tuple(range(-180, 180))),
    "zero_to_turn": kind(call(going_on, (0, 1)), laser=TURNING, first=0),
    "overlapping": kind(call(going_on, (1, 3, 20)), laser=TURNING),
    "turning_start": kind(call(turning_start), laser=TURNING[0], first=0, n=(350, 340), reference=0.0),
    "uneven_ends": kind(readings(lambda c, new: new(c), STEPS)),
    "no_step": kind(readings(lambda c, name: {name: 0.0}, ("angle_increment", "angle_max")), usable=False),
    # a driver that reverses the array and keeps the bearings: the room is seen in a mirror
    "mirrored": kind(call(lambda draft: [flip(c) for c in draft.readings]), reference=0.0, usable=False, said="mirror|turn"),
    "older_part": kind(call(older_part, (1, 2), Span(0.0, 0.4), Span(0.5, 1.0)), reference=0.0),
    # the first scan states the times of a motor that starts
    "first_times": kind(changed(SCANS, lambda m, factor: {"content": {
        name: m.content[name] * factor for name in ("time_increment", "scan_time")
    } if m.scan == 0 else {}}, (8.0, 0.05, -1.0)), NO_WHEELS, reference=0.0, spins=True),
}  # fmt: skip


def multi_echo(draft: Draft, has_more: bool) -> None:
    """MultiEchoLaserScan; behind glass and at edges there are two echoes."""
    for item in draft.scans:
        c = item.content
        seen = np.isfinite(c["ranges"])
        echoes = [[z] if ok else [] for z, ok in zip(c["ranges"], seen, strict=True)]
        for i in np.flatnonzero(has_more & seen & (draft.rng.random(len(seen)) < 0.05)):
            echoes[i].append(c["ranges"][i] + 0.4)
        values = c["intensities"] if len(c["intensities"]) else np.full(len(echoes), 100.0)
        c["intensities"] = [[value] * len(each) for value, each in zip(values, echoes, strict=True)]
        c["ranges"], item.kind = echoes, "MultiEchoLaserScan"


def bearings(item: Item) -> Floats:
    c = item.content
    return np.asarray(c["angle_min"] + c["angle_increment"] * np.arange(len(c["ranges"])))


def as_cloud(
    item: Item, kinds: str, *, height: int = 1, pad: int = 0, order: str = "<", **columns: Any
) -> None:
    """Make a point cloud of columns; `kinds` is the type of x, y and z, and those of further fields."""
    xyz, *more = kinds.split()
    fields = dict.fromkeys("xyz", xyz) | dict(one.split(":") for one in more)
    size, points = np.dtype([(name, order + of) for name, of in fields.items()]), len(columns["x"])
    form = np.dtype({
        "names": size.names, "formats": [size[name] for name in fields], "offsets": [size.fields[name][1] for name in fields],
        "itemsize": size.itemsize + pad,
    })  # fmt: skip
    table: NDArray[Any] = np.zeros(points, form)
    for name in fields:
        table[name] = columns[name]
    item.content, item.kind = {"points": table, "height": height, "big": order == ">"}, "PointCloud2"


def flat_cloud(draft: Draft, kinds: str, pad: int, order: str, has_nans: bool) -> None:
    """The points of one laser in its plane, as laser_geometry and drivers of planar lasers send them."""
    for item in draft.scans:
        z, bearing = (
            np.where(np.isfinite(item.content["ranges"]), item.content["ranges"], np.nan),
            bearings(item),
        )
        some = np.isfinite(z) | has_nans
        x, y = (z * np.cos(bearing))[some], (z * np.sin(bearing))[some]
        as_cloud(item, kinds, pad=pad, order=order, x=x, y=y, z=0 * x, intensity=7.0 + 0 * x)
    draft.rename("/scan", "/points")


def ring_cloud(draft: Draft, elevations: tuple[float, ...], kinds: str, topic: str) -> None:
    """A laser with rings, of which one is level; with a type of `t`, the cloud is organised."""
    n, is_organised = len(elevations), " t:" in kinds
    for item in draft.scans:
        z, bearing = item.content["ranges"], bearings(item)
        flat, b, up = np.repeat(z, n), np.repeat(bearing, n), np.tile(np.radians(elevations), len(z))
        after = np.repeat(np.arange(len(z)) * item.content["time_increment"], n)
        columns: dict[str, Any] = {
            "x": flat * np.cos(b), "y": flat * np.sin(b), "z": flat * np.tan(up), "intensity": 9.0 + 0 * b,
            "ring": np.tile(np.arange(n), len(z)), "time": after, "t": np.rint(after * 1e9), "timestamp": after + item.stamp + EPOCH,
        }  # fmt: skip
        order = (
            np.argsort(columns["ring"], kind="stable") if is_organised else np.flatnonzero(np.isfinite(flat))
        )
        columns = {name: value[order] for name, value in columns.items()}
        columns |= {name: np.where(np.isfinite(flat[order]), columns[name], np.nan) for name in "xyz"}
        as_cloud(item, kinds, height=n if is_organised else 1, **columns)
    draft.rename("/scan", topic)


def slow_cloud(draft: Draft) -> None:
    """A cloud holds several turns of the laser."""
    scans = draft.scans
    draft.drop("/scan")
    for item, more in zip(scans[:-1:2], scans[1::2], strict=False):
        z, bearing = np.append(item.content["ranges"], more.content["ranges"]), np.tile(bearings(item), 2)
        some, t = np.isfinite(z), np.arange(len(z)) * PERIOD / 360 * 1e9
        x, y = (z * np.cos(bearing))[some], (z * np.sin(bearing))[some]
        as_cloud(item, "f4 t:u4 ring:u2", x=x, y=y, z=0 * x, t=t[some], ring=0 * x)
        item.log = item.arrival = more.log
        draft.add(replace(item, topic="/points"))


def sonar_ring(draft: Draft, n: int, cone: float, is_one_topic: bool) -> None:
    """Range messages: sonars with wide cones, or thin infrared beams."""
    mount, turns = draft.on("/tf_static")[0].content["transforms"][0][2], np.arange(n) * 360 // n
    draft.add_static(
        *(
            ("base_link", f"sonar_{i}", vec7(*mount[:2], np.radians(turn - 180)))
            for i, turn in enumerate(turns)
        )
    )
    for item in draft.scans:
        for i, turn in enumerate(turns):
            at, z = item.stamp + 0.001 * i, float(item.content["ranges"][turn])
            content = {"field_of_view": cone, "min_range": 0.02, "max_range": 12.0, "range": z}
            topic = "/sonar" if is_one_topic else f"/sonar/{i}"
            draft.add(Item(topic, "Range", at, logged(at, draft.rng), f"sonar_{i}", content))
    draft.drop("/scan")


def not_finite(draft: Draft, topic: str, bad: float) -> None:
    """A few values of odometry, poses or transforms are no numbers."""
    for item in draft.on(topic):
        if draft.rng.random() < 0.05:
            edge = {"transforms": [("odom", "base_link", np.full(7, bad))]}
            item.content = edge if topic == "/tf" else item.content | {"pose": np.full(7, bad)}


def three_dimensional(c: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return a pose with height, roll and pitch, as a motion capture or an inertial unit states it."""
    x, y, _, _, _, s, w = c["pose"]
    roll, pitch, up = 0.02 * rng.normal(size=3)
    return {"pose": vec7(x, y, 2 * np.arctan2(s, w), z=0.8 + up, roll=roll, pitch=pitch)}


POSES, TURN, UNKNOWN = ("/pose", "/odom"), Laser(sweep=1, first=-180, n=360), np.r_[np.zeros(6), 1.0]
RING_LASERS = (TURN, replace(TURN, sweep=-1), replace(TURN, sweep=0))
RINGS = ((-2.0, 0.0, 2.0, 4.0), (-15.0, -5.0, 0.0, 5.0, 15.0), (-1.0, 1.0))
RING_KINDS = tuple(
    f"f4 intensity:f4{more}"
    for more in ("", " ring:u2", " ring:u2 time:f4", " ring:u1 timestamp:f8", " t:u4 ring:u1")
)
RING_TOPICS = ("/points", "/velodyne_points", "/os_cloud_node/points")
TYPES: dict[str, Kind] = {
    "multi_echo": kind(call(multi_echo, 0.5)),
    "flat_cloud": kind(call(flat_cloud, ("f4", "f4 intensity:f4", "f8"), (0, 4), ("<", ">"), 0.3)),
    "ring_cloud": kind(call(ring_cloud, RINGS, RING_KINDS, RING_TOPICS), laser=RING_LASERS),
    "cloud_slice": kind(call(ring_cloud, RINGS, RING_KINDS, RING_TOPICS), laser=RING_LASERS, words=("--slice", "-0.1,0.8")),
    "slow_cloud": kind(call(slow_cloud), laser=TURN),
    "sonar_ring": kind(call(sonar_ring, (8, 12, 16), (0.3, 0.01), 0.5), laser=RING_LASERS[2], usable=False),
    # odometry whose pose, or twist, is never filled in
    "twist_only": kind(sometimes(dropped("/tf")), contents(ODOM, lambda c, pose: {"pose": pose}, (UNKNOWN, 0 * UNKNOWN)),
                       reference=0.0),
    "pose_only": kind(contents(ODOM, lambda c, value: {"twist": np.full(6, value)}, (0.0, np.nan))),
    "no_orientation": kind(
        dropped("/tf"), either(*(contents((topic,), lambda c: {"pose": c["pose"] * PLACE}) for topic in POSES)),
        reference=1.0, lacks=("pose", "odom"), said="no orientation|quaternion|heading"),
    # the odometry comes as PoseStamped
    "odometry_is_pose": kind(dropped("/tf"), changed(ODOM, lambda m: {"topic": "/odom_pose", "kind": "PoseStamped"}),
                             reference=0.0, lacks=("odom",)),
    "not_finite": kind(call(not_finite, ("/pose", "/odom", "/tf"), (np.nan, np.inf, 1e300)), reference=1.0),
    "three_dimensional": kind(contents(POSES, three_dimensional, RNG), reference=1.0),
}  # fmt: skip
