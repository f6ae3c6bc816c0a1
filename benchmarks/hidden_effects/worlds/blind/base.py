"""The base: commands, motors, wheels and floor, one millisecond at a time.

Two first-order lags in series follow the commands; each wheel has a gain of its own, loses grip of its own and may
have play. What hidden effects do to commands, motors, wheels and floor is here, all of it off at the defaults.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from benchmarks.hidden_effects.log import Floats

STEP = 0.001
"""[s]"""
N_LOGGED = 9
"""Logged a step: x, y, phi, rim travel right and left [m], v, omega of the body, rim speeds right and left [m/s]."""
X, Y, PHI, RIM_RIGHT, RIM_LEFT, V, OMEGA, SPEED_RIGHT, SPEED_LEFT = range(N_LOGGED)
N_STATES = 18
# the first five states are those logged first
FAST_RIGHT, FAST_LEFT, OUT_RIGHT, OUT_LEFT, COMMAND, SENSE, SINCE_CHANGE = range(5, 12)
RAMP_V, RAMP_OMEGA, LAST_RIGHT, LAST_LEFT, PLAY_RIGHT, PLAY_LEFT = range(12, 18)


class Base(NamedTuple):
    """The true base; a NamedTuple because the kernel reads it."""

    tau: float
    """[s] of the motors."""
    tau_fast: float
    """[s] of the second lag, 0: none."""
    base_nominal: float
    base_true: float
    wheel_radius: float
    """[m], as the two above."""
    gain_right: float = 1.0
    gain_left: float = 1.0
    """Travel of the wheel over what the encoder says."""
    slip: float = 0.0
    slip_x: float = 0.0
    slip_y: float = 0.0
    slip_r: float = 0.0
    """Share lost by a wheel within a patch; its centre and radius [m]."""
    v_max: float = 0.0
    """[m/s]; 0: none."""
    eccentricity: float = 0.0
    """Of the right wheel, over its radius."""
    left_turn_loss: float = 0.0
    """Share of a left turn that is lost."""
    caster_loss: float = 0.0
    caster_time: float = 0.0
    """Share of a turn lost for this long [s] after the sense of turning has changed."""
    sag_rate: float = 0.0
    """[1/s] by which motors follow less."""
    dead_omega: float = 0.0
    dead_v: float = 0.0
    """[rad/s, m/s] below which a command does nothing."""
    ramp_v: float = 0.0
    ramp_omega: float = 0.0
    """[m/s2, rad/s2] of the base's own ramps; 0: none."""
    spin_loss: float = 0.0
    spin_above: float = 0.0
    """Share lost by a wheel that gains speed by more than this [m/s2]."""
    play: float = 0.0
    """[m] at the rim between encoder and wheel."""
    side_slide: float = 0.0
    """[s]: v omega times this is how fast the body slides outward in a curve."""
    pile: float = 0.0
    pile_direction: float = 0.0
    """Share of its way that a carpet carries the body aside, and where to [rad] in the map."""


@numba.njit(cache=True)
def _wheel_targets(state, v, omega, t, base):  # type: ignore[no-untyped-def]
    """Return what the wheels shall do [m/s], of the command in force."""
    if abs(omega) < base.dead_omega:
        omega = 0.0
    if abs(v) < base.dead_v:
        v = 0.0
    if base.ramp_v > 0:
        most_v, most_omega = base.ramp_v * STEP, base.ramp_omega * STEP
        state[RAMP_V] += min(max(v - state[RAMP_V], -most_v), most_v)
        state[RAMP_OMEGA] += min(max(omega - state[RAMP_OMEGA], -most_omega), most_omega)
        v, omega = state[RAMP_V], state[RAMP_OMEGA]
    follow = 1.0 - base.sag_rate * t
    half = 0.5 * base.base_nominal
    return follow * (v + omega * half), follow * (v - omega * half)


@numba.njit(cache=True)
def _rim_speeds(state, right, left, base):  # type: ignore[no-untyped-def]
    """Let the motors follow; return how fast the wheels turn [m/s]."""
    if base.tau_fast > 0:
        q = 1 - np.exp(-STEP / base.tau_fast)
        state[FAST_RIGHT] += q * (right - state[FAST_RIGHT])
        state[FAST_LEFT] += q * (left - state[FAST_LEFT])
    else:
        state[FAST_RIGHT], state[FAST_LEFT] = right, left
    if base.tau > 0:
        q = 1 - np.exp(-STEP / base.tau)
        state[OUT_RIGHT] += q * (state[FAST_RIGHT] - state[OUT_RIGHT])
        state[OUT_LEFT] += q * (state[FAST_LEFT] - state[OUT_LEFT])
    else:
        state[OUT_RIGHT], state[OUT_LEFT] = state[FAST_RIGHT], state[FAST_LEFT]
    mean = 0.5 * (state[OUT_RIGHT] + state[OUT_LEFT])
    half_difference = 0.5 * (state[OUT_RIGHT] - state[OUT_LEFT])
    if base.v_max > 0:
        mean = min(max(mean, -base.v_max), base.v_max)
    return mean + half_difference, mean - half_difference


@numba.njit(cache=True)
def _through_play(state, gap, speed, play):  # type: ignore[no-untyped-def]
    """Return how fast a wheel turns [m/s] whose encoder sits before the play."""
    if play == 0:
        return speed
    state[gap] += speed * STEP
    over = state[gap] - min(max(state[gap], 0.0), play)
    state[gap] -= over
    return over / STEP


@numba.njit(cache=True)
def _gains(state, right, left, base):  # type: ignore[no-untyped-def]
    """Return what share of a wheel's turning moves the body, right and left."""
    gain_right, gain_left = base.gain_right, base.gain_left
    if base.eccentricity != 0:
        gain_right *= 1 + base.eccentricity * np.sin(state[RIM_RIGHT] / base.wheel_radius)
    if base.slip != 0:
        c = np.cos(state[PHI]) * 0.5 * base.base_true
        s = np.sin(state[PHI]) * 0.5 * base.base_true
        reach = base.slip_r**2
        if (state[X] - s - base.slip_x) ** 2 + (state[Y] + c - base.slip_y) ** 2 < reach:
            gain_left *= 1 - base.slip
        if (state[X] + s - base.slip_x) ** 2 + (state[Y] - c - base.slip_y) ** 2 < reach:
            gain_right *= 1 - base.slip
    if base.spin_loss != 0:
        if abs(right) - abs(state[LAST_RIGHT]) > base.spin_above * STEP:
            gain_right *= 1 - base.spin_loss
        if abs(left) - abs(state[LAST_LEFT]) > base.spin_above * STEP:
            gain_left *= 1 - base.spin_loss
        state[LAST_RIGHT], state[LAST_LEFT] = right, left
    return gain_right, gain_left


@numba.njit(cache=True)
def _turn_kept(state, omega, half_difference, base):  # type: ignore[no-untyped-def]
    """Return the turn [rad/s] that floor and caster leave."""
    if base.left_turn_loss != 0 and omega > 0:
        omega *= 1 - base.left_turn_loss
    if base.caster_loss != 0:
        if abs(half_difference) * 2 / base.base_nominal > 0.12:
            sense = 1.0 if half_difference > 0 else -1.0
            if sense != state[SENSE]:
                state[SINCE_CHANGE] = 0.0
            state[SENSE] = sense
        state[SINCE_CHANGE] += STEP
        if state[SINCE_CHANGE] < base.caster_time:
            omega *= 1 - base.caster_loss
    return omega


@numba.njit(cache=True)
def advance(state, first, n, times, commands, n_commands, base, log):  # type: ignore[no-untyped-def]
    """Let the base move n steps from step `first` on, and log each.

    Parameters
    ----------
    state : (N_STATES,), changed in place
    times : (n_commands,) [s] from when on each command acts
    commands : (n_commands, 2) [m/s, rad/s]
    log : (n_steps, N_LOGGED), written from row `first` on
    """
    for i in range(first, first + n):
        t = i * STEP
        k = int(state[COMMAND])
        while k + 1 < n_commands and times[k + 1] <= t + 1e-9:
            k += 1
        state[COMMAND] = k
        v, omega = 0.0, 0.0
        if k >= 0:
            v, omega = commands[k, 0], commands[k, 1]
        target_right, target_left = _wheel_targets(state, v, omega, t, base)
        right, left = _rim_speeds(state, target_right, target_left, base)
        state[RIM_RIGHT] += right * STEP
        state[RIM_LEFT] += left * STEP
        gain_right, gain_left = _gains(state, right, left, base)
        v_right = _through_play(state, PLAY_RIGHT, right, base.play) * gain_right
        v_left = _through_play(state, PLAY_LEFT, left, base.play) * gain_left
        v = 0.5 * (v_right + v_left)
        half_difference = 0.5 * (state[OUT_RIGHT] - state[OUT_LEFT])
        omega = _turn_kept(state, (v_right - v_left) / base.base_true, half_difference, base)
        middle = state[PHI] + 0.5 * STEP * omega
        state[X] += v * np.cos(middle) * STEP
        state[Y] += v * np.sin(middle) * STEP
        if base.side_slide != 0:
            aside = -base.side_slide * v * omega
            state[X] -= aside * np.sin(middle) * STEP
            state[Y] += aside * np.cos(middle) * STEP
        if base.pile != 0:
            carried = base.pile * abs(v)
            state[X] += carried * np.cos(base.pile_direction) * STEP
            state[Y] += carried * np.sin(base.pile_direction) * STEP
        state[PHI] += omega * STEP
        log[i, :V] = state[:V]
        log[i, V], log[i, OMEGA], log[i, SPEED_RIGHT], log[i, SPEED_LEFT] = v, omega, right, left


def start_state(x: float, y: float, phi: float) -> Floats:
    """Return a base at rest that has never had a command."""
    state = np.zeros(N_STATES)
    state[[X, Y, PHI]] = x, y, phi
    state[COMMAND], state[SINCE_CHANGE] = -1, 9.0
    return state
