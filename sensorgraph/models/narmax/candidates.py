"""Candidate terms of the model `narmax` for each ray, and their columns in the regression.

All rays share the terms of poses and twist. In addition, each ray uses lagged readings of itself and of its
neighbours, alone and, at lag 1, times the twist: a reading changes with the motion between two scans. A turn shifts the view
from ray to ray, so neighbours reach as far as the robot usually turns between scans.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from math import comb
from typing import Any

import numpy as np

from robotmodic_ident import Terms, polynomial
from sensorgraph.models.narmax.sequences import ScanSequence
from sensorgraph.types import Bools, Floats, Ints

TWIST = ("v(k)", "omega(k)")
FACTORS = (*TWIST, "omega(k)^2")
"""Factors of readings at lag 1."""


@dataclass(frozen=True, kw_only=True)
class NarmaxForm:
    """Form of the equations: the set of candidate terms."""

    lags: int
    """[scans] Largest lag."""
    degree: int
    neighbours: int
    """Number of neighbouring rays on each side."""
    spacing: int
    """[rays] Distance between neighbours."""
    noise_lags: int
    n_terms: int
    """Maximum number of terms of a ray."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)

    @cached_property
    def shared(self) -> Terms:
        """Monomials of lagged poses and the twist; those with sin^2 are omitted, since cos^2 + sin^2 = 1."""
        names = ["x", "y", "cos_phi", "sin_phi"]
        signals = [f"{n}(k-{lag})" if lag else f"{n}(k)" for lag in range(self.lags + 1) for n in names]
        every = polynomial([*signals, *TWIST], self.degree)
        kept = [
            i
            for i, term in enumerate(every)
            if not any(f.variable == "sin_phi" and f.power > 1 for f in term)
        ]
        return every[kept]

    @cached_property
    def static(self) -> Ints:
        """Indices of the terms of `shared` that depend on the current pose only: no lags, no twist."""
        alone = [all(f.lag == 0 and f.variable not in ("v", "omega") for f in term) for term in self.shared]
        return np.flatnonzero(alone)

    @cached_property
    def readings(self) -> list[tuple[int, int, str]]:
        """(neighbour, lag, factor) of each reading term; neighbour -1 is the next ray to the right, factor is of `FACTORS`."""
        offsets = [self.spacing * o for o in range(-self.neighbours, self.neighbours + 1)]
        offsets.sort(key=lambda o: (abs(o), o))
        plain = [(o, lag, "") for o in offsets for lag in range(1, self.lags + 1)]
        return plain + [(o, 1, factor) for factor in FACTORS for o in offsets if self.lags]

    @property
    def reach(self) -> int:
        """[rays] Distance to the farthest neighbour."""
        return self.neighbours * self.spacing

    @property
    def n_shared(self) -> int:
        """Upper bound of the number of shared terms, known before they are listed."""
        return comb(4 * (self.lags + 1) + len(TWIST) + self.degree, self.degree)

    @property
    def n_candidates(self) -> int:
        """Number of candidates of a ray that has all its neighbours."""
        return len(self.shared) + len(self.readings)

    def names(self, ray: int) -> list[str]:
        """Return the names of all candidates of one ray; readings are named after their ray, `r67(k-1)`."""
        own = [
            f"r{max(ray + offset, 0)}(k-{lag})" + (f"*{factor}" if factor else "")
            for offset, lag, factor in self.readings
        ]
        return [*self.shared.names, *own]


@dataclass(frozen=True, kw_only=True)
class ReadingScale:
    """Scale of readings in the fit: (r - centre) / width."""

    centre: float
    """[m] Mean of the returns."""
    width: float
    """[m] Standard deviation of the returns."""

    @classmethod
    def of(cls, ranges: Floats) -> ReadingScale:
        """Return the scale of ranges, from the mean and the standard deviation of all returns."""
        known = ranges[np.isfinite(ranges)]
        return cls(centre=float(known.mean()), width=max(float(known.std()), 1e-3))


class ReadingColumns:
    """Columns of reading terms at some rows, computed on demand."""

    def __init__(
        self, form: NarmaxForm, scale: ReadingScale, readings: Floats, motion: ScanSequence, rows: Ints
    ) -> None:
        self.form, self.rows = form, rows
        v, omega = motion.twists[rows].T
        self.factors = dict(zip(FACTORS, (v, omega, omega**2), strict=True))
        self.scaled = (readings - scale.centre) / scale.width
        """(n, n_rays) scaled readings, the last one held; nan before the first of a stretch."""

    def all_known(self) -> Bools:
        """Return whether all readings that a ray may use are known (n_rows, n_rays)."""
        own = np.ones((len(self.rows), self.scaled.shape[1]), dtype=np.bool_)
        for lag in range(1, self.form.lags + 1):
            own &= np.isfinite(self.scaled[self.rows - lag])
        out = own.copy()
        for offset in range(self.form.spacing, min(self.form.reach, own.shape[1] - 1) + 1, self.form.spacing):
            out[:, offset:] &= own[:, :-offset]
            out[:, :-offset] &= own[:, offset:]
        return out

    def of_all(self, rows: slice, rays: slice) -> Floats:
        """Return the columns (n_rows, n_columns): each lag of these rays, then lag 1 times each factor; 0 where unknown."""
        k = self.rows[rows]
        lagged = [np.nan_to_num(self.scaled[k - lag, rays]) for lag in range(1, self.form.lags + 1)]
        products = [lagged[0] * self.factors[name][rows, None] for name in FACTORS] if lagged else []
        return np.concatenate([*lagged, *products], axis=1) if lagged else np.zeros((len(k), 0))

    def places(self, ray: int, rays: slice) -> Ints:
        """Return the column in `of_all` of each reading term (n_readings,) of a ray; -1: the ray has no such term."""
        width = rays.stop - rays.start
        block = {"": 0} | {name: self.form.lags + i for i, name in enumerate(FACTORS)}
        out = [
            (block[factor] + (lag - 1 if not factor else 0)) * width + ray + offset - rays.start
            if rays.start <= ray + offset < rays.stop
            else -1
            for offset, lag, factor in self.form.readings
        ]
        return np.array(out, dtype=np.intp)

    def of_ray(self, ray: int, which: Ints, rows: Ints) -> Floats:
        """Return the columns (n_rows, len(which)) of some reading terms of one ray, at rows given by index."""
        out = np.empty((len(rows), len(which)))
        for j, term in enumerate(which.tolist()):
            offset, lag, factor = self.form.readings[term]
            out[:, j] = self.scaled[self.rows[rows] - lag, ray + offset]
            if factor:
                out[:, j] *= self.factors[factor][rows]
        return out


def form_from(data: Mapping[str, Any]) -> NarmaxForm:
    """Recreate the form from the output of `to_dict`.

    Raises
    ------
    ValueError : A number is not an integer or is negative, or the spacing is 0.
    """
    form = NarmaxForm(**data)
    if not all(type(n) is int and n >= 0 for n in form.to_dict().values()) or form.spacing < 1:
        raise ValueError(f"the form is {form}, expected integers of 0 or more")
    return form
