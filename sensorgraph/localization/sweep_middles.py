"""Poses at the stamps of slow sweeps, between the middles of two sweeps.

A pose is that at the stamp, the time of the first ray. The scan determines the pose in the middle of its sweep, and the odometry
leads from there to the stamp. It errs, by wrong wheels, coarse encoders and stamps that scatter: in 50 ms of a turn at 1 rad/s,
3 ms are 0.17°. But the stamp lies between the middles of two sweeps. Let h' and h [s] be its distances from them, a the pose by the
other middle and b that by its own. The pose of least variance is then

    b + w (a - b),  w = h / (h + h').

The difference r = a - b is the error of the odometry from middle to middle. With random steps, of variance q per second, and
with errors of variance s of each of its poses,

    var r = q (h + h') + 2 s,  cov(r_k, r_k+1) = -s,

and the pose has the variance

    q h h' / (h + h') + s (1 + w² + (1 - w)²).

The variance of r is that of five scans around and, with the same weight, one that all scans give for the same motion: its part
that grows with the squares of way and turn is that of wheels and stamps. All scans give the share of s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import convolve1d
from scipy.optimize import nnls

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.scan_track import turn_matrices
from sensorgraph.localization.settings import SIGNIFICANT
from sensorgraph.types import Bools, Floats

AROUND = 2
"""[scans] on either side of a scan that give the variance of the odometry there."""
ROUNDS = 4
"""Number of reweighted fits of the variance by the motion."""
LEAST = 0.01
"""Variance of a motion at least, relative to the mean one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepMiddles:
    """Motion, by the odometry that deskewed the scans, between stamps and middles of sweeps."""

    to_own: Floats
    """(n_scans, 3) [m, m, rad] From the stamp of a scan to the middle of its sweep, in base_link."""
    from_other: Floats
    """(n_scans, 3) [m, m, rad] From the middle of the sweep at the other side of the stamp to the stamp."""
    other: int
    """The scan of this sweep is the one before, -1, or the one after, 1."""
    share: Floats
    """(n_scans,) w, the share of the other middle; 0: the stamp is not between two middles."""
    is_deskewed: Bools
    """(n_scans,) This odometry deskewed the scan."""

    @staticmethod
    def of(run: Run, motion: Motion) -> SweepMiddles | None:
        """Return the middles of the sweeps of a run; None if its rays have the time of their scan."""
        half = float(run.sensor.ray_delays.mean())
        n, t = run.n_scans, run.stamps
        if half == 0.0 or n < 2:
            return None
        other = -1 if half > 0 else 1
        middles = motion.at(t + half)
        there = np.clip(np.arange(n) + other, 0, n - 1)
        apart = -other * (t - (t + half)[there])
        apart[there == np.arange(n)] = 0.0
        share = np.where(apart > 0, abs(half) / (abs(half) + np.maximum(apart, 1e-9)), 0.0)
        stamps = motion.at(t)
        return SweepMiddles(
            to_own=compose(invert(stamps), middles),
            from_other=compose(invert(middles[there]), stamps),
            other=other,
            share=share,
            is_deskewed=np.ones(n, dtype=np.bool_),
        )

    def without(self, scans: Bools) -> SweepMiddles:
        """Return the middles for scans of which some (n_scans,) were deskewed by another motion."""
        return replace(self, is_deskewed=self.is_deskewed & ~scans)

    def placed(self, poses: Floats, covariances: Floats, follows: Bools) -> tuple[Floats, Floats]:
        """Return poses (n_scans, 3) and covariances (n_scans, 3, 3) of x, y, phi in map between the middles of two sweeps.

        Parameters
        ----------
        poses, covariances : By the own middle of each scan, without the errors of the odometry during a sweep.
        follows : (n_scans,) A scan and the one before both determine their poses.
        """
        n, w = len(poses), self.share[:, None]
        there = np.clip(np.arange(n) + self.other, 0, n - 1)
        pair = follows if self.other < 0 else np.append(follows[1:], False)
        is_between = pair & (self.share > 0) & self.is_deskewed & self.is_deskewed[there]
        if not is_between.any():
            return poses, covariances
        by_other = compose(compose(poses, self.to_own)[there], self.from_other)
        r = compose(invert(poses), by_other)
        r[:, 2] = wrap(r[:, 2])
        r[~is_between] = 0.0
        moved = compose(poses, w * r)
        variance, white = _errors(r, self.to_own, is_between)
        steps, white = (1.0 - 2.0 * white) * variance, white * variance
        alone = np.median(w[is_between])  # the share of the way that its own middle alone leaves
        own = np.where(
            is_between[:, None],
            steps * w * (1.0 - w) + white * (1.0 + w**2 + (1.0 - w) ** 2),
            steps * alone + 2.0 * white,
        )
        own[~self.is_deskewed] = 0.0
        turn = turn_matrices(poses[:, 2])
        return moved, covariances + (turn * own[:, None, :]) @ turn.transpose(0, 2, 1)


def _errors(r: Floats, steps: Floats, known: Bools) -> tuple[Floats, Floats]:
    """Return the variance (n, 3) of the odometry around each scan, and the share (3,) of it that one of its poses has.

    Parameters
    ----------
    r : (n, 3) Errors of the odometry from middle to middle, 0 where they are not known.
    steps : (n, 3) Its motion from stamp to middle: in the same time, errors grow with it.
    """
    motion = np.column_stack([np.ones(len(r)), (steps[:, :2] ** 2).sum(axis=1), steps[:, 2] ** 2])
    by_motion = np.column_stack([_fitted(motion, square, known) for square in (r**2).T])
    box = np.ones(2 * AROUND + 1)
    counts = convolve1d(known.astype(np.float64), box, mode="constant")[:, None]
    sums = convolve1d(r**2, box, axis=0, mode="constant")
    variance = (len(box) * by_motion + sums) / (len(box) + counts)
    z = r / np.sqrt(np.maximum(variance, 1e-18))
    both = known[1:] & known[:-1]
    products = (z[1:] * z[:-1])[both].sum(axis=0) / max(int(both.sum()), 1)
    return variance, np.clip(-products / np.maximum((z[known] ** 2).mean(axis=0), 1e-12), 0.0, 0.5)


def _fitted(columns: Floats, squares: Floats, known: Bools) -> Floats:
    """Return the fit (n,) of columns (n, m), with weights of 0 or more, to the known squares (n,) of normal errors."""
    usual = float(squares[known].mean())
    fit = np.full(len(squares), max(usual, 1e-18))
    for _ in range(ROUNDS):
        weight = 1.0 / fit[known]  # the deviation of a square is in proportion to the variance
        wanted = np.minimum(squares[known], SIGNIFICANT**2 * fit[known])  # no slip
        found, _ = nnls(columns[known] * weight[:, None], wanted * weight)
        fit = np.maximum(columns @ found, LEAST * usual + 1e-18)
    return fit
