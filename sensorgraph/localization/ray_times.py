"""Identify the time of each ray within a scan from the run itself, and test the times that the log states.

On a turning robot a sweep smears the scan, and interlaced sweeps split it into a comb. In short track pieces
with many turns, Gauss-Newton minimises the weighted squares of point-to-line residuals,

    sum_i w_i (r_i(pose, line) + J_i · values)².

The unknowns are the poses, the lines of the surface patches and the four `values` of the ray times. The
result is compared with the known mirrors. The mean of all times is not observable, since the poses absorb it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, ndtr, stdtrit

from logs.motion import Motion
from logs.run import RangeSensor
from sensorgraph.localization.turning_pieces import (
    CLASSES,
    MAX_STEPS,
    MIN_GAIN,
    LinearisedPieces,
    TurningPieces,
    sweep_basis,
)
from sensorgraph.types import Floats

SETTLED = 1.0
"""Squared step, in standard errors, below which the iteration ends."""
MOTION_ERROR = 0.1
"""Relative error of the odometry velocity within a scan, and thus of the times."""
AGREES, MAX_DISTANCE = (float(chdtri(CLASSES, p)) for p in (0.05, 0.001))
"""Squared Mahalanobis distances: up to the first, the times of the log are kept after the first step; up to the second, an
estimate may be that of a laser. 95 % and 99.9 % of chi-squared with the time of each class."""
MIRRORS = {"SICK LMS 2xx": 1 / 75, "SICK PLS": 1 / 25}
"""Laser without ray times in its driver -> [s] mirror period (SICK AG, technical descriptions)."""
SCALES = np.array([0.0, *[min(MIRRORS.values())] * (CLASSES - 1)])
"""(4,) [s] Least values to which the relative error of the motion applies: of the class delays, the shortest mirror period."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RayTimes:
    """Ray times that the run shows, and the estimate that supports them."""

    name: str
    """Reason: the laser, or the relation to the ray times of the log."""
    sensor: RangeSensor
    stated: RangeSensor
    """The sensor as the log describes it."""
    values: Floats
    """(4,) [s] Estimated sweep time, and delays of ray classes 1 to 3 relative to class 0."""
    standard_errors: Floats
    """(4,) [s]"""

    @property
    def line(self) -> str:
        """One line for the user: the ray times, their reason and the estimate."""
        sensor, k = self.sensor, self.sensor.interlaced_sweeps
        direction = " clockwise" if sensor.is_clockwise else ""
        what = f"a scan is one{direction} sweep of {1e3 * abs(sensor.sweep_time):.1f} ms"
        if sensor.sweep_time == 0 and k == 1:
            what = "all rays of a scan have the time of its stamp"
        if k > 1:
            what = (
                f"a scan is {k} interlaced{direction} sweeps of {1e3 * abs(sensor.sweep_time):.1f} ms, "
                f"{1e3 * sensor.sweep_period:+.1f} ms apart"
            )
        sign = 1.0 if self.stated.has_ray_delays else float(np.sign(self.values[0]))
        both = [
            f"{1e3 * v:.1f} ± {1e3 * sd:.1f}"
            for v, sd in zip(
                [sign * self.values[0], *np.abs(self.values[1:])], self.standard_errors, strict=True
            )
        ]
        shown = f"{both[0]} and {both[1]} ms" if k > 1 else f"{both[0]} ms"
        source = (
            f"the log states {1e3 * self.stated.sweep_time:.1f} ms from the first to the last ray"
            if self.stated.has_ray_delays
            else "identified from the run"
        )
        return f"{what}, {self.name}; {source}, the run shows {shown} (`sensor.sweep_time` in robot.yaml overrides it)"


def hypotheses(sensor: RangeSensor) -> list[tuple[str, RangeSensor]]:
    """Return the name of each candidate laser, and the sensor with its ray times."""
    n = sensor.n_rays
    share = min((n / (n - 1) if n > 1 else 1.0) * float(np.ptp(sensor.bearings)) / (2 * np.pi), 1.0)
    plain = replace(sensor, interlaced_sweeps=1, sweep_period=0.0, first_ray_delay=0.0)
    out = []
    for name, turn in (*MIRRORS.items(), ("a laser that turns once per scan", 1.0 / sensor.rate)):
        for direction in (1.0, -1.0):
            sweep = replace(plain, sweep_time=direction * share * turn)
            out.append((f"as in {name}", sweep))
            for k in (2, 4) if name in MIRRORS else ():
                for order in (1.0, -1.0):
                    interlaced = replace(sweep, interlaced_sweeps=k, sweep_period=order * turn)
                    out.append((f"as in {name}", interlaced))
    return out


def _alternatives(sensor: RangeSensor) -> list[tuple[str, RangeSensor]]:
    """Return the candidates if the log states ray times: reversed, none, and the lasers."""
    reverse = replace(sensor, sweep_time=-sensor.sweep_time, sweep_period=-sensor.sweep_period)
    none = replace(sensor, sweep_time=0.0, sweep_period=0.0, interlaced_sweeps=1, first_ray_delay=0.0)
    known = [("opposite to the log", reverse), ("unlike in the log", none)]
    new = [(name, one) for name, one in hypotheses(sensor) if not _is_like(one, reverse)]
    return [*known, *new]


def _is_like(one: RangeSensor, other: RangeSensor) -> bool:
    """Tell whether two sensors have the same ray times, to 5 % of the longest."""
    a, b = _values(one), _values(other)
    return bool(np.abs(a - b).max() <= 0.05 * np.abs(b).max())


def _values(sensor: RangeSensor) -> Floats:
    """Return the sweep time and the class delays (4,) [s] of a sensor."""
    classes = np.arange(1, CLASSES) % sensor.interlaced_sweeps
    return np.array([sensor.sweep_time, *(sensor.sweep_period * classes)])


def identify_ray_times(
    sensor: RangeSensor, pieces: TurningPieces, start: LinearisedPieces, motion: Motion
) -> RayTimes | None:
    """Estimate sweep time and class delays; return the ray times that match them, or None to keep those of the log.

    Parameters
    ----------
    sensor : With the ray times of the log.
    pieces : Of a track with these.
    start : The pieces, linearised at these.
    motion : Motion of base_link, from the odometry or the track.
    """
    if CLASSES % sensor.interlaced_sweeps:
        return None
    values, basis, equations = _values(sensor), sweep_basis(sensor.n_rays), start
    for step in range(MAX_STEPS):
        found = equations.estimate(basis)
        change, covariance = found.change, found.covariance
        values = values + change
        covariance += np.eye(CLASSES) * (values[0] / len(basis)) ** 2  # to the time of a ray
        if step == 0 and _agrees(sensor, values, covariance):
            return None
        if change @ np.linalg.solve(covariance, change) < SETTLED:
            break
        equations = pieces.linearised(basis @ values, motion)
    errors = np.sqrt(np.diag(covariance))
    wide = covariance * small_sample(int(pieces.piece[-1]) + 1)
    return _judge(sensor, values, errors, wide)


def small_sample(n_pieces: int) -> float:
    """Return the factor of a covariance from few pieces: Student's t, not the normal distribution, at the decision."""
    z = np.sqrt(MIN_GAIN)
    return float(stdtrit(n_pieces - 1, ndtr(-z)) / z) ** 2


def _distance(expected: Floats, values: Floats, covariance: Floats) -> float:
    """Return the squared Mahalanobis distance of an estimate (4,) from expected values (4,).

    The motion has a relative error of `MOTION_ERROR`, so that a class delay shorter than this share of a mirror period may be zero.
    """
    own = covariance + np.diag((MOTION_ERROR * np.maximum(np.abs(expected), SCALES)) ** 2)
    off = values - expected
    return float(off @ np.linalg.solve(own, off))


def _agrees(sensor: RangeSensor, values: Floats, covariance: Floats) -> bool:
    """Tell whether the first step confirms the ray times of the log.

    Opposite times smear the surfaces, so that the step is short and its standard errors are wide. A wide estimate
    confirms stated times only if it also excludes that there are none.
    """
    if _distance(_values(sensor), values, covariance) >= AGREES:
        return False
    none = np.zeros(CLASSES)
    return not sensor.has_ray_delays or _distance(none, values, covariance) >= MIN_GAIN


def _judge(sensor: RangeSensor, values: Floats, errors: Floats, covariance: Floats) -> RayTimes | None:
    """Return the candidate that the estimate confirms, if it is the only one; None to keep the ray times of the log.

    Where the log states ray times and no candidate matches, one sweep of the estimated length is used. A sensor without
    stated ray times gets the mean ray time at the stamp, so that the poses do not change. Otherwise the first measured
    ray has the time of the stamp.
    """
    is_stated = sensor.has_ray_delays
    candidates = _alternatives(sensor) if is_stated else hypotheses(sensor)
    judged = sorted(
        ((_distance(_values(one), values, covariance), name, one) for name, one in candidates),
        key=lambda row: row[0],
    )
    (best, name, found), second = judged[0], judged[1]
    as_logged = _distance(_values(sensor), values, covariance)
    is_clear = best <= MAX_DISTANCE and min(as_logged, second[0]) - best >= MIN_GAIN
    if not is_clear:
        one_sweep = np.array([values[0], 0.0, 0.0, 0.0])
        is_one_sweep = _distance(one_sweep, values, covariance) <= MAX_DISTANCE
        if not is_stated or not is_one_sweep or as_logged < MIN_GAIN:
            return None
        plain = replace(sensor, interlaced_sweeps=1, sweep_period=0.0, first_ray_delay=0.0)
        name, found = "unlike in the log", replace(plain, sweep_time=float(values[0]))
    at_stamp = found.ray_delays.min() if is_stated else found.ray_delays.mean()
    found = replace(found, first_ray_delay=found.first_ray_delay - float(at_stamp))
    return RayTimes(name=name, sensor=found, stated=sensor, values=values, standard_errors=errors)
