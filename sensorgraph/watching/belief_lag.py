"""Time by which the pose that the robot believes is late.

A pose that is T old at its stamp is that of the robot T ago. With the tracked pose x(t), the belief b(t) less x(t - T) has an offset
that lasts for a block of some seconds, and noise. Each block has the cost

    C_b(T) = sum_k |r_k(T) - mean r(T)|²,   r_k = (b(t_k) - x(t_k - T)) / tolerance,

on a grid of T. The minimum of C = sum_b C_b is the estimate. Neighbouring beliefs have the same error, blocks do not: the variance
is sum_b C_b'² / C''² (the sandwich of Liang and Zeger 1986). It is at least 2 s² / C'', and T² s² / (C(0) - C(T)), those of errors
with the mean square s² of a belief that last for a second. At a constant velocity, only the noise of the track
changes C, and the age is not known. Derivatives are taken over times that are longer than this noise lasts.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from logs.transforms import wrap
from sensorgraph.types import Floats
from sensorgraph.watching.settings import BELIEF_FAULT, TRACKING

STEP = 0.05
"""[s] Step of the grid."""
WIDE = 8
"""Number of these steps over which derivatives are taken."""
NONE = 2 * WIDE
"""Index of no lag on the grid."""
LAGS = STEP * (np.arange(NONE + 24 + WIDE + 1) - NONE)
"""(n_lags,) [s] The grid; a belief that is later than 1.2 s is not followed."""
LASTS = 1.0
"""[s] Time for which an error of a belief lasts, as of one that is corrected."""
BLOCK = 5.0
"""[s] Duration of a block."""
LONGEST_STEP = 1.0
"""[s] Between tracked poses that are further apart, the pose is not known."""
ROUNDING = 1e-6
"""Mean square of r at least: a thousandth of the tolerances."""
MOST_BLOCKS = 60
"""Number of blocks that are kept: more than two periods of driving have."""


class BeliefLag:
    """Collects the costs of one collection of evidence."""

    def __init__(self) -> None:
        self.age = 0.0
        self._track: deque[tuple[float, float, float, float]] = deque()
        self._waiting: deque[tuple[float, Floats]] = deque()
        self._blocks: deque[Floats] = deque(maxlen=MOST_BLOCKS)
        self._n: deque[int] = deque(maxlen=MOST_BLOCKS)
        self._begin, self._rows = -math.inf, list[Floats]()

    def forget_pose(self) -> None:
        """Begin again, as the motion up to the next tracked pose is not known."""
        self._close()
        self._track.clear()
        self._waiting.clear()

    def add(self, stamp: float, tracked: Floats, believed: Floats | None) -> None:
        """Take the tracked pose (3,) at a stamp [s] and the believed one (3,)."""
        if self._track and not 0.0 < stamp - self._track[-1][0] < LONGEST_STEP:
            self.forget_pose()
        before = self._track[-1][3] if self._track else tracked[2]
        self._track.append((stamp, tracked[0], tracked[1], before + float(wrap(tracked[2] - before))))
        if believed is not None:
            self._waiting.append((stamp, believed))
        while self._waiting and self._waiting[0][0] - LAGS[0] <= stamp:
            self._compare(*self._waiting.popleft())
        while self._track[0][0] < stamp - LAGS[-1] + 2 * LAGS[0] - LONGEST_STEP:
            self._track.popleft()

    def _compare(self, stamp: float, believed: Floats) -> None:
        """Compare a belief with the track at all times of the grid."""
        t, x, y, phi = np.array(self._track).T
        times = stamp - LAGS
        if times[-1] < t[0]:
            return
        off = [np.interp(times, t, of) for of in (x, y, phi)]
        way, turn = TRACKING.tolerance
        row = np.column_stack(
            [(believed[0] - off[0]) / way, (believed[1] - off[1]) / way, wrap(believed[2] - off[2]) / turn]
        )
        if stamp - self._begin > BLOCK:
            self._close()
            self._begin = stamp
        self._rows.append(row)

    def _close(self) -> None:
        """End the block."""
        if len(self._rows) > 2:
            rows = np.array(self._rows)  # (n, n_lags, 3)
            self._blocks.append(((rows - rows.mean(axis=0)) ** 2).sum(axis=(0, 2)))
            self._n.append(3 * (len(rows) - 1))
        self._rows, self._begin = [], -math.inf

    def estimates(self) -> tuple[Floats, Floats]:
        """Return the lag [s] and its standard error, (1,) each."""
        unknown = np.zeros(1), np.full(1, math.inf)
        if len(self._blocks) < 2:
            return unknown
        costs = np.array(self._blocks)
        total = costs.sum(axis=0)
        k = int(np.argmin(total))
        if not WIDE <= k < len(LAGS) - WIDE:
            return unknown
        slopes, curvatures = _derivatives(costs, k)
        curvature = curvatures.sum()
        if curvature <= 0:
            return unknown
        n, rows = len(costs), sum(self._n)
        variance = n / (n - 1) * float((slopes**2).sum()) / curvature**2
        repeats = max(rows / 3 / n / BLOCK * LASTS, 1.0)  # of one error
        square = repeats * (float(total[k]) / rows + ROUNDING)
        least = 2.0 * square / curvature
        if k != NONE:
            least = max(least, LAGS[k] ** 2 * square / max(float(total[NONE] - total[k]), 1e-12))
        return np.array([LAGS[k]]), np.array([math.sqrt(max(variance, least) + STEP**2 / 12)])

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the standard error with the tolerance of the fault, which is known (Welch 1947).

        Those of the standard error alone are the number of blocks in which the robot changes its motion, less one.
        """
        costs = np.array(self._blocks)
        if len(costs) < 2:
            return 1.0
        k = int(np.clip(np.argmin(costs.sum(axis=0)), WIDE, len(LAGS) - WIDE - 1))
        curvatures = np.maximum(_derivatives(costs, k)[1], 0.0)
        own = max(float(curvatures.sum() ** 2 / max((curvatures**2).sum(), 1e-12)) - 1.0, 1.0)
        error = float(self.estimates()[1][0])
        return own if math.isinf(error) else own * (1.0 + (BELIEF_FAULT.tolerance / error) ** 2) ** 2


def _derivatives(costs: Floats, k: int) -> tuple[Floats, Floats]:
    """Return the first and second derivatives (n,) of costs (n, n_lags) at the k-th lag."""
    before, here, after, width = costs[:, k - WIDE], costs[:, k], costs[:, k + WIDE], WIDE * STEP
    return (after - before) / (2 * width), (after - 2 * here + before) / width**2
