"""Which terms a model needs in free run: added, and taken out again, by what they do to the simulation error.

One step ahead nearly every model of a slow output looks right; what it is worth shows in free run. The gradient of the
simulation error by the coefficient of a term that is not there yet tells how promising it is (a Gauss-Newton step in
Gram space, for all candidates in one run); the most promising ones are tried by a short descent. So terms are ranked as
by forward selection (Billings 2013, ch. 3), but by the simulation error (Piroddi and Spinelli 2003).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import LevenbergMarquardt
from robotmodic_ident.estimation.simulation_error import FreeRunLeastSquares
from robotmodic_ident.model import Narmax, among
from robotmodic_ident.records import Record, blocks
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

TRIAL = LevenbergMarquardt(max_steps=5, converged=1e-2)
"""The descent that tells which of the promising terms is best."""
SHORT_DESCENT = LevenbergMarquardt(max_steps=20, converged=1e-3)
"""The descent of a model on the way; the one that is kept is brought to rest."""

SHOOTING_LENGTHS = (3, 10, 30, 100, 300, 1000)
"""[samples] of the stretches that are run free where the whole diverges."""


@dataclass(frozen=True, kw_only=True)
class FreeRunSearch:
    """How far terms are looked for by the simulation error."""

    max_terms: int = 30
    """Largest model."""
    trials: int = 3
    """Most promising terms that a descent tries at each size."""
    min_gain: float = 1e-2
    """Relative fall of the simulation error's sum of squares that a larger model must bring ..."""
    max_loss: float = 0.02
    """Relative rise of it at which a term of the first model is taken out all the same."""
    patience: int = 2
    """... so many sizes in a row, else the search ends."""


FREE_RUN_SEARCH = FreeRunSearch()


@dataclass(frozen=True, eq=False)
class Simulated:
    """A model and its simulation error."""

    model: Narmax
    rss: float
    """[units of the output, squared] sum of squares of the free run's residual."""
    initial: Floats
    """(n_initial,) [units of the output] estimated initial outputs."""


@dataclass(frozen=True, eq=False)
class FreeRunTerms:
    """The search among candidate terms, on records, for the least simulation error of every size."""

    records: Sequence[Record]
    terms: Terms
    """Candidates."""
    settings: FreeRunSearch = FREE_RUN_SEARCH

    def path(self, start: Narmax) -> dict[int, Simulated]:
        """Return size -> the best model of that size.

        What `start` has too much is taken out first, then the model grows.

        Raises
        ------
        IdentError
            if `start` diverges in free run
        """
        now = self.started(start)
        best: dict[int, Simulated] = {}
        now, idle = self._pruned(now, best), 0
        while len(now.model.terms) < self.settings.max_terms and idle < self.settings.patience:
            before = min(one.rss for one in best.values())
            grown = self._grown(now)
            if grown is None:
                break
            now = self._thinned(grown, best)
            idle = idle + 1 if before - now.rss < self.settings.min_gain * before else 0
        return best

    def started(self, start: Narmax) -> Simulated:
        """Descend from `start`; where it diverges, first over short stretches, then over longer ones.

        That is multiple shooting (Bock 1983) with measured states at every start, lengthened until one is enough.
        """
        try:
            return self.minimised(start, start.parameters, SHORT_DESCENT)
        except IdentError:
            theta = start.parameters
        for length in SHOOTING_LENGTHS:
            pieces = [
                piece
                for record in self.records
                for piece in blocks(record, max(1, len(record) // (length + self.terms.max_lag)))
            ]
            try:
                short = FreeRunLeastSquares(start.recursion(), pieces)
                theta = short.minimise(theta, SHORT_DESCENT)[0].theta
            except IdentError:  # too long already; the whole is tried from where this came
                break
        return self.minimised(start, theta, SHORT_DESCENT)

    def minimised(
        self, model: Narmax, theta: Floats, settings: LevenbergMarquardt, initial: Floats | None = None
    ) -> Simulated:
        """Descend from coefficients theta (n_terms,), and from initial outputs (n_initial,) or the measured ones."""
        result, initial = self._error(model).minimise(theta, settings, initial)
        return Simulated(replace(model, theta=result.theta), result.rss, initial)

    def _error(self, model: Narmax) -> FreeRunLeastSquares:
        return FreeRunLeastSquares(model.recursion(), self.records, look_back=self.terms.max_lag)

    def _grown(self, now: Simulated) -> Simulated | None:
        """Return the model with the term more that lowers its simulation error most; None: there is none."""
        try:
            gain = self._gains(now)
        except IdentError:
            return None
        tried = []
        for j in np.argsort(-gain, kind="stable")[: self.settings.trials].tolist():
            if gain[j] <= 0.0:
                continue
            larger = among(now.model, now.model.terms + self.terms[[j]])
            try:
                tried.append(self.minimised(larger, larger.theta, TRIAL, now.initial))
            except IdentError:  # it diverges on the way
                continue
        if not tried:
            return None
        best = min(tried, key=lambda one: one.rss)
        return self.minimised(best.model, best.model.theta, SHORT_DESCENT, best.initial)

    def _thinned(self, now: Simulated, best: dict[int, Simulated]) -> Simulated:
        """Take terms out as long as that beats the best model of the smaller size; return where this ends."""
        self._remember(now, best)
        while len(now.model.terms) - 1 in best and (trial := self._shrunk(now)) is not None:
            if not self._remember(trial, best):
                break
            now = trial
        return now

    def _pruned(self, now: Simulated, best: dict[int, Simulated]) -> Simulated:
        """Take terms out as long as that costs little; return where this ends."""
        self._remember(now, best)
        while len(now.model.terms) > 1 and (trial := self._shrunk(now)) is not None:
            if trial.rss > now.rss * (1.0 + self.settings.max_loss):
                break
            self._remember(trial, best)
            now = trial
        return now

    def _shrunk(self, now: Simulated) -> Simulated | None:
        """Return the model without its least useful term; None if it diverges."""
        try:
            i = self._least_useful(now)
            smaller = among(now.model, now.model.terms[[j for j in range(len(now.model.terms)) if j != i]])
            return self.minimised(smaller, smaller.theta, SHORT_DESCENT, now.initial)
        except IdentError:
            return None

    def _remember(self, now: Simulated, best: dict[int, Simulated]) -> bool:
        size = len(now.model.terms)
        if size not in best or now.rss < best[size].rss * (1.0 - self.settings.min_gain):
            best[size] = now
            return True
        return False

    def _gains(self, now: Simulated) -> Floats:
        """Return what a Gauss-Newton step with each candidate more would take off the sum of squares (n_candidates,)."""
        full = among(now.model, now.model.terms + self.terms)
        gram, cross, _ = self._normalised(now, full)
        n = len(now.model.terms)
        damped = gram[:n, :n] + TRIAL.damping * np.eye(n)
        both = np.linalg.solve(damped, np.column_stack([gram[:n], cross[:n]]))
        norm = np.diagonal(gram) + TRIAL.damping - (gram[:n] * both[:, :-1]).sum(axis=0)
        rest = cross - gram[:n].T @ both[:, -1]
        gain = rest**2 / np.maximum(norm, TRIAL.damping)
        place = {name: i for i, name in enumerate(full.terms.names)}
        where = np.array([place.get(name, 0) for name in self.terms.names])
        return np.where(where >= n, gain[where], 0.0)

    def _least_useful(self, now: Simulated) -> int:
        """Return the term whose loss costs least to first order."""
        gram, cross, theta = self._normalised(now, now.model)
        inverse = np.linalg.pinv(gram, hermitian=True)
        theta = theta + inverse @ cross
        return int(np.argmin(theta**2 / np.maximum(np.diagonal(inverse), 1e-100)))

    def _normalised(self, now: Simulated, model: Narmax) -> tuple[Floats, Floats, Floats]:
        """Return the normal equations of a model, and its coefficients, for columns of unit norm."""
        gram, cross = self._error(model).normal_equations(model.theta, now.initial)
        size = np.sqrt(np.maximum(np.diagonal(gram), 0.0))  # below 0 by rounding
        size = np.where(size > 0, size, 1.0)
        gram, cross = gram / size / size[:, None], cross / size
        if not (np.isfinite(gram).all() and np.isfinite(cross).all()):
            raise IdentError("the gradients of the model diverge on these records")
        return gram, cross, model.theta * size
