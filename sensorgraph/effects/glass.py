"""Glass pane."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import UNEXPECTED, blind_walls
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.places import ends_of_part, part_of_wall, seen_without, walls_of
from sensorgraph.effects.proposals import (
    LOSS_LEFTOVERS,
    PROPOSAL,
    best_first,
    best_part,
    on_part_of_wall,
    sharpen_part,
    strange_on_walls,
)
from sensorgraph.effects.set_up import third_of_map_error, wall_direction_error
from sensorgraph.types import Bools, Floats
from sensorgraph.world.beams import Beams
from sensorgraph.world.scene import RIGHT_ANGLE, Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Add the transmission of rays at oblique incidence."""
    scene.surfaces.append(partial(pass_through, a=a))


def pass_through(scene: Scene, beams: Beams, *, a: Amendment) -> None:
    """Lengthen the rays that pass through the pane."""
    on = part_of_wall(scene, beams, a)
    through = on & (beams.incidence >= a["alpha_ret"])
    if not through.any():
        return
    if a["depth"] > 0:
        behind = beams.ranges + a["depth"] / np.maximum(beams.cosine, 0.02)
    else:
        behind = np.full(beams.ranges.shape, np.inf)
        behind[through] = seen_without(scene.walls, walls_of(scene, a.place), beams, through)
    beams.ranges = np.where(through, behind, beams.ranges)
    beams.reading = beams.ranges.copy()
    beams.bent()[through] = False


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for long or missing returns at oblique incidence, on a part of one wall."""
    on, walls = strange_on_walls(residuals)
    found = []
    for wall in walls:
        found += _panes(residuals, wall, on & (residuals.beams.wall == wall))
    return best_first(found)[:3]


def _panes(residuals: Residuals, wall: int, mine: Bools) -> list[Proposal]:
    """Propose panes on one wall, with a plane behind and with the map behind."""
    z, mu = residuals.z[mine], residuals.mu[mine]
    incidence, cosine = residuals.incidence[mine], residuals.beams.cosine[mine]
    along, log_p = residuals.along[mine], residuals.log_p[mine]
    long = residuals.long[mine]
    depths = [0.0]
    if long.sum() >= PROPOSAL.min_rays:
        d = (z - mu)[long] * cosine[long]
        counts, edges = np.histogram(d, bins=np.arange(0.0, min(d.max() + 0.1, 30.0) + 0.05, 0.05))
        at = int(counts.argmax())
        near = np.abs(d - (edges[at] + 0.025)) < 0.05
        depths.append(float(np.median(d[near])))
    else:
        depths.append(50.0)
    behind = seen_without(residuals.walls, np.array([wall]), residuals.beams, mine)
    best: Proposal | None = None
    for depth in depths:
        seen = mu + depth / np.maximum(cosine, 0.02) if depth > 0 else behind
        through = residuals.likely(seen, mine) - log_p
        for alpha in np.radians([0.0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75]):
            gain = np.where(incidence >= alpha, through, 0.0)
            first, last, total = best_part(along, gain)
            if best is None or total > best.gain:
                a, b, sharp, exact = _pane(along, incidence, through, (first, last))
                best = on_part_of_wall(
                    residuals,
                    wall,
                    max(exact, total),
                    a=a,
                    b=b,
                    alpha_ret=max(sharp, 1e-3),
                    depth=depth,
                )
    return [best] if best is not None else []


def _pane(
    along: Floats, incidence: Floats, through: Floats, span: tuple[float, float]
) -> tuple[float, float, float, float]:
    """Return a, b, alpha_ret of a pane, refined to single rays, and the gain."""
    a, b = span
    alpha, gain = 0.0, 0.0
    for _ in range(2):
        inside = (along >= a) & (along <= b)
        if not inside.any():
            return *span, 0.0, 0.0
        order = np.argsort(-incidence[inside])
        total = np.cumsum(through[inside][order])
        at = int(total.argmax())
        sorted_incidence = incidence[inside][order]
        alpha = float((sorted_incidence[at] + sorted_incidence[min(at + 1, len(order) - 1)]) / 2)
        a, b, gain = sharpen_part(along, np.where(incidence >= alpha, through, 0.0), a, b)
    return a, b, alpha, gain


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Return the walls with too few rays at oblique incidence."""
    alpha = typical["alpha_ret"]
    oblique = np.asarray(UNEXPECTED * (exposure.seen & (exposure.incidence > alpha)))
    why = f"too few rays at an incidence above {np.degrees(alpha):.0f} degrees"
    return blind_walls(exposure, oblique, need, why)


GLASS = Effect(
    name="glass",
    title="glass pane",
    channel="scan",
    stage="surface",
    physics="A pane returns only rays at an incidence below alpha_ret; other rays measure the surface behind it.",
    equation="z = r for α < α_ret, else the range of the surface behind, from a to b along the wall",
    source="Koch, May, Murphy and Nuechter (2017), identification and correction of transparent and specular reflecting objects in laser scans",
    varies="incidence on a part of one wall, with long readings",
    rivals={
        "mirror": "a mirror shows the mirrored room and not a plane",
        "moved_wall": "approach the wall at normal incidence",
    },
    parameters=(
        *ends_of_part("the pane"),
        Parameter(
            name="alpha_ret",
            unit="rad",
            doc="incidence below which the pane returns",
            neutral=RIGHT_ANGLE,
            low=0.0,
            high=RIGHT_ANGLE,
            search_step=0.01,
            typical=float(np.radians(20.0)),
            hidden=wall_direction_error,
        ),
        Parameter(
            name="depth",
            unit="m",
            doc="depth of a plane behind the pane; 0: the surface in the map",
            neutral=None,
            low=0.0,
            absent_at_zero=True,
            step=1e-4,
            typical=1.0,
            hidden=third_of_map_error,
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
