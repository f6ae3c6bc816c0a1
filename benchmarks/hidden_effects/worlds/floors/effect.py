"""What an effect may change: hooks along the way from a command to the log."""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Mapping
from typing import Any

from benchmarks.hidden_effects.log import Booleans, Floats, Odometry
from benchmarks.hidden_effects.worlds.floors.scene import BaseState, Rays, Scene

Mount = tuple[Floats, Floats, Floats]
"""(n_scans, n_rays) each [m, m, rad]."""


EFFECTS: dict[str, type[Effect]] = {}


class Effect:
    """Nothing: each hook leaves things as they are."""

    name = "none"
    channel = "scan"
    """Scan, odometry, drive or pose."""
    scene: Scene
    spans: Mapping[str, tuple[float, float]] = types.MappingProxyType({})
    """Parameters that are drawn between two numbers."""

    def __init_subclass__(cls, name: str = "", channel: str = "scan", **spans: tuple[float, float]) -> None:
        """Register an effect by its name."""
        cls.name, cls.channel, cls.spans = name, channel, spans
        if name:
            EFFECTS[name] = cls

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {}
        self.location: dict[str, Any] | None = None

    def setup(self, scene: Scene) -> None:
        """Draw size and place."""
        self.scene = scene
        self.draw(scene)

    def draw(self, scene: Scene) -> None:
        """Draw size and place."""
        self.parameters = rounded(**{key: even(scene, *span) for key, span in self.spans.items()})

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


DEGREE = math.pi / 180


def even(scene: Scene, low: float, high: float) -> float:
    """Draw a number between two."""
    return float(scene.rng.uniform(low, high))


def size(scene: Scene, materiality: float, low: float = 1.7, high: float = 6.0) -> float:
    """Draw low to high times what matters, its logarithm even."""
    return materiality * math.exp(scene.rng.uniform(math.log(low), math.log(high)))


def sign(scene: Scene) -> float:
    """Draw -1 or 1."""
    return float(scene.rng.choice([-1, 1]))


def rounded(**parameters: float) -> dict[str, float]:
    """Return parameters as they are applied and told."""
    return {name: round(float(value), 5) for name, value in parameters.items()}


def sector(scene: Scene, width: float) -> tuple[float, float]:
    """Draw the ends [rad] of a sector of the scan, of some width [rad]."""
    bearings = scene.robot.bearings
    first = scene.rng.uniform(bearings[0], bearings[-1] - width)
    return first, first + width


def signed(scene: Scene, materiality: float) -> float:
    """Draw a size of either sign."""
    return sign(scene) * size(scene, materiality)


Law = Callable[..., Any]


def law(
    name: str,
    draw: Callable[[Scene], Mapping[str, float]],
    channel: str = "scan",
    note: str = "",
    **hooks: Law,
) -> None:
    """Define an effect by what it does at hooks of `Effect`, each a function of its parameters and the hook's arguments.

    Of the hook `ideal` it is a function of parameters and rays that returns the ranges.
    """

    def acts(hook: str, function: Law) -> Law:
        if hook == "ideal":
            return lambda self, rays: setattr(rays, "ranges", function(self.parameters, rays))
        return lambda self, *arguments: function(self.parameters, *arguments)

    members: dict[str, Any] = {hook: acts(hook, function) for hook, function in hooks.items()}
    members["__doc__"] = note
    members["draw"] = lambda self, scene: setattr(self, "parameters", rounded(**draw(scene)))
    types.new_class(name, (Effect,), {"name": name, "channel": channel}, lambda body: body.update(members))
