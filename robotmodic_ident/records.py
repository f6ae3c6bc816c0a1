"""Records of signals over time, and lagged columns of them; no lag crosses a gap or the start of a record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.errors import IdentError
from robotmodic_ident.terms import Terms, signal_name
from robotmodic_ident.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Signals sampled at common times; steps of the stamps above `max_gap` are gaps.

    Raises
    ------
    IdentError : A signal holds no real numbers.
    ValueError : The signals differ in length, or the stamps do not increase.
    """

    signals: Mapping[str, Floats]
    """Variable -> (n,) values; nan: unknown."""
    stamps: Floats | None = None
    """(n,) [s] strictly increasing; None: evenly sampled without a gap."""
    max_gap: float | None = None
    """[s] longer steps are gaps; None: 1.5 times the median step."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "signals", {name: _numbers(name, v) for name, v in self.signals.items()})
        lengths = {name: np.shape(values) for name, values in self.signals.items()}
        if (
            not lengths
            or any(len(shape) != 1 for shape in lengths.values())
            or len(set(lengths.values())) > 1
        ):
            raise ValueError(f"signals have shapes {lengths}, expected one shape (n,)")
        if self.stamps is not None and (
            self.stamps.shape != (len(self),) or not (np.diff(self.stamps) > 0).all()
        ):
            raise ValueError(f"stamps has shape {self.stamps.shape}, expected ({len(self)},), increasing")

    def __len__(self) -> int:
        return len(next(iter(self.signals.values())))

    @property
    def longest_step(self) -> float | None:
        """[s] maximum time between two samples of a segment; None without stamps."""
        if self.max_gap is not None or self.stamps is None or len(self) < 2:
            return self.max_gap
        return 1.5 * float(np.median(np.diff(self.stamps)))

    def segments(self) -> list[slice]:
        """Return the segments between time gaps."""
        n, longest = len(self), self.longest_step
        if self.stamps is None or longest is None or n < 2:
            return [slice(0, n)]
        cuts = [0, *(np.flatnonzero(np.diff(self.stamps) > longest) + 1).tolist(), n]
        return [slice(a, b) for a, b in pairwise(cuts)]


Records: TypeAlias = Record | Mapping[str, Floats] | Iterable[Record | Mapping[str, Floats]]
"""One record or many, each with or without stamps."""


def check_names(output: object, inputs: object = ()) -> None:
    """Check that there is one output, and that inputs are a list of names.

    Raises
    ------
    IdentError : If there are several outputs, or inputs are one text, whose letters would be read as names.
    """
    if not isinstance(output, str):
        raise IdentError(
            f"output is {output!r}, but a model describes one signal; identify each signal separately"
        )
    if isinstance(inputs, str):
        raise IdentError(f"inputs is {inputs!r}, expected a list of names, such as [{inputs!r}]")


@dataclass(frozen=True, kw_only=True, eq=False)
class LaggedData:
    """Rows of lagged signals with the outputs to predict."""

    columns: dict[str, Floats]
    """Signal (`y(k-1)`, `u(k)`, `x`) -> (n,) values, all finite."""
    targets: Floats
    """(n, n_outputs) outputs at k; nan if unknown."""
    record: NDArray[np.intp]
    """(n,) index of the record of each row."""
    sample: NDArray[np.intp]
    """(n,) index k of the sample in that record."""


def lags(variable: str, first: int, last: int) -> list[str]:
    """Return the names of a variable from lag `first` to lag `last`: `u(k)`, `u(k-1)`, ..."""
    if not 0 <= first <= last:
        raise ValueError(f"lags are {first} to {last}, expected 0 <= first <= last")
    return [signal_name(variable, lag) for lag in range(first, last + 1)]


def halves(record: Record | Mapping[str, Floats]) -> list[Record]:
    """Split a record into its first and second half: one to fit a model, the other to test it."""
    return blocks(record, 2)


def blocks(record: Record | Mapping[str, Floats], n: int) -> list[Record]:
    """Split a record into n contiguous blocks of nearly equal length; random splits would leak through the lags."""
    (record,) = as_records(record)
    if not 1 <= n <= len(record):
        raise ValueError(f"n is {n}, expected 1 to {len(record)}, the number of samples")
    edges = np.linspace(0, len(record), n + 1).round().astype(int)
    return [
        Record(
            signals={name: np.asarray(values)[a:b] for name, values in record.signals.items()},
            stamps=None if record.stamps is None else record.stamps[a:b],
            max_gap=record.max_gap,
        )
        for a, b in pairwise(edges.tolist())
    ]


def cut(record: Record, piece: slice) -> Record:
    """Return a section of a record with the same maximum gap."""
    return Record(
        signals={name: np.asarray(values)[piece] for name, values in record.signals.items()},
        stamps=None if record.stamps is None else record.stamps[piece],
        max_gap=record.longest_step,
    )


def padded_before(record: Record, n: int) -> Record:
    """Return a record with n additional samples before it, in which every signal has its first value."""
    if n == 0 or len(record) == 0:
        return record
    whole = cut(record, slice(None))
    stamps = whole.stamps
    if stamps is not None:
        step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 1.0
        stamps = np.concatenate([stamps[0] - step * np.arange(n, 0, -1), stamps])
    signals = {name: np.concatenate([np.full(n, v[0]), v]) for name, v in whole.signals.items()}
    return Record(signals=signals, stamps=stamps, max_gap=whole.max_gap)


def as_records(records: Records) -> list[Record]:
    """Convert one record or many, each a `Record` or a mapping of signals (or a data frame), to a list of records.

    Raises
    ------
    IdentError : A record is no mapping, or a signal holds no numbers.
    """
    given: Any = records
    is_one = isinstance(given, Record) or hasattr(given, "items") or not isinstance(given, Iterable)
    several = [given] if is_one else list(given)
    for one in several:
        if not isinstance(one, Record) and not hasattr(one, "items"):
            raise IdentError(
                f"a record is of type {type(one).__name__}, expected a mapping of names of signals to arrays (n,)"
            )
    return [one if isinstance(one, Record) else Record(signals=one) for one in several]


def _numbers(name: str, values: object) -> Floats:
    """Return the values of a signal as numbers."""
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "cmM":  # neither complex nor times
            return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        pass
    raise IdentError(f"signal {name} holds no real numbers; expected an array (n,), nan where it is unknown")


def lagged(
    records: Records,
    terms: Terms,
    outputs: Sequence[str],
    *,
    skip: int | None = None,
) -> LaggedData:
    """Collect the lagged columns of `terms`; rows with an unknown regressor are left out.

    Parameters
    ----------
    skip : [samples] Start of every segment to leave out, so that models with different lags use the same rows.
        Default: the largest lag, which is the minimum.

    Raises
    ------
    IdentError
        If a record lacks a signal, or no row remains.
    ValueError
        If `skip` is below the largest lag.
    """
    look_back = terms.max_lag if skip is None else skip
    if look_back < terms.max_lag:
        raise ValueError(f"skip is {skip}, expected at least {terms.max_lag}, the largest lag of the terms")
    atoms = {f.signal: (f.variable, f.lag or 0, f.minus) for term in terms for f in term}
    parts: dict[str, list[Floats]] = {name: [] for name in atoms}
    targets, owner, sample = [], [], []
    for i, record in enumerate(as_records(records)):
        unknown = {v for v, _, _ in atoms.values()} | set(outputs)
        unknown -= set(record.signals)
        if unknown:
            names = ", ".join(sorted(unknown))
            raise IdentError(f"record {i} has no signal {names}; it has {', '.join(record.signals)}")
        data = record.signals
        for piece in record.segments():
            k = np.arange(piece.start + look_back, piece.stop, dtype=np.intp)
            if len(k) == 0:
                continue
            rows = {
                name: data[v][k - lag] - (0.0 if minus is None else data[v][k - minus])
                for name, (v, lag, minus) in atoms.items()
            }
            known = np.ones(len(k), dtype=np.bool_)
            for values in rows.values():
                known &= np.isfinite(values)
            for name, values in rows.items():
                parts[name].append(values[known])
            targets.append(np.stack([data[name][k[known]] for name in outputs], axis=1))
            owner.append(np.full(int(known.sum()), i, dtype=np.intp))
            sample.append(k[known])
    if not targets or sum(map(len, targets)) == 0:
        raise IdentError(
            f"no row remains after a look back of {look_back} samples; use longer records, or smaller lags"
        )
    return LaggedData(
        columns={name: np.concatenate(values) for name, values in parts.items()},
        targets=np.concatenate(targets),
        record=np.concatenate(owner),
        sample=np.concatenate(sample),
    )
