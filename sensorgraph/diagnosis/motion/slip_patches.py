"""Search for a slippery patch, and its posterior distribution.

A patch is a disc x = (x, y, log r). The best disc of a lattice along the path is the start of further lattices, each
with the mean and the principal axes of the posterior on the previous one:

    p(x) ~ exp(gain(x) / T) / r²           a patch of unknown size has the density 1 / r³ over (x, y, r)
    x_i  = mean + L u_i,   L L' = covariance + covariance of a cell,   u_i in {-2, ..., 2}³

The gain of a disc is that of the regression, with the lost share of the motion at its optimum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.motion.increments import MIN_MOTION
from sensorgraph.diagnosis.motion.regression import TEMPERATURE, Term
from sensorgraph.diagnosis.motion.wheel_model import SlipPatch, WheelModel
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.types import Floats

MAX_VALUES = 1_000_000
"""Maximum number of rows times discs in memory: 8 MB per array."""
RADII = (0.2, 0.3, 0.42, 0.56, 0.72, 0.92, 1.2, 1.6, 2.1)
"""[m] radii that are tried; the first and the last one bound all others."""
MIN_INFORMATION = WHEEL_SLIP.sizes["s"] ** -2
"""Minimum inverse variance of the lost share, at a standard error of its materiality; with less, the robot hardly crossed the
disc."""
CELL = 0.15
"""[m] distance between the centres that are tried."""
MAX_CENTRES = 250
"""Maximum number of centres; of more, every second or third is tried."""
LATTICE = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 3), axis=-1).reshape(-1, 3)
"""(125, 3) nodes in standard deviations."""
N_LATTICES = 4
"""Number of lattices, each up to 3.5 times as fine as the previous one."""


def patch_price(model: WheelModel) -> float:
    """Return the complexity penalty [nats] of a patch."""
    return model.rows.price(len(WHEEL_SLIP.parameters))


def best_patch(model: WheelModel, terms: Sequence[Term]) -> tuple[SlipPatch, float] | None:
    """Return the most likely patch in addition to other effects, and its evidence [nats].

    Either each wheel slips at its own place, or the body slips as a whole: the more likely of the two. The
    result is None if the robot hardly moved.
    """
    is_moving = np.abs(model.wheels.distance) > MIN_MOTION
    positions = model.rows.increment_poses[is_moving, :2]
    if not len(positions):
        return None
    cells = np.unique(np.round(positions / CELL).astype(np.intp), axis=0)
    if len(cells) > MAX_CENTRES:
        cells = cells[:: len(cells) // MAX_CENTRES + 1]
    centres = cells * CELL
    discs = np.concatenate([np.column_stack([centres, np.full(len(centres), r)]) for r in RADII])
    found = [_best_disc(model, discs, track, terms) for track in (model.robot.wheels.base, 0.0)]
    return max(found, key=lambda one: one[1])


def _best_disc(
    model: WheelModel, discs: Floats, track: float, terms: Sequence[Term]
) -> tuple[SlipPatch, float]:
    """Return the best of discs (n, 3) and of the lattices around it, and its evidence [nats]."""
    gains, _ = gains_of_discs(model, discs, track, terms)
    near, more_gains, _, _ = _posterior(model, discs[int(np.argmax(gains))], track, terms)
    x, y, r = (float(value) for value in near[int(np.argmax(more_gains))])
    patch = SlipPatch(x=x, y=y, r=r, track=track, covariance=np.zeros((4, 4)))
    return patch, float(more_gains.max()) - patch_price(model)


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
    lost = np.clip(score / information, 0.0, 1.0)
    gains = lost * score - 0.5 * lost**2 * information
    gains[information < MIN_INFORMATION] = 0.0
    for i, patch in enumerate(model.patches):  # the same floor does not slip twice
        if model.patch_term(i) in terms:
            apart = np.hypot(discs[:, 0] - patch.x, discs[:, 1] - patch.y)
            gains[apart < np.minimum(discs[:, 2], patch.r)] = 0.0
    return gains, lost


def refine_patch(model: WheelModel, i: int, terms: Sequence[Term]) -> None:
    """Move a patch to the disc nearest to its posterior mean, and compute the covariance of s, x, y, r around it."""
    rest = [term for term in terms if term != model.patch_term(i)]
    track = model.patches[i].track
    discs, _, lost, weight = _posterior(model, model.patches[i].disc, track, rest)
    values = np.column_stack([lost, discs])
    middle = weight @ values
    likely = np.flatnonzero(weight >= 1 / len(weight))  # more than the average
    nearest = likely[np.argmin(((values[likely, 1:] - middle[1:]) ** 2).sum(axis=1))]
    x, y, r = (float(value) for value in discs[nearest])
    off = values - values[nearest]
    covariance = (off * weight[:, None]).T @ off
    model.patches[i] = SlipPatch(x=x, y=y, r=r, track=track, covariance=covariance)
    model.whiten()


def _posterior(
    model: WheelModel, disc: Floats, track: float, terms: Sequence[Term]
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the discs (n, 3) of the last lattice around a disc, with gains [nats], lost shares and weights (n,).

    The most likely disc of all lattices is the first one.
    """
    best = middle = np.array([disc[0], disc[1], np.log(disc[2])])
    covariance = np.diag([(0.5 * disc[2] + CELL) ** 2] * 2 + [0.5])
    for _ in range(N_LATTICES):
        axes = np.linalg.cholesky(covariance)
        x = np.concatenate([best[None], middle + LATTICE @ axes.T])
        x[:, 2] = np.clip(x[:, 2], *np.log([RADII[0], RADII[-1]]))
        discs = np.column_stack([x[:, :2], np.exp(x[:, 2])])
        gains, lost = gains_of_discs(model, discs, track, terms)
        log_p = gains / TEMPERATURE - 2 * x[:, 2]
        weight = np.exp(log_p - log_p.max())
        weight /= weight.sum()
        best, middle = x[int(np.argmax(gains))], weight @ x
        off = x - middle
        covariance = (off * weight[:, None]).T @ off + axes @ axes.T / 12
    return discs, gains, lost, weight
