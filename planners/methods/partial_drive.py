"""A car's drive during planning: its curves so far, and their logged bins. It can be continued from before its end."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planners.cars.car_curve import car_section
from planners.coverage import Coverage
from planners.curve import Curve, join_curves
from planners.search.log_phases import PHASES, met
from planners.types import Bools, Floats
from planners.vehicle import Limits


@dataclass(frozen=True, kw_only=True, eq=False)
class PartialDrive:
    """Consecutive curves of a car; immutable: every change returns a new drive."""

    grid: Coverage
    """Grid of bins; the counts are not used."""
    rate: float
    """[Hz] of the log."""
    limits: Limits
    here: Floats
    """(3,) [m, m, rad] pose of the car."""
    curves: tuple[Curve, ...] = ()
    clock: float = 0.0
    """[s] start of the last curve."""
    earlier: Bools | None = None
    """(PHASES, nx, ny, n_phi) bins in a log of each phase before the last curve; None: no bins."""

    @cached_property
    def seen(self) -> Bools:
        """(PHASES, nx, ny, n_phi) bins in a log of each phase."""
        if not self.curves:
            return np.zeros((PHASES, *self.grid.reachable.shape), dtype=np.bool_)
        last = met(self.curves[-1], self.grid, self.rate, self.clock)
        return last if self.earlier is None else last | self.earlier

    @property
    def met(self) -> Bools:
        """(nx, ny, n_phi) bins in a log of every phase."""
        return np.asarray(self.seen.all(axis=0))

    @property
    def duration(self) -> float:
        """[s]"""
        return self.clock + self.curves[-1].duration if self.curves else 0.0

    @property
    def curve(self) -> Curve:
        """All curves as one; there must be at least one."""
        return join_curves(list(self.curves))

    def extended(self, curve: Curve) -> PartialDrive:
        """Return the drive continued along a curve that starts at `here`."""
        return replace(
            self,
            here=_end(curve),
            curves=(*self.curves, curve),
            clock=self.duration,
            earlier=self.seen if self.curves else None,
        )

    def replaced_by(self, curve: Curve) -> PartialDrive:
        """Return the drive along one curve instead of all curves."""
        return replace(self, curves=(), clock=0.0, earlier=None).extended(curve)

    def without_last(self, back: float) -> PartialDrive | None:
        """Return the drive without its last `back` [s]; None if the whole last curve would be removed."""
        if back == 0.0:
            return self
        if not self.curves:
            return None
        *first, curve = self.curves
        last = int(np.searchsorted(curve.starts, curve.duration - back, side="right")) - 1
        if last <= 0:
            return None
        shorter = car_section(curve, 0, last, self.limits)
        return replace(self, here=_end(shorter), curves=(*first, shorter))


def _end(curve: Curve) -> Floats:
    return np.asarray(curve.sample(np.array([curve.duration]))[0][0])
