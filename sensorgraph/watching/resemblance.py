"""Is a scan taken at a pose of the graph, or at another place that resembles it: the share of its readings that fit.

Walls resemble walls: of the readings of another room, some fit at the pose of the graph that matches them best. With
the ratio R_i of the density of reading i at the pose to that of any reading in the place, and the share q of readings
that the graph predicts, the likelihood of a scan is

    ∫ f(q) prod_i (q R_i + 1 - q)^w dq,

where w is the share of independent readings. At the pose, q has the density f(q) = a q^(a - 1), whose mean a / (a + 1)
is the prior share of predicted readings. At another place, any share is equally probable: f(q) = 1.

A robot that was followed may leave what the graph knows. Where the graph answers only a share of the rays, its scan is of
known surroundings with this probability, and otherwise it may resemble them by any share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sensorgraph.types import Bools, Floats
from sensorgraph.watching.readings import ReadingEvidence

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
"""Gauss-Legendre quadrature of the integral; with 60 independent readings, its error is below 0.01 nats."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Resemblance:
    """Log-likelihoods of one scan at poses, relative to readings from anywhere in the place."""

    here: Floats
    """(n_poses,) [nats] if the robot is at the pose."""
    elsewhere: Floats
    """(n_poses,) [nats] if it is at another place, which resembles this pose by any share."""


def resemblance_of(found: ReadingEvidence, confirmed: Bools, share: float) -> Resemblance:
    """Return the two log-likelihoods of a scan at poses.

    Parameters
    ----------
    confirmed : (n_poses,) Whether the robot was followed to the pose. It may leave what the graph knows, and a ray that the
        graph does not answer counts as much as at the best other pose. Otherwise, such a reading is not predicted.
    share : Share of independent readings.
    """
    known = np.where(found.known, found.ratios, 0.0)
    unanswered = np.where(confirmed[:, None], known.max(axis=0), math.log(1.0 - found.predicted))
    ratios = np.where(found.known | ~found.read, known, unanswered)
    q, weights = 0.5 * (NODES + 1.0), 0.5 * WEIGHTS
    odds = np.maximum((np.exp(ratios) - 1.0) / found.predicted, -1.0)  # R - 1
    scans = share * np.log1p(q[:, None, None] * odds).sum(axis=2)  # (24, n_poses)
    power = found.predicted / (1.0 - found.predicted)
    elsewhere = _log_sum(scans, weights)
    here = _log_sum(scans, weights * power * q ** (power - 1.0))
    knows = np.where(confirmed, found.answered, 1.0)
    with np.errstate(divide="ignore"):
        mixed = np.logaddexp(np.log(knows) + here, np.log1p(-knows) + elsewhere)
    return Resemblance(here=np.asarray(mixed), elsewhere=elsewhere)


def _log_sum(logs: Floats, weights: Floats) -> Floats:
    """Return log sum_j weights_j exp(logs_jk)."""
    return np.asarray(np.logaddexp.reduce(logs + np.log(weights)[:, None], axis=0))
