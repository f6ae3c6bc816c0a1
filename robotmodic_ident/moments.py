"""Moments: the sums Φ'Φ, Φ'Y and Y'Y of any amount of data, which can be added, merged, subtracted and saved.

All outputs share one Gram matrix Φ'Φ. For an output with missing values (nan), the Gram matrix of the missing rows is
stored and subtracted on demand. The cost is proportional to the number of missing rows, or of present rows if fewer.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robotmodic_ident.errors import IdentError
from robotmodic_ident.files import atomic_file
from robotmodic_ident.scale import Scale
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

ROWS_PER_BLOCK = 4096
"""Rows per block, so that Φ of a block fits into the cache and memory stays bounded."""
ROWS_IN_CACHE = 128
"""Rows of Y that are multiplied while they are in the cache."""
MAX_UNPACKED_PRODUCTS = 1_000_000
"""Maximum number of multiplications for which BLAS does not pack the matrices first."""
MOMENTS_FORMAT = "robotmodic-moments-1"
MAX_OUTPUT = 1e150
"""Maximum magnitude of an output; squares of larger values overflow."""


class Moments:
    """The sums for a least-squares fit of many outputs at once."""

    def __init__(self, terms: Terms, n_outputs: int, *, scale: Scale | None = None) -> None:
        if n_outputs < 1 or len(terms) < 1:
            raise ValueError(
                f"moments have {len(terms)} terms and {n_outputs} outputs; expected at least 1 of each"
            )
        m = len(terms)
        self.terms = terms
        self.scale = scale
        """Scale of the variables; None until it is taken from the range of the first data."""
        self.gram: Floats = np.zeros((m, m))
        """(n_terms, n_terms) Φ'Φ over all rows with at least one output."""
        self.cross: Floats = np.zeros((m, n_outputs))
        """(n_terms, n_outputs) Φ'Y over the rows with a known output."""
        self.power: Floats = np.zeros(n_outputs)
        """(n_outputs,) Y'Y."""
        self.count: NDArray[np.int64] = np.zeros(n_outputs, dtype=np.int64)
        """(n_outputs,) number of rows with a known output."""
        self.missing: dict[int, Floats] = {}
        """Output -> (n_terms, n_terms) Gram matrix of the rows with an unknown output."""

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.power)

    def add(self, columns: Mapping[str, ArrayLike], y: ArrayLike) -> Moments:
        """Add data in the units of the user.

        Parameters
        ----------
        columns : signal (`y(k-1)`, `x`) -> (n,) values; rows that are not finite are left out
        y : (n, n_outputs) or (n,); nan: unknown

        Raises
        ------
        ValueError
            If the shapes do not match.
        IdentError
            If a column is missing, or the square of an output overflows.
        """
        data = {name: np.asarray(columns[name], dtype=np.float64) for name in columns}
        y = _as_rows(y, self.n_outputs)
        if wrong := {name: v.shape for name, v in data.items() if v.shape != (len(y),)}:
            raise ValueError(f"columns have shapes {wrong}, expected ({len(y)},), the number of rows of y")
        if self.scale is None:
            self.scale = _scale_of(self.terms, data)
        for start in range(0, len(y), ROWS_PER_BLOCK):
            rows = slice(start, start + ROWS_PER_BLOCK)
            block = {name: values[rows] for name, values in data.items()}
            self.add_rows(self.terms.matrix(block, self.scale, n=len(y[rows])), y[rows])
        return self

    def add_rows(self, phi: Floats, y: ArrayLike) -> Moments:
        """Add rows phi (n, n_terms) of an evaluated dictionary, as returned by `terms.matrix`."""
        y = _as_rows(y, self.n_outputs)
        if phi.shape != (len(y), len(self.terms)):
            raise ValueError(f"phi has shape {phi.shape}, expected ({len(y)}, {len(self.terms)})")
        with np.errstate(over="ignore", invalid="ignore"):
            cross, power = self._products(phi, y)  # power is finite only if all outputs are known
        if np.isfinite(power).all() and np.isfinite(phi).all():
            self.gram += phi.T @ phi
            self.cross += cross
            self.power += power
            self.count += len(y)
            return self
        return self._add_incomplete(phi, y)

    def _products(self, phi: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return Φ'Y (n_terms, n_outputs) and Y'Y (n_outputs,), a few rows at a time, so that Y is read once.

        If Y'Y is not finite, Y contains unknown values and Φ'Y is incomplete.
        """
        cross, power, part = np.zeros(self.cross.shape), np.zeros(len(self.power)), np.empty(self.cross.shape)
        step = max(ROWS_IN_CACHE, MAX_UNPACKED_PRODUCTS // cross.size // ROWS_IN_CACHE * ROWS_IN_CACHE)
        for start in range(0, len(y), step):
            rows, some = phi[start : start + step], y[start : start + step]
            power += np.einsum("ij,ij->j", some, some)
            if not np.isfinite(power).all():
                break
            cross += np.matmul(rows.T, some, out=part)
        return cross, power

    def _add_incomplete(self, phi: Floats, y: Floats) -> Moments:
        """Add rows with unknown outputs or terms."""
        known = ~np.isnan(y)
        if np.isinf(y).any():
            raise IdentError("y contains an infinite value; replace missing measurements by nan")
        use = known.any(axis=1) & np.isfinite(phi).all(axis=1)
        phi, y, known = phi[use], np.where(known, y, 0.0)[use], known[use]
        if len(y) and np.abs(y).max() > MAX_OUTPUT:
            raise IdentError(f"y reaches {np.abs(y).max():.3g}, whose square overflows; use larger units")
        block = phi.T @ phi
        n_known = known.sum(axis=0)
        self.gram += block
        cross, power = self._products(phi, y)
        self.cross += cross
        self.power += power
        self.count += n_known
        phi = np.ascontiguousarray(phi)  # rows are selected below
        for i in np.flatnonzero(n_known < len(y)).tolist():
            if 2 * n_known[i] < len(y):
                few = phi[known[:, i]]
                hole = block - few.T @ few
            else:
                few = phi[~known[:, i]]
                hole = few.T @ few
            if i in self.missing:
                self.missing[i] += hole
            else:
                self.missing[i] = hole
        return self

    def gram_of(self, output: int) -> Floats:
        """Return Φ'Φ (n_terms, n_terms) over the rows in which one output is known."""
        return self.gram - self.missing[output] if output in self.missing else self.gram

    def groups(self, *, limit: int = 1 << 24) -> Iterator[tuple[NDArray[np.intp], Floats]]:
        """Yield (outputs, grams) with grams (1, m, m) if the Gram matrix is shared, otherwise (len(outputs), m, m).

        One stack of Gram matrices holds at most `limit` numbers.
        """
        shared = np.array([i for i in range(self.n_outputs) if i not in self.missing], dtype=np.intp)
        if len(shared):
            yield shared, self.gram[None]
        own = np.array(sorted(self.missing), dtype=np.intp)
        step = max(1, limit // self.gram.size)
        for start in range(0, len(own), step):
            some = own[start : start + step]
            yield some, self.gram - np.stack([self.missing[int(i)] for i in some])

    def pick(self, terms: ArrayLike | None = None, outputs: ArrayLike | None = None) -> Moments:
        """Return the moments of a subset of terms and outputs, given by index, without reading the data again."""
        t = np.arange(len(self.terms)) if terms is None else np.asarray(terms, dtype=np.intp)
        o = np.arange(self.n_outputs) if outputs is None else np.asarray(outputs, dtype=np.intp)
        out = Moments(self.terms[t.tolist()], len(o), scale=self.scale)
        square = np.ix_(t, t)
        out.gram, out.cross = self.gram[square], self.cross[np.ix_(t, o)]
        out.power, out.count = self.power[o], self.count[o]
        out.missing = {j: self.missing[i][square] for j, i in enumerate(o.tolist()) if i in self.missing}
        return out

    def __add__(self, other: Moments) -> Moments:
        """Merge with the moments of other data."""
        return self._combined(other, 1.0)

    def __sub__(self, other: Moments) -> Moments:
        """Remove the moments of data that these contain, such as a fold or an old segment."""
        out = self._combined(other, -1.0)
        if (out.count < 0).any():
            raise IdentError(
                "the moments to subtract have more rows than these; subtract only data that were added before"
            )
        return out

    def _combined(self, other: Moments, sign: float) -> Moments:
        if self.terms.names != other.terms.names or self.n_outputs != other.n_outputs:
            raise IdentError(
                f"moments of {len(self.terms)} terms and {self.n_outputs} outputs cannot be combined with "
                f"{len(other.terms)} terms and {other.n_outputs} outputs; use the same terms and outputs"
            )
        if None not in (self.scale, other.scale) and self.scale != other.scale:
            raise IdentError(
                "moments with different scales cannot be combined; specify one scale for all of them: "
                "Moments(terms, n_outputs, scale=Scale.between({...}))"
            )
        out = Moments(self.terms, self.n_outputs, scale=self.scale or other.scale)
        out.gram = self.gram + sign * other.gram
        out.cross = self.cross + sign * other.cross
        out.power = self.power + sign * other.power
        out.count = self.count + (other.count if sign > 0 else -other.count)
        out.missing = {i: hole.copy() for i, hole in self.missing.items()}
        for i, hole in other.missing.items():
            out.missing[i] = out.missing[i] + sign * hole if i in out.missing else sign * hole
        return out

    def save(self, path: Path | str) -> None:
        """Write one .npz file, without pickle."""
        header = {
            "format": MOMENTS_FORMAT,
            "terms": self.terms.names,
            "scale": None if self.scale is None else self.scale.to_dict(),
        }
        own = sorted(self.missing)
        with atomic_file(Path(path)) as part, part.open("wb") as file:
            np.savez(
                file,
                header=np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
                gram=self.gram,
                cross=self.cross,
                power=self.power,
                count=self.count,
                missing_outputs=np.array(own, dtype=np.int64),
                missing=np.stack([self.missing[i] for i in own]) if own else np.empty((0, 0, 0)),
            )

    @classmethod
    def load(cls, path: Path | str) -> Moments:
        """Read moments written by `save`.

        Raises
        ------
        IdentError
            If the file holds no moments, or its arrays do not match its terms.
        OSError
            If the file cannot be read.
        """
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as data:
                return _restored({name: data[name] for name in data.files})
        except Exception as exc:  # zipfile, zlib and numpy raise many kinds of errors for a damaged file
            if isinstance(exc, OSError) and exc.filename is not None:  # it cannot be opened
                raise
            raise IdentError(
                f"{path}: not a file of moments ({exc}); expected a file of Moments.save"
            ) from exc


def _restored(data: Mapping[str, NDArray[Any]]) -> Moments:
    """Restore moments from their arrays."""
    header = json.loads(bytes(data["header"]))
    if header["format"] != MOMENTS_FORMAT:
        raise IdentError(f"format {header['format']!r}, expected {MOMENTS_FORMAT!r}")
    scale = None if header["scale"] is None else Scale.from_dict(header["scale"])
    out = Moments(Terms.parse(*header["terms"]), len(data["power"]), scale=scale)
    n, m = out.n_outputs, len(out.terms)
    shapes = {"gram": (m, m), "cross": (m, n), "power": (n,), "count": (n,)}
    for name, shape in shapes.items():
        if data[name].shape != shape or not np.can_cast(data[name].dtype, np.float64, "same_kind"):
            raise ValueError(
                f"{name} is {data[name].shape} of {data[name].dtype}, expected {shape} of numbers"
            )
    out.gram, out.cross, out.power = (data[name].astype(np.float64) for name in ("gram", "cross", "power"))
    out.count = data["count"].astype(np.int64)
    if out.count.min() < 0:
        raise ValueError(f"count is {out.count.tolist()}, expected at least 0 rows")
    own, missing = data["missing_outputs"].tolist(), data["missing"].astype(np.float64)
    if own != sorted(set(own) & set(range(n))) or (own and missing.shape != (len(own), m, m)):
        raise ValueError(f"missing_outputs is {own} and missing {missing.shape}, expected each output once")
    out.missing = dict(zip(own, missing, strict=True))
    return out


def _as_rows(y: ArrayLike, n_outputs: int) -> Floats:
    y = np.asarray(y, dtype=np.float64)
    y = y[:, None] if y.ndim == 1 else y
    if y.ndim != 2 or y.shape[1] != n_outputs:
        raise ValueError(f"y has shape {y.shape}, expected (n, {n_outputs})")
    return y


def _scale_of(terms: Terms, columns: Mapping[str, Floats]) -> Scale:
    """Return the scale from the bounds of each variable over all its lags.

    Variables that appear only inside cos and sin are not scaled.
    """
    values: dict[str, list[Floats]] = {}
    for term in terms:
        for f in term:
            if f.is_scaled and f.signal in columns:
                values.setdefault(f.variable, []).append(columns[f.signal])
    return Scale.of({name: np.concatenate(parts) for name, parts in values.items()})
