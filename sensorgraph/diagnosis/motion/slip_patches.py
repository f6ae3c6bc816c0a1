"""Search for a slippery patch, and its posterior distribution.

A patch is a disc x = (x, y, log r). The best disc of a grid along the path starts an adaptive importance sampler
(Cornuet et al. 2012, "Adaptive multiple importance sampling", Scandinavian Journal of Statistics 39):

    p(x) ~ exp(gain(x) / T) / r²           a patch of unknown size has the density 1 / r³ over (x, y, r)
    w_i  = p(x_i) / (1/K Σ_k q_k(x_i))     q_k: Student's t of round k

Each round has the mean and the covariance of all samples so far. The gain of a disc is that of the regression, with
the lost share of the motion at its optimum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from sensorgraph.diagnosis.motion.increments import MIN_MOTION
from sensorgraph.diagnosis.motion.regression import Term
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.wheel_model import SlipPatch, WheelModel
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.types import Floats

PATCH_PRICE = EVIDENCE.price * len(WHEEL_SLIP.parameters)
"""[nats] complexity penalty of a patch."""
MAX_VALUES = 1_000_000
"""Maximum number of rows times discs in memory: 8 MB per array."""
TAILS = 3
"""Degrees of freedom of the proposals: heavy tails, so that no weight is unbounded."""
LEAST_EFFECTIVE = 20
"""Minimum number of increments that move, and of effective samples from which a proposal is estimated."""
RADIUS_RANGE = (0.1, 2.5)
"""[m] smallest and largest radius of a patch."""
RADII = (0.2, 0.3, 0.42, 0.56, 0.72, 0.92, 1.2, 1.6, 2.1)
"""[m] radii that are tried."""
MIN_INFORMATION = 400.0
"""[1] minimum inverse variance of the lost share, for 5 % standard error; with less, the robot hardly
crossed the disc."""
CELL = 0.15
"""[m] distance between the centres that are tried."""
MAX_CENTRES = 250
"""Maximum number of centres; of more, every second or third is tried."""
N_ROUNDS = 7
"""Number of rounds of the importance sampler."""
N_SAMPLES = 100
"""Number of discs of a round."""
MAX_SLIP = 0.95
"""Maximum share of the motion that a patch loses."""


def best_patch(
    model: WheelModel, terms: Sequence[Term], rng: np.random.Generator
) -> tuple[SlipPatch, float] | None:
    """Return the most likely patch in addition to other effects, and its evidence [nats].

    Either each wheel slips at its own place, or the body slips as a whole: the more likely of the two. The
    result is None if the robot hardly moved.
    """
    is_moving = np.abs(model.wheels.distance) > MIN_MOTION
    positions = model.rows.increment_poses[is_moving, :2]
    if len(positions) < LEAST_EFFECTIVE:
        return None
    cells = np.unique(np.round(positions / CELL).astype(np.intp), axis=0)
    if len(cells) > MAX_CENTRES:
        cells = cells[:: len(cells) // MAX_CENTRES + 1]
    centres = cells * CELL
    discs = np.concatenate([np.column_stack([centres, np.full(len(centres), r)]) for r in RADII])
    found = [_best_disc(model, discs, track, terms, rng) for track in (model.robot.wheels.base, 0.0)]
    return max(found, key=lambda one: one[1])


def _best_disc(
    model: WheelModel, discs: Floats, track: float, terms: Sequence[Term], rng: np.random.Generator
) -> tuple[SlipPatch, float]:
    """Return the best of discs (n, 3) and of the samples around it, and its evidence [nats]."""
    gains, _ = gains_of_discs(model, discs, track, terms)
    near, more_gains, _, _ = _sampled(model, discs[int(np.argmax(gains))], track, terms, rng)
    x, y, r = (float(value) for value in near[int(np.argmax(more_gains))])
    patch = SlipPatch(x=x, y=y, r=r, track=track, covariance=np.zeros((4, 4)))
    return patch, float(more_gains.max()) - PATCH_PRICE


def gains_of_discs(
    model: WheelModel, discs: Floats, track: float, terms: Sequence[Term]
) -> tuple[Floats, Floats]:
    """Return the gain [nats] and the lost share of the motion (n_discs,) of each disc, given a set of effects.

        lost = clip(score / information, 0, max_slip),   gain = lost score - lost² information / 2

    The free effects are projected out of the information.
    """
    regression, two = model.regression, 2 * model.rows.n  # rows across the heading show no slip
    fit, whitener = regression.solve(model.prior(terms)), model.whitener.first(2)
    residual = (regression.y - regression.A @ fit.theta)[:two]
    free = np.diag(fit.covariance) > 0
    C = fit.covariance[np.ix_(free, free)]
    score, total, information = (np.zeros(len(discs)) for _ in range(3))
    at_a_time = max(1, MAX_VALUES // len(residual))
    for first in range(0, len(discs), at_a_time):  # a long run has hundreds of thousands of rows
        some = slice(first, first + at_a_time)
        Z = whitener(model.slip_columns(discs[some], track))
        score[some] = residual @ Z
        cross = regression.A[:two, free].T @ Z
        total[some] = np.einsum("ij,ij->j", Z, Z)
        information[some] = total[some] - np.einsum("ij,ij->j", cross, C @ cross)
    information = np.maximum(information, 1e-9 + 1e-6 * total)
    lost = np.clip(score / information, 0.0, MAX_SLIP)
    gains = lost * score - 0.5 * lost**2 * information
    gains[information < MIN_INFORMATION] = 0.0
    for i, patch in enumerate(model.patches):  # the same floor does not slip twice
        if model.patch_term(i) in terms:
            apart = np.hypot(discs[:, 0] - patch.x, discs[:, 1] - patch.y)
            gains[apart < np.minimum(discs[:, 2], patch.r)] = 0.0
    return gains, lost


def refine_patch(model: WheelModel, i: int, terms: Sequence[Term], rng: np.random.Generator) -> None:
    """Move a patch to the disc nearest to its posterior mean, and compute the covariance of s, x, y, r around it."""
    rest = [term for term in terms if term != model.patch_term(i)]
    track = model.patches[i].track
    discs, _, lost, weight = _sampled(model, model.patches[i].disc, track, rest, rng)
    values = np.column_stack([lost, discs])
    middle = weight @ values
    likely = np.flatnonzero(weight >= 1 / len(weight))  # more than the average
    nearest = likely[np.argmin(((values[likely, 1:] - middle[1:]) ** 2).sum(axis=1))]
    x, y, r = (float(value) for value in discs[nearest])
    off = values - values[nearest]
    covariance = (off * weight[:, None]).T @ off
    model.patches[i] = SlipPatch(x=x, y=y, r=r, track=track, covariance=covariance)
    model.whiten()


def _sampled(
    model: WheelModel, disc: Floats, track: float, terms: Sequence[Term], rng: np.random.Generator
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return discs (n, 3), the given one first, with their gains [nats], lost shares and weights (n,)."""
    low, high = np.log(RADIUS_RANGE)
    middle = np.array([disc[0], disc[1], np.log(disc[2])])
    covariance = np.diag([(0.5 * disc[2] + CELL) ** 2] * 2 + [0.5])
    x = middle[None]
    gains, lost = gains_of_discs(model, disc[None], track, terms)
    proposals = []
    for _ in range(N_ROUNDS):
        proposals.append((middle, covariance))
        drawn = _draw(rng, middle, covariance)
        drawn = drawn[(drawn[:, 2] > low) & (drawn[:, 2] < high)]
        more_gains, more_lost = gains_of_discs(model, _discs(drawn), track, terms)
        x = np.concatenate([x, drawn])
        gains, lost = np.append(gains, more_gains), np.append(lost, more_lost)
        log_q = np.logaddexp.reduce([_log_density(x, *one) for one in proposals], axis=0)
        log_w = gains / EVIDENCE.temperature - 2 * x[:, 2] - log_q
        broad = _tempered(log_w)
        middle = broad @ x
        off = x - middle
        covariance = (off * broad[:, None]).T @ off + 1e-8 * np.eye(3)
    return _discs(x), gains, lost, _weights(log_w)


def _draw(rng: np.random.Generator, middle: Floats, scale: Floats) -> Floats:
    """Draw samples (n_samples, 3) of Student's t with a middle (3,) and a scale matrix (3, 3)."""
    normal = rng.multivariate_normal(np.zeros(3), scale, size=N_SAMPLES)
    return middle + normal / np.sqrt(rng.chisquare(TAILS, size=(N_SAMPLES, 1)) / TAILS)


def _log_density(x: Floats, middle: Floats, scale: Floats) -> Floats:
    """Return the log-density (n,) of Student's t at samples (n, 3), without constants."""
    off = x - middle
    square = np.einsum("ij,ij->i", off, np.linalg.solve(scale, off.T).T)
    return np.asarray(-0.5 * (TAILS + 3) * np.log1p(square / TAILS) - 0.5 * np.linalg.slogdet(scale)[1])


def _weights(log_w: Floats) -> Floats:
    """Return weights (n,) that add up to 1."""
    weight = np.exp(log_w - log_w.max())
    return np.asarray(weight / weight.sum())


def _tempered(log_w: Floats) -> Floats:
    """Return weights (n,) to the largest power up to 1 that leaves LEAST_EFFECTIVE samples, 1 / Σ w²."""

    def spare(power: float) -> float:
        return float(1 / np.square(_weights(power * log_w)).sum()) - LEAST_EFFECTIVE

    return _weights(log_w if spare(1.0) >= 0 else brentq(spare, 0.0, 1.0, xtol=1e-6) * log_w)


def _discs(x: Floats) -> Floats:
    """Return discs (n, 3) x, y, r of samples (n, 3) x, y, log r."""
    return np.column_stack([x[:, :2], np.exp(x[:, 2])])
