"""Controllers that steer by the sensor's readings, scan by scan; registry CONTROLLERS.

A controller can also be a polynomial identified by `sensorgraph identify`: the `MODEL.json` of a command, or
two, `TURN.json,SPEED.json`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planners.arena import wrap
from robotmodic_ident import Narmax
from robotmodic_ident.errors import IdentError
from sensorgraph.errors import SensorgraphError
from sensorgraph.identification.signals import RAY_PATTERN, perceived, rays_of
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

Controller = Callable[[Floats], tuple[float, float]]
"""Readings (n_rays,) [m] -> (v, omega) [m/s, rad/s]."""
TURN_AWAY_DISTANCE = 0.35
"""[m] Distance from the footprint to an obstacle ahead at which the robot turns away."""
FOLLOW_DISTANCE = 0.30
"""[m] Distance from the footprint to a followed wall."""
LOST_DISTANCE = 0.50
"""[m] Excess over the distance of a followed wall above which the wall is lost."""
MAX_SEARCH_TURN = 1.5 * np.pi
"""[rad] Maximum turn to the right in search of a lost wall: enough to pass its end, but not to circle."""
AHEAD_HALF_WIDTH = np.radians(30.0)  # half width of the sector ahead
CRUISE_SHARE = 0.75  # of the maximum speed


class _ReactiveController:
    """Common part of the reactive controllers: free distance as the nearest reading in a sector."""

    def __init__(self, robot: Robot, seed: int) -> None:
        self.limits, self.radius = robot.limits, robot.footprint_radius
        self.bearings = wrap(robot.sensor.bearings + robot.sensor.mount[2])
        self.reach = float(np.hypot(*robot.sensor.mount[:2]))
        self.ahead = np.abs(self.bearings) < AHEAD_HALF_WIDTH
        self.rng = np.random.default_rng([seed, 4])

    def nearest(self, readings: Floats, sector: Bools) -> float:
        """Return the second lowest reading [m] of a sector, so that a single outlier does not steer."""
        values = readings[sector & ~np.isnan(readings)]
        return float(np.partition(values, 1)[1]) if len(values) > 1 else np.inf

    def open_way(self, readings: Floats) -> float:
        """Return the distance [m] that the footprint can move ahead."""
        return self.nearest(readings, self.ahead) - self.radius + self.reach


class WallFollowing(_ReactiveController):
    """Keep the wall on the right at a constant distance; turn left before an obstacle; without a wall, drive straight."""

    def __init__(self, robot: Robot, seed: int) -> None:
        super().__init__(robot, seed)
        self.period = 1.0 / robot.sensor.rate
        self.searched = np.inf  # [rad] turned to the right without a wall
        self.right = (self.bearings < -np.radians(20.0)) & (self.bearings > -np.radians(100.0))

    def __call__(self, readings: Floats) -> tuple[float, float]:
        """Steer by the distance to the right and the free distance ahead."""
        way = self.open_way(readings)
        if way < TURN_AWAY_DISTANCE:
            self.searched = 0.0
            return 0.0, 0.6 * self.limits.omega
        off = self.nearest(readings, self.right) - self.radius - FOLLOW_DISTANCE
        slow = min((way - TURN_AWAY_DISTANCE) / 0.5 + 0.2, 1.0)
        turn = float(np.clip(-1.6 * off, -0.5, 0.5)) * self.limits.omega
        self.searched = self.searched - turn * self.period if off > LOST_DISTANCE else 0.0
        return CRUISE_SHARE * self.limits.v * slow, turn if self.searched < MAX_SEARCH_TURN else 0.0


class RandomBounce(_ReactiveController):
    """Drive straight; before an obstacle turn by a random angle, and further until the path is free."""

    def __init__(self, robot: Robot, seed: int) -> None:
        super().__init__(robot, seed)
        self.period = 1.0 / robot.sensor.rate
        self.remaining_turn = 0.0  # [rad] remaining turn
        self.side = 1.0

    def __call__(self, readings: Floats) -> tuple[float, float]:
        """Steer by the free distance ahead."""
        way = self.open_way(readings)
        if self.remaining_turn <= 0 and way < TURN_AWAY_DISTANCE:
            self.remaining_turn = float(self.rng.uniform(np.pi / 3, np.pi))
            self.side = 1.0 if self.rng.random() < 0.5 else -1.0
        if self.remaining_turn > 0:
            rate = 0.6 * self.limits.omega
            self.remaining_turn -= rate * self.period
            if self.remaining_turn <= 0 and way < TURN_AWAY_DISTANCE:
                self.remaining_turn = rate * self.period
            return 0.0, self.side * rate
        return CRUISE_SHARE * self.limits.v, 0.0


CONTROLLERS: dict[str, Callable[[Robot, int], Controller]] = {
    "wall_following": WallFollowing,
    "random_bounce": RandomBounce,
}
"""Name -> (robot, seed) -> controller."""

TURN_OUTPUTS, SPEED_OUTPUTS = ("cmd_omega", "omega"), ("cmd_v", "v")
PERIOD_TOLERANCE = 0.05
"""Maximum relative deviation of the model's period from a multiple of the sensor's."""


class PolynomialController:
    """Turn rate or speed from an identified polynomial of the readings; the other command is constant.

    Past outputs are the controller's own commands. A ray without return keeps the last command.
    """

    def __init__(self, model: Narmax, facts: Mapping[str, Any], robot: Robot, *, name: str) -> None:
        self.model, self.name = model, name
        self.factors = [f for term in (*model.terms, *model.denominator) for f in term]
        self.names: dict[str, str] = {
            f.variable: facts.get("signals", {}).get(f.variable, f.variable) for f in self.factors
        }
        self.is_turn = model.output in TURN_OUTPUTS
        if not self.is_turn and model.output not in SPEED_OUTPUTS:
            raise SensorgraphError(
                f"{name} predicts {model.output}, expected one of {', '.join(TURN_OUTPUTS + SPEED_OUTPUTS)} for a controller"
            )
        held = facts.get("held", {})
        self.held = float(held.get("cmd_v" if self.is_turn else "cmd_omega", 0.0))
        self.rays = {
            v: rays_of(robot.sensor, s)
            for v, s in self.names.items()
            if v != model.output and RAY_PATTERN.fullmatch(s)
        }
        if unknown := [s for v, s in self.names.items() if v not in self.rays and v != model.output]:
            raise SensorgraphError(
                f"{name} needs {', '.join(unknown)}, which the robot does not perceive; identify a command from "
                "rays such as L45-90"
            )
        self.every = _scans_per_step(facts.get("period_s"), robot.sensor.rate, name)
        self.depth = max(model.terms.max_lag, model.denominator.max_lag) + 1
        self.past: dict[str, list[float]] = {}
        self.own = [0.0] * self.depth  # newest first, as each of `past`
        self.count, self.command = 0, 0.0

    @classmethod
    def load(cls, path: Path, robot: Robot) -> PolynomialController:
        """Read a model file of `sensorgraph identify`."""
        model = Narmax.load(path)
        try:
            return cls(model, json.loads(path.read_text()), robot, name=path.name)
        except (AttributeError, TypeError, ValueError, RecursionError) as exc:
            if isinstance(exc, SensorgraphError | IdentError):
                raise
            raise SensorgraphError(f"{path}: not a controller ({exc}); create one with `identify`") from exc

    def __call__(self, readings: Floats) -> tuple[float, float]:
        """Steer by the rays of the polynomial, at the period of its identification."""
        due = self.count % self.every == 0
        self.count += 1
        if due:
            now = {v: float(perceived(readings[None], rays)[0]) for v, rays in self.rays.items()}
            if all(np.isfinite(value) for value in now.values()):
                self._step(now)
            else:  # reading and command of this step are those of the step before
                self.past = {v: [kept[0], *kept[:-1]] for v, kept in self.past.items()}
                self.own = [self.own[0], *self.own[:-1]]
        return (self.held, self.command) if self.is_turn else (self.command, self.held)

    def _step(self, now: Mapping[str, float]) -> None:
        """Run the model one step further in free run, where noise terms are 0."""
        for v, value in now.items():
            kept = self.past.setdefault(v, [value] * self.depth)  # constant before the start
            self.past[v] = [value, *kept[:-1]]
        model, past = self.model, {**self.past, self.model.output: [np.nan, *self.own]}
        columns = {
            f.signal: np.array(
                [past[f.variable][f.lag or 0] - (0.0 if f.minus is None else past[f.variable][f.minus])]
            )
            for f in self.factors
        }
        top = model.terms.matrix(columns, model.scale, n=1)[0] @ model.theta
        bottom = 1.0 + model.denominator.matrix(columns, model.scale, n=1)[0] @ model.denominator_theta
        with np.errstate(divide="ignore", invalid="ignore"):
            value = float(np.clip(top / bottom, *model.limits))
        if np.isfinite(value):
            self.command = abs(value) if model.is_magnitude else value
        self.own = [value if np.isfinite(value) else self.command, *self.own[:-1]]


def _scans_per_step(period: float | None, rate: float, name: str) -> int:
    """Return the number of scans per step of a model."""
    if period is None:
        return 1
    steps = float(period) * rate
    whole = max(1, round(steps))
    if abs(steps - whole) > PERIOD_TOLERANCE * whole:
        raise SensorgraphError(
            f"{name} has a period of {period:g} s, expected a multiple of the scan period of {1 / rate:g} s"
        )
    return whole


def controller_named(name: str, robot: Robot, seed: int) -> Controller:
    """Return a controller of the registry, or the polynomial in a `MODEL.json`."""
    if name in CONTROLLERS:
        return CONTROLLERS[name](robot, seed)
    if not name.endswith(".json"):
        raise SensorgraphError(
            f"controller is {name!r}, expected {', '.join(CONTROLLERS)} or a MODEL.json of `identify`"
        )
    files = [Path(part) for part in name.split(",")]
    for file in files:
        if not file.is_file():
            raise SensorgraphError(f"{file} does not exist; create a model with `sensorgraph identify`")
    models = [PolynomialController.load(file, robot) for file in files]
    if len(models) == 1:
        return models[0]
    turns, speeds = [m for m in models if m.is_turn], [m for m in models if not m.is_turn]
    if len(turns) != 1 or len(speeds) != 1:
        raise SensorgraphError(
            f"{name} has {len(turns)} models of the turn rate and {len(speeds)} of the speed, expected one of each"
        )
    return lambda readings: (speeds[0](readings)[0], turns[0](readings)[1])


def controller_label(name: str) -> str:
    """Return a short name for use in a file name: `turn+speed` for `a/turn.json,a/speed.json`."""
    return "+".join(Path(part).stem for part in name.split(",")) if name.endswith(".json") else name
