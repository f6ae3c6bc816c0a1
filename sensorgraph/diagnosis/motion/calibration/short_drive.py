"""Noise of a drive of a few steps, and what it leaves uncertain.

A long drive shows its noise by the scatter between its windows. A drive of a few steps does not, so that its noise
is modelled. The residuals of component c = x, y, phi of all steps are

    r_c = J_c (theta - theta_0) + e_c,    e_c ~ N(0, a_c C_c + b_c D_c²),    theta ~ N(theta_0, P⁻¹).

C_c is the covariance of the steps by the scans, plus that of stamps that are a little wrong, which cancels from
step to step. D_c is the slip that the wheels usually have. The factors a_c and b_c have log-normal priors. They are
the most probable ones with theta integrated out (restricted likelihood, Patterson and Thompson 1971). Student's t
limits the influence of a single slip (Lange, Little and Taylor 1989).

The standard errors account for uncertain factors: Student's t with the degrees of freedom of Satterthwaite (1946)
widens them, so that twice their value covers 95 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.transforms import compose, invert
from sensorgraph.diagnosis.motion.calibration.laser_motion import LaserMotion
from sensorgraph.diagnosis.motion.calibration.settings import CALIBRATION
from sensorgraph.localization.settings import WHEELS
from sensorgraph.robust import SIGMA_OF_MAD
from sensorgraph.types import Floats

N_FACTORS = 6
"""a and b of x, y and phi."""
STEP = 0.03
"""Step of the numerical derivatives by the logarithms of the factors."""
SCAN_TURN = 0.002
"""[rad] heading error of such a step."""
USUAL_SLIP = 0.4
"""Usual slip of wheels, relative to the noise that localization expects of them (`WheelSettings`)."""
NOISE_SPREAD = 3.0
"""Factor by which the noise of wheels and scans may be larger or smaller than usual, as a standard deviation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StepNoise:
    """Shape of the noise of the steps of one drive, before it is scaled by the factors."""

    scans: Floats
    """(3, n, n) [m², m², rad²] covariance of the measured steps, per component."""
    wheels: Floats
    """(3, n) [m, m, rad] standard deviation of slip in each step."""

    @classmethod
    def of(cls, motion: LaserMotion) -> StepNoise:
        """Return the noise of the steps, from the scans' own covariance and from the way and turn of each step."""
        n = len(motion.first)
        steps = compose(invert(motion.odometry[:-1]), motion.odometry[1:])
        ways = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
        turns = np.append(0.0, np.cumsum(np.abs(np.diff(motion.odometry[:, 2]))))
        way, turn = ways[motion.second] - ways[motion.first], turns[motion.second] - turns[motion.first]
        w = WHEELS
        wheels = np.stack(
            [
                w.ahead_per_metre * way + w.place_per_turn * turn,
                w.left_per_metre * way + w.place_per_turn * turn,
                w.turn_per_metre * way + w.turn_per_turn * turn,
            ]
        )
        ends = 2 * np.eye(n)
        k = np.flatnonzero(motion.second[:-1] == motion.first[1:])
        ends[k, k + 1] = ends[k + 1, k] = -1.0
        scans = np.square([CALIBRATION.scan_place, CALIBRATION.scan_place, SCAN_TURN])[:, None, None] * ends
        if motion.scatter is not None:
            scans = scans + motion.scatter
        return cls(scans=scans, wheels=np.maximum(wheels, 1e-6))

    def first_weights(self, residuals: Floats) -> Floats:
        """Return weights (3, n) of slips from the residuals (n, 3) before any fit, relative to their median size."""
        size = np.abs(residuals.T / self.wheels)
        return student_weights((size / (SIGMA_OF_MAD * np.median(size, axis=1, keepdims=True) + 1e-9)) ** 2)

    def whitened(
        self,
        weights: Floats,
        residuals: Floats,
        jacobians: Floats,
        prior: Floats,
    ) -> WhiteSteps:
        """Combine residuals (n, 3) and their derivatives (n, 3, k) into rows with independent noise.

        Parameters
        ----------
        weights : (3, n) Of each slip; 1 without outliers.
        prior : (k, k)
        """
        sd = self.wheels / np.sqrt(weights)
        values, vectors = np.linalg.eigh(self.scans / (sd[:, :, None] * sd[:, None, :]))
        turned = vectors.transpose(0, 2, 1)
        return WhiteSteps(
            residuals=np.einsum("cjn,nc->cj", turned / sd[:, None, :], residuals),
            jacobians=np.einsum("cjn,nca->cja", turned / sd[:, None, :], jacobians),
            turned=turned,
            by_scans=np.maximum(values, 0.0),
            prior=prior,
            usual=np.repeat(2 * np.log([1.0, USUAL_SLIP]), 3),
            spread=2 * float(np.log(NOISE_SPREAD)),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class WhiteSteps:
    """The linearised problem with independent rows."""

    residuals: Floats
    """(3, n) at theta_0"""
    jacobians: Floats
    """(3, n, k)"""
    turned: Floats
    """(3, n, n) orthonormal rows, by which the residuals of the steps were combined"""
    by_scans: Floats
    """(3, n) variance per a; that per b is 1"""
    prior: Floats
    """(k, k) P"""
    usual: Floats
    """(6,) prior means of log a and log b"""
    spread: float
    """their prior standard deviation"""

    def variances(self, factors: Floats) -> Floats:
        """Return the variances of the rows (3, n) for log a and log b, (6,)."""
        a, b = np.exp(factors).reshape(2, 3, 1)
        return np.asarray(a * self.by_scans + b)

    def information(self, factors: Floats) -> Floats:
        """Return the normal matrix (k, k) with the prior."""
        weighted = self.jacobians / self.variances(factors)[:, :, None]
        return np.asarray(np.einsum("cna,cnb->ab", weighted, self.jacobians) + self.prior)

    def moved(self, factors: Floats) -> Floats:
        """Return the most probable theta - theta_0, (k,)."""
        score = np.einsum("cna,cn->a", self.jacobians, self.residuals / self.variances(factors))
        return np.asarray(np.linalg.solve(self.information(factors), score))

    def cost(self, factors: Floats) -> float:
        """Return minus the logarithm of the probability of the factors, with theta integrated out."""
        v = self.variances(factors)
        score = np.einsum("cna,cn->a", self.jacobians, self.residuals / v)
        information = self.information(factors)
        fit = float((self.residuals**2 / v).sum() - score @ np.linalg.solve(information, score))
        off = float((((factors - self.usual) / self.spread) ** 2).sum())
        return 0.5 * (float(np.log(v).sum()) + float(np.linalg.slogdet(information)[1]) + fit + off)

    def slips(self, factors: Floats) -> Floats:
        """Return the expected square of each slip (3, n), relative to its variance."""
        left = self.residuals - self.jacobians @ self.moved(factors)
        b = np.exp(factors[3:])[:, None]
        known = b / self.variances(factors)
        mean = np.einsum("cjn,cj->cn", self.turned, known * left)
        left_open = np.einsum("cjn,cj->cn", self.turned**2, 1 - known)
        return np.asarray(mean**2 / b + left_open)


def student_weights(squares: Floats) -> Floats:
    """Return the weights of squared residuals, in units of their variance, under Student's t."""
    return np.asarray((CALIBRATION.tail + 1) / (CALIBRATION.tail + squares))


def most_probable(steps: WhiteSteps, start: Floats) -> Floats:
    """Return the most probable log a and log b, (6,)."""
    from scipy.optimize import minimize  # slow to import, and only for short drives

    return np.asarray(minimize(steps.cost, start, method="BFGS", options={"gtol": 1e-2}).x)


def widened_errors(steps: WhiteSteps, factors: Floats) -> Floats:
    """Return the standard errors (k,) of theta: twice their value covers 95 %, although the factors are uncertain.

    1 / freedom_i = ½ g_iᵀ H⁻¹ g_i,    g_i = d log variance_i / d factors,    H = d² cost / d factors²
    """
    from scipy.stats import t as student

    moves = STEP * np.eye(N_FACTORS)
    curvature = np.array(
        [
            [
                steps.cost(factors + a + b) - steps.cost(factors + a - b)
                - steps.cost(factors - a + b) + steps.cost(factors - a - b)
                for b in moves
            ]
            for a in moves
        ]
    ) / (4 * STEP**2)  # fmt: skip

    def logarithms(at: Floats) -> Floats:
        return np.asarray(np.log(np.diagonal(np.linalg.inv(steps.information(at)))))

    slopes = np.stack(
        [(logarithms(factors + m) - logarithms(factors - m)) / (2 * STEP) for m in moves], axis=-1
    )
    uncertain = np.einsum("ia,ab,ib->i", slopes, np.linalg.pinv(curvature, hermitian=True), slopes)
    freedom = np.clip(2.0 / np.maximum(uncertain, 1e-9), 1.0, 1e6)
    return np.asarray(np.exp(0.5 * logarithms(factors)) * student.ppf(0.975, freedom) / 1.96)
