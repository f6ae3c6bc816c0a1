"""Readings of cones, and the visible stretches of walls that explain them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from planners.types import ROUND_OFF
from sensorgraph.models.cones.kernels import ranges_to_stretch
from sensorgraph.models.cones.settings import CONES
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import FIT_SIGMAS
from sensorgraph.types import Bools, Floats, Ints


class Stretch(NamedTuple):
    """The visible part of a line n·p = d, with n = (cos angle, sin angle) towards the visible side."""

    angle: float
    """[rad] Angle of the normal n."""
    offset: float
    """[m] Offset d."""
    low: float
    """[m] Abscissa t·p of the lower end, t = (-n_y, n_x)."""
    high: float
    """[m] Abscissa of the upper end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ConeReadings:
    """Readings of the nearest surface in cones."""

    origins: Floats
    """(n, 2) [m] positions of the sensor in map."""
    directions: Floats
    """(n, 2) unit vectors of the axes."""
    halves: Floats
    """(n,) [rad] half opening angles; 0: a thin ray."""
    ranges: Floats
    """(n,) [m] measured ranges; +inf: no return up to `range_max`."""
    range_max: float

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def returned(self) -> Bools:
        """(n,) whether the reading is a return."""
        return np.isfinite(self.ranges)

    @property
    def reach(self) -> Floats:
        """(n,) [m] range up to which the cone is clear."""
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
        """Return the ranges (n,) [m] to the nearest point of a stretch (inf: not in the cone) and its abscissae (n,)."""
        r, t = np.empty(len(self)), np.empty(len(self))
        nx, ny = float(np.cos(stretch.angle)), float(np.sin(stretch.angle))
        ranges_to_stretch(
            self.origins, self.directions, self.halves, nx, ny, stretch.offset, stretch.low, stretch.high,
            r, t,
        )  # fmt: skip
        return r, t

    def refit(self, stretch: Stretch, sigma: float, *, with_ends: bool = False) -> Stretch:
        """Fit a stretch to the readings that end on it, by one Gauss-Newton step.

        The step of (angle, offset, low, high) minimises |e - slopes' step|² + |prior step|², with e = measured - r.
        The range is r = sqrt(h² + s²). If the nearest point is an end: (dr/doffset = -h / r, dr/dend = s / r).
        Otherwise: (dr/doffset = -r / h).

        Parameters
        ----------
        sigma : [m] Noise of the readings; residuals above `FIT_SIGMAS` are not used.
        with_ends : Also fit the ends, to the readings whose nearest point is an end.
        """
        r, t = self.to(stretch)
        cos, sin = np.cos(stretch.angle), np.sin(stretch.angle)
        with np.errstate(invalid="ignore"):
            e = self.ranges - r
            near = np.isfinite(e) & (np.abs(e) < FIT_SIGMAS * sigma)
        if near.sum() < 3:
            return stretch
        e, r, t, origins = e[near], r[near], t[near], self.origins[near]
        height = (
            origins @ np.array([cos, sin]) - stretch.offset
        )  # (n,) h: distance of the sensor from the line
        along = t - origins @ np.array([-sin, cos])  # (n,) s: from the foot to the nearest point
        middle = float(t.mean())
        at_low, at_high = (np.abs(t - end) < ROUND_OFF for end in (stretch.low, stretch.high))
        at_end = at_low | at_high
        # dr/doffset, where the nearest point is an end or a point of the line
        scale = np.where(at_end, -height / r, -r / height)
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
        prior = sigma / np.array([FACES.turn_prior, *3 * [CONES.shift_prior]])
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


def loss(ranges: Floats, predicted: Floats, sigma: float, range_max: float) -> Floats:
    """Return ½ min(e² / sigma², FIT_SIGMAS²): the negative log likelihood [nats] of readings (n,) given ranges (n,)."""
    e = (np.minimum(ranges, range_max) - np.minimum(predicted, range_max)) / sigma
    return 0.5 * np.minimum(e * e, FIT_SIGMAS**2)
