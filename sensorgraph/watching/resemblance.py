"""Is a scan taken at a pose of the graph, or at another place that resembles it: the share of its readings that fit.

Walls resemble walls: of the readings of another room, some fit at the pose of the graph that matches them best. With
the ratio R_i of the density of reading i at the pose to that of any reading in the place, and the share q of readings
that the graph predicts, the likelihood of a scan is

    ∫ f(q) prod_i (q R_i + 1 - q)^w dq,

where w is the share of independent readings. At the pose, q has the density f(q) = a q^(a - 1), whose mean a / (a + 1)
is the prior share of predicted readings. At another place, any share is equally probable: f(q) = 1.

A ray that stays in space that the graph does not know has R_i = 1, as a reading from anywhere. Or the surroundings resemble those
of another pose, whose R_i it has. Where the graph answers only the share a of the rays, these end close to the unknown: an answer
holds with the probability a. A reading that does not fit has a R_i + (1 - a) times that of unknown surroundings. So has one that
the graph does not answer, where the unknown surroundings are those of another pose. The graph may also know a surface, but not
well. Of a ray that it answers, a reading that fits has the greater R_i of both. Surroundings that resemble others do so by a share
that persists. So f counts with which the scan is more probable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.types import Floats
from sensorgraph.watching.readings import ReadingEvidence

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
"""Gauss-Legendre quadrature of the integral; with 60 independent readings, its error is below 0.01 nats."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Resemblance:
    """Log-likelihoods of one scan at poses, relative to readings from anywhere in the place."""

    here: Floats
    """(n_poses, n_poses) [nats] if the robot is at the pose of the row, and what the graph does not know there resembles the
    surroundings of the pose of the column; on the diagonal, it resembles none."""
    elsewhere: Floats
    """(n_poses,) [nats] if it is at another place, which resembles this pose by any share."""


def resemblance_of(found: ReadingEvidence, share: float) -> Resemblance:
    """Return the log-likelihoods of a scan at poses; `share` is the share of independent readings."""
    none = np.eye(len(found.ratios), dtype=np.bool_)
    other = np.where(none[:, :, None], 0.0, found.ratios)
    here, any_share = _likelihoods(found, other, share)
    return Resemblance(
        here=np.where(none, here, np.maximum(here, any_share)), elsewhere=np.diag(any_share).copy()
    )


def likelihoods_at(found: ReadingEvidence, share: float) -> Floats:
    """Return the log-likelihoods (n_poses,) of a scan at poses whose unknown surroundings resemble none, as `resemblance_of`."""
    return _likelihoods(found, np.zeros((1, 1, 1)), share)[0][:, 0]


def _likelihoods(found: ReadingEvidence, other: Floats, share: float) -> tuple[Floats, Floats]:
    """Return the log-likelihoods (n_poses, n) of a scan at poses, with the share of the pose, and with any.

    Parameters
    ----------
    other : (n_poses or 1, n, n_rays or 1) [nats] Logarithms of R_i in the surroundings that those of the pose may resemble.
    """
    own, holds = found.ratios[:, None], found.answered[:, None, None]
    doubted = np.log(holds * np.exp(own) + (1.0 - holds) * np.exp(other))
    is_known = found.known[:, None] | (other == 0.0)
    ratios = np.where((own > 0.0) & is_known, np.maximum(own, other), doubted)
    q, weights = 0.5 * (NODES + 1.0), 0.5 * WEIGHTS
    odds = np.maximum((np.exp(ratios) - 1.0) / found.predicted, -1.0)  # R - 1
    scans = share * np.array([np.log1p(each * odds).sum(axis=2) for each in q])  # (24, n_poses, n)
    power = found.predicted / (1.0 - found.predicted)
    return _log_sum(scans, weights * power * q ** (power - 1.0)), _log_sum(scans, weights)


def _log_sum(logs: Floats, weights: Floats) -> Floats:
    """Return log sum_j weights_j exp(logs_jkl)."""
    return np.asarray(np.logaddexp.reduce(logs + np.log(weights)[:, None, None], axis=0))
