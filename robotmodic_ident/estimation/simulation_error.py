"""Simulation error: minimise Σ (measured(k) - ŷ(k))² over free runs ŷ, with coefficients and initial outputs unknown.

With noise on the output only (output error), regression on measured past outputs is biased. A free run does not use
them, but it needs initial conditions. The first `look_back` outputs of every segment are noisy states, whose effect
lasts long in a slow system. They are estimated together with the coefficients, and their residuals count like those of
other samples (Ljung 1999, sec. 7.2). One recursion gives the gradients for both.

`with_signs` is for outputs measured without their sign, as by a pulse counter, which measures the speed of a wheel but
not its direction. The model describes the signed output. The measured magnitudes take the signs of the free run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import (
    DESCENT,
    Estimate,
    LevenbergMarquardt,
    levenberg_marquardt,
)
from robotmodic_ident.prediction.recursion import Recursion, Segment
from robotmodic_ident.records import Record
from robotmodic_ident.types import Floats

MAX_INITIAL_OUTPUTS = 100
"""Maximum number of estimated initial outputs of all segments; above it, every segment starts from measurements."""


class FreeRunLeastSquares:
    """Free-run residuals of a model over all segments, as a function of coefficients and initial outputs."""

    def __init__(self, recursion: Recursion, records: Sequence[Record], *, look_back: int = 0) -> None:
        """Prepare the runs; `look_back` [samples] gives models with different lags the same start."""
        recursion.look_back = max(recursion.look_back, look_back)
        self.recursion = recursion
        self.segments: list[Segment] = [s for record in records for s in recursion.segments(record)]
        back = recursion.look_back
        zero = np.zeros_like(recursion.theta)  # shows which samples are predicted, without divergence
        runs = [recursion.run(s, free=True, theta=zero)[0] for s in self.segments]
        starts = [
            back > 0
            and len(out) > 2 * back
            and bool(np.isfinite(s.measured[:back]).all() and np.isfinite(out[back]))
            for s, out in zip(self.segments, runs, strict=True)
        ]
        self.estimated = starts if sum(starts) * back <= MAX_INITIAL_OUTPUTS else [False] * len(starts)
        """(n_segments,) whether the initial outputs of a segment are estimated."""
        self.back = back
        self.rows = []
        """(n,) whether the residual of each sample counts, for every segment."""
        for s, out, is_estimated in zip(self.segments, runs, self.estimated, strict=True):
            use = np.isfinite(out) & np.isfinite(s.measured)
            use[:back] = is_estimated
            self.rows.append(use)
        self.count = int(sum(rows.sum() for rows in self.rows)) - back * sum(self.estimated)
        if self.count <= 0:
            raise IdentError("the model predicts no sample of these records; use longer records")

    @property
    def measured_start(self) -> Floats:
        """(n_initial,) measured initial outputs of all segments whose start is estimated."""
        parts = [s.measured[: self.back] for s, use in zip(self.segments, self.estimated, strict=True) if use]
        return np.concatenate(parts) if parts else np.empty(0)

    def evaluate(self, both: Floats, *, gradient: bool = False) -> tuple[float, list[Floats], list[Floats]]:
        """Return the sum of squares, residuals and gradients of every segment; inf if a run diverges.

        Parameters
        ----------
        both : (n_parameters + n_initial,) coefficients, then initial outputs
        """
        m = len(self.recursion.theta)
        theta, place, total = both[:m], m, 0.0
        residuals, gradients = [], []
        for segment, rows, is_estimated in zip(self.segments, self.rows, self.estimated, strict=True):
            initial = both[place : place + self.back] if is_estimated else None
            out, _, slopes = self.recursion.run(
                segment, free=True, theta=theta, gradient=gradient, initial=initial
            )
            with np.errstate(over="ignore", invalid="ignore"):
                rest = np.where(rows, segment.measured - out, 0.0)
                total += float(rest @ rest)
            residuals.append(rest)
            if gradient:
                wide = np.zeros((len(out), len(both)))
                wide[rows, :m] = slopes[rows, :m]
                if is_estimated:
                    wide[rows, place : place + self.back] = slopes[rows, m:]
                gradients.append(wide)
            place += self.back if is_estimated else 0
        return (total if np.isfinite(total) else np.inf), residuals, gradients

    def minimise(
        self, theta: Floats, settings: LevenbergMarquardt = DESCENT, initial: Floats | None = None
    ) -> tuple[Estimate, Floats]:
        """Minimise from coefficients (n_parameters,); also return the initial outputs (n_initial,).

        The gradients of the estimate are orthogonal to those of the initial outputs.

        Raises
        ------
        IdentError
            If the initial model diverges.
        """
        m = len(theta)
        start = np.concatenate([theta, self.measured_start if initial is None else initial])
        found = levenberg_marquardt(self.evaluate, start, settings)
        J = np.concatenate(found.gradients)
        basis = np.linalg.qr(J[:, m:])[0] if J.shape[1] > m else np.empty((len(J), 0))
        own = J[:, :m] - basis @ (basis.T @ J[:, :m])
        ends = np.cumsum([len(r) for r in found.residuals])[:-1]
        estimate = Estimate(
            theta=found.theta[:m], rss=found.rss, count=self.count, residuals=found.residuals,
            gradients=np.split(own, ends), converged=found.converged,
        )  # fmt: skip
        return estimate, found.theta[m:]

    def normal_equations(self, theta: Floats, initial: Floats) -> tuple[Floats, Floats]:
        """Return J'J (n_parameters, n_parameters) and J'r (n_parameters,) with the initial outputs eliminated.

        They give one Gauss-Newton step from theta. The initial outputs are eliminated by the Schur complement. Gradients
        are held in memory for one block of samples at a time.

        Raises
        ------
        IdentError
            If the gradients diverge.
        """
        m, back, place = len(theta), self.back, 0
        gram, cross = np.zeros((m, m)), np.zeros(m)
        for segment, rows, is_estimated in zip(self.segments, self.rows, self.estimated, strict=True):
            start = initial[place : place + back]
            whole = np.zeros((m + back * is_estimated + 1,) * 2)
            for part, out, slopes in self.recursion.gradient_blocks(
                segment, free=True, theta=theta, initial=start if is_estimated else None
            ):
                use = rows[part] & np.isfinite(out)
                J = np.column_stack([slopes[use], (segment.measured[part] - out)[use]])
                with np.errstate(over="ignore", invalid="ignore"):
                    whole += J.T @ J
            if is_estimated:
                rest = segment.measured[:back] - start
                whole[m : m + back, m : m + back] += np.eye(back)
                whole[m : m + back, -1] += rest
                whole[-1, m : m + back] += rest
                inner = whole[m : m + back, m : m + back]
                keep = np.r_[:m, m + back]
                if not np.isfinite(whole).all():
                    raise IdentError("the gradients of the model diverge on these records")
                size = np.sqrt(np.diagonal(inner))
                side = whole[keep, m : m + back] / size
                inverse = np.linalg.pinv(inner / np.outer(size, size), hermitian=True)
                whole = whole[np.ix_(keep, keep)] - side @ inverse @ side.T
                place += back
            gram += whole[:m, :m]
            cross += whole[:m, -1]
        if not (np.isfinite(gram).all() and np.isfinite(cross).all()):
            raise IdentError("the gradients of the model diverge on these records")
        return gram, cross


def initial_outputs(recursion: Recursion, segment: Segment, n: int) -> Floats | None:
    """Return the initial outputs (look_back,) for which a free run fits the first n measured samples best.

    None if they cannot be estimated: one of them is unknown, n is at most look_back, or the model has no past output.
    """
    m, back = len(recursion.theta), recursion.look_back
    head = Segment(piece=slice(0, n), base=segment.base[:n], measured=segment.measured[:n])
    start = head.measured[:back]
    if not recursion.feeds_back or n <= back or not np.isfinite(start).all():
        return None

    def evaluate(initial: Floats, /, *, gradient: bool = False) -> tuple[float, list[Floats], list[Floats]]:
        out, _, slopes = recursion.run(head, free=True, gradient=gradient, initial=initial)
        known = np.isfinite(head.measured)
        rest = np.where(known, head.measured - out, 0.0)
        total = float(rest @ rest)
        return (
            total if np.isfinite(total) else np.inf,
            [rest],
            [np.where(known[:, None], slopes[:, m:], 0.0)] if gradient else [],
        )

    try:
        return levenberg_marquardt(evaluate, start, DESCENT).theta
    except IdentError:  # the run diverges within the first samples
        return None


MAX_START = 20
"""[samples] maximum length of the start of a segment from which its first signs are estimated."""
MAX_ROUNDS = 5
"""Maximum number of updates of the first signs from the resulting free run."""


def with_signs(recursion: Recursion, segment: Segment) -> Segment:
    """Return a segment whose measured magnitudes have the signs of the free run that fits its start best."""
    measured = segment.measured
    known = np.isfinite(measured)
    n = min(int(known.argmin()) if not known.all() else len(known), MAX_START)
    if n <= recursion.look_back:
        return segment
    best, least = measured, np.inf
    for first in range(n):  # try both signs, with one change of sign at sample `first`
        for side in (1.0, -1.0):
            start = measured.copy()
            start[:n] *= np.where(np.arange(n) < first, -side, side)
            run, error = _settled(recursion, segment, start, n)
            if error < least:
                best, least = np.copysign(measured, np.where(np.isfinite(run), run, start)), error
    return replace(segment, measured=np.where(known, best, measured))


def _settled(recursion: Recursion, segment: Segment, start: Floats, n: int) -> tuple[Floats, float]:
    """Return the free run with self-consistent signs, and its sum of squares over the first n magnitudes."""
    run, error = np.full(len(start), np.nan), np.inf
    for _ in range(MAX_ROUNDS):
        signed = replace(segment, measured=start)
        run = recursion.run(signed, free=True, initial=initial_outputs(recursion, signed, n))[0]
        run[: recursion.look_back] = np.where(
            np.isfinite(run[: recursion.look_back]), run[: recursion.look_back], start[: recursion.look_back]
        )
        rest = np.abs(run[:n]) - np.abs(start[:n])
        error = float(rest @ rest) if np.isfinite(rest).all() else np.inf
        new = start.copy()
        new[:n] = np.copysign(start[:n], run[:n])
        if not np.isfinite(error) or (new[:n] == start[:n]).all():
            break
        start = new
    return run, error
