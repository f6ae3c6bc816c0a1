"""Search for a slippery patch: discs on a grid, then random steps around the best, then its spread."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.motion.settings import EVIDENCE, ODOMETRY
from sensorgraph.diagnosis.motion.wheels.columns import WheelTerm
from sensorgraph.diagnosis.motion.wheels.model import SlipPatch, WheelModel
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.types import Floats

PATCH = ODOMETRY.patch
PATCH_PRICE = EVIDENCE.price * len(WHEEL_SLIP.parameters)
"""[nats] complexity penalty of a patch."""
MAX_VALUES = 1_000_000
"""Maximum number of rows times discs in memory: 8 MB per array."""


def best_patch(
    model: WheelModel, terms: Sequence[WheelTerm], rng: np.random.Generator
) -> tuple[SlipPatch, float] | None:
    """Return the most likely patch in addition to other effects, and its evidence [nats].

    Either each wheel slips at its own place, or the body slips as a whole: the more likely of the two. The
    result is None if the robot hardly moved.
    """
    is_moving = np.abs(model.wheels.distance) > PATCH.min_moving
    positions = model.rows.increment_poses[is_moving, :2]
    if len(positions) < PATCH.min_positions:
        return None
    cells = np.unique(np.round(positions / PATCH.cell).astype(np.intp), axis=0)
    if len(cells) > PATCH.max_centres:
        cells = cells[:: len(cells) // PATCH.max_centres + 1]
    centres = cells * PATCH.cell
    discs = np.concatenate([np.column_stack([centres, np.full(len(centres), r)]) for r in PATCH.radii])
    found = [_best_disc(model, discs, track, terms, rng) for track in (model.robot.wheels.base, 0.0)]
    return max(found, key=lambda one: one[1])


def _best_disc(
    model: WheelModel, discs: Floats, track: float, terms: Sequence[WheelTerm], rng: np.random.Generator
) -> tuple[SlipPatch, float]:
    """Return the best of discs (n, 3), improved by random steps, and its evidence [nats]."""
    gains, _ = gains_of_discs(model, discs, track, terms)
    disc = discs[int(np.argmax(gains))]
    for step in PATCH.first_steps:
        near = disc + step * rng.uniform(-PATCH.first_spread, PATCH.first_spread, size=(PATCH.n_first, 3))
        near[:, 2] = np.clip(near[:, 2], *PATCH.radius_range)
        near = np.concatenate([disc[None], near])
        gains, _ = gains_of_discs(model, near, track, terms)
        disc = near[int(np.argmax(gains))]
    x, y, r = (float(value) for value in disc)
    patch = SlipPatch(x=x, y=y, r=r, track=track, covariance=np.zeros((4, 4)))
    return patch, float(gains.max()) - PATCH_PRICE


def gains_of_discs(
    model: WheelModel, discs: Floats, track: float, terms: Sequence[WheelTerm]
) -> tuple[Floats, Floats]:
    """Return the gain [nats] and the lost share of the motion (n_discs,) of each disc, given a set of effects.

        lost = clip(score / information, 0, max_slip),   gain = lost score - lost² information / 2

    The free effects are projected out of the information.
    """
    regression = model.regression
    fit = regression.solve(model.prior(terms))
    residual = regression.y - regression.A @ fit.theta
    free = np.diag(fit.covariance) > 0
    C = fit.covariance[np.ix_(free, free)]
    score, total, information = (np.zeros(len(discs)) for _ in range(3))
    at_a_time = max(1, MAX_VALUES // len(residual))
    for first in range(0, len(discs), at_a_time):  # a long run has hundreds of thousands of rows
        some = slice(first, first + at_a_time)
        Z = model.whitener(model.slip_columns(discs[some], track))
        score[some] = residual @ Z
        cross = regression.A[:, free].T @ Z
        total[some] = np.einsum("ij,ij->j", Z, Z)
        information[some] = total[some] - np.einsum("ij,ij->j", cross, C @ cross)
    information = np.maximum(information, 1e-9 + 1e-6 * total)
    lost = np.clip(score / information, 0.0, PATCH.max_slip)
    gains = lost * score - 0.5 * lost**2 * information
    gains[information < PATCH.min_information] = 0.0
    return gains, lost


def refine_patch(model: WheelModel, i: int, terms: Sequence[WheelTerm], rng: np.random.Generator) -> None:
    """Move a patch to its posterior mean, and compute its spread there."""
    rest = [term for term in terms if term != model.patch_term(i)]
    track = model.patches[i].track
    discs = _grid_about(model.patches[i].disc)
    gains, lost = gains_of_discs(model, discs, track, rest)
    for step in PATCH.refining_steps:
        near = _random_steps(discs[int(np.argmax(gains))], step, rng)
        if not len(near):
            continue
        more_gains, more_lost = gains_of_discs(model, near, track, rest)
        discs = np.concatenate([discs, near])
        gains, lost = np.append(gains, more_gains), np.append(lost, more_lost)
    model.patches[i] = _posterior_mean(discs, gains, lost, track)
    model.whiten()


def _grid_about(disc: Floats) -> Floats:
    """Return discs (n, 3) of all sizes with centres near that of a disc, and the disc itself."""
    reach, radii = PATCH.grid_reach, np.arange(*PATCH.grid_radii)
    steps = np.arange(-reach, reach + 0.01, PATCH.grid_step)
    dx, dy, r = (axis.ravel() for axis in np.meshgrid(steps, steps, radii, indexing="ij"))
    near = np.hypot(dx, dy) <= reach + 0.01
    return np.concatenate([disc[None], np.column_stack([disc[0] + dx, disc[1] + dy, r])[near]])


def _random_steps(disc: Floats, step: float, rng: np.random.Generator) -> Floats:
    """Return random discs (2 n or fewer, 3) around a disc.

    Half of them are larger or smaller with the same near edge, because these fit almost equally well.
    """
    n = PATCH.n_refining
    turn = rng.uniform(-np.pi, np.pi, size=n)
    growth = PATCH.ridge_growth * step * rng.normal(size=n)
    ridge = disc + growth[:, None] * np.stack([np.cos(turn), np.sin(turn), np.ones(n)], axis=1)
    ridge += PATCH.rim * rng.normal(size=ridge.shape)
    near = np.concatenate([disc + step * rng.normal(size=(n, 3)), ridge])
    low, high = PATCH.radius_range
    return near[(near[:, 2] > low) & (near[:, 2] < high)]


def _posterior_mean(discs: Floats, gains: Floats, lost: Floats, track: float) -> SlipPatch:
    """Return the disc nearest to the posterior mean of discs (n, 3), and the spread of s, x, y, r around it."""
    # one disc per cell, because the density of the discs is that of the search, not of the posterior
    best = np.argsort(-gains)
    best = best[gains[best] > gains[best[0]] - PATCH.credible_fall]
    _, first = np.unique(np.round(discs[best] / PATCH.posterior_cell), axis=0, return_index=True)
    best = best[first]
    # scale-invariant prior of a patch of unknown size: 1 / r³
    weight = np.exp((gains[best] - gains.max()) / EVIDENCE.temperature) / discs[best, 2] ** 3
    weight /= weight.sum()
    values = np.column_stack([lost, discs])[best]
    middle = weight @ values
    nearest = int(np.argmin(((values[:, 1:] - middle[1:]) ** 2).sum(axis=1)))
    x, y, r = (float(value) for value in discs[best[nearest]])
    off = values - values[nearest]
    return SlipPatch(x=x, y=y, r=r, track=track, covariance=(off * weight[:, None]).T @ off)
