"""Readings of cones, and the stretches of wall that explain them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sensorgraph.models.cones.kernels import ranges_to_stretch
from sensorgraph.models.cones.settings import CONES
from sensorgraph.types import Bools, Floats, Ints


class Stretch(NamedTuple):
    """What is seen of a line n·p = d, n = (cos angle, sin angle) towards the side that is seen."""

    angle: float
    """[rad]"""
    offset: float
    """[m] d."""
    low: float
    """[m] abscissa t·p of one end, t = (-n_y, n_x) ..."""
    high: float
    """... and of the other."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ConeReadings:
    """Readings, each of the nearest surface in a cone."""

    origins: Floats
    """(n, 2) [m] in map."""
    directions: Floats
    """(n, 2) unit, of the axes."""
    halves: Floats
    """(n,) [rad] half the opening angles; 0: a thin ray."""
    ranges: Floats
    """(n,) [m]; +inf: nothing up to `range_max`."""
    range_max: float

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def returned(self) -> Bools:
        """(n,) something was seen."""
        return np.isfinite(self.ranges)

    @property
    def reach(self) -> Floats:
        """(n,) [m] up to where the cone was clear."""
        return np.minimum(self.ranges, self.range_max)

    def take(self, index: Ints | Bools | slice) -> ConeReadings:
        """Return some of the readings."""
        return replace(
            self,
            origins=np.ascontiguousarray(self.origins[index]),  # kernels are compiled for this layout
            directions=np.ascontiguousarray(self.directions[index]),
            halves=np.ascontiguousarray(self.halves[index]),
            ranges=np.ascontiguousarray(self.ranges[index]),
        )

    def to(self, stretch: Stretch) -> tuple[Floats, Floats]:
        """Return ranges (n,) [m] to the nearest point of a stretch, inf where it is in no cone, and its abscissae (n,)."""
        r, t = np.empty(len(self)), np.empty(len(self))
        nx, ny = float(np.cos(stretch.angle)), float(np.sin(stretch.angle))
        ranges_to_stretch(
            self.origins,
            self.directions,
            self.halves,
            nx,
            ny,
            stretch.offset,
            stretch.low,
            stretch.high,
            r,
            t,
        )
        return r, t

    def refit(self, stretch: Stretch, sigma: float, *, with_ends: bool = False) -> Stretch:
        """Move a stretch so that these readings end on it: one step of Gauss and Newton.

        A stretch that turns by da, shifts by dd and is cut at its end e carries the nearest point along; what the range
        changes by is the part of that along the ray. A reading of the line itself tells of da and dd as a thin ray does.

        Parameters
        ----------
        sigma : [m] noise of the readings; those `fit_sigmas` off are left out
        with_ends : move the ends, too, by the readings that are nearest to them
        """
        r, t = self.to(stretch)
        cos, sin = np.cos(stretch.angle), np.sin(stretch.angle)
        with np.errstate(invalid="ignore"):
            e = self.ranges - r
            near = np.isfinite(e) & (np.abs(e) < CONES.fit_sigmas * sigma)
        if near.sum() < 3:
            return stretch
        e, r, t, origins = e[near], r[near], t[near], self.origins[near]
        height = origins @ np.array([cos, sin]) - stretch.offset  # (n,) of the sensor above the line
        along = t - origins @ np.array([-sin, cos])  # (n,) from its foot to the nearest point
        middle = float(t.mean())
        at_low, at_high = (np.abs(t - end) < ON_END for end in (stretch.low, stretch.high))
        at_end = at_low | at_high
        scale = np.where(
            at_end, -height / r, -r / height
        )  # d r / d offset: of a point that stays, of a ray that does
        slopes = np.stack(
            [
                np.where(
                    at_end, (along * stretch.offset + height * t) / r + scale * middle, scale * -(t - middle)
                ),
                scale,
                np.where(at_low, along / r, 0.0),
                np.where(at_high, along / r, 0.0),
            ]
        )  # (4, n)
        if not with_ends:
            slopes = slopes[:2]
        prior = sigma / np.array([CONES.turn_prior, CONES.shift_prior, CONES.shift_prior, CONES.shift_prior])
        step = np.zeros(4)
        step[: len(slopes)] = np.linalg.solve(
            slopes @ slopes.T + np.diag(prior[: len(slopes)] ** 2), slopes @ e
        )
        turn, shift, low, high = step.tolist()
        return Stretch(
            stretch.angle + turn,
            stretch.offset + shift + middle * turn,
            stretch.low + low,
            stretch.high + high,
        )


ON_END = 1e-9
"""[m] within which the nearest point is an end."""


def loss(ranges: Floats, predicted: Floats, sigma: float, range_max: float) -> Floats:
    """Return what each reading (n,) [m] is unlikely by [nats], given a predicted range (n,); held at `fit_sigmas`."""
    e = (np.minimum(ranges, range_max) - np.minimum(predicted, range_max)) / sigma
    return 0.5 * np.minimum(e * e, CONES.fit_sigmas**2)
