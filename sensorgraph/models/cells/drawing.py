"""Drawing of readings among cells: the outcome of each ray, and its error about the face."""

from __future__ import annotations

import numpy as np

from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.cells.distribution import KNOTS, shape_mixtures
from sensorgraph.models.cells.ray_march import CellTable, list_candidates
from sensorgraph.models.cells.set_aside import summarise_poses
from sensorgraph.models.distribution import Mixture
from sensorgraph.models.mixture import MODE, P_OFF
from sensorgraph.types import Floats

SMALLEST = 1e-12
"""Smallest probability of a quantile."""


def draw_readings(
    table: CellTable, learned: tuple[Floats, Floats, float], lasers: Floats, bearings: Floats, uniform: Floats,
    normal: Floats,
) -> Floats:  # fmt: skip
    """Draw one reading (n_poses, n_rays) [m] of each ray at poses (n_poses, 3) of the laser.

    `uniform` and `normal` (n_poses, n_rays) are the random numbers; equal numbers give equal readings. The uniform number
    selects the outcome and whether its error is wide. Outcomes are ordered: no return, candidates off the mode from far to
    near, readings that only noise moves off the mode, and readings near the mode. Their probabilities are those of
    `CellModel.predict`, with the calibrated p_off. A reading near the mode has the distribution of the mixture within
    `OFF_DISTANCE` of it.

    Parameters
    ----------
    learned : `reliability` of the mode, `tails` and `nothing` of the model.
    """
    out = np.full(uniform.shape, np.inf)
    reliability, tails, nothing = learned
    summaries, _, _ = summarise_poses(table, lasers, bearings, "mode")
    from scipy.special import ndtr, ndtri  # imported here, since it takes long and only drawing needs it

    p_off = np.interp(summaries[..., P_OFF], KNOTS, reliability)
    quantiles = ndtr(normal)
    for i, pose in enumerate(lasers):
        # room for the mixture of the readings near the mode, whose candidates may be split
        r, w, sigma, survival = (part[0] for part in list_candidates(table, pose[None], bearings, room=2))
        mode = summaries[i, :, MODE]
        here = _spread_near(mode, r, w, sigma, table.rough)
        width = tails[1:, None] * here  # (2, n_rays) of narrow and wide errors
        exceeds = np.maximum(2.0 * ndtr(-OFF_DISTANCE / width), 1e-300)
        of_width = tails[0] * exceeds[1]
        by_noise = (1.0 - tails[0]) * exceeds[0] + of_width
        # the other readings beyond reach are longer ranges, which are unknown
        beyond = survival * nothing
        no_return = beyond / np.maximum(w.sum(axis=1) + beyond, 1e-300)
        off = np.where(np.abs(r - mode[:, None]) > OFF_DISTANCE, w, 0.0)
        # (n_rays, n_most) of this candidate and all farther ones
        to_end = np.cumsum(off[:, ::-1], axis=1)[:, ::-1]
        by_cells = to_end[:, 0]
        all_off = by_cells + by_noise * np.maximum(w.sum(axis=1) - by_cells, 0.0)
        number = (uniform[i] - no_return) / np.maximum(1.0 - no_return, 1e-300)
        is_there = (number >= 0) & (w > 0).any(axis=1)
        is_off = is_there & (number < p_off[i]) & (all_off > 0)
        share = np.where(is_off, all_off * number / np.maximum(p_off[i], 1e-300), np.inf)
        rows = np.flatnonzero(share < by_cells)
        k = (to_end[rows] > share[rows, None]).sum(axis=1) - 1
        moved_by_noise, is_on = is_off & ~(share < by_cells), is_there & ~is_off
        # negative for wide errors, which come first
        left = (share - by_cells) * by_noise - (all_off - by_cells) * of_width
        which = (left < 0).astype(np.intp), np.arange(len(left))
        far_end, quantile = exceeds[which], quantiles[i]
        far = width[which] * np.sign(quantile - 0.5) * -ndtri(far_end * np.minimum(quantile, 1.0 - quantile))
        out[i, rows] = r[rows, k] + sigma[rows, k] * normal[i, rows]
        out[i, moved_by_noise] = mode[moved_by_noise] + far[moved_by_noise]
        if is_on.any():
            means, weights, widths = r[None, is_on], w[None, is_on], sigma[None, is_on]
            mixture = _mixture_of(means, weights, widths, survival[None, is_on], table, reliability, tails)
            at = mode[None, is_on]
            low, high = mixture.cdf(at - OFF_DISTANCE), mixture.cdf(at + OFF_DISTANCE)
            inside = np.clip(low + (high - low) * quantile[is_on], SMALLEST, 1.0 - SMALLEST)
            out[i, is_on] = np.clip(mixture.quantile(inside), at - OFF_DISTANCE, at + OFF_DISTANCE)[0]
    return out


def _mixture_of(
    means: Floats, weights: Floats, widths: Floats, survival: Floats, table: CellTable, reliability: Floats,
    tails: Floats,
) -> Mixture:  # fmt: skip
    """Return the mixtures (1, n_rays) of returns of candidates, shaped in place, as `CellModel.mixture` does."""
    shape_mixtures(means, weights, widths, table.reach, reliability, tails)
    return Mixture(
        means=means, weights=weights, widths=widths, sources=np.full(means.shape, -1), p_no_return=survival,
    )  # fmt: skip


def _spread_near(mode: Floats, r: Floats, w: Floats, sigma: Floats, otherwise: float) -> Floats:
    """Return the spread [m] of the readings near the mode (n_rays,), over candidates (n_rays, n_most)."""
    on = np.where(np.abs(r - mode[:, None]) <= OFF_DISTANCE, w, 0.0)
    total = on.sum(axis=1)
    return np.where(
        total > 0, np.sqrt((on * sigma**2).sum(axis=1) / np.where(total > 0, total, 1.0)), otherwise
    )
