"""A log before it is written: messages as plain values, and what is true of it. `kinds_*` change one thing in it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.fuzz.structure.drives import MOUNT, N_TURN, PAUSE, PERIOD, REAR_MOUNT, Drive, Floats

EPOCH = 1_700_000_000.0
"""[s] of the true time 0."""
SIGMA = 0.01
"""[m] of a range."""
LATENCY = 0.004
"""[s] from the stamp of a message to its log time, at least; 0 to 2 ms more are random."""


@dataclass
class Item:
    """One message."""

    topic: str
    kind: str
    """Name of the type without its package, such as LaserScan."""
    stamp: float
    """[s] header stamp on the true clock; kinds may add offsets."""
    log: float
    """[s] log time on the true clock."""
    frame: str
    content: dict[str, Any]
    scan: int = -1
    """Number of the scan, for messages of the laser that is located; -1: another message."""
    arrival: float = np.nan
    """[s] by which the file is ordered; nan: the first log time."""

    def __post_init__(self) -> None:
        self.arrival = self.log if np.isnan(self.arrival) else self.arrival


@dataclass(kw_only=True)
class Laser:
    """What the laser measures and how its driver describes it."""

    sweep: int = 1
    """1, -1: it spins counter-clockwise, clockwise; 0: it measures all rays at once."""
    first: int = -180
    """[deg] direction of the first ray in base_link; one ray per degree and stride."""
    n: int = 360
    """Number of rays."""
    stride: int = 1
    """[deg] between rays."""
    yaw: float = 0.0
    """[deg] of the laser in base_link."""
    range_max: float = 12.0
    every: int = 1
    """Turns per scan: 10 Hz divided by it."""


@dataclass(kw_only=True)
class Draft:
    """A log, and the truth about it."""

    drive: Drive | None = None
    laser: Laser = field(default_factory=Laser)
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    items: list[Item] = field(default_factory=list)
    true_times: dict[int, float] = field(default_factory=dict)
    """Scan -> [s] true time of its first ray."""
    first_rays: dict[int, int] = field(default_factory=dict)
    """Scan -> [deg] direction of its first ray in base_link, if it differs from that of the laser."""
    is_stream: bool = False
    """Whether the reader may cut the rays into other scans; each stamp is then the true time of a first ray."""
    container: str = "bag"
    """Key of `writers.CONTAINERS`."""
    options: list[str] = field(default_factory=list)
    """Further words for both commands."""
    usable: bool = True
    """Whether `locate` has what it needs."""
    expects: set[str] = field(default_factory=lambda: {"odom"})
    """Roles that the reader must find: odom, pose, cmd."""
    gauges: set[str] = field(default_factory=set)
    """What the log does not hold: `lever` and `yaw` of the mount."""
    said: str = ""
    """Pattern of what `inspect` or `locate` must print; with it, an error is not silent."""
    empty: list[tuple[str, str]] = field(default_factory=list)
    """(topic, kind) of topics without messages."""
    definitions: dict[str, str] = field(default_factory=dict)
    """Kind -> definition of types that no typestore has."""

    def on(self, topic: str) -> list[Item]:
        """Return the messages of a topic."""
        return [item for item in self.items if item.topic == topic]

    @property
    def scans(self) -> list[Item]:
        """The messages of the laser that is located."""
        return [item for item in self.items if item.scan >= 0]

    @property
    def readings(self) -> list[dict[str, Any]]:
        """The contents of these messages."""
        return [item.content for item in self.scans]

    @property
    def sources(self) -> list[tuple[str, str]]:
        """Each topic with a type of its messages."""
        return list(dict.fromkeys([(item.topic, item.kind) for item in self.items] + self.empty))

    def keep(self, wanted: Callable[[Item], bool]) -> None:
        """Drop all other messages."""
        self.items = [item for item in self.items if wanted(item)]

    def drop(self, *topics: str) -> None:
        """Drop the messages of topics."""
        self.keep(lambda item: item.topic not in topics)

    def drop_odometry(self) -> None:
        """Drop the odometry, which the reader then need not find."""
        self.drop("/odom", "/tf")
        self.expects.discard("odom")

    def add_static(self, *edges: tuple[str, str, Floats]) -> None:
        """Add a message of static transforms (parent, child, value)."""
        self.add(Item("/tf_static", "TFMessage", 0.0, 0.0, "", {"transforms": [*edges]}))

    def state(self, poses: Floats) -> None:
        """Let the odometry and its transform state other poses (n, 3)."""
        for item, pose in zip(self.on("/odom"), poses, strict=True):
            item.content = item.content | {"pose": vec7(*pose)}
        for item, pose in zip(self.on("/tf"), poses, strict=True):
            item.content = {"transforms": [("odom", "base_link", vec7(*pose))]}

    def rename(self, old: str, new: str) -> None:
        """Rename a topic."""
        for item in self.on(old):
            item.topic = new

    def frames(self, change: Callable[[str], str]) -> None:
        """Rename frames everywhere."""
        for item in self.items:
            item.frame = change(item.frame)
            if "child" in item.content:
                item.content["child"] = change(item.content["child"])
            if "transforms" in item.content:
                item.content["transforms"] = [
                    (change(a), change(b), value) for a, b, value in item.content["transforms"]
                ]

    def edges(
        self, change: Callable[[str, str, Floats], Iterable[tuple[str, str, Floats]]], *, child: str = ""
    ) -> None:
        """Replace each transform by others, or each of one child."""
        for item in [item for item in self.items if item.kind == "TFMessage"]:
            item.content["transforms"] = [
                new
                for edge in item.content["transforms"]
                for new in (change(*edge) if child in ("", edge[1]) else [edge])
            ]
        self.keep(lambda item: item.kind != "TFMessage" or bool(item.content["transforms"]))

    def add(self, *items: Item) -> None:
        """Append messages; `writers` sort by arrival."""
        self.items += items


def vec7(x: float, y: float, yaw: float, *, z: float = 0.0, roll: float = 0.0, pitch: float = 0.0) -> Floats:
    """Return a translation and a quaternion x, y, z, w; the rotation is yaw, then pitch, then roll."""
    cy, sy, cp, sp, cr, sr = (f(a / 2) for a in (yaw, pitch, roll) for f in (np.cos, np.sin))
    return np.array(
        [x, y, z, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy]
    )  # fmt: skip


def compose(a: Floats, b: Floats) -> Floats:
    """Return the planar pose b (..., 3), given in a (..., 3), in the frame of a."""
    a, b = np.broadcast_arrays(np.asarray(a, dtype=float), np.asarray(b, dtype=float))
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [a[..., 0] + c * b[..., 0] - s * b[..., 1], a[..., 1] + s * b[..., 0] + c * b[..., 1], a[..., 2] + b[..., 2]],
        axis=-1,
    )  # fmt: skip


def inverse(a: Floats) -> Floats:
    """Return the inverse of planar poses (..., 3)."""
    a = np.asarray(a, dtype=float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], -a[..., 2]], axis=-1)


def measured(drive: Drive, laser: Laser, k: int, rng: np.random.Generator) -> Floats:
    """Return the ranges (n,) of scan k in the order in which the laser measures them, with noise; inf: no return."""
    turns = laser.first % 360 if laser.sweep >= 0 else -laser.first % 360
    rays = laser.stride * np.arange(laser.n)
    if laser.sweep == 0:
        z = drive.flashes[k][(laser.first + rays) % N_TURN]
    else:
        z = drive.turns[laser.sweep][k * N_TURN + turns + rays]
    z = z + SIGMA * rng.normal(size=len(z))
    return np.where(z > laser.range_max, np.inf, np.round(z, 3))


def start_of(laser: Laser, k: int) -> float:
    """Return the true time [s] of the first ray of scan k."""
    turns = laser.first % 360 if laser.sweep >= 0 else -laser.first % 360
    return PAUSE + PERIOD * (k + (turns / N_TURN if laser.sweep else 0.0))


def logged(at: float, rng: np.random.Generator) -> float:
    """Return the log time [s] of a message that is complete at a time."""
    return at + LATENCY + 0.002 * float(rng.random())


def ray_times(draft: Draft, k: int, directions: Floats) -> Floats:
    """Return the true times (n,) [s] of the rays of scan k in some directions (n,) [rad] in base_link."""
    laser = draft.laser
    first = draft.first_rays.get(k, laser.first)
    after = (laser.sweep * (np.degrees(directions) - first) + 0.5) % 360.0 - 0.5  # [deg]
    return np.asarray(draft.true_times[k] + (PERIOD * after / 360.0 if laser.sweep else 0.0 * after))


def laser_scan(draft: Draft, k: int) -> Item:
    """Return scan k as an honest driver describes it: bearings in the laser frame, in the order of the rays."""
    laser, rng = draft.laser, draft.rng
    sign = -1 if laser.sweep < 0 else 1
    step = np.radians(laser.stride) * sign
    low = np.radians(laser.first - laser.yaw)
    at = start_of(laser, k)
    per_ray = PERIOD / N_TURN * laser.stride if laser.sweep else 0.0
    draft.true_times[k] = at
    content = {
        "angle_min": low, "angle_max": low + step * (laser.n - 1), "angle_increment": step,
        "time_increment": per_ray, "scan_time": PERIOD * laser.every, "range_min": 0.05, "range_max": laser.range_max,
        "ranges": measured(draft.drive, laser, k, rng), "intensities": np.zeros(0),
    }  # fmt: skip
    return Item("/scan", "LaserScan", at, logged(at + per_ray * laser.n, rng), "laser", content, scan=k)


def flip(reading: dict[str, Any]) -> None:
    """Let the driver send the array of a scan the other way."""
    reading |= {name: reading[name][::-1].copy() for name in ("ranges", "intensities")}


def reverse(reading: dict[str, Any]) -> None:
    """Let the driver send the array of a scan the other way, with bearings that fit."""
    flip(reading)
    low, high, step = (reading[name] for name in ("angle_max", "angle_min", "angle_increment"))
    reading |= {"angle_min": low, "angle_max": high, "angle_increment": -step}


def reverse_times(item: Item) -> None:
    """Let the driver state times of the rays that fit a reversed array."""
    item.stamp += item.content["time_increment"] * (len(item.content["ranges"]) - 1)
    item.content["time_increment"] *= -1


def mount_of(laser: Laser) -> Floats:
    """Return the true planar pose of the laser in base_link."""
    return np.array([*MOUNT, np.radians(laser.yaw)])


def base_draft(drive: Drive, rng: np.random.Generator, laser: Laser) -> Draft:
    """Return a log without anything odd: /scan, /odom, /tf (odom -> base_link), /tf_static, /pose, /cmd_vel."""
    draft = Draft(drive=drive, laser=laser, rng=rng)
    last = drive.n_turns
    draft.add(*(laser_scan(draft, k) for k in range(0, last, laser.every)))
    for t, pose, twist in zip(drive.odom_times, drive.odometry, drive.twists, strict=True):
        log = logged(t, rng)
        value = {"pose": vec7(*pose), "twist": _six(twist), "child": "base_link"}
        draft.add(
            Item("/odom", "Odometry", t, log, "odom", value),
            Item("/tf", "TFMessage", t, log + 1e-4, "", {"transforms": [("odom", "base_link", vec7(*pose))]}),
        )
    draft.add_static(("base_link", "laser", vec7(*mount_of(laser), z=0.25)))
    for t, command in zip(drive.cmd_times, drive.commands, strict=True):
        draft.add(Item("/cmd_vel", "Twist", t, logged(t, rng), "", {"twist": _six(command)}))
    return draft


def add_reference(draft: Draft, topic: str = "/pose", kind: str = "PoseStamped", rate: float = 20.0) -> None:
    """Add the pose of base_link in map, as a tracking system measures it."""
    times = np.arange(0.05, draft.drive.times[-1], 1 / rate)
    poses = draft.drive.pose_at(times) + draft.rng.normal(size=(len(times), 3)) * [0.002, 0.002, 0.002]
    for t, pose in zip(times, poses, strict=True):
        content: dict[str, Any] = {"pose": vec7(*pose)}
        if kind == "PoseWithCovarianceStamped":
            content["covariance"] = np.diag([4e-6, 4e-6, 0, 0, 0, 4e-6]).ravel()
        if kind == "TransformStamped":
            content["child"] = "base_link"
        draft.add(Item(topic, kind, t, logged(t, draft.rng), "map", content))


def rear_scans(draft: Draft, topic: str, frame: str = "rear_laser", *, every: int = 2) -> None:
    """Add the scans of a second laser of 180 rays that looks backwards."""
    n = 180
    for k in range(0, draft.drive.n_turns, every):
        at = PAUSE + PERIOD * k
        z = draft.drive.rear_flashes[k][(90 + np.arange(n)) % N_TURN]
        z = np.round(z + SIGMA * draft.rng.normal(size=n), 3)
        content = {
            "angle_min": -np.pi / 2, "angle_max": -np.pi / 2 + np.radians(n - 1), "angle_increment": np.radians(1.0),
            "time_increment": 0.0, "scan_time": PERIOD * every, "range_min": 0.05, "range_max": 12.0,
            "ranges": np.where(z > 12.0, np.inf, z), "intensities": np.zeros(0),
        }  # fmt: skip
        draft.add(Item(topic, "LaserScan", at, logged(at, draft.rng), frame, content))
    mount = vec7(*REAR_MOUNT, np.pi, z=0.2)
    draft.add_static(("base_link", frame, mount))


def _six(twist: Floats) -> Floats:
    return np.array([twist[0], 0.0, 0.0, 0.0, 0.0, twist[1]])
