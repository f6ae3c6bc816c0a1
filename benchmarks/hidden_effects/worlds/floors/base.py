"""The base and who drives it: commands, motors, wheels and floor, two milliseconds at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from benchmarks.hidden_effects.geometry import wrapped
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.floors.effect import Effect
from benchmarks.hidden_effects.worlds.floors.robots import Robot
from benchmarks.hidden_effects.worlds.floors.scene import STEP, BaseState, Setup
from benchmarks.hidden_effects.worlds.floors.ways import Ways

STYLES = ("waypoints", "wander")
SIGHT = 2.5
"""[m] that one who wanders looks ahead."""


class Driver:
    """Gives a command at a time, within the limits of the robot."""

    def __init__(self, ways: Ways, robot: Robot, rng: np.random.Generator, style: str) -> None:
        self.ways = ways
        self.robot = robot
        self.rng = rng
        self.style = style
        self.v = 0.0
        self.omega = 0.0
        self.mode = "stop"
        self.until = rng.uniform(0.5, 1.5)
        """[s] when what it does ends."""
        self.next = rng.uniform(5, 9)
        """[s] of the next stop, turn or reversal."""
        self.path = np.zeros((0, 2))
        self.at = 0
        """Index of the place of the path that it heads for."""
        self.speed = rng.uniform(0.6, 1.0)
        """Share of the robot's."""
        self.phase = rng.uniform(0, 6)
        self.turn_sign = 1
        self.turn_left = 0.0
        """[rad] left of a turn in place."""
        self.curl = 0.0
        """[rad/s] while it reverses."""
        self.visits: list[Floats] = []

    def step(self, t: float, x: float, y: float, phi: float) -> tuple[float, float]:
        """Return the command [m/s, rad/s] at a time [s] and pose [m, m, rad]."""
        v = omega = 0.0
        if self.mode == "stop":
            if t > self.until:
                self.mode = "go"
        elif self.mode == "spin":
            omega = self._spin(t)
        elif self.mode == "back":
            v, omega = self._back(t, x, y, phi)
        if self.mode == "go":
            if t > self.next and abs(self.v) < self.robot.v:
                self._interrupt(t)
            elif self.style == "waypoints":
                v, omega = self._follow(x, y, phi)
            else:
                v, omega = self._wander(t, x, y, phi)
        period = 1 / self.robot.command_rate
        most_v, most_omega = self.robot.a * period * 0.9, self.robot.alpha * period * 0.9
        self.v += max(-most_v, min(most_v, v - self.v))
        self.omega += max(-most_omega, min(most_omega, omega - self.omega))
        self.v, self.omega = round(self.v, 4), round(self.omega, 4)
        return self.v, self.omega

    def _interrupt(self, t: float) -> None:
        """Begin to stand, to turn in place or to reverse."""
        rng = self.rng
        self.next = t + rng.uniform(5, 10)
        self.speed = rng.uniform(0.5, 1.0)
        chance = rng.random()
        if chance < 0.35:
            self.mode = "stop"
            self.until = t + rng.uniform(0.8, 2.2)
        elif chance < 0.65:
            self.mode = "spin"
            self.until = t + 6
            self.turn_left = rng.choice([-1, 1]) * rng.uniform(0.8, 5)
        else:
            self.mode = "back"
            self.until = t + rng.uniform(1, 2.5)
            self.curl = rng.uniform(-0.4, 0.4)

    def _spin(self, t: float) -> float:
        left = self.turn_left
        omega = math.copysign(min(self.robot.omega * 0.8, max(0.25, 1.5 * abs(left))), left)
        self.turn_left -= self.omega * (1 / self.robot.command_rate)
        if abs(self.turn_left) < 0.05 or t > self.until:
            self.mode = "go"
        return omega

    def _back(self, t: float, x: float, y: float, phi: float) -> tuple[float, float]:
        radius = self.robot.footprint
        behind = radius * 0.6 + 0.15
        clearance = self.ways.clearance(x - behind * math.cos(phi), y - behind * math.sin(phi))
        if clearance < radius * 0.9 or t > self.until:
            self.mode = "go"
            return 0.0, self.curl
        return -0.45 * self.robot.v, self.curl

    def _choose_goal(self, x: float, y: float) -> None:
        """Plan a way to one of twelve cells: far, and far from earlier goals."""
        cells = self.rng.integers(len(self.ways.cells), size=12)
        places = np.array([self.ways.place(cell) for cell in cells])
        distances = np.hypot(*(places - (x, y)).T)
        if self.visits:
            visits = np.array(self.visits)
            off = np.hypot(places[:, None, 0] - visits[None, :, 0], places[:, None, 1] - visits[None, :, 1])
            distances = np.minimum(distances, np.min(off, axis=1) * 1.3)
        goal = int(cells[np.argmax(np.minimum(distances, 7 * self.robot.v / 0.3))])
        self.visits.append(self.ways.place(goal))
        self.path = self.ways.path(x, y, goal)
        self.at = 0

    def _follow(self, x: float, y: float, phi: float) -> tuple[float, float]:
        """Head for a place of the path some way ahead; slower near walls and in bends."""
        robot = self.robot
        if not len(self.path) or np.hypot(*(self.path[-1] - (x, y))) < 0.18:
            self._choose_goal(x, y)
        look = 0.25 + 0.45 * abs(self.v)
        path = self.path
        while self.at < len(path) - 1 and math.hypot(path[self.at][0] - x, path[self.at][1] - y) < look:
            self.at += 1
        off_x, off_y = path[self.at][0] - x, path[self.at][1] - y
        bearing = wrapped(math.atan2(off_y, off_x) - phi)
        distance = max(0.15, math.hypot(off_x, off_y))
        if abs(bearing) > 0.9:
            return 0.0, math.copysign(min(robot.omega * 0.8, 1.6 * abs(bearing)), bearing)
        clearance = min(
            self.ways.clearance(x, y),
            self.ways.clearance(x + 0.5 * robot.v * math.cos(phi), y + 0.5 * robot.v * math.sin(phi)),
        )
        share = min(1.0, max(0.25, (clearance - robot.footprint) / (0.5 * robot.v + 0.1)))
        v = robot.v * self.speed * share * max(0.2, math.cos(bearing) ** 2)
        omega = 2 * v * math.sin(bearing) / distance
        if abs(omega) > 0.7 * robot.omega:
            v *= 0.7 * robot.omega / abs(omega)
            omega = math.copysign(0.7 * robot.omega, omega)
        return v, omega

    def _free_ahead(self, x: float, y: float, direction: float) -> float:
        """Return how far it could go [m] in a direction [rad]."""
        distance = 0.0
        while distance < SIGHT:
            distance += 0.12
            at = x + distance * math.cos(direction), y + distance * math.sin(direction)
            if self.ways.clearance(*at) < self.robot.footprint + 0.04:
                break
        return distance

    def _wander(self, t: float, x: float, y: float, phi: float) -> tuple[float, float]:
        """Drive on, swaying, away from walls; turn where it can stop just in time."""
        robot = self.robot
        stop = robot.v**2 / (2 * robot.a) + robot.v * 0.35
        ahead = self._free_ahead(x, y, phi + 0.0)
        left, right = self._free_ahead(x, y, phi + 0.7), self._free_ahead(x, y, phi + -0.7)
        if ahead < max(0.25, stop * abs(self.v) / robot.v + 0.15):
            if abs(self.omega) < 0.1:
                far_left = self._free_ahead(x, y, phi + 1.6)
                far_right = self._free_ahead(x, y, phi + -1.6)
                self.turn_sign = 1 if left + 0.8 * far_left > right + 0.8 * far_right else -1
            return 0.0, self.turn_sign * robot.omega * 0.6
        v = robot.v * self.speed * min(1.0, ahead / (1.3 * stop + 0.3))
        omega = 0.8 * (min(left, 1.5) - min(right, 1.5)) + 0.35 * math.sin(0.35 * t + self.phase)
        omega = max(-0.6 * robot.omega, min(0.6 * robot.omega, omega))
        return v * (1 - 0.5 * abs(omega) / robot.omega), omega


SOON = 1e-9
"""[s] by which what is due may come early."""


def follow(tau: float) -> float:
    """Return the share of a difference that a lag of tau [s] makes up in a step."""
    return 1 - math.exp(-STEP / tau)


@dataclass(kw_only=True, eq=False)
class _Link:
    """Commands on their way to the base: each acts some time after it was given."""

    setup: Setup
    effect: Effect
    given: list[tuple[float, float, float]] = field(default_factory=list)
    """[s, m/s, rad/s]"""
    due: list[float] = field(default_factory=list)
    """[s] of each."""
    next_tick: float = 0.0
    n_taken: int = 0

    def give(self, t: float, v: float, omega: float) -> None:
        """Send a command."""
        background = self.setup.background
        self.given.append((t, v, omega))
        delays = background.network_delays
        age = self.setup.robot.delay - background.tick / 2
        self.due.append(t + age + self.effect.command_age(t) + delays[len(self.given) % len(delays)])

    def act(self, state: BaseState) -> None:
        """Put commands that are due into force, where the base looks for them now."""
        t, tick = state.t, self.setup.background.tick
        if t < self.next_tick - SOON:
            return
        self.next_tick = self.next_tick + tick if tick else t
        while self.n_taken < len(self.due) and self.due[self.n_taken] <= t + SOON:
            _, state.v, state.omega = self.given[self.n_taken]
            self.n_taken += 1


def drive(
    setup: Setup, effect: Effect | None = None, commands: Floats | None = None
) -> tuple[Floats, Floats]:
    """Run the base.

    Parameters
    ----------
    commands : (n, 3) [s, m/s, rad/s] to give again, without a driver

    Returns
    -------
    run : (n, 8) every `STEP`, see `scene`
    commands : (n, 3) [s, m/s, rad/s] as given
    """
    effect = effect or Effect()
    robot, background = setup.robot, setup.background
    x, y, phi = setup.start
    state = BaseState(setup=setup, x=x, y=y, phi=phi)
    driver = Driver(setup.ways, robot, np.random.default_rng((*setup.seed, 1)), setup.style)
    link = _Link(setup=setup, effect=effect, next_tick=background.tick_phase * background.tick)
    track = effect.true_track(robot.wheel_base)
    lags = follow(robot.tau), follow(background.second_lag) if background.second_lag else 1.0
    every = round(1 / robot.command_rate / STEP)
    run = np.zeros((int(setup.duration / STEP) + 1, 8))
    for i, row in enumerate(run):
        state.t = i * STEP
        if i % every == 0:
            if commands is None:
                link.give(state.t, *driver.step(state.t, state.x, state.y, state.phi))
            else:
                link.give(state.t, *commands[len(link.given), 1:])
        link.act(state)
        _turn_wheels(state, effect, lags)
        left, right = effect.ground(state, state.rim_left, state.rim_right)
        ahead, aside, omega = effect.body(state, (left + right) / 2, (right - left) / track)
        row[:] = state.t, state.x, state.y, state.phi, state.rim_left, state.rim_right, ahead, omega
        half = omega * STEP / 2
        c, s, chord = math.cos(state.phi + half), math.sin(state.phi + half), 1 - half * half / 6
        state.x += (ahead * c - aside * s) * STEP * chord
        state.y += (ahead * s + aside * c) * STEP * chord
        state.phi += omega * STEP
    return run, np.array(link.given)


def _turn_wheels(state: BaseState, effect: Effect, lags: tuple[float, float]) -> None:
    """Let both motors follow the command in force for a step."""
    robot = state.setup.robot
    v, omega = effect.target(state, state.v, state.omega)
    most_v, most_omega = robot.v * 1.001, robot.omega * 1.001
    v, omega = max(-most_v, min(most_v, v)), max(-most_omega, min(most_omega, omega))
    left, right = v - omega * robot.wheel_base / 2, v + omega * robot.wheel_base / 2
    turned = effect.motors(state, left, right)
    if turned is None:
        turned = lagged(state, left, right, lags)
    state.rim_left, state.rim_right = turned


def lagged(state: BaseState, left: float, right: float, lags: tuple[float, float]) -> tuple[float, float]:
    """Return both rim speeds [m/s] after two lags in series; the first is kept in the state."""
    first, second = lags
    state.motor_left += first * (left - state.motor_left)
    state.motor_right += first * (right - state.motor_right)
    return (
        state.rim_left + second * (state.motor_left - state.rim_left),
        state.rim_right + second * (state.motor_right - state.rim_right),
    )
