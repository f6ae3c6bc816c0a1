"""Candidates of the model `narmax`: which terms a ray may have, and their columns.

All rays share the terms of poses and twist. A ray also has its own and its neighbours' lagged readings, alone and,
at lag 1, times the twist: a reading changes by what the robot does between two scans. A turn moves the view from ray
to ray, so that neighbours reach as far as the robot usually turns from scan to scan.
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
"""What readings at lag 1 are multiplied by."""


@dataclass(frozen=True, kw_only=True)
class NarmaxForm:
    """What terms the rays choose from."""

    lags: int
    """[scans]"""
    degree: int
    neighbours: int
    """On each side."""
    spacing: int
    """[rays] from one neighbour to the next."""
    noise_lags: int
    n_terms: int
    """Most terms of a ray."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)

    @cached_property
    def shared(self) -> Terms:
        """Monomials of lagged poses and the twist; those with sin^2 are left out, since cos^2 + sin^2 = 1."""
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
        """Those of `shared` that a pose alone gives: neither lags nor twist."""
        alone = [all(f.lag == 0 and f.variable not in ("v", "omega") for f in term) for term in self.shared]
        return np.flatnonzero(alone)

    @cached_property
    def readings(self) -> list[tuple[int, int, str]]:
        """(neighbour, lag, factor) of each reading term; neighbour -1 is the ray to the right, factor is of the twist."""
        offsets = [self.spacing * o for o in range(-self.neighbours, self.neighbours + 1)]
        offsets.sort(key=lambda o: (abs(o), o))
        plain = [(o, lag, "") for o in offsets for lag in range(1, self.lags + 1)]
        return plain + [(o, 1, factor) for factor in FACTORS for o in offsets if self.lags]

    @property
    def reach(self) -> int:
        """[rays] to the farthest neighbour."""
        return self.neighbours * self.spacing

    @property
    def n_shared(self) -> int:
        """Bound of the count of shared terms, known before they are listed."""
        return comb(4 * (self.lags + 1) + len(TWIST) + self.degree, self.degree)

    @property
    def n_candidates(self) -> int:
        """Of one ray that has all its neighbours."""
        return len(self.shared) + len(self.readings)

    def names(self, ray: int) -> list[str]:
        """Name all candidates of one ray; readings are called after their ray, `r67(k-1)`."""
        own = [
            f"r{max(ray + offset, 0)}(k-{lag})" + (f"*{factor}" if factor else "")
            for offset, lag, factor in self.readings
        ]
        return [*self.shared.names, *own]


@dataclass(frozen=True, kw_only=True)
class ReadingScale:
    """How readings are scaled inside the fit: (r - centre) / width."""

    centre: float
    """[m]"""
    width: float
    """[m]"""

    @classmethod
    def of(cls, ranges: Floats) -> ReadingScale:
        """Take mean and spread of all returns."""
        known = ranges[np.isfinite(ranges)]
        return cls(centre=float(known.mean()), width=max(float(known.std()), 1e-3))


class ReadingColumns:
    """Columns of reading terms at some rows, each made when it is asked for."""

    def __init__(
        self, form: NarmaxForm, scale: ReadingScale, readings: Floats, motion: ScanSequence, rows: Ints
    ) -> None:
        self.form, self.rows = form, rows
        v, omega = motion.twists[rows].T
        self.factors = dict(zip(FACTORS, (v, omega, omega**2), strict=True))
        self.scaled = (readings - scale.centre) / scale.width
        """(n, n_rays) held readings; nan before the first of a stretch."""

    def all_known(self) -> Bools:
        """Tell at which rows all readings that a ray may use are known (n_rows, n_rays)."""
        own = np.ones((len(self.rows), self.scaled.shape[1]), dtype=np.bool_)
        for lag in range(1, self.form.lags + 1):
            own &= np.isfinite(self.scaled[self.rows - lag])
        out = own.copy()
        for offset in range(self.form.spacing, min(self.form.reach, own.shape[1] - 1) + 1, self.form.spacing):
            out[:, offset:] &= own[:, :-offset]
            out[:, :-offset] &= own[:, offset:]
        return out

    def of_all(self, rows: slice, rays: slice) -> Floats:
        """Return (n_rows, n_columns): each lag of these rays, then lag 1 times each factor; 0 where not known."""
        k = self.rows[rows]
        lagged = [np.nan_to_num(self.scaled[k - lag, rays]) for lag in range(1, self.form.lags + 1)]
        products = [lagged[0] * self.factors[name][rows, None] for name in FACTORS] if lagged else []
        return np.concatenate([*lagged, *products], axis=1) if lagged else np.zeros((len(k), 0))

    def places(self, ray: int, rays: slice) -> Ints:
        """Return where the terms (n_readings,) of a ray stand among the columns of `of_all`; -1: it has no such term."""
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
        """Return the columns (n_rows, len(which)) of some reading terms of one ray, at rows given by place."""
        out = np.empty((len(rows), len(which)))
        for j, term in enumerate(which.tolist()):
            offset, lag, factor = self.form.readings[term]
            out[:, j] = self.scaled[self.rows[rows] - lag, ray + offset]
            if factor:
                out[:, j] *= self.factors[factor][rows]
        return out


def form_from(data: Mapping[str, Any]) -> NarmaxForm:
    """Restore what `to_dict` gave.

    Raises
    ------
    ValueError : a number is not whole or below 0, or there is no spacing
    """
    form = NarmaxForm(**data)
    if not all(type(n) is int and n >= 0 for n in form.to_dict().values()) or form.spacing < 1:
        raise ValueError(f"the form is {form}, expected whole numbers from 0")
    return form
