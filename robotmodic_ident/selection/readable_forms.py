"""Linear models with nonlinearities that are not polynomial: dry friction, and an output measured without its sign.

Both are estimated in free run, where their effect is largest: friction determines the coasting distance of a motor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from robotmodic_ident.errors import IdentError
from robotmodic_ident.fitting import fit
from robotmodic_ident.model import Narmax
from robotmodic_ident.records import Record
from robotmodic_ident.selection.candidates import dictionary
from robotmodic_ident.selection.criteria import MAX_STEPS
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

SPANS = (1, 3, 10)
"""[samples] between the two values; a longer span is less sensitive to noise, a shorter one has less delay."""
WIDTH_SHARES = (0.003, 0.03)
"""Widths of tanh as shares of the largest difference; tanh replaces the sign, whose derivative is 0."""


MAX_LEAST_SHARE = 0.1
"""Maximum 5 % quantile of a magnitude, as a share of its largest value."""
MAX_NEGATIVE_SHARE = 0.05
"""Maximum size of negative values of a magnitude, as a share of its largest value."""
TIME_CONSTANTS = (1.0, 4.0, 16.0)
"""[samples] time constants of the smoothed input whose sign is the initial guess."""
DELAYS = (0, 2, 5)
"""[samples] delays of the smoothed input."""


def friction_models(
    records: Sequence[Record],
    output: str,
    inputs: Sequence[str],
    order: int,
    limits: tuple[float, float],
) -> list[Narmax]:
    """Return linear models with a friction term tanh((y(k-1) - y(k-1-span)) / width) of the speed of the output.

    Coulomb friction resists every motion equally; a polynomial approximates it only by a slope.
    """
    linear = dictionary(output, inputs, order, 1, order)
    out = []
    for span in SPANS:
        largest = _largest_difference(records, output, span)
        if not largest > 0:
            continue
        for share in WIDTH_SHARES:
            terms = linear + Terms.parse(
                f"tanh(({output}(k-1)-{output}(k-{1 + span}))/{float(f'{share * largest:.2g}')!r})"
            )
            with suppress(IdentError):
                out.append(
                    fit(
                        records,
                        output,
                        terms,
                        n_terms=len(terms),
                        search="forward",
                        estimator="simulation",
                        limits=limits,
                    )
                )
    return out


def _largest_difference(records: Sequence[Record], output: str, span: int) -> float:
    parts = [np.asarray(record.signals[output], dtype=np.float64) for record in records]
    steps = [np.abs(part[span:] - part[:-span]) for part in parts if len(part) > span]
    known = np.concatenate(steps) if steps else np.empty(0)
    known = known[np.isfinite(known)]
    return float(known.max()) if len(known) else 0.0


def magnitude_models(
    records: Sequence[Record],
    output: str,
    inputs: Sequence[str],
    order: int,
) -> list[Narmax]:
    """Return a linear model of the signed output of a magnitude; an empty list if the output is not a magnitude.

    The initial signs are those of a smoothed and delayed input. They are replaced by the signs of the free run of the
    resulting model until the error stops decreasing, similar to phase retrieval (Gerchberg and Saxton 1972). The best
    of all initial guesses is returned.
    """
    values = np.concatenate([np.asarray(r.signals[output], dtype=np.float64) for r in records])
    values = values[np.isfinite(values)]
    top = float(values.max(initial=0.0))
    if (
        values.min(initial=0.0) < -MAX_NEGATIVE_SHARE * top
        or np.quantile(values, 0.05) > MAX_LEAST_SHARE * top
    ):
        return []
    terms = dictionary(output, inputs, order, 1, order)
    best, least = None, np.inf
    for signs in _first_signs(records, inputs):
        with suppress(IdentError):
            model, error = _with_settled_signs(records, output, terms, signs)
            if error < least:
                best, least = model, error
    return [] if best is None else [replace(best, is_magnitude=True)]


def _first_signs(records: Sequence[Record], inputs: Sequence[str]) -> Iterator[list[Floats]]:
    """Yield initial guesses of the signs: (n,) 1 or -1 for every record."""
    for name in inputs:
        for constant in TIME_CONSTANTS:
            for delay in DELAYS:
                stay = np.exp(-1.0 / constant)
                out = []
                for record in records:
                    u = np.nan_to_num(np.asarray(record.signals[name], dtype=np.float64))
                    smooth = lfilter([1.0 - stay], [1.0, -stay], u)
                    late = np.r_[np.full(min(delay, len(u)), smooth[0]), smooth[: max(len(u) - delay, 0)]]
                    out.append(np.where(late < 0, -1.0, 1.0))
                yield out


def _with_settled_signs(
    records: Sequence[Record], output: str, terms: Terms, signs: list[Floats]
) -> tuple[Narmax, float]:
    """Alternate between fitting and updating the signs; return the model and its mean squared error of magnitude."""
    model, error = None, np.inf
    for _ in range(MAX_STEPS):
        signed = [
            replace(r, signals={**r.signals, output: np.asarray(r.signals[output]) * s})
            for r, s in zip(records, signs, strict=True)
        ]
        now = fit(signed, output, terms, n_terms=len(terms), search="forward", estimator="simulation")
        runs = [now.predict_mpo(r, warm_up=2 * terms.max_lag) for r in signed]
        rest = np.concatenate(
            [np.abs(run) - r.signals[output] for run, r in zip(runs, records, strict=True)]
        )[terms.max_lag :]
        square = float(np.nanmean(rest**2))
        if not square < error:
            break
        model, error = now, square
        signs = [np.where(run < 0, -1.0, 1.0) for run in runs]
    if model is None:
        raise IdentError("the free run diverges")
    return model, error
