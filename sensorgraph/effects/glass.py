"""Glass pane."""

from __future__ import annotations

from functools import partial

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.places import part_of_wall, seen_without
from sensorgraph.effects.set_up import end_of_part_error, third_of_map_error, wall_direction_error
from sensorgraph.effects.shared import LOSS_LEFTOVERS, LOST_BY_DIRECTION
from sensorgraph.world.scene import RIGHT_ANGLE, Beams, Scene


def transform(scene: Scene, a: Amendment) -> None:
    """Let slanting rays through."""
    scene.surfaces.append(partial(pass_through, a=a))


def pass_through(scene: Scene, beams: Beams, *, a: Amendment) -> None:
    """Lengthen the rays that the pane does not return."""
    on = part_of_wall(scene, beams, a)
    through = on & (beams.incidence >= a["alpha_ret"])
    if not through.any():
        return
    if a["depth"] > 0:
        behind = beams.ranges + a["depth"] / np.maximum(beams.cosine, 0.02)
    else:
        behind = seen_without(scene, beams, through, a.place)
    beams.ranges = np.where(through, behind, beams.ranges)
    beams.reading = beams.ranges.copy()
    beams.bent()[through] = False


GLASS = Effect(
    name="glass",
    title="glass pane",
    channel="scan",
    stage="surface",
    physics="A pane returns only rays that meet it more head-on than alpha_ret; others see what stands behind it.",
    equation="z = r for α < α_ret, else what stands behind, from a to b along the wall",
    source="Koch, May, Murphy and Nuechter (2017), identification and correction of transparent and specular reflecting objects in laser scans",
    varies="one part of one wall, long readings, incidence",
    rivals={
        "mirror": "what is seen behind is the room mirrored, not a plane",
        "moved_wall": "approach it at normal incidence",
    },
    parameters=(
        Parameter(
            name="a",
            unit="m",
            doc="where the pane begins, along the wall from its first end",
            neutral=None,
            search_step=0.01,
            hidden=end_of_part_error,
        ),
        Parameter(
            name="b", unit="m", doc="where it ends", neutral=None, search_step=0.01, hidden=end_of_part_error
        ),
        Parameter(
            name="alpha_ret",
            unit="rad",
            doc="the pane returns below this incidence",
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
            doc="of a plane behind the pane; 0: what the map has there",
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
    diagnostics=Diagnostics(leftovers=LOSS_LEFTOVERS, misfit_share=0.012, telltale=LOST_BY_DIRECTION),
)
