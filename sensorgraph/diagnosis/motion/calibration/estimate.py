"""Estimate wheel scales, heading bias and laser mount from driving alone, with realistic standard errors.

    laser step = mount⁻¹ * corrected wheel step * mount

The corrected wheel step has the distance scaled by `way_scale`, the turn by `turn_scale`, and a turn of
`heading_bias` per metre added. This is the model of Censi, Franchi, Marchionni and Oriolo (2013),
Simultaneous calibration of odometry and sensor parameters for mobile robots, IEEE T-RO 29(2). Three nuisances
are fitted as well: the delay between scans and odometry, and the drift of the robot with the floor, along x
and y.

    r_c = J_c (theta - theta_0) + L_c e_c,   e_c ~ Student's t with variance s_c,   s_c ~ scaled inverse chi²

r_c are the residuals of the motion in c = x, y, phi, summed over windows, so that stamp errors cancel, and L_c Lᵀ_c is
their usual covariance. Expectation maximisation finds the noise factors s (Lange, Little and Taylor 1989). The whitened
rows are those of the regression of the motion channels; the standard errors are those of independent windows, or of
long blocks of the run if larger (Liang and Zeger 1986; Cameron and Miller 2015). Student's t widens them by the degrees of
freedom of the noise factors (Welch 1947), so that twice their value covers 95 %.

The constants were chosen on intel, fr079 and aces, and on parts of one located log (`benchmarks.halves`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from logs.transforms import compose, invert
from sensorgraph.diagnosis.motion.calibration.laser_motion import (
    BLOCKS,
    STEP_TURN,
    STEP_WAY,
    WINDOW,
    LaserMotion,
)
from sensorgraph.diagnosis.motion.regression import BoundedPrior, Regression
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.localization.settings import WHEELS
from sensorgraph.localization.wheels import corrected_steps
from sensorgraph.types import Floats

PARAMETERS = ("way_scale", "turn_scale", "heading_bias", "mount_x", "mount_y", "mount_phi")
"""Estimated parameters: distance and turn scale of the odometry, the turn that it misses [rad/m], the laser
in base_link [m, m, rad]."""
NUISANCES = ("delay", "drift_x", "drift_y")
"""[s] delay of a scan after the odometry at its stamp; [m/m] drift with the floor, in map."""
N_ALL = len(PARAMETERS) + len(NUISANCES)
PRIOR_ERRORS = np.array([0.3, 0.3, 0.1, 0.3, 0.3, 0.3, 0.3, 0.02, 0.02])
"""(9,) prior standard deviations of PARAMETERS and NUISANCES: of the scales, the heading bias [rad/m], the mount [m, rad],
the delay [s], and the drift with the floor (slope, nap of a carpet). Half of one, as a standard error, hides a quantity."""
TAIL = 4.0
"""Degrees of freedom of Student's t for the residuals."""
SETTLED = 0.02
"""Change of every parameter, in standard errors, and relative change of the noise factors, below which these steps end."""
NOISE_FREEDOM = 1.0
"""Degrees of freedom of the prior of a noise factor: the noise may be several times larger or smaller than usual."""
USUAL_SLIP = 0.3
"""Usual slip of wheels, relative to the noise that localization expects of them (`WheelSettings`)."""
STAMP_ERRORS = (0.003, 0.003, 0.002)
"""[m, m, rad] error of a pose that the scans do not show: wrong stamps, above all. It cancels from step to step."""
SIDEWAYS_SD = 0.0026
"""[rad] variation of the direction of travel between floors, beyond the scatter within a run. It adds to the standard
error of the mount's yaw. The eighths of intel and aces show 0.15°, those of fr079 less."""
CENTRE_SD = 0.008
"""[m] variation of the point about which the base turns, between floors and ways of turning. It adds to the standard error
of the mount's x of a short drive; long ones contain it. Pieces of fr079 and aces show 8 mm, those of intel less."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowRows:
    """Whitened rows of the windows, linearised at `at`: y = A (theta - at) + white noise."""

    A: Floats
    """(n_windows, 3, 9)"""
    y: Floats
    """(n_windows, 3)"""
    at: Floats
    """(9,)"""
    prior: BoundedPrior
    """Of theta - at."""
    from_s: Floats
    """(n_windows,) [s] start of each window, since the first scan."""
    floors: Floats
    """(9,) standard deviations between floors, which the windows do not show."""

    @property
    def n(self) -> int:
        """Number of windows."""
        return len(self.y)

    def part(self, chosen: slice) -> WindowRows:
        """Return some windows."""
        return replace(self, A=self.A[chosen], y=self.y[chosen], from_s=self.from_s[chosen])

    def regression(self, more: Floats | None = None) -> Regression:
        """Return the regression of all rows, with a further column (n_windows, 3) in front."""
        A = self.A if more is None else np.concatenate([more[:, :, None], self.A], axis=2)
        return Regression.of(A.reshape(-1, A.shape[2]), self.y.ravel())

    def estimate(self) -> tuple[Floats, Floats]:
        """Return values and standard errors (9,)."""
        from scipy.stats import t as student  # slow to import, and rarely needed

        def widening(freedom: Floats | float) -> Floats:
            return np.asarray(student.ppf(0.975, freedom) / student.ppf(0.975, np.inf))

        regression = self.regression()
        fit = regression.solve(self.prior)
        stderr = np.sqrt(np.diag(fit.covariance)) * widening(self._freedom(fit.covariance))
        blocks = min(BLOCKS, self.n)
        if blocks > 1:
            block = np.repeat(np.arange(self.n) * blocks // self.n, 3)
            robust = np.sqrt(regression.robust_variances(fit, block) * blocks / (blocks - 1))
            stderr = np.maximum(stderr, robust * widening(blocks - 1))
        return self.at + fit.theta, np.hypot(stderr, self.floors)

    def _freedom(self, covariance: Floats) -> Floats:
        """Return the degrees of freedom (9,) of standard errors with noise factors of the windows (Welch 1947).

        A factor has those of its prior and of the windows, less the parameters that its component determines.
        """
        if not self.n:
            return np.full(N_ALL, np.inf)
        used = np.einsum("nca,ab,ncb->c", self.A, covariance, self.A)
        parts = np.square(np.einsum("ab,ncb->nca", covariance, self.A)).sum(
            axis=0
        )  # variance by each component
        with np.errstate(divide="ignore"):
            return np.asarray(
                np.diag(covariance) ** 2 / (parts**2 / (NOISE_FREEDOM + self.n - used)[:, None]).sum(axis=0)
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class DrivingCalibration:
    """Calibration of wheels and mount from driving alone."""

    values: Floats
    """(9,) of PARAMETERS and NUISANCES."""
    stderr: Floats
    """(9,) twice these values cover 95 %."""
    mount: Floats
    """(3,) [m, m, rad] specified mount."""
    way_m: float
    turn_rad: float
    duration_s: float
    rows: WindowRows
    hidden: dict[str, str] = field(default_factory=dict)
    """Name -> why the drive does not show it; its value is then little more than the prior."""
    metre: str = "the laser's"
    """Owner of the length scale in which distances are given."""

    @property
    def stated(self) -> Floats:
        """(6,) specified values of PARAMETERS: unit scales, no bias, and the mount."""
        return np.array([1.0, 1.0, 0.0, *self.mount])

    def of(self, name: str) -> tuple[float, float]:
        """Return value and standard error of one of PARAMETERS or NUISANCES."""
        k = (*PARAMETERS, *NUISANCES).index(name)
        return float(self.values[k]), float(self.stderr[k])

    def part(self, chosen: slice) -> DrivingCalibration:
        """Return the calibration by some windows, linearised at that of all."""
        rows = self.rows.part(chosen)
        values, stderr = rows.estimate()
        return replace(self, values=values, stderr=stderr, rows=rows)

    def by_metre(self, stretch: float, stderr: float) -> DrivingCalibration:
        """Return the calibration for a laser whose ranges are too long by a factor, known within a standard error."""
        values, errors = self.values.copy(), self.stderr.copy()
        values[0] /= stretch
        errors[0] = np.hypot(errors[0] / stretch, values[0] * stderr / stretch)
        return replace(self, values=values, stderr=errors, metre="the map's")


def calibrate(motion: LaserMotion) -> DrivingCalibration:
    """Estimate wheels and mount from one run; a short one has large standard errors."""
    rows = whitened_rows(motion, WINDOW if len(motion.first) >= WINDOW * BLOCKS else 1)
    values, stderr = rows.estimate()
    way = float(np.hypot(*np.diff(motion.odometry[:, :2], axis=0).T).sum())
    turn = float(np.abs(np.diff(motion.odometry[:, 2])).sum())
    return DrivingCalibration(
        values=values,
        stderr=stderr,
        mount=motion.mount,
        hidden=hidden_parameters(stderr, way, turn),
        way_m=way,
        turn_rad=turn,
        duration_s=float(np.ptp(motion.stamps)),
        rows=rows,
    )


def hidden_parameters(stderr: Floats, way: float, turn: float) -> dict[str, str]:
    """Return the parameters and the delay that a drive does not show, with the reason.

    Parameters
    ----------
    stderr : (9,)
    way, turn : [m, rad] Distance and turns of the whole drive by the odometry.
    """
    if way == turn == 0.0:
        short_way = short_turn = "the odometry never moves"
    else:
        short_way = f"the robot drove {way:.1f} m" if way < 2 * STEP_WAY else ""
        short_turn = f"the robot turned by {np.degrees(turn):.0f}°" if turn < 2 * STEP_TURN else ""
    lacks = dict.fromkeys(PARAMETERS, short_way)
    lacks |= dict.fromkeys(("turn_scale", "mount_x", "mount_y"), short_turn)
    lacks["delay"] = short_way and short_turn
    other = dict.fromkeys(
        lacks, "the drive does not separate it from the others; drive straight and turn to both sides"
    )
    other["delay"] = "the speed hardly changes during the drive"
    is_hidden = stderr > PRIOR_ERRORS / 2
    return {name: lacks[name] or other[name] for name, hides in zip(lacks, is_hidden, strict=False) if hides}


def whitened_rows(motion: LaserMotion, window: int) -> WindowRows:
    """Return the rows of all windows of this many steps, linearised at the estimate."""
    n = len(motion.first) // window
    begins = motion.stamps[motion.first[::window][:n]] - motion.stamps[0]
    before = np.concatenate([[1.0, 1.0, 0.0], motion.mount, np.zeros(3)])
    prior = BoundedPrior(mean=np.zeros(N_ALL), sigma=PRIOR_ERRORS, reach=np.full(N_ALL, np.inf))
    floors = np.array([0.0, 0.0, 0.0, CENTRE_SD if window == 1 else 0.0, 0.0, SIDEWAYS_SD, 0.0, 0.0, 0.0])
    A, y = np.zeros((n, 3, N_ALL)), np.zeros((n, 3))
    rows = WindowRows(A=A, y=y, at=before, prior=prior, from_s=begins, floors=floors)
    if not n:
        return rows
    theta, covariance, factors = before, np.diag(PRIOR_ERRORS**2), np.ones(3)
    whitening = np.linalg.inv(np.linalg.cholesky(window_covariances(motion, window)))
    for _ in range(SCAN.fit.max_rounds):  # outliers lose their weight slowly
        y = np.einsum("cmn,nc->mc", whitening, _added(_residuals(motion, theta), window))
        A = np.einsum("cmn,nca->mca", whitening, _derivatives(motion, theta, window))
        squares = y**2 + np.einsum("nca,ab,ncb->nc", A, covariance, A)  # with what theta leaves uncertain
        weights = (TAIL + 1) / (TAIL + squares / factors)
        last, factors = factors, (NOISE_FREEDOM + (weights * squares).sum(axis=0)) / (NOISE_FREEDOM + n)
        root = np.sqrt(weights / factors)
        here = replace(prior, mean=before - theta)
        rows = replace(rows, A=root[:, :, None] * A, y=root * y, at=theta, prior=here)
        fit = rows.regression().solve(here)
        theta, covariance = theta + fit.theta, fit.covariance
        is_still = (np.abs(fit.theta) < SETTLED * np.sqrt(np.diag(covariance))).all()
        if is_still and (np.abs(factors - last) < SETTLED * last).all():
            break
    return rows


def window_covariances(motion: LaserMotion, window: int) -> Floats:
    """Return the usual covariances (3, n, n) [m², m², rad²] of n windows: by the scans, by slip, and by wrong stamps.

    An error of a stamp cancels from step to step, and between windows.
    """
    steps = compose(invert(motion.odometry[:-1]), motion.odometry[1:])
    ways = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
    turns = np.append(0.0, np.cumsum(np.abs(np.diff(motion.odometry[:, 2]))))
    way, turn = (total[motion.second] - total[motion.first] for total in (ways, turns))
    slip = USUAL_SLIP * np.stack(
        [
            WHEELS.ahead_per_metre * way + WHEELS.place_per_turn * turn,
            WHEELS.left_per_metre * way + WHEELS.place_per_turn * turn,
            WHEELS.turn_per_metre * way + WHEELS.turn_per_turn * turn,
        ],
        axis=1,
    )
    own = np.square(np.maximum(slip, 1e-6)) + (0.0 if motion.scatter is None else motion.scatter)
    n = len(way) // window
    of = np.arange(n * window) // window
    joins = motion.second[: n * window - 1] == motion.first[1 : n * window]
    before, after = of[:-1][joins], of[1:][joins]
    ends = 2.0 * window * np.eye(n)
    np.add.at(ends, (before, after), -1.0)
    np.add.at(ends, (after, before), -1.0)
    variances = _added(own, window).T
    return np.asarray(variances[:, :, None] * np.eye(n) + np.square(STAMP_ERRORS)[:, None, None] * ends)


def _added(values: Floats, window: int) -> Floats:
    """Sum values (n_steps, ...) over windows (n_windows, ...)."""
    n = len(values) // window
    return np.asarray(values[: n * window].reshape(n, window, *values.shape[1:]).sum(axis=1))


def _derivatives(motion: LaserMotion, theta: Floats, window: int) -> Floats:
    """Return the derivatives (n_windows, 3, 9) of the predicted motion of each window, in the laser frame."""
    columns = []
    for k, step in enumerate(PRIOR_ERRORS / 30):
        change = np.zeros(N_ALL)
        change[k] = step
        off = _residuals(motion, theta - change) - _residuals(motion, theta + change)
        columns.append(_added(off / (2 * step), window))
    return np.stack(columns, axis=-1)


def _residuals(motion: LaserMotion, theta: Floats) -> Floats:
    """Return the measured steps of the laser relative to the predicted ones (n_steps, 3) [m, m, rad]."""
    return compose(invert(predicted(motion, theta)), motion.steps)


def predicted(motion: LaserMotion, theta: Floats) -> Floats:
    """Return the steps (n_steps, 3) [m, m, rad] of the laser that wheels and mount of theta (9,) predict."""
    way_scale, turn_scale, heading_bias, *mount, delay, drift_x, drift_y = theta
    moved = corrected_steps(motion.odometry_steps, way_scale, turn_scale, heading_bias)
    phi = np.concatenate([[0.0], np.cumsum(moved[:, 2])])
    cos, sin = np.cos(phi[:-1]), np.sin(phi[:-1])
    x = np.concatenate([[0.0], np.cumsum(cos * moved[:, 0] - sin * moved[:, 1])])
    y = np.concatenate([[0.0], np.cumsum(sin * moved[:, 0] + cos * moved[:, 1])])
    poses = np.column_stack([x, y, phi])
    if delay != 0.0:
        t = motion.stamps
        poses = np.column_stack([np.interp(t + delay, t, column) for column in poses.T])
    steps = compose(invert(poses[motion.first]), poses[motion.second])
    way = np.hypot(steps[:, 0], steps[:, 1])
    cos, sin = np.cos(motion.headings), np.sin(motion.headings)
    steps[:, 0] += way * (cos * drift_x + sin * drift_y)
    steps[:, 1] += way * (cos * drift_y - sin * drift_x)
    at = np.asarray(mount)
    return compose(compose(invert(at)[None], steps), at[None])
