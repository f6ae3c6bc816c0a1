"""Search for the terms of every ray: forward selection by error reduction ratio on shared moments.

Error reduction ratio of candidate c: err_c = (b_c² / remaining_c) / y'y, the share of y'y that c explains in addition
to the chosen terms.

Orthogonal least squares (Billings 2013, ch. 3) is computed as a pivoted Cholesky factorisation of Φ'Φ, which needs
only the rows of the chosen terms. For a ray with missing scans only these rows are corrected, so the search is exact
and its extra cost is proportional to the number of missing scans. `robotmodic_ident.select` does the same for one ray
at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from robotmodic_ident.selection.criteria import information, penalties
from robotmodic_ident.selection.forward import DEPENDENCE_TOLERANCE, EPSILON, TIE_TOLERANCE
from sensorgraph.models.narmax.candidates import NarmaxForm, ReadingColumns
from sensorgraph.models.polynomial.support import ROWS_PER_TERM
from sensorgraph.types import Bools, Floats, Ints, Progress

RAYS_PER_BLOCK = 32
"""Number of rays processed at a time; it limits memory."""
CRITERION = "ebic"
"""Criterion for the number of terms; EBIC penalises the number of possible models (Chen and Chen 2008)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ChosenTerms:
    """The terms of one ray, in order of selection."""

    order: Ints
    """(k,) candidates: indices of shared terms, then of the ray's readings."""
    err: Floats
    """(k,) error reduction ratio of each term."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    """Moments for the search of one ray."""

    row: Callable[[int], Floats]
    """Function from a candidate to its row (m,) of Φ'Φ over the ray's scans."""
    diagonal: Floats
    """(m,) diagonal of Φ'Φ."""
    cross: Floats
    """(m,) Φ'y."""
    power: float
    """y'y."""
    count: int
    """Number of scans of the ray."""


class SharedMoments:
    """Φ'Φ and Φ'Y of all rays over the same scans; reading columns are computed for a few rays at a time."""

    def __init__(self, phi: Floats, columns: ReadingColumns, ranges: Floats, form: NarmaxForm) -> None:
        """Store phi (n, n_shared), and ranges (n, n_rays) [m] at the same rows; nan: unknown."""
        self.columns, self.form = columns, form
        self.n_rays = ranges.shape[1]
        self.known = np.isfinite(ranges) & columns.all_known()
        # rows are gathered where scans are missing
        self.phi = phi if self.known.all() else np.ascontiguousarray(phi)
        self.y = np.where(self.known, ranges, 0.0)
        self.static = phi[:, form.static]
        self.gram = phi.T @ phi
        self.cross = phi.T @ self.y
        self.power = np.einsum("ij,ij->j", self.y, self.y)

    def searches(self, *, is_static: bool, progress: Progress | None = None) -> Iterator[ChosenTerms]:
        """Yield the terms of each ray; with `is_static`, only terms of the current pose are candidates."""
        step = RAYS_PER_BLOCK
        for first in range(0, self.n_rays, step):
            rays = range(first, min(first + step, self.n_rays))
            if is_static:
                yield from (self._static(ray) for ray in rays)
            else:
                yield from self._lagged(rays)
            if progress is not None:
                progress(rays.stop, self.n_rays)

    def _static(self, ray: int) -> ChosenTerms:
        static_terms = self.form.static
        known = self.known[:, ray]
        phi = self.static
        gram = self.gram[np.ix_(static_terms, static_terms)] if known.all() else phi[known].T @ phi[known]
        problem = _Problem(
            row=lambda c: gram[c],
            diagonal=np.diagonal(gram).copy(),
            cross=self.cross[static_terms, ray],
            power=float(self.power[ray]),
            count=int(known.sum()),
        )
        found = forward_selection(
            problem, self.form.n_terms, self.form.shared[static_terms.tolist()].canonical_order
        )
        return ChosenTerms(order=static_terms[found.order], err=found.err)

    def _lagged(self, rays: range) -> Iterator[ChosenTerms]:
        """Search the terms of neighbouring rays, whose moments are computed together."""
        h = self.form.reach
        around = slice(max(rays.start - h, 0), min(rays.stop + h, self.n_rays))
        readings = self.columns.of_all(slice(None), around)
        mixed, own = self.phi.T @ readings, readings.T @ readings
        cross = readings.T @ self.y[:, rays.start : rays.stop]
        m = len(self.gram)
        order = np.r_[self.form.shared.canonical_order, m + np.arange(len(self.form.readings))]
        for j, ray in enumerate(rays):
            places = self.columns.places(ray, around)
            has = np.flatnonzero(places >= 0)
            at = places[has]
            full = np.block([[self.gram, mixed[:, at]], [mixed[:, at].T, own[np.ix_(at, at)]]])
            row, diagonal = _rows_of_known_scans(full, self.phi, readings[:, at], self.known[:, ray])
            problem = _Problem(
                row=row,
                diagonal=diagonal,
                cross=np.r_[self.cross[:, ray], cross[at, j]],
                power=float(self.power[ray]),
                count=int(self.known[:, ray].sum()),
            )
            candidates = np.r_[np.arange(m), m + has]
            place = np.full(m + len(self.form.readings), -1)
            place[candidates] = np.arange(len(candidates))
            found = forward_selection(problem, self.form.n_terms, place[order][place[order] >= 0])
            yield ChosenTerms(order=candidates[found.order], err=found.err)


def _rows_of_known_scans(
    full: Floats, phi: Floats, readings: Floats, known: Bools
) -> tuple[Callable[[int], Floats], Floats]:
    """Return the rows of Φ'Φ over the known scans, on demand, and its diagonal; `full` is over all scans."""
    if known.all():
        return (lambda c: full[c]), np.diagonal(full).copy()
    fewer = known if 2 * known.sum() < len(known) else ~known
    part = np.concatenate([phi[fewer], readings[fewer]], axis=1)
    squares = np.einsum("ij,ij->j", part, part)
    if fewer is known:
        return (lambda c: part[:, c] @ part), squares
    diagonal = np.diagonal(full) - squares
    safe = np.where(
        diagonal > 1e-12 * np.diagonal(full), diagonal, 0.0
    )  # smaller differences are rounding errors
    return (lambda c: full[c] - part[:, c] @ part), safe


def forward_selection(problem: _Problem, n_max: int, order: Ints) -> ChosenTerms:
    """Select terms greedily, the constant first, and truncate at the minimum of the criterion.

    The columns are scaled to unit norm. Step: c = argmax b_c² / remaining_c, z = b_c / sqrt(remaining_c).
    Row of the factor: ((Φ'Φ)_c - sum_i basis_i,c basis_i) / sqrt(remaining_c).
    Update: b = b - z row, remaining = remaining - row². Error reduction ratio: err = z² / y'y.

    Parameters
    ----------
    order : (m,) Canonical order of the candidates, which decides ties; the constant is candidate 0.
    """
    m = len(problem.diagonal)
    n_max = max(1, min(n_max, m, problem.count // ROWS_PER_TERM))
    norm = np.sqrt(np.where(problem.diagonal > 0, problem.diagonal, 1.0))
    remaining = np.where(problem.diagonal > 0, 1.0, 0.0)  # remaining squared norm
    b = problem.cross / norm
    basis, chosen, gains = np.empty((n_max, m)), [], []
    for k in range(n_max):
        c = 0 if k == 0 else _best(b, remaining, order, 4.0 * EPSILON * problem.power)
        if c < 0 or remaining[c] <= DEPENDENCE_TOLERANCE:
            break
        row = problem.row(c) / (norm * norm[c])
        row = row - basis[:k, c] @ basis[:k]
        row /= np.sqrt(remaining[c])
        basis[k] = row
        z = b[c] / np.sqrt(remaining[c])
        b = b - z * row
        remaining = remaining - row**2
        remaining[c] = 0.0
        chosen.append(c)
        gains.append(z)
    explained = np.array(gains) ** 2 / (problem.power if problem.power > 0 else 1.0)
    rest = 1.0 - np.r_[0.0, np.cumsum(explained)]
    count = np.array([max(problem.count, 1)])
    cost = penalties(CRITERION, len(chosen), m, count)
    size = 1 + int(information(rest[None], cost, count)[0, 1:].argmin()) if chosen else 0
    return ChosenTerms(order=np.array(chosen[:size], dtype=np.intp), err=explained[:size])


def _best(b: Floats, remaining: Floats, order: Ints, floor: float) -> int:
    """Return the candidate with the largest gain, the first in canonical order among equals; -1: all are dependent."""
    free = remaining > DEPENDENCE_TOLERANCE
    gain = np.where(free, b**2 / np.where(free, remaining, 1.0), -1.0)
    best = float(gain.max())
    if best < 0:
        return -1
    equal = gain[order] >= best - TIE_TOLERANCE * best - floor
    return int(order[int(np.argmax(equal))])
