"""Black, absorbing surface."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import blind_walls
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.places import ends_of_part, part_of_wall
from sensorgraph.effects.proposals import (
    LOSS_LEFTOVERS,
    PROPOSAL,
    best_first,
    best_run,
    on_part_of_wall,
    sharpen_part,
    sum_by_wall,
)
from sensorgraph.types import Floats
from sensorgraph.world.beams import Beams
from sensorgraph.world.scene import Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Add the loss of rays at oblique incidence or long range."""
    scene.surfaces.append(partial(absorb, a=a))


def absorb(scene: Scene, beams: Beams, *, a: Amendment) -> None:
    """Reduce the probability of a return on the black part."""
    on = part_of_wall(scene, beams, a)
    near = min(a["r0"], 1e6) / np.maximum(beams.ranges, 1e-6)
    chance = np.minimum(1.0, beams.cosine * near**2)
    beams.p_return = np.where(on, chance, 1.0) * beams.p_return


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for missing returns that increase with range and incidence, on a part of one wall."""
    on = residuals.beams.wall >= 0
    lost = on & residuals.lost & residuals.aimed
    if lost.sum() < PROPOSAL.min_lost:
        return []
    found = []
    cosine, r = residuals.beams.cosine[on], residuals.beams.ranges[on]
    returned, log_p = residuals.returned[on], residuals.log_p[on]
    walls, along = residuals.beams.wall[on], residuals.along[on]
    n_walls = len(residuals.walls)
    best: dict[int, tuple[float, float, float, float]] = {}
    gone = residuals.lost[on]

    def gains(r0: float, some: Any = slice(None)) -> Floats:
        p = np.clip(np.minimum(1.0, cosine[some] * (r0 / r[some]) ** 2), 1e-4, 1.0)
        missed = np.log(1 - p * (1 - residuals.loss) + 1e-5) - log_p[some]
        return np.where(returned[some], np.log(p), np.where(gone[some], missed, 0.0))

    for r0 in np.geomspace(0.3, residuals.sensor.range_max, 14):
        gain = gains(r0)
        table = sum_by_wall(walls, along, gain, n_walls)
        first, last, total = best_run(table)
        for wall in np.argsort(-total)[:2]:
            if total[wall] > best.get(int(wall), (PROPOSAL.min_gain,))[0]:
                best[int(wall)] = (
                    float(total[wall]),
                    first[wall] * PROPOSAL.wall_bin,
                    (last[wall] + 1) * PROPOSAL.wall_bin,
                    float(r0),
                )
    for wall, (promised, a, b, start) in sorted(best.items(), key=lambda item: -item[1][0])[:2]:
        mine = np.flatnonzero(walls == wall)
        tries = []
        for r0 in start * np.geomspace(0.85, 1.18, 9):
            low, high, exact = sharpen_part(along[mine], gains(r0, mine), a, b)
            tries.append((exact, low, high, float(r0)))
        exact, low, high, r0 = max(tries)
        if exact < promised:
            low, high, r0 = a, b, start
        found.append(on_part_of_wall(residuals, wall, max(exact, promised), a=low, b=high, r0=r0))
    return best_first(found)[:2]


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Return the walls with too few rays from far away or at oblique incidence."""
    r0 = typical["r0"]
    with np.errstate(divide="ignore"):
        p = np.cos(exposure.incidence) * (r0 / np.maximum(exposure.range, 1e-3)) ** 2
    p = np.clip(p, 1e-3, 1 - 1e-3)
    nats = p * np.log(p / (1 - exposure.loss)) + (1 - p) * np.log((1 - p) / exposure.loss)
    why = f"too few rays from farther than {r0:.0f} m, or at oblique incidence"
    return blind_walls(exposure, exposure.seen * nats, need, why)


BLACK_SURFACE = Effect(
    name="black_surface",
    title="black, absorbing surface",
    channel="scan",
    stage="surface",
    physics="A dark part of a wall returns with probability min(1, cos(incidence) (r0 / r)^2).",
    equation="P(return) = min(1, cos α (r₀ / r)²), from a to b along the wall",
    source="Jelalian (1992), laser radar systems: the range equation of a Lambertian target",
    varies="range and incidence on a part of one wall",
    rivals={
        "max_range": "look at another wall at the same range",
        "incidence_dropout": "look at another wall at the same incidence",
    },
    parameters=(
        *ends_of_part("the dark part"),
        Parameter(
            name="r0",
            unit="m",
            doc="range up to which every ray returns at normal incidence",
            neutral=None,
            low=0.0,
            search_step=0.05,
            typical=1.0,
        ),
    ),
    transform=transform,
    place="wall",
    diagnostics=Diagnostics(
        unobservable=unobservable,
        propose=propose,
        leftovers=LOSS_LEFTOVERS,
        misfit_share=0.012,
    ),
)
