"""What wide tolerances in robot.yaml take along without a name: nothing is found there, but nothing is shown either."""

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
"""Times its materiality that an effect may reach unnamed, above which a tolerance is called wide; robot.yaml's defaults
stay below 1.2."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tolerated:
    """One effect that a tolerance takes along."""

    tolerance: str
    """Its key in robot.yaml."""
    most: Amendment
    """The largest that passes without a name."""
    taken: Amendment | None
    """What passed in this run, where that is more than its materiality."""


def tolerated(finding: Finding) -> list[Tolerated]:
    """List what the tolerances of this run are too wide to show."""
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
    """Return the effects that a tolerance takes along, in the order of robot.yaml's keys."""
    keys = [f.name for f in fields(Tolerances)]
    own = [effect for effect in EFFECTS.values() if effect.diagnostics.tolerance]
    return sorted(own, key=lambda effect: keys.index(effect.diagnostics.tolerance))


def _largest(effect: Effect, tolerances: Tolerances) -> Amendment:
    """Return the largest size of an effect that a tolerance takes along, along its first parameter."""
    first, *others = effect.steps
    if effect.nuisances:
        bound = SCAN.nuisance.max_tolerances * prior_widths(tolerances)[effect.nuisances[0]]
    else:
        bound = SCAN.nuisance.max_tolerances * getattr(tolerances, effect.diagnostics.tolerance)
    return effect(**{first: float(bound)}, **dict.fromkeys(others, 0.0))


def _taken(effect: Effect, finding: Finding) -> Amendment | None:
    """Return what a tolerance took in this run, as the effect it would have been."""
    if finding.explained is None:
        return None
    g = finding.explained.final.state.g
    corners = g[len(Nuisance) :]
    values = g[list(effect.nuisances)] if effect.nuisances else [np.abs(corners).max(initial=0.0)]
    return effect(**dict(zip(effect.steps, map(float, values), strict=True)))
