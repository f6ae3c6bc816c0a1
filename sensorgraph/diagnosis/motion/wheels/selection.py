"""Select the wheel effects by evidence, in competition with structure that no effect explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sensorgraph.diagnosis.engine import selection as engine
from sensorgraph.diagnosis.motion.consequence import (
    ReferenceError,
    SimulationError,
    reference_error,
)
from sensorgraph.diagnosis.motion.reference_noise import LimitedNoiseFitter, noise_limits
from sensorgraph.diagnosis.motion.regression import Term
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import (
    AcceptedStructure,
    StructureFamily,
    StructureTest,
    TestedStructure,
)
from sensorgraph.diagnosis.motion.wheels.model import STRUCTURE_THRESHOLD, SlipPatch, WheelModel
from sensorgraph.diagnosis.motion.wheels.patch_search import PATCH_PRICE, best_patch, refine_patch
from sensorgraph.diagnosis.motion.wheels.reference_structure import reference_jumps
from sensorgraph.diagnosis.motion.wheels.structure import (
    JUMP,
    N_NEARER_JUMPS,
    jump_spacing,
    nearer_jumps,
    odometry_families,
)
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.types import Floats

N_REFINED = 2
"""Number of refinements of the moment of a change."""
PATCH_SHARE = 0.1
"""Share of the evidence of a patch, below which structure only reflects its rim: no patch is a sharp disc."""
MAX_PATCHES = 3
"""Maximum number of patches in one run."""


def select(model: WheelModel, rng: np.random.Generator, *, is_reference_straight: bool = False) -> list[Term]:
    """Add effects to the model while the evidence suffices, then remove superfluous ones.

    Structure that no effect explains competes with the effects, and replaces them if it explains more. If the
    reference is known to be straight, a distorted reference is not tried.
    """
    most = len(model.layout.terms) + MAX_PATCHES
    terms = engine.select(WheelChannel(model, rng), threshold=EVIDENCE.threshold, most=most)
    _join_patches(model, terms, rng)
    _admit_structure(model, terms, rng, is_reference_straight=is_reference_straight)
    for i in range(len(model.patches)):
        if model.patch_term(i) in terms:
            refine_patch(model, i, terms, rng)
    engine.remove_superfluous(WheelChannel(model, rng), terms)
    return terms


class WheelChannel:
    """Wheel effects and slippery patches, as hypotheses about the odometry."""

    def __init__(self, model: WheelModel, rng: np.random.Generator) -> None:
        self.model, self.rng = model, rng

    def best(self, model: Sequence[Term]) -> tuple[Term, float] | None:
        """Return the best further effect or patch, and its evidence [nats]."""
        wheels = self.model
        gains = {term: wheels.evidence(model, term) for term in wheels.layout.terms if term not in model}
        best = max(gains, key=lambda term: gains[term], default=None)
        top = -np.inf if best is None else gains[best]
        can_slip = len(wheels.patches) < MAX_PATCHES
        found = wheels.last_patch = best_patch(wheels, model, self.rng) if can_slip else None
        if found is not None and found[1] >= max(top, EVIDENCE.threshold):
            wheels.patches.append(found[0])
            return wheels.patch_term(len(wheels.patches) - 1), found[1]
        return None if best is None else (best, top)

    def added(self, model: Sequence[Term]) -> None:
        """Refine a patch that has entered, and fit the noise."""
        if model[-1].effect is WHEEL_SLIP:
            self.model.whiten()
            refine_patch(self.model, len(self.model.patches) - 1, model, self.rng)
        self.model.fit_noise()

    def removed(self, model: Sequence[Term]) -> None:
        """Keep the noise, which was fitted with all effects free."""

    def evidence(self, model: Sequence[Term], hypothesis: Term) -> float:
        """Return the evidence [nats] for an effect in addition to the others."""
        return self.model.evidence(model, hypothesis)

    def needed(self, model: Sequence[Term], hypothesis: Term) -> float:
        """Return the evidence [nats] that an effect needs."""
        return EVIDENCE.threshold


def _join_patches(model: WheelModel, terms: list[Term], rng: np.random.Generator) -> None:
    """Replace several patches by one if that is more likely, or if two of them contain each other's centre.

    The filter absorbs a patch outside the model as noise, and more of it the longer the robot stays there. A
    large patch is therefore found in pieces. The same floor does not slip twice: a second patch on it only
    corrects the rim of the first, which the pose errors blur.
    """
    pieces, several = model.patches, list(terms)
    if len(pieces) < 2:
        return
    likelihood = model.log_posterior(terms)
    model.patches = []
    model.whiten()
    terms[:] = [term for term in terms if term.effect is not WHEEL_SLIP]
    found = best_patch(model, terms, rng)
    if found is not None:
        model.patches = [found[0]]
        terms.append(model.patch_term(0))
        model.whiten()
        refine_patch(model, 0, terms, rng)
    is_likelier = model.log_posterior(terms) >= likelihood - PATCH_PRICE * (len(pieces) - 1)
    if found is None or not (is_likelier or _lie_on_each_other(pieces)):
        model.patches, terms[:] = pieces, several
        model.whiten()
        return
    model.fit_noise()
    engine.remove_superfluous(WheelChannel(model, rng), terms)


def _lie_on_each_other(patches: Sequence[SlipPatch]) -> bool:
    """Tell whether two patches contain each other's centre."""
    return any(np.hypot(a.x - b.x, a.y - b.y) < min(a.r, b.r) for a, b in combinations(patches, 2))


# structure -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class StructureCandidate:
    """Structure that could enter the model, in addition to patches or instead of them."""

    family: StructureFamily
    evidence: float
    """[nats]"""
    replaces_patches: bool


def _admit_structure(
    model: WheelModel, terms: list[Term], rng: np.random.Generator, *, is_reference_straight: bool
) -> None:
    """Let structure that no effect explains enter the model, in addition to the effects or instead of patches."""
    model.denoise_motion()
    fit = model.regression.solve(model.prior(model.layout.terms))
    families = odometry_families(
        model.rows, model.motion, model.robot.wheels, is_reference_straight=is_reference_straight
    )
    jumps = reference_jumps(model.rows, model.y - model.columns @ fit.theta)
    limits = noise_limits(model.robot, model.wheels, model.rows.stamps)
    test = StructureTest(model.rows.valid, model.y, LimitedNoiseFitter(limits))
    own = model.columns
    # a patch at the place of jumps absorbs a part of them, so that jumps are tested without patches
    family, gain = _best_structure(model, test, own, families if model.patches else [*families, *jumps])
    dispersion = test.dispersion(EVIDENCE.cluster, limits[0].period)
    candidate = StructureCandidate(family=family, evidence=gain, replaces_patches=False)
    if model.patches:
        candidate = _in_stead_of_patches(model, test, own, candidate, [*families, *jumps])
    beside = model.A if candidate.replaces_patches else own
    needed = STRUCTURE_THRESHOLD * dispersion
    if not candidate.replaces_patches:
        needed = max(needed, _left_by_rims(model, terms))
    if candidate.evidence < needed:
        model.tested.append(TestedStructure(families=test.tested, threshold=needed))
        return
    likely = [family for family in test.ranking(beside, families) if not family.is_of_reference]
    explained = [candidate.family] if candidate.family.is_of_reference else likely or [candidate.family]
    size = _size(model, test.explained(beside, explained), candidate.family)
    rivals = [family.statement for family in likely]
    accepted = AcceptedStructure(
        family=candidate.family,
        evidence=candidate.evidence,
        threshold=needed,
        size=size,
        rivals=[text for text in rivals if text != candidate.family.statement][:2],
    )
    is_material = size.is_material(model.robot.limits.v, candidate.evidence)
    tested = TestedStructure(families=test.tested, threshold=needed, best=accepted, is_material=is_material)
    model.tested.append(tested)
    if not candidate.replaces_patches and not is_material:
        return
    if candidate.replaces_patches:
        model.patches = []
        terms[:] = [term for term in terms if term.effect is not WHEEL_SLIP]
    if is_material:
        model.structure = accepted
    model.fit_noise()
    engine.remove_superfluous(WheelChannel(model, rng), terms)


def _best_structure(
    model: WheelModel, test: StructureTest, own: Floats, families: Sequence[StructureFamily]
) -> tuple[StructureFamily, float]:
    """Return the best family in addition to columns (2 n, k), and its evidence; the moment of a change is refined."""
    family, gain = test.best(own, families)
    if gain <= 0:
        return family, gain
    jump, most = test.best(own, [one for one in families if one.kind == JUMP])
    reach = jump_spacing(model.motion)
    for _ in range(N_REFINED):
        nearer, more = test.best(
            own, nearer_jumps(model.rows, model.motion, model.robot.wheels.base, jump.moment, reach)
        )
        if more > most:
            jump, most = nearer, more
        reach /= N_NEARER_JUMPS
    return (jump, most) if most > gain else (family, gain)


def _size(model: WheelModel, missing: Floats, family: StructureFamily) -> SimulationError | ReferenceError:
    """Return the error of a simulation, or of a reference, that lacks rows (2 n,)."""
    if family.is_of_reference:
        return reference_error(model.rows.D_yaw @ model.motion.turn, missing)
    return model.error_without(missing)


def _in_stead_of_patches(
    model: WheelModel,
    test: StructureTest,
    own: Floats,
    beside: StructureCandidate,
    families: Sequence[StructureFamily],
) -> StructureCandidate:
    """Return the better candidate: structure in addition to the patches, or structure instead of them."""
    # without the patches, which may have absorbed the structure
    family, total = _best_structure(model, test, model.A, families)
    gain = test.lead(model.A, family, own)
    has_rims = not any(patch.is_unbounded for patch in model.patches)
    if gain + PATCH_PRICE * len(model.patches) > beside.evidence or (gain > 0 and not has_rims):
        return StructureCandidate(family=family, evidence=total, replaces_patches=True)
    return beside


def _left_by_rims(model: WheelModel, terms: Sequence[Term]) -> float:
    """Return the evidence for structure [nats] that the rim of a patch may cause.

    Beside several patches it is 0: they imitate something else.
    """
    wheels = [term for term in terms if term.effect is not WHEEL_SLIP]
    if len(terms) - len(wheels) != 1:
        return 0.0
    return PATCH_SHARE * (model.log_posterior(terms) - model.log_posterior(wheels))
