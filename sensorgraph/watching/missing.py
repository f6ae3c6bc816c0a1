"""How much evidence another pose could add to that of the most probable mode: when a search for it is worthwhile."""

from __future__ import annotations

import math

from sensorgraph.watching.modes import Mode
from sensorgraph.watching.settings import TrackingPriors

FITTING = 0.7
"""Share of the usual evidence above which readings fit a pose."""


class MissingEvidence:
    """Evidence that another place could add since the scans fit the most probable mode less well than usual.

    Parameters
    ----------
    usual : [nats] Evidence of an answered reading that is expected at the right pose. It is followed.
    log_places : Logarithm of the number of places that can be told apart.
    """

    def __init__(self, usual: float, log_places: float, priors: TrackingPriors) -> None:
        self.usual, self.log_places, self.priors = usual, log_places, priors
        self.nats = 0.0
        self.limit = log_places
        """[nats] from which a search is worthwhile: what a found pose pays. It doubles with each search in vain."""

    @property
    def is_enough(self) -> bool:
        """Whether a search is worthwhile."""
        return self.nats > self.limit

    def fits(self, main: Mode | None) -> bool:
        """Tell whether the readings of the last scan fit a mode."""
        return main is not None and main.evidence > FITTING * self.usual

    def add(self, main: Mode | None, n: float, weight: float) -> None:
        """Count a scan.

        Parameters
        ----------
        main : The most probable mode; None without any.
        n : Number of independent readings.
        weight : Share of new evidence in the scan.
        """
        if main is None:
            self.nats += weight * self.usual * n + 1.0
            return
        missing = weight * n * main.answered * (FITTING * self.usual - main.evidence)
        self.nats = max(self.nats + missing, 0.0)
        if self.nats == 0.0:
            self.limit = self.log_places
        if math.exp(main.score) > 0.99 and main.answered > 0.5 and main.is_matched:
            share = min(weight * self.priors.independent_distance / self.priors.usual_distance, 1.0)
            self.usual += share * (main.evidence - self.usual)

    def begin_search(self) -> None:
        """Begin again to count, with a higher limit."""
        self.nats, self.limit = 0.0, min(2.0 * max(self.limit, 1.0), 64.0 * self.log_places)
