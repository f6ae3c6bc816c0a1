"""A set-up, its drive without anything hidden, and the rays of its scans: what effects are drawn for."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from benchmarks.hidden_effects.log import Floats, Ints
from benchmarks.hidden_effects.worlds.floors.background import Background
from benchmarks.hidden_effects.worlds.floors.raycast import meet_walls
from benchmarks.hidden_effects.worlds.floors.robots import Robot
from benchmarks.hidden_effects.worlds.floors.rooms import Room
from benchmarks.hidden_effects.worlds.floors.ways import Ways

STEP = 0.002
"""[s] of the drive."""
TIME, X, Y, PHI, RIM_LEFT, RIM_RIGHT, V, OMEGA = range(8)
"""Columns of a drive: [s, m, m, rad], rim speeds [m/s], and what the body does ahead [m/s] and in turning [rad/s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """Room, robot and flaws."""

    seed: tuple[int, ...]
    robot: Robot
    plan: Room
    """As in the map."""
    room: Room
    """As it is."""
    background: Background
    ways: Ways
    style: str
    """Of the drive: waypoints or wander."""
    duration: float
    """[s]"""
    start: tuple[float, float, float]
    """[m, m, rad]"""


@dataclass(kw_only=True, eq=False)
class Rays:
    """Rays of all scans (n_scans, n_rays), and what they meet; effects change it."""

    nominal: Floats
    """[rad] bearings that the log tells."""
    taken: Floats
    """[s] when each ray is taken."""
    scan_times: Floats
    """(n_scans,) [s] when each scan should begin."""
    bearings: Floats
    """[rad] as they are, in the frame of the laser."""
    starts: Floats
    """(n_scans, n_rays, 2) [m]"""
    directions: Floats
    """[rad] in the map."""
    walls: Floats
    """(n_walls, 4) [m]"""
    wall_names: list[tuple[str, int]]
    """Ring of each wall, and its index there."""
    rng: np.random.Generator
    """For effects alone."""
    ranges: Floats = field(init=False)
    """[m]"""
    wall: Ints = field(init=False)
    along: Floats = field(init=False)
    cosine: Floats = field(init=False)
    """As in `raycast.Hits`."""
    spare_noise: Floats = field(init=False)
    """Of variance 1, for an effect."""

    def meet(self) -> None:
        """Let each ray meet the walls."""
        hits = meet_walls(self.starts, self.directions, self.walls)
        self.ranges, self.wall, self.along, self.cosine = hits

    def incidence(self) -> Floats:
        """Return the angle of incidence of each ray [rad]."""
        return np.asarray(np.arccos(np.clip(self.cosine, 0, 1)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene(Setup):
    """A set-up with the drive that it gives where nothing is hidden."""

    rng: np.random.Generator
    """Of what is hidden."""
    run: Floats
    """(n, 8) every `STEP`"""
    commands: Floats
    """(n, 3) [s, m/s, rad/s]"""
    hits: Rays
    clearance: float
    """[m] at least between the footprint and the map's walls."""
    way: float
    """[m]"""


@dataclass(kw_only=True, eq=False)
class BaseState:
    """State of a base while it drives; effects read it."""

    setup: Setup
    x: float
    y: float
    phi: float
    """[m, m, rad]"""
    t: float = 0.0
    """[s]"""
    v: float = 0.0
    omega: float = 0.0
    """[m/s, rad/s] of the command in force."""
    motor_left: float = 0.0
    motor_right: float = 0.0
    """[m/s] after the first lag."""
    rim_left: float = 0.0
    rim_right: float = 0.0
    """[m/s] as the encoders see it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Odometry:
    """What the base logs."""

    stamps: Floats
    """(n,) [s]"""
    poses: Floats
    """(n, 3) [m, m, rad]"""
    twists: Floats
    """(n, 2) [m/s, rad/s]"""


def pose_at(run: Floats, t: Floats | float) -> tuple[Floats, Floats, Floats]:
    """Return x, y [m] and heading [rad] of a drive at some times [s]."""
    x, y, phi = (np.asarray(np.interp(t, run[:, TIME], run[:, column])) for column in (X, Y, PHI))
    return x, y, phi
