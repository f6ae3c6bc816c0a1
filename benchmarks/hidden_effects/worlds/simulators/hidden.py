"""What is hidden in a case: its name, its size, where it is; and which kinds serve development, which the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.hidden_effects.case import Case, Spec, truth_of
from benchmarks.hidden_effects.geometry import Room, lasting, ngon, spot_in, with_edge_moved
from benchmarks.hidden_effects.library import CHANNEL
from benchmarks.hidden_effects.log import Floats, Log
from benchmarks.hidden_effects.worlds.simulators.rooms import OUTER

LIBRARY = {
    "dev": (
        "range_bias", "mount_yaw", "latency", "quantisation", "unmapped_obstacle", "missing_obstacle", "people",
        "range_noise", "max_range", "self_occlusion", "glass", "wheel_radius", "wheel_base", "dead_time",
    ),
    "report": (
        "range_scale", "sector_bias", "mount_xy", "scan_skew", "range_drift", "moved_obstacle", "moved_wall",
        "random_outliers", "black_surface", "min_range", "incidence_dropout", "map_scale", "mirror",
        "wheel_radius_diff", "pose_clock_offset", "actuator_lag", "speed_saturation",
    ),
}  # fmt: skip
"""Effects that a library of sensor faults knows."""
FOREIGN = {
    "dev": (
        "lens_distortion", "camera_knocked", "crosstalk", "door_opens", "phase_cycle", "stiction", "missed_ticks",
        "tilted_floor",
    ),
    "report": (
        "curtain", "late_stamps", "dust", "laser_knocked", "sunlight", "bearing_stretch", "eccentric_wheel",
        "caster_drag", "payload",
    ),
}  # fmt: skip
"""Effects that no library knows; the right answer to each is "something unknown, here"."""
IRSIM_LIBRARY = {
    "dev": ("unmapped_obstacle", "mount_yaw", "people", "wheel_radius"),
    "report": ("moved_obstacle", "missing_obstacle", "mount_xy", "moved_wall", "wheel_base", "max_range"),
}
"""Library effects that are natural in ir-sim."""
IRSIM_FOREIGN = {"dev": ("lens_distortion",), "report": ("beam_jitter",)}
"""`beam_jitter` is the lidar's own `angle_std`."""
KINDS_OF = {
    ("mujoco", "singles"): LIBRARY, ("mujoco", "foreign"): FOREIGN,
    ("irsim", "singles"): IRSIM_LIBRARY, ("irsim", "foreign"): IRSIM_FOREIGN,
}  # fmt: skip
"""World and suite -> kinds of development and of the report."""
CHANNELS = {
    **dict.fromkeys(("missed_ticks", "eccentric_wheel"), "odometry"),
    **dict.fromkeys(("stiction", "tilted_floor", "caster_drag", "payload"), "drive"),
}
"""Of those outside the library that do not show in the scans."""
SPANS: dict[str, dict[str, tuple[float, float]]] = {
    "range_bias": {"b": (0.012, 0.03)},
    "range_scale": {"s": (0.006, 0.015)},
    "range_noise": {"k": (0.006, 0.012)},
    "range_drift": {"b1": (0.02, 0.04)},
    "sector_bias": {"theta1": (-0.9, 0.2), "width": (0.4, 0.7), "b": (0.025, 0.05)},
    "mount_yaw": {"delta": (0.007, 0.02)},
    "mount_xy": {"dx": (0.015, 0.03), "dy": (0.015, 0.03)},
    "latency": {"tau": (0.025, 0.07)},
    "scan_skew": {"T": (0.04, 0.09)},
    "quantisation": {"q": (0.03, 0.05)},
    "max_range": {"R": (3.0, 4.0)},
    "min_range": {"r_min": (0.7, 1.0)},
    "incidence_dropout": {"alpha_max": (0.95, 1.15)},
    "random_outliers": {"p": (0.008, 0.03)},
    "self_occlusion": {"theta1": (-1.2, 0.9), "width": (0.06, 0.15), "r0": (0.15, 0.3)},
    "map_scale": {"s": (0.006, 0.012)},
    "unmapped_obstacle": {"r": (0.12, 0.25)},
    "moved_obstacle": {"dx": (0.05, 0.1), "dy": (0.05, 0.1)},
    "missing_obstacle": {},
    "moved_wall": {"d": (0.03, 0.07)},
    "people": {"count": (1.0, 2.0)},
    "glass": {"alpha_ret": (0.25, 0.6), "depth": (0.7, 2.0)},
    "black_surface": {"r0": (0.7, 1.5)},
    "mirror": {},
    "wheel_radius": {"s": (0.012, 0.03)},
    "wheel_radius_diff": {"s": (0.01, 0.02)},
    "wheel_base": {"s": (0.015, 0.04)},
    "pose_clock_offset": {"tau": (0.03, 0.08)},
    "dead_time": {"L": (0.06, 0.15)},
    "actuator_lag": {"tau": (0.06, 0.15)},
    "speed_saturation": {"v_max": (0.18, 0.26)},
    "lens_distortion": {"edge": (0.05, 0.1)},
    "camera_knocked": {"shift": (0.025, 0.05), "yaw": (0.01, 0.02), "when": (0.3, 0.7)},
    "crosstalk": {"turn": (0.7, 2.5), "width": (0.06, 0.15), "r0": (0.6, 1.5)},
    "door_opens": {"when": (0.3, 0.6), "depth": (0.8, 2.0)},
    "phase_cycle": {"b": (0.02, 0.04), "length": (0.5, 1.5)},
    "stiction": {"v": (0.05, 0.09)},
    "missed_ticks": {"share": (0.05, 0.1), "above": (0.6, 0.7)},
    "tilted_floor": {"slope": (0.03, 0.06), "towards": (-3.14, 3.14)},
    "curtain": {"sway": (0.05, 0.1), "period": (3.0, 8.0)},
    "late_stamps": {"share": (0.2, 0.4), "late": (0.06, 0.12)},
    "dust": {"p": (0.03, 0.08), "depth": (0.5, 1.2)},
    "laser_knocked": {"yaw": (0.01, 0.02), "when": (0.3, 0.7)},
    "sunlight": {"towards": (-3.14, 3.14), "width": (0.25, 0.5)},
    "bearing_stretch": {"s": (0.012, 0.03)},
    "eccentric_wheel": {"e": (0.04, 0.08)},
    "caster_drag": {"force": (8.0, 15.0)},
    "payload": {"factor": (2.0, 3.0), "when": (0.3, 0.7)},
}
"""Parameter -> least and largest size drawn: some three to eight times what a careful set-up has."""
SIGNED = {"b", "s", "delta", "dx", "dy", "d", "b1", "yaw"}
ON_WALLS = {"moved_wall", "glass", "black_surface", "mirror", "door_opens", "curtain"}
PARTS = {"glass", "black_surface", "mirror", "door_opens", "curtain"}
"""They cover a part of their wall, from `a` to `b` [m] along it."""


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """One hidden effect."""

    name: str
    parameters: dict[str, float] = field(default_factory=dict)
    place: str = ""
    """Wall or obstacle."""
    xy: tuple[float, float] | None = None

    def __getitem__(self, key: str) -> float:
        return self.parameters[key]

    @property
    def channel(self) -> str:
        """Where it shows."""
        return CHANNELS.get(self.name) or CHANNEL.get(self.name, "scan")


class Secrets:
    """All that is hidden in a case, by name."""

    def __init__(self, *hidden: Hidden | None) -> None:
        self.all = tuple(one for one in hidden if one is not None)

    def get(self, name: str) -> Hidden | None:
        """Return the effect of a name, if it is hidden."""
        return next((one for one in self.all if one.name == name), None)

    def value(self, name: str, key: str, otherwise: float = 0.0) -> float:
        """Return a parameter of an effect, or what it is without the effect."""
        one = self.get(name)
        return otherwise if one is None else one[key]

    @property
    def mount(self) -> Floats:
        """(3,) [m, m, rad] by which the laser is not where it should be."""
        return np.array(
            [self.value("mount_xy", "dx"), self.value("mount_xy", "dy"), self.value("mount_yaw", "delta")]
        )


def draw_hidden(name: str, room: Room, rng: np.random.Generator) -> Hidden:
    """Draw size and place of an effect."""
    values = {}
    for key, span in SPANS[name].items():
        values[key] = float(rng.uniform(*span)) * (float(rng.choice([-1, 1])) if key in SIGNED else 1.0)
    place, xy = "", None
    if "theta1" in values:
        values["theta2"] = values["theta1"] + values.pop("width")
    if name in ON_WALLS:
        place = _wall(room, rng)
        a, b = room.edge(place)
        xy = _point((a + b) / 2)
        if name in PARTS:
            length = float(np.hypot(*(b - a)))
            width = min(float(rng.uniform(0.9, 1.5)), 0.6 * length)
            values["a"] = float(rng.uniform(0.15 * length, 0.85 * length - width))
            values["b"] = values["a"] + width
            xy = _point(a + (b - a) * (values["a"] + width / 2) / length)
    elif name in ("moved_obstacle", "missing_obstacle"):
        place = str(rng.choice(room.obstacles))
        xy = _point(room.rings[place].mean(axis=0))
    elif name == "unmapped_obstacle":
        xy = _free_spot(room, values["r"], rng)
        values |= {"x": xy[0], "y": xy[1]}
    return Hidden(name=name, parameters=values, place=place, xy=xy)


def _point(xy: Floats) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])


def _wall(room: Room, rng: np.random.Generator) -> str:
    """Draw one of the longer outer walls."""
    ring = room.rings[OUTER]
    length = np.hypot(*(np.roll(ring, -1, axis=0) - ring).T)
    return f"{OUTER}/edge_{int(rng.choice(np.flatnonzero(length > 0.6 * length.max())))}"


def _free_spot(room: Room, radius: float, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a place near a wall, so that the way through the room stays free."""
    free = room.free()
    ring = free.buffer(-(radius + 0.05)).difference(free.buffer(-(radius + 0.25)))
    return _point(spot_in(ring, rng))


def hidden_of(world: str, spec: Spec) -> tuple[str, int]:
    """Return the name of what is hidden in a case, and how many turns its suite has."""
    if spec.effect or spec.suite == "none":
        return spec.effect, 1
    turns = KINDS_OF[world, spec.suite][spec.kinds]
    return turns[spec.index % len(turns)], len(turns)


EPOCH_NS = 1_700_000_000 * 10**9
"""When every run begins."""
SIGMA_XY, SIGMA_YAW = 0.002, 0.0015
"""[m, rad] of the camera."""
LEAST_CHANGED, LEAST_RMSE = 0.002, 0.2
"""Share of readings, or their root mean square over sigma, from which on an effect has left a mark in a run."""


def truth(hidden: Hidden, mark: dict[str, float] | None) -> dict[str, Any]:
    """Return what the scorer of benchmarks.hidden_effects reads.

    Parameters
    ----------
    mark : `changed_share` and `rmse_over_sigma` of an effect of the scans; None: of wheels and motors, all of which are
    drawn well above their materiality
    """
    where = {"name": hidden.place or None, "xy": list(hidden.xy) if hidden.xy else None}
    return {
        "name": hidden.name,
        "channel": hidden.channel,
        "parameters": hidden.parameters,
        "location": where if hidden.place or hidden.xy else None,
        "materiality_ratio": None,
        "mark": {"changed_share": 0.0, "rmse_over_sigma": 0.0} if mark is None else mark,
        "material": mark is None
        or mark["changed_share"] >= LEAST_CHANGED
        or mark["rmse_over_sigma"] >= LEAST_RMSE,
        "deterministic": True,
    }


def changed_room(room: Room, hidden: Sequence[Hidden]) -> Room:
    """Return the room with the changes that effects make to it."""
    for one in hidden:
        if one.name == "missing_obstacle":
            room = room.with_ring(one.place, None)
        elif one.name == "moved_obstacle":
            room = room.with_ring(one.place, room.rings[one.place] + [one["dx"], one["dy"]])
        elif one.name == "unmapped_obstacle":
            room = room.with_ring("new", ngon(24, one["r"]) + [one["x"], one["y"]])
        elif one.name == "moved_wall":
            room = room.with_ring(OUTER, with_edge_moved(room.outer, int(one.place.split("_")[1]), one["d"]))
        elif one.name == "map_scale":
            middle, scale = room.outer.mean(axis=0), 1 + one["s"]
            room = Room(rings={name: middle + (ring - middle) * scale for name, ring in room.rings.items()})
    return room


def as_built(room: Room, secrets: Secrets, rng: np.random.Generator, *, dirty: bool) -> tuple[Room, Room]:
    """Return the room as it stands, dirty with every corner up to 4 mm off, and the one that the pilot keeps clear of."""
    built = changed_room(room, secrets.all)
    if dirty:
        built = built.changed(lambda _, ring: ring + rng.uniform(-0.004, 0.004, ring.shape))
    new = built.rings.get("new")
    return built, room if new is None else room.with_ring("new", new)


def bent_by_lens(poses: Floats, room: Room, edge: float) -> Floats:
    """Return poses (n, 3) as a lens shows them that is off by `edge` [m] towards the corners of the room."""
    ring = room.rings[OUTER]
    middle = (ring.min(axis=0) + ring.max(axis=0)) / 2
    off, reach = poses[:, :2] - middle, 0.7 * float(np.hypot(*(ring.max(axis=0) - middle)))
    bent = poses.copy()
    bent[:, :2] += edge * off / reach * np.square(off / reach).sum(axis=1, keepdims=True)
    return bent


def seen_by_camera(poses: Floats, noise: Floats, rho: float) -> Floats:
    """Return poses (n, 3) with noise of which a share `rho` lasts from frame to frame."""
    poses = poses + lasting(noise, rho) * [SIGMA_XY, SIGMA_XY, SIGMA_YAW]
    return np.column_stack([poses[:, :2], np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))])


def case_of(spec: Spec, room: Room, log: Log, robot: str, told: list[dict[str, Any]], **facts: Any) -> Case:
    """Return a case; `facts` are those of its truth."""
    is_foreign = bool(told) and told[0]["name"] not in CHANNEL
    truth = truth_of(spec, told, is_foreign=is_foreign, n_rays=int(log.ranges.size), **facts)
    return Case(log=log, map={"arena.geojson": room.geojson()}, robot=robot, truth=truth)
