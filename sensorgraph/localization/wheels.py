"""Scale, turn scale and heading bias of the odometry, identified step by step from what the laser measured.

The model is way = s·way', turn = k·turn' + b·way' of what the odometry says (primed): wheels of other radii or another
base than the driver thinks (Borenstein and Feng 1996). Two regressions are updated recursively with each step.
"""

from __future__ import annotations

import numpy as np

from logs.transforms import wrap
from sensorgraph.localization.result import WheelParameters
from sensorgraph.localization.settings import WHEELS, WheelSettings
from sensorgraph.types import Floats


class WheelEstimate:
    """What is known of the wheels so far."""

    def __init__(self, settings: WheelSettings = WHEELS) -> None:
        self.settings = settings
        self._way_information = settings.way_scale_sd**-2
        self._way_moment = self._way_information
        sds = np.array([settings.turn_scale_sd, settings.heading_bias_sd])
        self._turn_information = np.diag(sds**-2)
        self._turn_moment = np.array([sds[0] ** -2, 0.0])
        self.way_scale, self.turn_scale, self.heading_bias = 1.0, 1.0, 0.0

    def corrected(self, steps: Floats) -> Floats:
        """Return steps (..., 3) [m, m, rad] of the odometry in base_link as the robot moved."""
        return corrected_steps(steps, self.way_scale, self.turn_scale, self.heading_bias)

    def deviations(self, way: float, turn: float) -> Floats:
        """Return the standard deviations (3,) [m, m, rad] of a corrected step ahead, left and in heading."""
        s, turn = self.settings, abs(turn)
        place = s.place_floor + s.place_per_turn * turn
        return np.array(
            [
                place + s.ahead_per_metre * way,
                place + s.left_per_metre * way,
                s.turn_floor + s.turn_per_metre * way + s.turn_per_turn * turn,
            ]
        )

    def learn(self, step: Floats, measured: Floats) -> None:
        """Take in a step (3,) of the odometry and the same step as the laser measured it."""
        way = float(signed_way(step))
        sd = self.deviations(abs(way), float(step[2]))
        off = measured - self.corrected(step)
        if (np.abs([off[0], off[1], wrap(off[2])]) > self.settings.outlier * sd).any():
            return
        weight = sd[0] ** -2
        self._way_information += weight * step[0] ** 2
        self._way_moment += weight * step[0] * measured[0]
        self.way_scale = self._way_moment / self._way_information
        weight = sd[2] ** -2
        row = np.array([step[2], way])
        self._turn_information += weight * np.outer(row, row)
        self._turn_moment += weight * row * measured[2]
        self.turn_scale, self.heading_bias = np.linalg.solve(self._turn_information, self._turn_moment)


def signed_way(steps: Floats) -> Floats:
    """Return how far steps (..., 3) [m, m, rad] in base_link lead [m]; backwards is less than 0."""
    return np.asarray(np.hypot(steps[..., 0], steps[..., 1]) * np.where(steps[..., 0] >= 0, 1.0, -1.0))


def corrected_steps(steps: Floats, way_scale: float, turn_scale: float, heading_bias: float) -> Floats:
    """Return steps (..., 3) [m, m, rad] of the odometry with its scales and its heading bias undone."""
    way = signed_way(steps)
    missed = (turn_scale - 1.0) * steps[..., 2] + heading_bias * way
    cos, sin = np.cos(missed / 2), np.sin(missed / 2)  # half the turn it missed, on the way
    x = way_scale * (cos * steps[..., 0] - sin * steps[..., 1])
    y = way_scale * (sin * steps[..., 0] + cos * steps[..., 1])
    return np.stack([x, y, steps[..., 2] + missed], axis=-1)


def identify_wheels(steps: Floats, measured: Floats, settings: WheelSettings = WHEELS) -> WheelParameters:
    """Fit the parameters to steps (n, 3) of the odometry and the same steps as measured, with standard errors.

    What is believed beforehand counts, so that turns and ways that always come together are told apart by it. Steps
    that deviate by more than `settings.outlier` robust standard deviations are left out: slip.
    """
    way = signed_way(steps)
    s = settings
    ahead, (way_sd,) = _regress(
        steps[:, :1], measured[:, 0], np.array([1.0]), np.array([s.way_scale_sd]), s.outlier
    )
    turns, (turn_sd, bias_sd) = _regress(
        np.column_stack([steps[:, 2], way]),
        wrap(measured[:, 2]),
        np.array([1.0, 0.0]),
        np.array([s.turn_scale_sd, s.heading_bias_sd]),
        s.outlier,
    )
    return WheelParameters(
        way_scale=float(ahead[0]),
        turn_scale=float(turns[0]),
        heading_bias=float(turns[1]),
        way_scale_sd=float(way_sd),
        turn_scale_sd=float(turn_sd),
        heading_bias_sd=float(bias_sd),
    )


def _regress(
    rows: Floats, values: Floats, before: Floats, before_sd: Floats, outlier: float
) -> tuple[Floats, Floats]:
    """Return robust coefficients and their standard errors, starting from what is believed before (k,)."""
    kept = np.isfinite(values) & np.isfinite(rows).all(axis=1)
    theta, covariance = before, np.diag(before_sd**2)
    for _ in range(4):
        off = np.abs(values - rows @ theta)
        scale = 1.4826 * float(np.median(off[kept])) + 1e-12 if kept.any() else 1.0
        kept = off < outlier * scale
        information = rows[kept].T @ rows[kept] / scale**2 + np.diag(before_sd**-2.0)
        moment = rows[kept].T @ values[kept] / scale**2 + before * before_sd**-2.0
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        theta = covariance @ moment
    return theta, np.sqrt(np.diag(covariance))
