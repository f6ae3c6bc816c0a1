"""Select the hypotheses of a motion channel by evidence: effects, and differences without a name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.motion.consequence import ReferenceError, SimulationError, sure_share
from sensorgraph.diagnosis.motion.motor_model import DriveModel
from sensorgraph.diagnosis.motion.motor_structure import DRIVE_FAMILIES
from sensorgraph.diagnosis.motion.regression import Fit, Term
from sensorgraph.diagnosis.motion.structure_test import (
    StructureFamily,
    StructureTest,
    TestedFamily,
)
from sensorgraph.diagnosis.motion.wheel_model import WheelModel
from sensorgraph.diagnosis.motion.wheel_structure import ODOMETRY_FAMILIES
from sensorgraph.types import Floats

FAMILIES_OF: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "odometry": ODOMETRY_FAMILIES,
    "drive": DRIVE_FAMILIES,
}
"""Channel -> its families without a name: name in the ledger, and noun phrase."""
MotionModel = WheelModel | DriveModel
"""Regression of one run, of wheels or of motors."""


class MotionChannel:
    """Hypotheses of a model, for the selection of the engine; `fit` is that of the present model."""

    def __init__(self, model: MotionModel, terms: Sequence[Term] = (), start: Fit | None = None) -> None:
        self.model, self.fit = model, model.fit(terms, start)
        self._fits: dict[frozenset[Term], Fit] = {}

    def best(self, model: Sequence[Term]) -> tuple[Term, float] | None:
        """Return the best further hypothesis and its evidence [nats]."""
        here = self.fit.log_posterior
        gains = {
            term: self._fit([*model, term]).log_posterior - here - self.model.rows.price(term.n_parameters)
            for term in self.model.terms
            if term not in model
        }
        return max(gains.items(), key=lambda one: one[1], default=None)

    def added(self, model: Sequence[Term]) -> None:
        """Fit a changed model from the present optimum."""
        self.fit = self._fit(model)
        self._fits = {}

    removed = added

    def _fit(self, model: Sequence[Term]) -> Fit:
        key = frozenset(model)
        if key not in self._fits:
            self._fits[key] = self.model.fit(model, self.fit)
        return self._fits[key]

    def evidence(self, model: Sequence[Term], hypothesis: Term) -> float:
        """Return the evidence [nats] for a hypothesis in addition to the others."""
        rest = [term for term in model if term != hypothesis]
        return (
            self.fit.log_posterior
            - self._fit(rest).log_posterior
            - self.model.rows.price(hypothesis.n_parameters)
        )


def admitted_structure(
    model: MotionModel,
    test: StructureTest,
    own: Floats,
    found: tuple[StructureFamily, float],
    threshold: float,
    size_of: Callable[[Floats, StructureFamily], SimulationError | ReferenceError],
    *,
    stands_for_material: bool = False,
) -> TestedFamily | None:
    """Return the best family if its evidence suffices and its size matters to a user; the ledger keeps the test.

    Parameters
    ----------
    own : (k n, .) Columns of the model without structure.
    found : The best family, and its evidence [nats].
    threshold : [nats]
    stands_for_material : It replaces effects that matter.
    size_of : Returns the error without rows (k n,) that the family explains.
    """
    family, gain = found
    others = {kind: replace(one, threshold=threshold) for kind, one in test.tested.items()}
    if gain < threshold:
        model.tested += others.values()
        return None
    missing = test.explained(own, family)
    size = size_of(missing, family)
    is_material = size.is_material(model.robot, gain)
    if family.least_change:
        rms = np.std(missing) / max(float(np.std(family.columns.sum(axis=1))), 1e-12)
        is_material = bool(2 * sure_share(gain) * rms >= family.least_change)
    screened = others.pop(family.kind, None)
    best = TestedFamily(
        family=family,
        evidence=gain,
        price=None if screened is None else screened.price,
        threshold=threshold,
        size=size,
        is_material=is_material or stands_for_material,
        rivals=test.rivals(family),
    )
    model.tested += [best, *(replace(one, beaten_by=best) for one in others.values())]
    return best if best.is_material else None
