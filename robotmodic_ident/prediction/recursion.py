"""Recursion: a model prepared to run sample by sample, with the factors of its inputs evaluated beforehand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.moments import ROWS_PER_BLOCK
from robotmodic_ident.prediction import kernels
from robotmodic_ident.records import Record
from robotmodic_ident.scale import Scale
from robotmodic_ident.terms import Factor, Term, Terms
from robotmodic_ident.types import Floats

NOISE_NAME = "e"
"""The variable of noise terms: the residual at past samples."""
UNLIMITED = (-np.inf, np.inf)
MAX_KEPT = 4_000_000
"""Maximum number of stored values of the input part; larger ones are evaluated again in every run, block by block."""
KIND_OF_FUNCTION = {
    "": kernels.KIND_POWER,
    "cos": kernels.KIND_COS,
    "sin": kernels.KIND_SIN,
    "P": kernels.KIND_LEGENDRE,
    "T": kernels.KIND_CHEBYSHEV,
    "B": kernels.KIND_SPLINE,
    "W": kernels.KIND_WAVELET,
    "abs": kernels.KIND_ABS,
    "tanh": kernels.KIND_TANH,
}


class InputPart:
    """The product of the input factors of each term, evaluated on demand and stored if it is small."""

    def __init__(self, terms: list[Term], columns: dict[str, Floats], scale: Scale, n: int) -> None:
        distinct = list(dict.fromkeys(terms))
        place = {term: j for j, term in enumerate(distinct)}
        self.parts = [Terms((term,)) for term in distinct]
        self.place = np.array([place[term] for term in terms], dtype=np.intp)
        self.columns, self.scale, self.n = columns, scale, n
        self.is_kept = n * len(terms) <= MAX_KEPT
        self._kept: Floats | None = None

    def __getitem__(self, rows: slice) -> Floats:
        """Return (n_rows, n_terms); nan where a term is unknown."""
        if not self.is_kept:
            return self._evaluated(rows)
        if self._kept is None:
            self._kept = self._evaluated(slice(0, self.n))
        return self._kept[rows]

    def _evaluated(self, rows: slice) -> Floats:
        n = len(range(*rows.indices(self.n)))
        some = {name: values[rows] for name, values in self.columns.items()}
        values = np.empty((n, len(self.parts)))
        for j, part in enumerate(self.parts):
            values[:, j] = part.matrix(some, self.scale, n=n)[:, 0]
        values[~np.isfinite(values).all(axis=1)] = np.nan
        return np.ascontiguousarray(values[:, self.place])


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment:
    """One segment without a gap, ready to run."""

    piece: slice
    """Samples of the record."""
    base: InputPart | Floats
    """(n, n_parameters) product of the input factors of each term; nan where unknown; read in slices."""
    measured: Floats
    """(n,) measured outputs; nan where unknown."""


class Recursion:
    """ŷ = Σ numerator / (1 + Σ denominator) + Σ noise, with the tables for the compiled loops."""

    def __init__(
        self,
        output: str,
        terms: Terms,
        denominator: Terms,
        noise: Terms,
        scale: Scale,
        theta: Floats,
        limits: tuple[float, float] = UNLIMITED,
    ) -> None:
        self.output, self.scale = output, scale
        self.limits = np.array(limits, dtype=np.float64)
        """(2,) saturation limits of the output."""
        self.groups = (terms, denominator, noise)
        self.table_of_terms: tuple[Term, ...] = terms.table + denominator.table + noise.table
        self.theta: Floats = np.asarray(theta, dtype=np.float64)
        """(n_parameters,) numerator, denominator, noise."""
        self.group = np.repeat(np.arange(3), [len(g) for g in self.groups]).astype(np.int64)
        self.look_back = max(g.max_lag for g in self.groups)
        feeds = [[f for f in term if f.variable in (output, NOISE_NAME)] for term in self.table_of_terms]
        self._check(feeds)
        self.starts = np.cumsum([0, *map(len, feeds)]).astype(np.int64)
        rows = [self._row(f) for some in feeds for f in some]
        self.table = np.array([row for row, _ in rows], dtype=np.int64).reshape(-1, kernels.N_COLUMNS)
        self.scales = np.array([pair for _, pair in rows], dtype=np.float64).reshape(-1, 2)
        self.feeds_back = bool((self.table[:, kernels.COL_OF_NOISE] == 0).any())
        """Whether the model has past outputs."""

    def _check(self, feeds: list[list[Factor]]) -> None:
        for term, some in zip(self.table_of_terms, feeds, strict=True):
            if any(not f.lag for f in some):
                name = Terms((term,)).names[0]
                raise IdentError(
                    f"term {name} contains the current {self.output}; use past values, such as {self.output}(k-1)"
                )

    def _row(self, f: Factor) -> tuple[list[int], tuple[float, float]]:
        of_noise = int(f.variable == NOISE_NAME)
        pair = self.scale.pair(f.variable) if f.is_scaled else f.domain or (0.0, 1.0)
        kind = KIND_OF_FUNCTION[f.function]
        return [f.lag or 0, of_noise, kind, f.harmonic, *f.part, f.power, f.minus or 0], pair

    def segments(self, record: Record) -> Iterator[Segment]:
        """Evaluate the input part of every term over each segment of a record."""
        signals = {name: np.asarray(values, dtype=np.float64) for name, values in record.signals.items()}
        self._check_signals(signals)
        for piece in record.segments():
            data = {name: values[piece] for name, values in signals.items()}
            n = piece.stop - piece.start
            measured = data.get(self.output, np.full(n, np.nan))
            yield Segment(piece=piece, base=self._base(data, n), measured=np.ascontiguousarray(measured))

    def _check_signals(self, signals: dict[str, Floats]) -> None:
        needed = {f.variable for term in self.table_of_terms for f in term} - {NOISE_NAME}
        if missing := sorted(needed - set(signals)):
            raise IdentError(f"record has no signal {', '.join(missing)}; it has {', '.join(signals)}")

    def _base(self, data: dict[str, Floats], n: int) -> InputPart:
        inputs = [
            tuple(f for f in t if f.variable not in (self.output, NOISE_NAME)) for t in self.table_of_terms
        ]
        atoms = {f.signal: (f.variable, f.lag or 0, f.minus) for term in inputs for f in term}
        columns = {
            name: _delayed(data[v], lag) - (0.0 if minus is None else _delayed(data[v], minus))
            for name, (v, lag, minus) in atoms.items()
        }
        return InputPart(inputs, columns, self.scale, n)

    def run(
        self,
        segment: Segment,
        *,
        free: bool,
        theta: Floats | None = None,
        gradient: bool = False,
        initial: Floats | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Return the prediction (n,), the noise (n,) and the gradient dŷ/dtheta (n, n_parameters).

        Without `gradient`, the last is empty.

        Parameters
        ----------
        initial : (look_back,) Initial outputs of a free run in place of the measured ones.
            The gradients by these outputs are additional columns.
        """
        n = len(segment.measured)
        out, past, noise = self._start(segment, initial)
        slopes = self._first_slopes(n, initial) if gradient else np.zeros((0, 0))
        theta = self.theta if theta is None else theta
        step = n if not isinstance(segment.base, InputPart) or segment.base.is_kept else ROWS_PER_BLOCK
        for first in range(0, n, max(step, 1)):
            rows = slice(max(first - self.look_back, 0), min(first + step, n))
            some = slopes[rows] if gradient else slopes
            if not self._advance(segment, rows, theta, free, out, past, noise, some):
                break
        return out, noise, slopes

    def gradient_blocks(
        self, segment: Segment, *, free: bool, theta: Floats | None = None, initial: Floats | None = None
    ) -> Iterator[tuple[slice, Floats, Floats]]:
        """Yield (samples, prediction (n,), dŷ/dtheta (n, n_parameters)) of `run`, block by block.

        The memory does not grow with the segment. The first look_back samples are left out. The iteration ends early
        if the run diverges.
        """
        n, back = len(segment.measured), self.look_back
        out, past, noise = self._start(segment, initial)
        theta = self.theta if theta is None else theta
        tail = self._first_slopes(min(back, n), initial)
        for first in range(back, n, ROWS_PER_BLOCK):
            rows = slice(first, min(first + ROWS_PER_BLOCK, n))
            slopes = np.concatenate([tail, np.zeros((rows.stop - first, tail.shape[1]))])
            if not self._advance(
                segment, slice(first - back, rows.stop), theta, free, out, past, noise, slopes
            ):
                return
            yield rows, out[rows], slopes[back:]
            tail = slopes[len(slopes) - back :]

    def _start(self, segment: Segment, initial: Floats | None) -> tuple[Floats, Floats, Floats]:
        n = len(segment.measured)
        out, past, noise = np.full(n, np.nan), segment.measured.copy(), np.zeros(n)
        if initial is not None:
            out[: self.look_back] = past[: self.look_back] = initial
        return out, past, noise

    def _first_slopes(self, n: int, initial: Floats | None) -> Floats:
        """Return initial gradients (n, n_parameters): zeros, and one unit column for each initial output."""
        m = len(self.table_of_terms)
        if initial is None:
            return np.zeros((n, m))
        slopes = np.zeros((n, m + len(initial)))
        slopes[np.arange(len(initial)), m + np.arange(len(initial))] = 1.0
        return slopes

    def _advance(
        self,
        segment: Segment,
        rows: slice,
        theta: Floats,
        free: bool,
        out: Floats,
        past: Floats,
        noise: Floats,
        slopes: Floats,
    ) -> bool:
        """Run over some samples, the first `look_back` of which are known; return False if the run diverges."""
        model = self._model(segment.base[rows], theta)
        return kernels.run(model, segment.measured[rows], free, out[rows], past[rows], noise[rows], slopes)

    def run_ahead(self, segment: Segment, steps: int) -> Floats:
        """Predict every sample (n,) `steps` ahead, from measurements up to `steps` samples before it."""
        _, noise, _ = self.run(segment, free=False)
        return kernels.run_ahead(self._model(segment.base[:], self.theta), segment.measured, noise, steps)

    def _model(self, base: Floats, theta: Floats) -> kernels.ModelTable:
        return kernels.ModelTable(
            base, theta, self.group, self.starts, self.table, self.scales, self.limits, self.look_back
        )


def _delayed(values: Floats, lag: int) -> Floats:
    if lag == 0:
        return values
    out = np.full(len(values), np.nan)
    out[lag:] = values[: max(len(values) - lag, 0)]
    return out
