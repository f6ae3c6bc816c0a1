"""Types: lasers in other messages than LaserScan, odometry of one part, poses of other types."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fuzz.structure.draft import Draft, Item, Laser, logged, vec7
from benchmarks.fuzz.structure.drives import PERIOD, Floats
from benchmarks.fuzz.structure.start import Start, named, of


def multi_echo(start: Start, draft: Draft) -> None:
    more = start.chance()
    for item in draft.scans:
        c = item.content
        seen = np.isfinite(c["ranges"])
        echoes = [[z] if ok else [] for z, ok in zip(c["ranges"], seen, strict=True)]
        if more:  # behind glass and at edges there are two
            for i in np.flatnonzero(seen & (start.rng.random(len(seen)) < 0.05)):
                echoes[i].append(c["ranges"][i] + 0.4)
        values = c["intensities"] if len(c["intensities"]) else np.full(len(echoes), 100.0)
        c["intensities"] = [[value] * len(each) for value, each in zip(values, echoes, strict=True)]
        c["ranges"], item.kind = echoes, "MultiEchoLaserScan"


def _bearings(item: Item) -> Floats:
    c = item.content
    return np.asarray(c["angle_min"] + c["angle_increment"] * np.arange(len(c["ranges"])))


def _as_cloud(
    item: Item,
    columns: dict[str, Any],
    kinds: dict[str, str],
    *,
    height: int = 1,
    pad: int = 0,
    big: bool = False,
) -> None:
    offsets, size = [], 0
    for kind in kinds.values():
        offsets.append(size)
        size += np.dtype(kind).itemsize
    formats = [(">" if big else "<") + kind for kind in kinds.values()]
    form = np.dtype({"names": list(kinds), "formats": formats, "offsets": offsets, "itemsize": size + pad})
    n = len(columns["x"])
    points: NDArray[Any] = np.zeros(n, form)
    for name in kinds:
        points[name] = columns[name]
    item.content = {"points": points, "height": height, "big": big}
    item.kind = "PointCloud2"


def flat_cloud(start: Start, draft: Draft) -> None:
    """The points of one laser in its plane, as laser_geometry and drivers of planar lasers send them."""
    layout = start.pick(("xyz", "intensity", "double", "padded", "big", "nan"))
    for item in draft.scans:
        z, bearing = item.content["ranges"], _bearings(item)
        seen = np.isfinite(z) if layout != "nan" else np.ones(len(z), dtype=bool)
        z = np.where(np.isfinite(z), z, np.nan)
        columns = {
            "x": (z * np.cos(bearing))[seen],
            "y": (z * np.sin(bearing))[seen],
            "z": np.zeros(int(seen.sum())),
        }
        kinds = dict.fromkeys("xyz", "f8" if layout == "double" else "f4")
        if layout == "intensity":
            columns["intensity"] = np.full(len(columns["x"]), 7.0)
            kinds["intensity"] = "f4"
        _as_cloud(item, columns, kinds, pad=4 if layout == "padded" else 0, big=layout == "big")
    draft.rename("/scan", "/points")


def ring_cloud(start: Start) -> Draft:
    """A laser with rings, of which one is level."""
    spins = start.chance(0.7)
    laser = Laser(sweep=start.pick((1, -1)) if spins else 0, first=-180, n=360)
    draft = start.draft(laser)
    elevations = np.radians(start.pick(((-2.0, 0.0, 2.0, 4.0), (-15.0, -5.0, 0.0, 5.0, 15.0), (-1.0, 1.0))))
    layout = start.pick(("ring", "ring_time", "ring_stamp", "organized", "no_ring"))
    for item in draft.scans:
        z, bearing = item.content["ranges"], _bearings(item)
        n = len(elevations)
        flat, up = np.repeat(z, n), np.tile(elevations, len(z))
        after = np.repeat(np.arange(len(z)) * item.content["time_increment"], n)
        b = np.repeat(bearing, n)
        columns: dict[str, Any] = {
            "x": flat * np.cos(b), "y": flat * np.sin(b), "z": flat * np.tan(up), "intensity": np.full(len(b), 9.0),
            "ring": np.tile(np.arange(n), len(z)), "time": after, "t": np.rint(after * 1e9),
            "timestamp": after + item.stamp + 1.7e9,
        }  # fmt: skip
        kinds = {"x": "f4", "y": "f4", "z": "f4", "intensity": "f4"}
        kinds |= {"no_ring": {}, "ring": {"ring": "u2"}, "ring_time": {"ring": "u2", "time": "f4"},
                  "ring_stamp": {"ring": "u1", "timestamp": "f8"}, "organized": {"t": "u4", "ring": "u1"}}[layout]  # fmt: skip
        if layout == "organized":
            order = np.argsort(columns["ring"], kind="stable")
            columns = {name: value[order] for name, value in columns.items()}
        seen = np.isfinite(columns["x"])
        if layout != "organized":
            columns = {name: value[seen] for name, value in columns.items()}
        else:
            columns |= {name: np.where(seen, columns[name], np.nan) for name in "xyz"}
        _as_cloud(item, columns, kinds, height=n if layout == "organized" else 1)
    draft.rename("/scan", start.pick(("/points", "/velodyne_points", "/os_cloud_node/points")))
    if layout == "no_ring" and start.chance():
        draft.options = ["--slice", "-0.1,0.8"]
    return draft


def cloud_beside_scan(start: Start, draft: Draft) -> None:
    clouds = [
        replace(item, scan=-1, topic="/points", content=dict(item.content)) for item in draft.scans[::5]
    ]
    for item in clouds:
        bearing, z = _bearings(item), np.nan_to_num(item.content["ranges"], posinf=0.0)
        _as_cloud(
            item, {"x": z * np.cos(bearing), "y": z * np.sin(bearing), "z": 0 * z}, dict.fromkeys("xyz", "f4")
        )
    draft.add(*clouds)


def sonar_ring(start: Start) -> Draft:
    """Range messages: sonars with wide cones, or thin infrared beams."""
    draft = start.draft(Laser(sweep=0, first=-180, n=360))
    n, cone = start.pick(((8, 0.3), (12, 0.5), (16, 0.01)))
    one = start.chance()
    mount = draft.on("/tf_static")[0].content["transforms"][0][2]
    for k, item in enumerate(draft.scans):
        for i in range(n):
            z = float(item.content["ranges"][i * 360 // n])
            content = {"field_of_view": cone, "min_range": 0.02, "max_range": 12.0, "range": z}
            at = item.stamp + 0.001 * i
            topic = "/sonar" if one else f"/sonar/{i}"
            draft.add(Item(topic, "Range", at, logged(at, draft.rng), f"sonar_{i}", content))
        if k == 0:
            rings = [("base_link", f"sonar_{i}", vec7(mount[0], mount[1], 2 * np.pi * (i * 360 // n) / 360 - np.pi))
                     for i in range(n)]  # fmt: skip
            draft.add_static(*rings)
    draft.drop("/scan")
    draft.usable = False
    return draft


@of(reference=0.0)
def twist_only(start: Start, draft: Draft) -> None:
    """Odometry whose pose is never filled in."""
    has_tf = start.chance()
    draft.keep(lambda item: item.topic != "/tf" or has_tf)
    zero = start.pick((np.r_[np.zeros(6), 1.0], np.zeros(7)))
    for item in draft.on("/odom"):
        item.content = item.content | {"pose": zero}


def pose_only(start: Start, draft: Draft) -> None:
    """Odometry whose twist is never filled in."""
    for item in draft.on("/odom"):
        item.content = item.content | {"twist": np.full(6, start.pick((0.0, np.nan)))}


@of(reference=1.0)
def no_orientation(start: Start, draft: Draft) -> None:
    topic = start.pick(("/pose", "/odom"))
    draft.drop("/tf")
    for item in draft.on(topic):
        item.content = item.content | {"pose": item.content["pose"] * [1, 1, 1, 0, 0, 0, 0]}
    draft.expects.discard("pose")
    draft.expects.discard("odom")
    draft.said = "no orientation|quaternion|heading"


@of(reference=0.0)
def odometry_is_pose(start: Start, draft: Draft) -> None:
    """The odometry comes as PoseStamped."""
    draft.drop("/tf")
    for item in draft.on("/odom"):
        item.topic, item.kind, item.content = "/odom_pose", "PoseStamped", {"pose": item.content["pose"]}
    draft.expects = set()


@of(reference=1.0)
def not_finite(start: Start, draft: Draft) -> None:
    """A few values of odometry, poses or transforms are nan."""
    topic = start.pick(("/pose", "/odom", "/tf"))
    for item in draft.on(topic):
        if start.chance(0.05):
            bad = np.full(7, start.pick((np.nan, np.inf, 1e300)))
            edge = {"transforms": [("odom", "base_link", bad)]}
            item.content = edge if topic == "/tf" else item.content | {"pose": bad}


@of(reference=1.0)
def three_dimensional(start: Start, draft: Draft) -> None:
    """Poses with height, roll and pitch, as a motion capture or an inertial unit states them."""
    for item in draft.items:
        if item.topic in ("/pose", "/odom"):
            x, y, _, _, _, s, c = item.content["pose"]
            yaw = 2 * np.arctan2(s, c)
            roll, pitch = 0.02 * start.rng.normal(size=2)
            item.content["pose"] = vec7(x, y, yaw, z=0.8 + 0.01 * start.rng.normal(), roll=roll, pitch=pitch)


def two_types_one_topic(start: Start, draft: Draft) -> None:
    """/scan is LaserScan in one part of the file and MultiEchoLaserScan in another."""
    draft.add(Item("/scan", "String", 0.5, 0.5, "", {"text": "laser started"}))
    draft.container = start.pick(("bag", "mcap"))


def slow_cloud(start: Start) -> Draft:
    """A cloud holds several turns of the laser."""
    draft = start.draft(Laser(sweep=1, first=-180, n=360))
    scans = draft.scans
    draft.keep(lambda item: item.scan < 0)
    for k in range(0, len(scans) - 1, 2):
        item, more = scans[k], scans[k + 1]
        z = np.concatenate([item.content["ranges"], more.content["ranges"]])
        bearing = np.tile(_bearings(item), 2)
        after = np.arange(720) * PERIOD / 360
        seen = np.isfinite(z)
        columns = {
            "x": z * np.cos(bearing),
            "y": z * np.sin(bearing),
            "z": 0 * z,
            "t": after * 1e9,
            "ring": 0 * z,
        }
        _as_cloud(item, {name: v[seen] for name, v in columns.items()},
                  {"x": "f4", "y": "f4", "z": "f4", "t": "u4", "ring": "u2"})  # fmt: skip
        item.log = item.arrival = more.log
        draft.add(item)
    draft.rename("/scan", "/points")
    return draft


TYPES = named(
    multi_echo, flat_cloud, ring_cloud, cloud_beside_scan, slow_cloud, sonar_ring, twist_only, pose_only,
    no_orientation, odometry_is_pose, not_finite, three_dimensional, two_types_one_topic,
)  # fmt: skip
