"""Scans that a search of the place joins into one view."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import takewhile

import numpy as np

from sensorgraph.localization.global_search import MIN_POINTS, LocalView
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats
from sensorgraph.watching.scan_input import ScanInput, apart, view_of
from sensorgraph.watching.settings import TrackingPriors


class KeptScans:
    """The last scans that lie apart, or that see something else than the one before."""

    def __init__(self, priors: TrackingPriors) -> None:
        self.priors = priors
        self._scans: deque[ScanInput] = deque(maxlen=priors.n_kept)

    def __iter__(self) -> Iterator[ScanInput]:
        return iter(self._scans)

    def __len__(self) -> int:
        return len(self._scans)

    @property
    def last_drift(self) -> Floats:
        """(3,) base_link at the last scan, in the frame of the dead reckoning."""
        return self._scans[-1].drift

    def add(self, now: ScanInput, *, fits: bool) -> None:
        """Keep a scan if it is apart from the last one, or most of its readings have changed.

        Parameters
        ----------
        fits : Whether its readings have about the usual evidence at the most probable mode.
        """
        s = self.priors
        if len(now.scan.points) < MIN_POINTS:
            return
        if now.observation.odometry is None:
            self._scans.clear()
        if self._scans:
            way, turn = apart(self.last_drift, now.drift)
            if way < s.keep_distance and turn < s.keep_turn and now.changed < MAJORITY:
                return
        self._scans.append(replace(now, fits=fits))

    def log_carried(self) -> Floats:
        """Return the logarithms (n,) of the probability that the robot was carried away just before each scan."""
        stamps = np.array([one.observation.stamp for one in self._scans])
        spans = np.diff(stamps, prepend=stamps[0] - self.priors.update_period)
        return np.asarray(np.log(self.priors.carried * np.maximum(spans, 0.1)))

    def view(self) -> LocalView:
        """Join the scans since the last one that fitted, or all of them if it fits.

        Scans that fitted are of the place from which the robot may have been carried.
        """
        recent = list(takewhile(lambda one: not one.fits, reversed(self._scans)))
        return view_of(recent[::-1] or list(self._scans))
