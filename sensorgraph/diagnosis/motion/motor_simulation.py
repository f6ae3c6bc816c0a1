"""Simulated motors: dead time, first-order lag, limited acceleration and maximum speed.

    held_k  = clip(command at (k STEP - delay), -v_max, v_max)
    speed_k = speed_(k-1) + clip((1 - keep) (held_k - speed_(k-1)), -slew STEP, slew STEP)
    keep    = exp(-STEP / tau)

v_max limits the translation only. `AccelerationLimit` selects where slew acts.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from enum import Enum

import numpy as np

from planners.kernel import kernel
from sensorgraph.diagnosis.motion.increments import SAME_STAMP, CommandSignal, DriveRows
from sensorgraph.types import Floats, Ints

STEP = 0.01
"""[s] step of the simulated motors."""
MAX_KNOWN = 6
"""Number of simulated drives that are cached. A fit needs each of them three times in a row; two hours take
12 MB at a step of 10 ms."""
SLEW_MARGIN = 1.02
"""Acceleration of the plain lag above which the limit is simulated, as a multiple of the robot's."""


class AccelerationLimit(Enum):
    """Where a base enforces the acceleration limits of robot.yaml."""

    MOTORS = "motors"
    """The change of speed is limited: the lag is clipped."""
    SET_POINT = "set point"
    """The base ramps the commands, and the motors follow with their lag."""
    NOWHERE = "nowhere"
    """Nowhere: the commands respect the limits."""


@dataclass(frozen=True, kw_only=True)
class MotorParameters:
    """Parameters of the simulated motors."""

    tau: float
    """[s] time constant."""
    delay: float
    """[s] dead time."""
    v_max: float = float("inf")
    """[m/s]"""
    second: float = 0.0
    """[s] time constant of a second lag in series."""


class MotorSimulation:
    """Response of the motors to the commands of one run."""

    def __init__(self, commands: CommandSignal, rows: DriveRows, slew: Floats) -> None:
        """Simulate from a second before the first command to a second after the last.

        Parameters
        ----------
        slew : (2,) [m/s², rad/s²] limits of the robot
        """
        self.commands, self.rows, self.slew = commands, rows, slew
        stamps = commands.stamps
        begin = stamps[0] - 1.0
        n_steps = int((min(stamps[-1] + 1.0, rows.end[-1] + 0.1) - begin) / STEP) + 2
        self.grid = begin + STEP * np.arange(n_steps)
        self.limit = AccelerationLimit.MOTORS
        self._known: dict[tuple[MotorParameters, AccelerationLimit], Floats] = {}
        self._latest_steps: tuple[float, tuple[Ints, Floats]] | None = None

    def rates(self, motors: MotorParameters, *, later: float = 0.0) -> Floats:
        """Return mean rates (2 n,) of the motors in each row, `later` [s] after the commands; 0 where not valid."""
        key = (motors, self.limit)
        travelled = self._known.pop(key, None)
        if travelled is None:
            travelled = self._travelled(motors, self._held(motors.delay, self.commands.values))
        self._known[key] = travelled  # most recently used last
        if len(self._known) > MAX_KNOWN:
            del self._known[next(iter(self._known))]
        return self._mean_rates(travelled, later)

    def rates_of(
        self,
        motors: MotorParameters,
        commands: Floats | None = None,
        *,
        limit: AccelerationLimit | None = None,
        share: float = 1.0,
    ) -> Floats:
        """Return the rates for other commands (n_commands, 2) at the same stamps, or for other limits.

        Parameters
        ----------
        limit : Where the acceleration is limited; default: as in this simulation.
        share : Of the acceleration limits of the robot.
        """
        other = copy(self)
        other.limit, other.slew = limit or self.limit, share * self.slew
        held = self._held(motors.delay, self.commands.values if commands is None else commands)
        return self._mean_rates(other._travelled(motors, held), 0.0)

    def _mean_rates(self, travelled: Floats, later: float) -> Floats:
        start, end = self.rows.start - later, self.rows.end - later
        ends = self.grid + STEP
        out = np.stack([np.interp(end, ends, c) - np.interp(start, ends, c) for c in travelled.T], axis=1)
        return self.rows.masked((out / (end - start)[:, None]).T.ravel())

    def _held(self, delay: float, commands: Floats) -> Floats:
        """Return the commands that hold in each step (n_steps, 2), `delay` [s] after they were given."""
        number, share = self._steps(delay)
        given = np.concatenate([np.zeros((2, 2)), commands])  # nothing is commanded before the first
        held, back = given[1:].take(number, axis=0), (given[:-1] - given[1:]).take(number, axis=0)
        return np.asarray(held + share[:, None] * back)

    def _steps(self, delay: float) -> tuple[Ints, Floats]:
        """Return how many commands hold or held in each step (n_steps,), and the share of the step before the last one.

        The step in which a held command changes is shared between old and new.
        """
        if self._latest_steps is None or self._latest_steps[0] != delay:
            stamps = self.commands.stamps
            number = np.searchsorted(stamps, self.grid + STEP - delay, side="right")
            when = stamps[np.maximum(number - 1, 0)] + delay
            share = np.clip((when - self.grid) / STEP, 0.0, 1.0)
            self._latest_steps = (delay, (number, share))
        return self._latest_steps[1]

    def _travelled(self, motors: MotorParameters, held: Floats) -> Floats:
        """Return the accumulated distance and turn of the motors at the end of each step (n_steps, 2).

        Parameters
        ----------
        held : (n_steps, 2) Commands that hold in each step.
        """
        held = np.column_stack([np.clip(held[:, 0], -motors.v_max, motors.v_max), held[:, 1]])
        keep = float(np.exp(-STEP / motors.tau)) if motors.tau > SAME_STAMP else 0.0
        if self.limit is AccelerationLimit.SET_POINT:
            held = np.stack(
                [
                    _with_limited_change(c.copy(), 0.0, a * STEP)
                    for c, a in zip(held.T, self.slew, strict=True)
                ],
                axis=1,
            )
        speed = _lagged((1 - keep) * held, keep)
        if self.limit is AccelerationLimit.MOTORS:
            for i, most in enumerate(self.slew):
                if np.abs(np.diff(speed[:, i])).max(initial=0.0) > SLEW_MARGIN * most * STEP:
                    speed[:, i] = _with_limited_change(held[:, i].copy(), keep, most * STEP)
        if motors.second > SAME_STAMP:
            again = float(np.exp(-STEP / motors.second))
            speed = _lagged((1 - again) * speed, again)
        # speed[k] is reached at the end of step k
        sums = np.cumsum(np.concatenate([np.zeros((1, 2)), speed[:-1] + speed[1:]]), axis=0)
        return np.asarray(sums * STEP / 2)


@kernel
def _lagged(inputs: Floats, keep: float) -> Floats:
    """Return x (n, 2) with x[k] = keep x[k - 1] + inputs[k], starting from 0."""
    out = inputs.copy()
    for k in range(1, len(out)):
        for i in range(2):
            out[k, i] += keep * out[k - 1, i]
    return out


@kernel
def _with_limited_change(held: Floats, keep: float, most: float) -> Floats:
    """Return speeds v (n,) of a first-order motor with limited change per step.

        v[k] = v[k - 1] + clip((held[k] - v[k - 1]) (1 - keep), -most, most)

    The motor starts at rest.
    """
    out = np.empty_like(held)
    v = 0.0
    for k in range(len(held)):
        change = (held[k] - v) * (1 - keep)
        v += min(max(change, -most), most)
        out[k] = v
    return out
