"""Estimate wheel scales, heading bias and laser mount from driving alone, with realistic standard errors.

    laser step = mount⁻¹ * corrected wheel step * mount

The corrected wheel step has the distance scaled by `way_scale`, the turn by `turn_scale`, and a turn of
`heading_bias` per metre added. This is the model of Censi, Franchi, Marchionni and Oriolo (2013),
Simultaneous calibration of odometry and sensor parameters for mobile robots, IEEE T-RO 29(2). Three nuisances
are fitted as well: the delay between scans and odometry, and the drift of the robot with the floor, along x
and y.

The residuals of the steps are summed over windows, so that stamp errors cancel. They have Student's t
distribution, which limits the influence of slip. The estimate is found by iteratively reweighted Gauss-Newton
steps. The standard errors are those of a jackknife over long blocks of the run (Quenouille 1956; Cameron and
Miller 2015), at least those of independent windows. They are widened so that twice their value covers 95 %.

The constants were chosen on intel, fr079 and aces, and on parts of one located log (`benchmarks.halves`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.diagnosis.motion.calibration.laser_motion import (
    LEAST_WINDOWS,
    STEP_TURN,
    STEP_WAY,
    WINDOW,
    LaserMotion,
)
from sensorgraph.localization.settings import WHEELS
from sensorgraph.localization.wheels import corrected_steps
from sensorgraph.robust import SIGMA_OF_MAD
from sensorgraph.types import Floats

PARAMETERS = ("way_scale", "turn_scale", "heading_bias", "mount_x", "mount_y", "mount_phi")
"""Estimated parameters: distance and turn scale of the odometry, the turn that it misses [rad/m], the laser
in base_link [m, m, rad]."""
NUISANCES = ("delay", "drift_x", "drift_y")
"""[s] delay of a scan after the odometry at its stamp; [m/m] drift with the floor, in map."""
N_ALL = len(PARAMETERS) + len(NUISANCES)
MOUNT_X, YAW = 3, 5
PRIOR_ERRORS = np.array([0.3, 0.3, 0.1, 0.3, 0.3, 0.3, 0.3, 0.02, 0.02])
"""(9,) prior standard deviations of PARAMETERS and NUISANCES: of the scales, the heading bias [rad/m], the mount [m, rad],
the delay [s], and the drift with the floor (slope, nap of a carpet)."""
DIFFERENCES = np.array([1e-4] * 6 + [1e-2] + [1e-4] * 2)
"""Steps of the numerical derivatives."""
BLOCKS = 8
"""Number of parts of a run that count as independent in the standard errors: slip and floors last for minutes."""
SHOWN_STEPS = 2.0
"""Number of steps of distance or turn; a quantity that less motion hides is hidden by the lack of it."""
TAIL = 4.0
"""Degrees of freedom of Student's t for the residuals."""
ITERATIONS = 8
"""Gauss-Newton steps."""
SETTLED = 0.02
"""Change of every parameter, in standard errors, below which these steps end."""
LEAST_BLOCK = 5
"""Minimum number of windows in a block. Shorter runs have fewer blocks, at least four, and larger
standard errors."""
HIDDEN_SHARE = 0.5
"""Standard error, relative to the prior standard deviation, above which a drive does not show a quantity."""
SHORT_ITERATIONS = 30
"""Maximum number of steps of a short drive; outliers lose their weight slowly (EM)."""
NOISE_FREEDOM = 1.0
"""Degrees of freedom of the prior of a noise factor: the noise may be several times larger or smaller than usual."""
USUAL_SLIP = 0.3
"""Usual slip of wheels, relative to the noise that localization expects of them (`WheelSettings`)."""
STAMP_ERRORS = (0.003, 0.003, 0.002)
"""[m, m, rad] error of a pose that the scans do not show: wrong stamps, above all. It cancels from step to step."""
DERIVATIVES = 3
"""Number of initial steps in which the derivatives are updated."""
SIDEWAYS_SD = 0.0026
"""[rad] variation of the direction of travel between floors, beyond the scatter within a run. It adds to
the standard error of the mount's yaw. The eighths of intel and aces show 0.15°, those of fr079 less."""
CENTRE_SD = 0.008
"""[m] variation of the point about which the base turns, between floors and ways of turning. It adds to the standard
error of the mount's x of a short drive; long ones contain it. Pieces of fr079 and aces show 8 mm, those of intel
less."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowRows:
    """Linearised problem at the estimate, one row per window."""

    information: Floats
    """(n_windows, 9, 9)"""
    scores: Floats
    """(n_windows, 9)"""
    prior: Floats
    """(9, 9)"""
    from_s: Floats
    """(n_windows,) [s] start of each window, since the first scan."""


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

    def by_metre(self, stretch: float, stderr: float) -> DrivingCalibration:
        """Return the calibration for a laser whose ranges are too long by a factor, known within a standard error."""
        values, errors = self.values.copy(), self.stderr.copy()
        values[0] /= stretch
        errors[0] = np.hypot(errors[0] / stretch, values[0] * stderr / stretch)
        return replace(self, values=values, stderr=errors, metre="the map's")


def calibrate(motion: LaserMotion) -> DrivingCalibration:
    """Estimate wheels and mount from one run; a short one has large standard errors."""
    before = np.concatenate([[1.0, 1.0, 0.0], motion.mount, np.zeros(3)])
    prior = np.diag(PRIOR_ERRORS**-2.0)
    if len(motion.first) < WINDOW * LEAST_WINDOWS:
        values, stderr, rows = _from_few_steps(motion, before, prior)
    else:
        values, stderr, rows = _from_windows(motion, before, prior)
    stderr[YAW] = np.hypot(stderr[YAW], SIDEWAYS_SD)
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
        short_way = f"the robot drove {way:.1f} m" if way < SHOWN_STEPS * STEP_WAY else ""
        short_turn = f"the robot turned by {np.degrees(turn):.0f}°" if turn < SHOWN_STEPS * STEP_TURN else ""
    lacks = dict.fromkeys(PARAMETERS, short_way)
    lacks |= dict.fromkeys(("turn_scale", "mount_x", "mount_y"), short_turn)
    lacks["delay"] = short_way and short_turn
    names = (*PARAMETERS, "delay")
    other = dict.fromkeys(
        names, "the drive does not separate it from the others; drive straight and turn to both sides"
    )
    other["delay"] = "the speed hardly changes during the drive"
    limits = HIDDEN_SHARE * PRIOR_ERRORS[: len(names)]
    is_hidden = stderr[: len(names)] > limits
    return {name: lacks[name] or other[name] for name, hides in zip(names, is_hidden, strict=True) if hides}


def _from_few_steps(motion: LaserMotion, before: Floats, prior: Floats) -> tuple[Floats, Floats, WindowRows]:
    """Return values and standard errors (9,) of a drive whose noise has a prior; there are no windows.

        r_c = J_c (theta - theta_0) + L_c e_c,   e_c ~ Student's t with variance s_c,   s_c ~ scaled inverse chi²

    r_c are the residuals of the steps in c = x, y, phi, and L_c Lᵀ_c is their usual covariance (`step_covariances`).
    The factors s are found by expectation maximisation (Lange, Little and Taylor 1989). Student's t with the degrees of
    freedom of factor and steps widens the standard errors.
    """
    from scipy.stats import t as student  # slow to import, and rarely needed

    n, nothing = len(motion.first), np.zeros((0, N_ALL))
    rows = WindowRows(
        information=np.zeros((0, N_ALL, N_ALL)), scores=nothing, prior=prior, from_s=np.zeros(0)
    )
    if not n:
        return before, PRIOR_ERRORS.copy(), rows
    theta, inverse = before.copy(), np.diag(PRIOR_ERRORS**2)
    whitening, factors = np.linalg.inv(np.linalg.cholesky(step_covariances(motion))), np.ones(3)
    for _ in range(SHORT_ITERATIONS):
        residuals = np.einsum("cmn,nc->mc", whitening, _residuals(motion, theta))
        jacobians = np.einsum("cmn,nca->mca", whitening, _derivatives(motion, theta, 1))
        spread = np.einsum("nca,ab,ncb->nc", jacobians, inverse, jacobians)  # of what theta leaves uncertain
        squares = residuals**2 + spread
        weights = (TAIL + 1) / (TAIL + squares / factors)
        factors = (NOISE_FREEDOM + (weights * squares).sum(axis=0)) / (NOISE_FREEDOM + n)
        weights = weights / factors
        inverse = np.linalg.inv(np.einsum("nc,nca,ncb->ab", weights, jacobians, jacobians) + prior)
        score = np.einsum("nc,nca,nc->a", weights, jacobians, residuals) - prior @ (theta - before)
        moved = inverse @ score
        theta += moved
        if (np.abs(moved) < SETTLED * np.sqrt(np.diagonal(inverse))).all():
            break
    stderr = np.sqrt(np.diagonal(inverse)) * student.ppf(0.975, NOISE_FREEDOM + n) / 1.96
    stderr[MOUNT_X] = np.hypot(stderr[MOUNT_X], CENTRE_SD)
    return theta, stderr, rows


def step_covariances(motion: LaserMotion) -> Floats:
    """Return the usual covariances (3, n, n) [m², m², rad²] of steps: by the scans, by slip, and by wrong stamps.

    An error of a stamp cancels from step to step.
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
        ]
    )
    own = np.square(np.maximum(slip, 1e-6))
    if motion.scatter is not None:
        own = own + motion.scatter.T
    n = len(way)
    ends = 2 * np.eye(n)
    k = np.flatnonzero(motion.second[:-1] == motion.first[1:])
    ends[k, k + 1] = ends[k + 1, k] = -1.0
    return np.asarray(own[:, :, None] * np.eye(n) + np.square(STAMP_ERRORS)[:, None, None] * ends)


def _from_windows(motion: LaserMotion, before: Floats, prior: Floats) -> tuple[Floats, Floats, WindowRows]:
    """Return values and standard errors (9,) of a drive whose windows show the noise, and its rows."""
    theta = before.copy()
    information, scores = np.zeros((1, N_ALL, N_ALL)), np.zeros((1, N_ALL))
    jacobians = np.zeros((1, 3, N_ALL))
    for iteration in range(ITERATIONS):
        residuals = _added(_residuals(motion, theta), WINDOW)
        if iteration < DERIVATIVES:
            jacobians = _derivatives(motion, theta, WINDOW)
        scale = SIGMA_OF_MAD * np.median(np.abs(residuals), axis=0) + 1e-9
        weights = (TAIL + 1) / (TAIL + (residuals / scale) ** 2) / scale**2
        information = np.einsum("kc,kca,kcb->kab", weights, jacobians, jacobians)
        scores = np.einsum("kc,kca,kc->ka", weights, jacobians, residuals)
        gradient = scores.sum(axis=0) - prior @ (theta - before)
        theta += np.linalg.solve(information.sum(axis=0) + prior, gradient)
    begins = motion.stamps[motion.first[::WINDOW][: len(scores)]] - motion.stamps[0]
    rows = WindowRows(information=information, scores=scores, prior=prior, from_s=begins)
    blocks = min(max(len(scores) // LEAST_BLOCK, 4), BLOCKS)
    return theta, standard_errors(rows, blocks), rows


def standard_errors(rows: WindowRows, blocks: int) -> Floats:
    """Return the standard errors (9,): of the jackknife over blocks, or of independent windows if larger.

        jackknife²   = (blocks - 1) / blocks  sum over b of (theta without block b - theta)²
        independent² = diag(H⁻¹ S'S H⁻¹),   H = total information,   S = scores (n_windows, 9)

    The jackknife is linearised at theta. Student's t with blocks - 1 degrees of freedom widens it.
    """
    from scipy.stats import t as student  # slow to import, and rarely needed

    total = rows.information.sum(axis=0) + rows.prior
    scores = rows.scores
    n = len(scores)
    block = np.arange(n) * blocks // n
    moves = np.array(
        [
            np.linalg.solve(total - rows.information[block == b].sum(axis=0), -scores[block == b].sum(axis=0))
            for b in range(blocks)
        ]
    )
    widening = student.ppf(0.975, blocks - 1) / 1.96
    jackknife = widening * np.sqrt((blocks - 1) / blocks * (moves**2).sum(axis=0))
    inverse = np.linalg.inv(total)
    independent = np.sqrt(np.diagonal(inverse @ (scores.T @ scores) @ inverse))
    return np.asarray(np.maximum(jackknife, independent))


def _added(values: Floats, window: int) -> Floats:
    """Sum values (n_steps, ...) over windows (n_windows, ...)."""
    n = len(values) // window
    return np.asarray(values[: n * window].reshape(n, window, *values.shape[1:]).sum(axis=1))


def _derivatives(motion: LaserMotion, theta: Floats, window: int) -> Floats:
    """Return the derivatives (n_windows, 3, 9) of the predicted motion of each window, in the laser frame."""
    columns = []
    for k, step in enumerate(DIFFERENCES):
        change = np.zeros(N_ALL)
        change[k] = step
        off = _residuals(motion, theta - change) - _residuals(motion, theta + change)
        columns.append(_added(off / (2 * step), window))
    return np.stack(columns, axis=-1)


def _residuals(motion: LaserMotion, theta: Floats) -> Floats:
    """Return the measured steps of the laser relative to the predicted ones (n_steps, 3) [m, m, rad]."""
    off = compose(invert(predicted(motion, theta)), motion.steps)
    off[:, 2] = wrap(off[:, 2])
    return off


def predicted(motion: LaserMotion, theta: Floats) -> Floats:
    """Return the steps (n_steps, 3) [m, m, rad] of the laser that wheels and mount of theta (9,) predict."""
    way_scale, turn_scale, heading_bias, *mount, delay, drift_x, drift_y = theta
    track = motion.odometry
    moved = compose(invert(track[:-1]), track[1:])
    moved[:, 2] = np.diff(track[:, 2])
    moved = corrected_steps(moved, way_scale, turn_scale, heading_bias)
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
    seen = compose(np.broadcast_to(invert(at), steps.shape), steps)
    out = compose(seen, np.broadcast_to(at, steps.shape))
    out[:, 2] = wrap(out[:, 2])
    return np.asarray(out)
