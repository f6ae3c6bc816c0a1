"""Size of unmodelled structure: the error of a simulation without it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

RECKONING_TIME = 60.0
"""[s] duration of dead reckoning, after which the error of a simulation is evaluated."""
MIN_DRIFT = 0.002
"""Position error after a minute of dead reckoning, above which it matters to a user, as a share of the distance at top speed:
5 cm for a robot at 0.4 m/s."""
MIN_SPEED_ERROR = 0.0125
"""Speed error of the wheels, above which it matters to a user, as a share of the top speed: 5 mm/s for a robot at 0.4 m/s."""


@dataclass(frozen=True, kw_only=True)
class SimulationError:
    """Error of a simulation of the run."""

    drift: float
    """[m] RMS error of the position after a minute of dead reckoning."""
    speed: float
    """[m/s] RMS error of the wheels' speed."""

    def to_dict(self) -> dict[str, float]:
        """Return plain data for the report."""
        return {"drift_m_per_minute": self.drift, "speed_m_s": self.speed}

    def sentence(self) -> str:
        """Return the error in words."""
        return f"a simulation without it is off by {self.drift:.2g} m after a minute and by {100 * self.speed:.2g} cm/s"

    def is_material(self, robot: Robot, evidence: float) -> bool:
        """Tell whether the error certainly matters to a user, given the evidence [nats] that it is not zero."""
        top_speed, sure = robot.limits.v, sure_share(evidence)
        way = top_speed * RECKONING_TIME
        return sure * self.drift > MIN_DRIFT * way or sure * self.speed > MIN_SPEED_ERROR * top_speed


@dataclass(frozen=True, kw_only=True)
class ReferenceError:
    """Error of the reference poses, if these are distorted."""

    place: float
    """[m] RMS error of the position along the path."""
    yaw: float
    """[rad] RMS error of the heading."""

    def to_dict(self) -> dict[str, float]:
        """Return plain data for the report."""
        return {"reference_m": self.place, "reference_rad": self.yaw}

    def sentence(self) -> str:
        """Return the error in words."""
        return f"the reference is off by {100 * self.place:.2g} cm and {np.degrees(self.yaw):.2g} degrees"

    def is_material(self, robot: Robot, evidence: float) -> bool:
        """Tell whether the error certainly exceeds the tolerance of the reference, given the evidence [nats] of it."""
        share, limits = sure_share(evidence) / SCAN.nuisance.max_tolerances, robot.tolerances
        return share * self.place > limits.pose_xy or share * self.yaw > limits.pose_yaw


def sure_share(evidence: float) -> float:
    """Return the share of a size that remains two standard errors below it.

        share = max(1 - 2 / z, 0),   z = sqrt(2 evidence)

    Parameters
    ----------
    evidence : [nats] That the size is not zero.
    """
    return max(1.0 - 2.0 / float(np.sqrt(2.0 * max(evidence, 1e-9))), 0.0)


def reference_error(turn: Floats, missing: Floats) -> ReferenceError:
    """Return the error of a reference whose steps differ from those of the wheels.

    Parameters
    ----------
    turn : (n,) [rad] Of the robot, in consecutive steps.
    missing : (2 n,) [m, then rad] Part of each step that the wheels did not make.
    """
    n = len(turn)
    place = np.cumsum(missing[:n] * np.exp(1j * np.cumsum(turn)))
    return ReferenceError(place=float(np.std(place)), yaw=float(np.std(np.cumsum(missing[n:]))))


def simulation_error(
    distance: Floats, turn: Floats, missing: Floats, dt: Floats, base: float, aside: Floats | None = None
) -> SimulationError:
    """Return the error of dead reckoning that lacks a part of the motion.

    Parameters
    ----------
    distance, turn : (n,) [m, rad] Of the robot, in consecutive steps.
    missing : (2 n,) [m, then rad] Part of each step that the simulation lacks.
    dt : (n,) [s] Duration of each step.
    base : [m] Wheelbase.
    aside : (n,) [m] Part of each step to the left that the simulation also lacks.
    """
    n = len(distance)
    away, yaw = missing[:n] + 1j * (np.zeros(n) if aside is None else aside), missing[n:]
    step = float(np.median(dt))
    heading, error = np.cumsum(turn), np.cumsum(yaw)
    true = np.cumsum(distance * np.exp(1j * heading))
    off = np.cumsum((distance + away) * np.exp(1j * (heading + error)))
    k = max(min(round(RECKONING_TIME / step), n - 1), 1)
    starts = np.arange(0, n - k, max(k // 6, 1))
    # from a common pose: undo the heading error from before the start
    ahead = (off[starts + k] - off[starts]) * np.exp(-1j * error[starts]) - (true[starts + k] - true[starts])
    drift = float(np.sqrt(np.mean(np.abs(ahead) ** 2))) if len(starts) else 0.0
    wheel = np.abs(away / dt) ** 2 + (base / 2 * yaw / dt) ** 2
    return SimulationError(drift=drift * RECKONING_TIME / (k * step), speed=float(np.sqrt(np.mean(wheel))))
