"""An object that stands against a wall."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.consequence import scan_change
from sensorgraph.diagnosis.scan.fit import cast
from sensorgraph.diagnosis.scan.materiality import is_map_error
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects.effect import without
from sensorgraph.types import Floats

NAME = "object_at_wall"
WALL_CAUSES: tuple[str, ...] = (
    "furniture that leans against the wall, an open door, a radiator",
    "a reflector, which appears wider than it is",
)


def find(checked: Checked) -> list[Doubt]:
    """Return an unmapped disc whose centre is inside a wall of the map: only a bulge of the wall is visible.

    At a site with known-good runs the test is skipped. Maps are inaccurate at walls everywhere, and the clutter floor
    accounts for it.
    """
    view, gains = checked.view, checked.gains
    data = view.data
    if data.clutter_nats:
        return []
    out = []
    for index, a in enumerate(view.fitted.model):
        if a.effect.place != "spot" or is_map_error(view.fitted, a):
            continue
        x, y = a["x"], a["y"]
        if data.arena.contains(np.array([[x, y]]))[0]:
            continue
        wall = data.arena.names[_nearest_wall(data.arena.walls, np.array([x, y]))]
        whole = cast(data, view.fitted.model)  # other effects may have moved since the cast of the fit
        out.append(
            Doubt(
                family=NAME,
                statement=f"readings end in front of {wall} near ({x:.1f}, {y:.1f}) m: an object stands against the wall, "
                "or the wall is reflective there",
                misfit=gains[index],
                statistic=gains[index],
                threshold=SCAN.selection.threshold,
                failed=frozenset([index]),
                fringe=frozenset([index]),
                size=scan_change(whole, cast(data, without(view.fitted.model, index))),
                causes=WALL_CAUSES,
            )
        )
    return out


def _nearest_wall(walls: Floats, point: Floats) -> int:
    """Return the index of the wall, of (n, 2, 2) [m], that is nearest to a point (2,)."""
    way = walls[:, 1] - walls[:, 0]
    share = ((point - walls[:, 0]) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12)
    foot = walls[:, 0] + np.clip(share, 0.0, 1.0)[:, None] * way
    return int(np.argmin(np.hypot(*(foot - point).T)))


OBJECT_AT_WALL = Unnamed(titles={NAME: "an object that stands against a wall"}, find=find)
