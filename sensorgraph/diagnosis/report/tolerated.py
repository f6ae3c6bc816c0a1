"""Effects that wide tolerances in robot.yaml hide: they can neither be found nor excluded."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.scan.nuisance import prior_widths
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment, Effect
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.world.robot import Tolerances

WIDE = 2.0
"""Largest hidden size of an effect, in units of its materiality, above which a tolerance is called wide. The defaults of
robot.yaml stay below 1.2."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tolerated:
    """An effect that a tolerance hides."""

    tolerance: str
    """Its key in robot.yaml."""
    most: Amendment
    """The largest hidden size."""
    taken: Amendment | None
    """The size absorbed in this run, if it exceeds the materiality."""


def tolerated(finding: Finding) -> list[Tolerated]:
    """List the effects that the tolerances of this run hide."""
    tolerances = finding.data.tolerances
    present = {a.name for a in finding.effects}
    out = []
    for effect in _tolerated_effects():
        most = _largest(effect, tolerances)
        if effect.name in present or most.ratio <= WIDE:
            continue
        taken = _taken(effect, finding)
        is_material = taken is not None and taken.ratio >= 1.0
        out.append(
            Tolerated(tolerance=effect.diagnostics.tolerance, most=most, taken=taken if is_material else None)
        )
    return out


def _tolerated_effects() -> list[Effect]:
    """Return the effects that a tolerance can hide, in the order of the keys in robot.yaml."""
    keys = [f.name for f in fields(Tolerances)]
    own = [effect for effect in EFFECTS.values() if effect.diagnostics.tolerance]
    return sorted(own, key=lambda effect: keys.index(effect.diagnostics.tolerance))


def _largest(effect: Effect, tolerances: Tolerances) -> Amendment:
    """Return the largest size of an effect that its tolerance hides, along its first parameter."""
    first, *others = effect.steps
    if effect.nuisances:
        bound = SCAN.nuisance.max_tolerances * prior_widths(tolerances)[effect.nuisances[0]]
    else:
        bound = SCAN.nuisance.max_tolerances * getattr(tolerances, effect.diagnostics.tolerance)
    return effect(**{first: float(bound)}, **dict.fromkeys(others, 0.0))


def _taken(effect: Effect, finding: Finding) -> Amendment | None:
    """Return the error that a tolerance absorbed in this run, expressed as the effect."""
    if finding.explained is None:
        return None
    g = finding.explained.final.state.g
    corners = g[len(Nuisance) :]
    values = g[list(effect.nuisances)] if effect.nuisances else [np.abs(corners).max(initial=0.0)]
    return effect(**dict(zip(effect.steps, map(float, values), strict=True)))
