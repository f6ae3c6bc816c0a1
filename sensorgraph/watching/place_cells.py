"""Probability that the cells of a place have changed for good: a hidden Markov model of each cell.

A cell is as the graph knows it, changed for a while, or changed for good. Let t be the probability that it is changed for a while
if it is not changed for good, and o the log-odds that it is changed for good. Evidence of e nats for a change of either kind gives

    o += e - log(1 - t + t exp(e)),        t -> t exp(e) / (1 - t + t exp(e)).

Between two scans, t returns to the share of cells that are changed for a while; exp(-dt / stay) of its distance from it remains.
So one sight does not distinguish the two kinds of change, however many readings it has. Later ones do, by the probability that
the first one would have ended meanwhile.

A thing is at least two cells wide, and passes on different sides of it meet different cells. So a reading that shows a change in
a cell is evidence for a thing around each cell next to it. A cell has changed if its own evidence is for a change, and a thing
is probably around it.
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit, logit

from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.watching.settings import PlacePriors

LEAST = 1e-6
"""Probability of a change for a while, at least, and of none."""
MOST = 30.0
"""[nats] Log-odds at most."""


class ChangeCells:
    """Evidence for one kind of change in n cells, which are numbered."""

    def __init__(self, n: int, priors: PlacePriors) -> None:
        self.priors = priors
        self.prior = float(logit(priors.changed))
        self.log_odds = np.full(n, self.prior)
        self.for_a_while = np.full(n, priors.for_a_while)
        self.looked = np.full(n, -np.inf)  # [s] of the last evidence
        self.passes = np.zeros(n, dtype=np.int32)  # that show a change
        self.first, self.last = np.full(n, np.nan), np.full(n, np.nan)  # [s] of evidence for a change
        self.shown: Ints = np.zeros(0, dtype=np.intp)
        """Cells that ever had evidence for a change."""

    def is_doubtful(self, cells: Ints) -> Bools:
        """Tell in which of some cells a change is more probable than without readings."""
        usual = self.priors.for_a_while
        return np.asarray((self.for_a_while[cells] > usual) | (self.log_odds[cells] > self.prior))

    def p(self, cells: Ints) -> Floats:
        """Return the probabilities (n,) that cells have changed for good."""
        return np.asarray(expit(self.log_odds[cells]))

    def add(self, cells: Ints, nats: Floats, stamp: float) -> None:
        """Add evidence (n,) of one scan to cells (n,); readings in one cell are of the same surface, so that their mean counts."""
        own, index, counts = np.unique(cells, return_inverse=True, return_counts=True)
        if len(own) == 0:
            return
        e = np.bincount(index, nats) / counts
        usual = self.priors.for_a_while
        t = usual + (self.for_a_while[own] - usual) * np.exp((self.looked[own] - stamp) / self.priors.stay)
        log_other = np.logaddexp(np.log1p(-t), np.log(t) + e)
        self.log_odds[own] = np.clip(self.log_odds[own] + e - log_other, -MOST, MOST)
        self.for_a_while[own] = np.clip(np.exp(np.log(t) + e - log_other), LEAST, 1.0 - LEAST)
        self.looked[own] = stamp
        self._show(own[e > 0], stamp)

    def _show(self, cells: Ints, stamp: float) -> None:
        """Note that cells (n,) show a change."""
        if np.isnan(self.first[cells]).any():
            self.shown = np.union1d(self.shown, cells)
        is_same: Bools = stamp - self.last[cells] <= self.priors.pass_gap
        self.passes[cells] += ~is_same
        self.first[cells] = np.fmin(self.first[cells], stamp)
        self.last[cells] = stamp


class ThingCells:
    """Evidence for one kind of change, in cells and of things around them; the cells (nx, ny) are numbered along y first."""

    def __init__(self, shape: tuple[int, int], priors: PlacePriors) -> None:
        n = shape[0] * shape[1]
        self.cells, self.things = ChangeCells(n, priors), ChangeCells(n, priors)
        beside = np.array([-1, 0, 1])
        self._around = (shape[1] * beside[:, None] + beside).ravel()

    def add(self, cells: Ints, nats: Floats, stamp: float) -> None:
        """Add evidence (n,) of one scan to cells (n,), none of which is at the border."""
        self.cells.add(cells, nats, stamp)
        shows = nats > 0
        around = self.around(cells[shows])
        spread = np.repeat(nats[shows], len(self._around))
        self.things.add(
            np.concatenate([around, cells[~shows]]), np.concatenate([spread, nats[~shows]]), stamp
        )

    def around(self, cells: Ints) -> Ints:
        """Return the numbers (9 n,) of cells (n,), none of which is at the border, and of those next to them."""
        return np.asarray((cells[:, None] + self._around).ravel())

    def is_doubtful(self, cells: Ints) -> Bools:
        """Tell in which of some cells a change is more probable than without readings."""
        return self.cells.is_doubtful(cells) | self.things.is_doubtful(cells)

    def probable(self) -> Ints:
        """Return the cells that have probably changed for good."""
        shown = self.cells.shown
        return np.asarray(
            shown[(self.things.p(shown) > 0.5) & (self.cells.log_odds[shown] > self.cells.prior)]
        )
