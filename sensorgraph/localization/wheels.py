"""Identify distance scale s, turn scale k and heading bias b of the odometry from motion measured by the laser.

The model of a step is

    way = s · way',  turn = k · turn' + b · way'.

Unprimed quantities are the true motion, primed ones the odometry's. The model covers wrong wheel radii and a
wrong wheelbase (Borenstein and Feng 1996). `WheelEstimate` updates two least-squares regressions recursively;
`identify_wheels` fits all steps.
"""

from __future__ import annotations

import numpy as np

from logs.transforms import wrap
from sensorgraph.localization.result import WheelParameters
from sensorgraph.localization.settings import SIGNIFICANT, WHEELS
from sensorgraph.robust import robust_sigma
from sensorgraph.types import Bools, Floats

MIN_SCATTER = 0.05
"""Lower bound of the estimated wheel noise, relative to the standard deviations of `WHEELS` ..."""
MAX_SCATTER = 3.0
"""... and upper bound."""
STRETCHES = 12
"""Number of segments of a log with independent slip; their differences give the standard errors."""


class WheelEstimate:
    """Recursive estimate of the wheel parameters."""

    def __init__(self) -> None:
        self._way_information = WHEELS.scale_sd**-2
        self._way_moment = self._way_information
        sds = np.array([WHEELS.scale_sd, WHEELS.heading_bias_sd])
        self._turn_information = np.diag(sds**-2)
        self._turn_moment = np.array([sds[0] ** -2, 0.0])
        self.way_scale, self.turn_scale, self.heading_bias = 1.0, 1.0, 0.0

    @property
    def parameters(self) -> WheelParameters:
        """The estimate, without standard errors."""
        return WheelParameters(
            way_scale=self.way_scale, turn_scale=self.turn_scale, heading_bias=self.heading_bias
        )

    def corrected(self, steps: Floats) -> Floats:
        """Return odometry steps (..., 3) [m, m, rad] in base_link, corrected by the estimate."""
        return corrected_steps(steps, self.way_scale, self.turn_scale, self.heading_bias)

    def deviations(self, way: Floats | float, turn: Floats | float) -> Floats:
        """Return the standard deviations (..., 3) [m, m, rad] of corrected steps (...): ahead, left, heading."""
        s, turn = WHEELS, np.abs(turn)
        place = s.place_floor + s.place_per_turn * turn
        return np.stack(
            [
                place + s.ahead_per_metre * way,
                place + s.left_per_metre * way,
                s.turn_floor + s.turn_per_metre * way + s.turn_per_turn * turn,
            ],
            axis=-1,
        )

    def learn(self, step: Floats, measured: Floats) -> None:
        """Update the estimate with a step (3,) of the odometry and the same step measured by the laser."""
        way = float(signed_distance(step))
        sd = self.deviations(abs(way), float(step[2]))
        off = measured - self.corrected(step)
        if slip_of(off, sd).any():
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


def slip_of(off: Floats, deviations: Floats) -> Floats:
    """Return the size (3,) [m, m, rad] of an error of the odometry; zeros if all of it may be noise.

    Parameters
    ----------
    off : (3,) [m, m, rad] From the predicted pose to the measured one.
    deviations : (3,) Standard deviations of the prediction.
    """
    size = np.abs([off[0], off[1], wrap(off[2])])
    return np.asarray(size if (size > SIGNIFICANT * deviations).any() else np.zeros(3))


def is_standing(steps: Floats) -> Bools:
    """Tell which steps (n, 3) of the odometry are those of wheels that stand, within the noise of a step of any length."""
    is_turned = np.abs(wrap(steps[:, 2])) > WHEELS.turn_floor
    return np.asarray((np.abs(signed_distance(steps)) < WHEELS.place_floor) & ~is_turned)


def signed_distance(steps: Floats) -> Floats:
    """Return the length [m] of steps (..., 3) [m, m, rad] in base_link; negative when reversing."""
    return np.asarray(np.hypot(steps[..., 0], steps[..., 1]) * np.where(steps[..., 0] >= 0, 1.0, -1.0))


def corrected_steps(steps: Floats, way_scale: float, turn_scale: float, heading_bias: float) -> Floats:
    """Return odometry steps (..., 3) [m, m, rad] corrected for scales and heading bias."""
    way = signed_distance(steps)
    missed = (turn_scale - 1.0) * steps[..., 2] + heading_bias * way
    cos, sin = np.cos(missed / 2), np.sin(missed / 2)  # the missed turn acts half-way through the step
    x = way_scale * (cos * steps[..., 0] - sin * steps[..., 1])
    y = way_scale * (sin * steps[..., 0] + cos * steps[..., 1])
    return np.stack([x, y, steps[..., 2] + missed], axis=-1)


def identify_wheels(steps: Floats, measured: Floats, *, is_seen: Bools | None = None) -> WheelParameters:
    """Fit the wheel parameters to steps (n, 3) of the odometry and the same steps by the laser, with standard errors.

    Two regressions, with priors on their coefficients, minimise the robustly weighted squares of

        way' - share · way,  turn' - (a · turn + c · way).

    The parameters are s = 1 / share, k = 1 / a and b = -c s / a. The odometry's steps are regressed on the
    measured ones because the noise is in the wheels. The reverse regression would bias every scale towards
    zero by slip (errors in variables, Fuller 1987).

    The priors separate turns and distances that always occur together. Steps beyond `SIGNIFICANT` robust
    standard deviations are excluded as slip, and so are those of wheels that stand while the robot is carried: they
    say nothing about scales. Slip depends on the floor, so that the standard errors are cluster-robust over
    `STRETCHES` segments of the log (Liang and Zeger 1986).

    Parameters
    ----------
    is_seen : (n, 2) The laser determines distance and turn of a step; None: of all.
    """
    by_way, by_turn = np.ones((2, len(steps)), dtype=np.bool_) if is_seen is None else is_seen.T
    way, turn = signed_distance(measured), wrap(measured[:, 2])
    sd = WheelEstimate().deviations(np.abs(way), turn)
    turned = ~is_standing(steps)
    by_way, by_turn = by_way & turned, by_turn & turned
    (share,), ((share_variance,),) = _regress(
        (measured[:, :1] / sd[:, :1])[by_way],
        (steps[:, 0] / sd[:, 0])[by_way],
        np.array([1.0]),
        np.array([WHEELS.scale_sd]),
    )
    scale = 1.0 / float(share)
    (a, c), covariance = _regress(
        (np.column_stack([turn, way]) / sd[:, 2:])[by_turn],
        (wrap(steps[:, 2]) / sd[:, 2])[by_turn],
        np.array([1.0, 0.0]),
        np.array([WHEELS.scale_sd, WHEELS.heading_bias_sd]),
    )  # of turn' = a turn + c way = (turn - b way') / k
    by_bias = np.array([c * scale / a**2, -scale / a])
    return WheelParameters(
        way_scale=scale,
        turn_scale=float(1.0 / a),
        heading_bias=float(-c * scale / a),
        way_scale_sd=float(np.sqrt(share_variance) * scale**2),
        turn_scale_sd=float(np.sqrt(covariance[0, 0]) / a**2),
        heading_bias_sd=float(np.sqrt(by_bias @ covariance @ by_bias)),
    )


def _regress(rows: Floats, values: Floats, before: Floats, before_sd: Floats) -> tuple[Floats, Floats]:
    """Return robust coefficients (k,) and their covariance (k, k), given their prior mean and deviation (k,).

    The scatter starts from a fit of least absolute deviations without prior. Around a prior that is far off,
    the scatter would be so large that the prior prevails.
    """
    kept = np.isfinite(values) & np.isfinite(rows).all(axis=1)
    prior = np.diag(before_sd**-2.0)
    theta, information = _least_deviations(rows[kept], values[kept], before), prior
    least = MIN_SCATTER if kept.sum() >= STRETCHES else 1.0  # few steps may agree by chance
    scale = 1.0
    for _ in range(4):
        off = np.abs(values - rows @ theta)
        scale = max(robust_sigma(off[kept]), least) if kept.any() else 1.0
        kept = off < SIGNIFICANT * scale
        information = rows[kept].T @ rows[kept] / scale**2 + prior
        moment = rows[kept].T @ values[kept] / scale**2 + prior @ before
        theta = np.asarray(np.linalg.solve(information, moment), dtype=np.float64)
    inverse = np.linalg.inv(information)
    stretch = np.arange(len(values)) * STRETCHES // max(len(values), 1)
    scores = rows * ((values - rows @ theta) * kept / scale**2)[:, None]
    sums = np.column_stack([np.bincount(stretch, column, STRETCHES) for column in scores.T])
    n = len(np.unique(stretch[kept]))
    meat = sums.T @ sums * (n / (n - 1)) if n > 1 else information - prior
    return theta, np.asarray(inverse @ (meat + prior) @ inverse, dtype=np.float64)


def _least_deviations(rows: Floats, values: Floats, before: Floats) -> Floats:
    """Return the coefficients (k,) of least absolute deviations; unobservable ones keep their prior.

    Iteratively reweighted least squares minimises sum_i |values_i - rows_i · theta|.
    """
    theta = before
    for _ in range(20):
        off = values - rows @ theta
        root = 1.0 / np.sqrt(np.maximum(np.abs(off), 1e-3))
        theta = theta + np.linalg.lstsq(rows * root[:, None], off * root, rcond=1e-6)[0]
    return np.asarray(theta, dtype=np.float64)
