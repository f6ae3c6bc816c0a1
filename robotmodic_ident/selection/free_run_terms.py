"""Select terms by the simulation error: terms are added and removed by their effect on the free run.

For a slow output, nearly every model predicts well one step ahead; its quality appears only in free run. Candidates are
ranked by the first-order gain of a Gauss-Newton step (J_j' M r)² / (J_j' M J_j). J_j is the gradient of the free run by
the coefficient of candidate j, r the residual, and M projects onto the complement of the gradients of the model. One run
gives the gains of all candidates, and the best ones are tried by a short descent. This is forward selection (Billings
2013, ch. 3) with the simulation error (Piroddi and Spinelli 2003).
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
from robotmodic_ident.selection.criteria import MAX_TERMS, PATIENCE
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

TRIAL = LevenbergMarquardt(max_steps=5, converged=1e-2)
"""Descent that compares the most promising terms."""
SHORT_DESCENT = LevenbergMarquardt(max_steps=20, converged=1e-3)
"""Descent of an intermediate model; the final model is refined to convergence."""

SHOOTING_LENGTHS = (3, 10, 30, 100, 300, 1000)
"""[samples] lengths of the sections for multiple shooting, if a free run over the whole record diverges."""


N_TRIALS = 3
"""Number of most promising terms that are tried by a descent at each size."""
MIN_GAIN = 1e-2
"""Minimum relative decrease of the sum of squares for a larger model."""
MAX_LOSS = 0.02
"""Maximum relative increase of the sum of squares for removing a term of the initial model."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """A model and its simulation error."""

    model: Narmax
    rss: float
    """[units of the output, squared] sum of squares of the free-run residual."""
    initial: Floats
    """(n_initial,) [units of the output] estimated initial outputs."""


@dataclass(frozen=True, eq=False)
class FreeRunTerms:
    """The search for the candidate terms with the least simulation error of every size."""

    records: Sequence[Record]
    terms: Terms
    """Candidates."""

    def path(self, start: Narmax) -> dict[int, Simulated]:
        """Return size -> best model of that size.

        Unnecessary terms of `start` are removed first, then terms are added.

        Raises
        ------
        IdentError
            If `start` diverges in free run.
        """
        now = self.started(start)
        best: dict[int, Simulated] = {}
        now, idle = self._pruned(now, best), 0
        while len(now.model.terms) < MAX_TERMS and idle < PATIENCE:
            before = min(one.rss for one in best.values())
            grown = self._grown(now)
            if grown is None:
                break
            now = self._thinned(grown, best)
            idle = idle + 1 if before - now.rss < MIN_GAIN * before else 0
        return best

    def started(self, start: Narmax) -> Simulated:
        """Descend from `start`; if it diverges, descend over short sections first, then over longer ones.

        This is multiple shooting (Bock 1983) with measured initial states, up to one section per record.
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
            except IdentError:  # the sections are too long; the whole records are tried from the last result
                break
        return self.minimised(start, theta, SHORT_DESCENT)

    def minimised(
        self, model: Narmax, theta: Floats, settings: LevenbergMarquardt, initial: Floats | None = None
    ) -> Simulated:
        """Descend from coefficients theta (n_terms,) and initial outputs (n_initial,), or the measured ones."""
        result, initial = self._error(model).minimise(theta, settings, initial)
        return Simulated(replace(model, theta=result.theta), result.rss, initial)

    def _error(self, model: Narmax) -> FreeRunLeastSquares:
        return FreeRunLeastSquares(model.recursion(), self.records, look_back=self.terms.max_lag)

    def _grown(self, now: Simulated) -> Simulated | None:
        """Return the model with the additional term that lowers the simulation error most; None if none does."""
        try:
            gain = self._gains(now)
        except IdentError:
            return None
        tried = []
        for j in np.argsort(-gain, kind="stable")[:N_TRIALS].tolist():
            if gain[j] <= 0.0:
                continue
            larger = among(now.model, now.model.terms + self.terms[[j]])
            try:
                tried.append(self.minimised(larger, larger.theta, TRIAL, now.initial))
            except IdentError:  # it diverges during the descent
                continue
        if not tried:
            return None
        best = min(tried, key=lambda one: one.rss)
        return self.minimised(best.model, best.model.theta, SHORT_DESCENT, best.initial)

    def _thinned(self, now: Simulated, best: dict[int, Simulated]) -> Simulated:
        """Remove terms while the result beats the best model of the smaller size; return the last such model."""
        self._remember(now, best)
        while len(now.model.terms) - 1 in best and (trial := self._shrunk(now)) is not None:
            if not self._remember(trial, best):
                break
            now = trial
        return now

    def _pruned(self, now: Simulated, best: dict[int, Simulated]) -> Simulated:
        """Remove terms while the loss is below `MAX_LOSS`; return the last such model."""
        self._remember(now, best)
        while len(now.model.terms) > 1 and (trial := self._shrunk(now)) is not None:
            if trial.rss > now.rss * (1.0 + MAX_LOSS):
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
        if size not in best or now.rss < best[size].rss * (1.0 - MIN_GAIN):
            best[size] = now
            return True
        return False

    def _gains(self, now: Simulated) -> Floats:
        """Return the decrease of the sum of squares (n_candidates,) by a Gauss-Newton step with each new candidate."""
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
        """Return the term whose removal costs least to first order."""
        gram, cross, theta = self._normalised(now, now.model)
        inverse = np.linalg.pinv(gram, hermitian=True)
        theta = theta + inverse @ cross
        return int(np.argmin(theta**2 / np.maximum(np.diagonal(inverse), 1e-100)))

    def _normalised(self, now: Simulated, model: Narmax) -> tuple[Floats, Floats, Floats]:
        """Return the normal equations J'J and J'r of a model, and its coefficients, for columns of unit norm."""
        gram, cross = self._error(model).normal_equations(model.theta, now.initial)
        size = np.sqrt(np.maximum(np.diagonal(gram), 0.0))  # may be slightly negative by rounding
        size = np.where(size > 0, size, 1.0)
        gram, cross = gram / size / size[:, None], cross / size
        if not (np.isfinite(gram).all() and np.isfinite(cross).all()):
            raise IdentError("the gradients of the model diverge on these records")
        return gram, cross, model.theta * size
