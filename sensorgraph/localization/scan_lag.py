"""Estimate by how much scan stamps and odometry stamps differ, from turns that both measure.

With the turns of laser and odometry between neighbouring scans, Δφ_k and Δφ'_k, and the odometry's turn rate ω'_k, the
model is

    Δφ_k = a Δφ'_k + a d (ω'_{k+1} - ω'_k) + e_k.

The lag d [s] is the time by which the scans must be shifted to match the odometry: positive if a scan was taken later
than its stamp. Two clocks that drift apart have a lag d + b τ at the share τ of the log, from -1/2 to 1/2. The standard errors
are cluster-robust over segments of the log (Liang and Zeger 1986).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import wrap
from sensorgraph.localization.missing_odometry import is_measured
from sensorgraph.localization.scan_track import ScanTrack
from sensorgraph.localization.settings import CAUCHY, N_REWEIGHTED, SIGNIFICANT
from sensorgraph.localization.wheels import STRETCHES
from sensorgraph.robust import robust_sigma
from sensorgraph.types import Floats, Ints

LONGEST_STEP = 3.0
"""Maximum step between two scans, in median steps."""
MIN_STEPS = 50
"""Minimum number of steps between scans."""
MIN_CHANGE = 0.01
"""[rad/s] Minimum root mean square change of the turn rate between two scans."""
MIN_SLOPE = 0.3
"""Minimum ratio of the turns of laser and odometry."""
MIN_LAG = 0.01
"""[s] Minimum lag that is reported."""
RELATIVE_ERROR = 0.2
"""Relative error of a lag that still agrees with the duration of a scan."""
LATENCY = 0.05
"""[s] Latency of odometry, at most: the period of slow wheel controllers, over which its turn rate is computed."""
N_STEPS = 4
"""Number of linear steps; each leaves a small share of the lag."""


@dataclass(frozen=True, kw_only=True)
class ScanLag:
    """Offset of the scan stamps."""

    value: float
    """[s] A scan was taken this much later than its stamp, by the clock of the odometry."""
    stderr: float
    """[s]"""
    drift: float = 0.0
    """[s] Change from the begin to the end of the log; 0: not significant."""
    drift_stderr: float = 0.0
    """[s]"""


def scan_lag(run: Run, motion: Motion, tracked: ScanTrack) -> ScanLag | None:
    """Return the lag of the scans relative to the odometry; None if the robot did not turn enough while it was measured.

    Parameters
    ----------
    motion : The odometry, without the stretches that the scans fill: these have no lag relative to the scans.
    tracked : Track of the scans.
    """
    found = _linear_lag(run.stamps, motion, tracked)
    for _ in range(N_STEPS):  # the model is linear in the lag, which a long lag is not
        if found is None or abs(found.value) < MIN_LAG:
            break
        more = _linear_lag(run.stamps + found.value, motion, tracked)
        if more is None:
            break
        is_close = abs(more.value) < MIN_LAG
        found = replace(more, value=found.value + more.value)
        if is_close:
            break
    return found


def _linear_lag(stamps: Floats, motion: Motion, tracked: ScanTrack) -> ScanLag | None:
    """Return the lag of scans at stamps (n,) [s] by the model that is linear in it; None if the drive does not show it."""
    step = np.diff(stamps)
    usable = tracked.matched & is_measured(motion, stamps)
    both = usable[1:] & usable[:-1] & tracked.is_continuous[1:] & (step > 0)
    for jump in tracked.jumps:
        both[max(jump - 1, 0)] = False
    seen = wrap(np.diff(tracked.poses[:, 2]))
    odometry, rate = motion.at(stamps)[:, 2], _turn_rate(motion, stamps, LATENCY)
    driven, change = np.diff(odometry), np.diff(rate)
    both &= step < LONGEST_STEP * np.median(step[step > 0]) if (step > 0).any() else False
    share = np.linspace(-0.5, 0.5, len(step))
    x, y = np.column_stack([driven, change, change * share])[both], seen[both]
    segment = (np.flatnonzero(both) * STRETCHES) // max(len(step), 1)
    if len(y) < MIN_STEPS or (change[both] ** 2).sum() < MIN_CHANGE**2 * len(y):
        return None
    drifting, covariance = _robust_fit(x, y, segment)
    drift, stderr = drifting[2] / drifting[0], np.sqrt(covariance[2, 2]) / drifting[0]
    is_drifting = drifting[0] > MIN_SLOPE and abs(drift) > max(SIGNIFICANT * stderr, MIN_LAG)
    beta, covariance = (drifting, covariance) if is_drifting else _robust_fit(x[:, :2], y, segment)
    if not beta[0] > MIN_SLOPE:
        return None
    lag = ScanLag(value=float(beta[1] / beta[0]), stderr=float(np.sqrt(covariance[1, 1]) / beta[0]))
    return replace(lag, drift=float(drift), drift_stderr=float(stderr)) if is_drifting else lag


def _robust_fit(x: Floats, y: Floats, segment: Ints) -> tuple[Floats, Floats]:
    """Return the coefficients (k,) of y (n,) in x (n, k), robust to outliers, and their covariance (k, k) by segments (n,)."""
    k = x.shape[1]
    weight = np.ones(len(y))
    inverse: Floats = np.eye(k)
    beta: Floats = np.zeros(k)
    for _ in range(N_REWEIGHTED):
        inverse = np.asarray(np.linalg.inv(x.T @ (x * weight[:, None]) + 1e-12 * np.eye(k)))
        beta = inverse @ (x.T @ (weight * y))
        left = y - x @ beta
        scale = robust_sigma(left) + 1e-9
        weight = 1.0 / (1.0 + (left / (CAUCHY * scale)) ** 2)
    scores = np.stack(
        [(x[segment == i] * (weight * left)[segment == i, None]).sum(axis=0) for i in range(STRETCHES)]
    )
    return beta, np.asarray(inverse @ (scores.T @ scores * STRETCHES / (STRETCHES - 1)) @ inverse)


def _turn_rate(motion: Motion, stamps: Floats, interval: float) -> Floats:
    """Return the turn rate (n,) [rad/s] of a motion at times (n,)."""
    ahead, behind = motion.at(stamps + interval / 2), motion.at(stamps - interval / 2)
    return np.asarray((ahead[:, 2] - behind[:, 2]) / interval)


def with_stamp_of(run: Run, lag: ScanLag) -> tuple[Run, tuple[str, ...]]:
    """Return the run with its stamps at the begin, middle or end of the sweep as the odometry shows, and a note on a lag.

    Drivers stamp a scan at any of the three, and the odometry has its own latency. So the nearest one counts if the
    lag agrees with it, or if the remainder is a likely latency and less than half as far from it as from the next. Any
    other lag is reported only, since it may be in either clock; so is that of clocks that drift apart.
    """
    sensor, delays = run.sensor, run.sensor.ray_delays
    text = f"{1e3 * lag.value:+.0f} ± {1e3 * lag.stderr:.1f} ms"
    if lag.drift:
        text += f", drifting by {1e3 * lag.drift:+.0f} ± {1e3 * lag.drift_stderr:.1f} ms over the log"
    elif abs(lag.value) < max(SIGNIFICANT * lag.stderr, MIN_LAG):
        return run, ()
    elif sensor.scan_duration > MIN_LAG:
        first, last = float(delays.min()), float(delays.max())
        shifts = {"begin": -first, "middle": -float(delays.mean()), "end": -last}
        where, second, _ = sorted(shifts, key=lambda name: abs(shifts[name] - lag.value))
        rest = abs(lag.value - shifts[where])
        is_latency = rest < min(LATENCY, 0.5 * abs(lag.value - shifts[second]))
        is_equal = rest < max(SIGNIFICANT * lag.stderr, RELATIVE_ERROR * (last - first))
        if is_equal or (is_latency and shifts[where] != 0.0):
            shifted = replace(sensor, first_ray_delay=sensor.first_ray_delay + shifts[where])
            return replace(run, sensor=shifted), (
                f"scans are stamped at the {where} of the sweep of {1e3 * sensor.scan_duration:.0f} ms: the odometry shows "
                f"a lag of {text}",
            )
    taken = (
        ""
        if abs(lag.value) < MIN_LAG
        else f" (by the odometry's clock, taken {'before' if lag.value < 0 else 'after'} these)"
    )
    return run, (
        f"lag of the scans relative to the odometry: {text}; poses are given at the stamps of the scans{taken}",
    )
