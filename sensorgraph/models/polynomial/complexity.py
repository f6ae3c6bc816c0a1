"""Selection of degree, harmonics and number of terms by cross-validation on stretches of the log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from robotmodic_ident import Moments, Scale, Terms, select
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.polynomial.settings import POLYNOMIAL
from sensorgraph.models.stretches import N_FOLDS, N_STRETCHES
from sensorgraph.types import Floats, Ints, Progress

Auto = int | Literal["auto"]

MAX_RAYS, MAX_SCANS = 16, 3000
"""Maximum numbers of rays and scans used in the selection, evenly spread."""
SCANS_PER_CANDIDATE = 8
"""Minimum number of training scans per candidate term."""
MAX_ERROR_RATIO = 0.99
"""A form with more candidates must reduce the error to less than this share."""
EVERY_SIZE_TO = 12
"""Every number of terms is tried up to this one, then steps of a fifth."""


@dataclass(frozen=True, kw_only=True)
class PolynomialForm:
    """The form that all rays share, and how it was chosen."""

    degree: int
    harmonics: int
    n_terms: int
    how: str

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


def n_candidates(degree: int, harmonics: int) -> int:
    """Return the number of monomials of x, y up to a degree times 1, cos, sin up to a harmonic."""
    return (degree + 1) * (degree + 2) // 2 * (2 * harmonics + 1)


def select_form(
    scans: TrainingScans, scale: Scale, dictionary: Callable[[int, int], Terms], *, degree: Auto = "auto",
    harmonics: Auto = "auto", n_terms: Auto = "auto", progress: Progress | None = None,
) -> PolynomialForm:  # fmt: skip
    """Return the form with the smallest mean error on held-out stretches of the training scans.

    Raises
    ------
    SensorgraphError : A degree or a number of harmonics or terms is too small.
    """
    for name, value, least in (("degree", degree, 0), ("harmonics", harmonics, 0), ("terms", n_terms, 1)):
        if value != "auto" and value < least:
            raise SensorgraphError(f"{name} is {value}, expected {least} or more, or auto")
    if degree != "auto" and harmonics != "auto" and n_terms != "auto":
        size = min(int(n_terms), n_candidates(degree, harmonics))
        return PolynomialForm(degree=degree, harmonics=harmonics, n_terms=size, how="given options")
    forms = _forms(len(scans), degree, harmonics)
    table = _Folds(scans, scale, dictionary(max(d for d, _ in forms), max(h for _, h in forms)))
    best = (np.inf, 0, 0, 1)
    for k, (d, h) in enumerate(forms):  # from few to many candidates
        if progress is not None:
            progress(k, len(forms))
        sizes, errors = table.errors(dictionary(d, h), None if n_terms == "auto" else n_terms)
        least = int(np.argmin(errors))
        if errors[least] < MAX_ERROR_RATIO * best[0]:
            best = (float(errors[least]), d, h, int(sizes[least]))
    error, d, h, size = best
    how = f"mean error {error:.3f} m on {N_FOLDS} x {N_STRETCHES // N_FOLDS} held-out stretches of the training scans"
    return PolynomialForm(degree=d, harmonics=h, n_terms=size, how=how)


def _forms(n: int, degree: Auto, harmonics: Auto) -> list[tuple[int, int]]:
    """Return the pairs (degree, harmonics) that n scans support, in the order of the number of candidates."""
    degrees = range(1, POLYNOMIAL.max_degree + 1) if degree == "auto" else [degree]
    waves = range(POLYNOMIAL.max_harmonics + 1) if harmonics == "auto" else [harmonics]
    forms = sorted(((d, h) for d in degrees for h in waves), key=lambda f: (n_candidates(*f), f))
    limit = min(POLYNOMIAL.max_candidates, n // SCANS_PER_CANDIDATE)
    return [f for f in forms if n_candidates(*f) <= limit] or forms[:1]


class _Folds:
    """Moments of a sample of rays and scans without each fold, for every sub-dictionary of a dictionary."""

    def __init__(self, scans: TrainingScans, scale: Scale, terms: Terms) -> None:
        q = scans.sensor.n_rays
        returning = np.flatnonzero(np.isfinite(scans.ranges).any(axis=0))
        rays = returning[
            np.unique(np.linspace(0, len(returning) - 1, min(MAX_RAYS, q)).round().astype(np.intp))
        ]
        some = np.unique(np.linspace(0, len(scans) - 1, min(MAX_SCANS, len(scans))).round().astype(np.intp))
        poses, ranges = scans.poses[some], scans.ranges[np.ix_(some, rays)]
        self.terms = terms
        self.limits = (scans.sensor.range_min, scans.sensor.range_max)
        self.y: Floats = np.where(np.isfinite(ranges), ranges, np.nan)
        self.phi = terms.matrix({"x": poses[:, 0], "y": poses[:, 1], "phi": poses[:, 2]}, scale)
        fold = np.arange(len(some)) * N_STRETCHES // len(some) % N_FOLDS
        self.held: list[Ints] = [np.flatnonzero(fold == f) for f in range(N_FOLDS)]
        parts = [Moments(terms, len(rays), scale=scale).add_rows(self.phi[h], self.y[h]) for h in self.held]
        total = parts[0]
        for part in parts[1:]:
            total = total + part
        self.moments = [total - part for part in parts]

    def errors(self, terms: Terms, n_terms: int | None) -> tuple[Ints, Floats]:
        """Return numbers of terms (n_sizes,) and the mean absolute validation error for each."""
        place = {name: i for i, name in enumerate(self.terms.names)}
        index = np.array([place[name] for name in terms.names])
        sizes = (
            _sizes(min(len(terms), POLYNOMIAL.max_terms))
            if n_terms is None
            else np.array([min(n_terms, len(terms))])
        )
        total, count = np.zeros(len(sizes)), 0
        for held, moments in zip(self.held, self.moments, strict=True):
            known = np.flatnonzero(moments.count > 0)
            picked = select(moments.pick(terms=index, outputs=known), int(sizes[-1]), keep=["1"])
            for j, ray in enumerate(known.tolist()):
                chosen = picked.chosen(j)
                T = picked.inverse[j, : len(chosen), : len(chosen)]
                gain = np.linalg.solve(T, picked.theta[j, chosen])
                theta = T @ (gain[:, None] * (np.arange(len(chosen))[:, None] < sizes))  # (n_terms, n_sizes)
                rows = held[np.isfinite(self.y[held, ray])]
                value = np.clip(self.phi[np.ix_(rows, index[chosen])] @ theta, *self.limits)
                total += np.abs(value - self.y[rows, ray][:, None]).sum(axis=0)
                count += len(rows)
        return sizes, total / max(count, 1)


def _sizes(n_max: int) -> Ints:
    """Return the numbers of terms to try: all small numbers, then steps of a fifth."""
    sizes = list(range(1, min(n_max, EVERY_SIZE_TO) + 1))
    while sizes[-1] < n_max:
        sizes.append(min(n_max, sizes[-1] + sizes[-1] // 5))
    return np.array(sizes, dtype=np.intp)
