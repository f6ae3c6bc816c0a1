"""Returns that are missing towards one side of the room, as from light through a window."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.fit import bare_cast
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects.places import part_of_wall
from sensorgraph.types import Bools, Floats, Ints

NAME = "missing_by_direction"


def find(checked: Checked) -> list[Doubt]:
    """Return a wall segment without returns if the missing returns depend on the direction in the room instead.

    In these directions, returns from other walls are missing as well; in other directions rays to the segment return.
    This is typical of light from one side.
    """
    view, gains, settings = checked.view, checked.gains, SCAN.goodness_of_fit
    beams = view.beams
    scene = view.fitted.cast.scene
    placed = [(i, a) for i, a in enumerate(view.fitted.model) if a.effect.on_part_of_wall]
    if not placed:
        return []
    bare = bare_cast(scene)
    n = settings.n_light_directions
    towards = np.broadcast_to(np.arctan2(beams.uy, beams.ux), view.lost.shape)
    direction = np.clip(((towards + np.pi) / (2 * np.pi) * n).astype(np.intp), 0, n - 1)
    is_near_enough = np.isfinite(bare.ranges) & (bare.ranges < view.range_max) & ~np.isnan(view.z)
    out = []
    for index, a in placed:
        on = is_near_enough & part_of_wall(scene, bare, a)

        def share(rays: Bools) -> tuple[Floats, Ints]:
            """Return the share of missing returns in each direction (n,), and the number of rays."""
            count = np.bincount(direction[rays], minlength=n)
            lost = np.bincount(direction[rays & view.lost], minlength=n)
            return lost / np.maximum(count, 1), count

        (on_part, n_on), (elsewhere, n_elsewhere) = share(on), share(is_near_enough & ~on)
        both = (n_on >= settings.min_rays) & (n_elsewhere >= settings.min_rays)
        # at the edge of the light, a direction is neither dark nor light
        least = settings.min_light_share
        dark, light = both & (on_part > 0.5), both & (on_part < settings.max_light_share)
        if (
            dark.any()
            and light.any()
            and (elsewhere[dark] > least).all()
            and (elsewhere[light] < least).all()
        ):
            out.append(
                Doubt(
                    family=NAME,
                    statement=f"returns are missing towards one side of the room ({np.degrees(_middle(dark)):.0f}° in the map), "
                    "at every wall in that direction",
                    misfit=gains[index],
                    statistic=float(elsewhere[dark].mean()),
                    threshold=least,
                    failed=frozenset([index]),
                    size=ScanError(wrong=float(view.lost.mean())),
                    causes=("light from that side: sun through a window, a lamp",),
                )
            )
    return out


def _middle(some: Bools) -> float:
    """Return the mean direction [rad] of some of the equal bins of a full turn."""
    at = (np.flatnonzero(some) + 0.5) / len(some) * 2 * np.pi - np.pi
    return float(np.angle(np.exp(1j * at).mean()))


MISSING_BY_DIRECTION = Unnamed(titles={NAME: "returns missing towards one side of the room"}, find=find)
