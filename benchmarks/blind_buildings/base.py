"""The base: commands, motors, wheels and floor, two milliseconds at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from benchmarks.blind_buildings.driver import Driver
from benchmarks.blind_buildings.effect import Effect
from benchmarks.blind_buildings.raycast import Floats
from benchmarks.blind_buildings.scene import STEP, BaseState, Setup

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
    track = effect.true_track(robot.track)
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
    left, right = v - omega * robot.track / 2, v + omega * robot.track / 2
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
