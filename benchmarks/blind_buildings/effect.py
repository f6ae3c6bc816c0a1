"""What an effect may change: hooks along the way from a command to the log."""

from __future__ import annotations

from typing import Any

from benchmarks.blind_buildings.raycast import Booleans, Floats
from benchmarks.blind_buildings.scene import BaseState, Odometry, Rays, Scene

Mount = tuple[Floats, Floats, Floats]
"""(n_scans, n_rays) each [m, m, rad]."""


class Effect:
    """Nothing: each hook leaves things as they are."""

    name = "none"
    channel = "scan"
    """Scan, odometry, drive or pose."""
    note = ""
    """What it is, and which effects of the library it comes near to."""
    is_deterministic = True
    scene: Scene

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {}
        self.location: dict[str, Any] | None = None

    def setup(self, scene: Scene) -> None:
        """Draw size and place."""
        self.scene = scene
        self.draw(scene)

    def draw(self, scene: Scene) -> None:
        """Draw size and place."""

    # commands and base

    def command_age(self, t: float) -> float:
        """Return by how much later [s] the command of a moment acts."""
        return 0.0

    def target(self, state: BaseState, v: float, omega: float) -> tuple[float, float]:
        """Return what the base tries to do of the command in force [m/s, rad/s]."""
        return v, omega

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float] | None:
        """Return rim speeds [m/s] a step later, of those asked for; None: the two lags."""
        return None

    def ground(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        """Return how fast the floor passes under each wheel [m/s], of its rim speed."""
        return left, right

    def true_track(self, track: float) -> float:
        """Return how far apart the wheels act [m]."""
        return track

    def body(self, state: BaseState, v: float, omega: float) -> tuple[float, float, float]:
        """Return the speed of the body ahead and aside [m/s], and how fast it turns [rad/s]."""
        return v, 0.0, omega

    # odometry

    def read_times(self, t: Floats) -> Floats:
        """Return when the encoders are truly read [s]."""
        return t

    def encoders(self, t: Floats, travel: Floats) -> Floats:
        """Return the travel of both rims (n, 2) [m] as counted."""
        return travel

    def increments(self, way: Floats, turn: Floats) -> tuple[Floats, Floats]:
        """Return the way [m] and the turn [rad] of each period as the base knows them."""
        return way, turn

    def odometry(self, odometry: Odometry) -> Odometry:
        """Return the odometry as logged."""
        return odometry

    # reference

    def poses(self, t: Floats, poses: Floats, run: Floats) -> Floats:
        """Return the poses (n, 3) [m, m, rad] that are observed, without noise."""
        return poses

    # laser

    def times(self, taken: Floats) -> Floats:
        """Return when each ray is truly taken [s]."""
        return taken

    def mount(self, taken: Floats, mount: Mount) -> Mount:
        """Return where the laser is on the robot."""
        return mount

    def bearing(self, taken: Floats, bearings: Floats) -> Floats:
        """Return the bearings [rad] at which the rays leave."""
        return bearings

    def meet(self, rays: Rays) -> None:
        """Let rays meet walls."""
        rays.meet()

    def ideal(self, rays: Rays) -> None:
        """Change ranges before the noise."""

    def noisy(self, rays: Rays, ranges: Floats) -> Floats:
        """Return ranges [m] with further noise."""
        return ranges

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        """Return ranges [m] as logged, of those that the sensor tells."""
        return ranges

    def outages(self, kept: Booleans) -> Booleans:
        """Return which scans (n_scans,) are logged."""
        return kept
