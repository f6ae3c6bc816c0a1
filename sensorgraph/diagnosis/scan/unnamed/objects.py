"""Objects that a disc or a wall does not describe: one that stands against a wall, and one that is present for a part of the run only."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError, is_map_error, scan_change
from sensorgraph.diagnosis.scan.fit import cast, log_p_at
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects.effect import without
from sensorgraph.effects.proposals import best_run
from sensorgraph.types import Floats

WALL_CAUSES: tuple[str, ...] = (
    "furniture that leans against the wall, an open door, a radiator",
    "a reflector, which appears wider than it is",
)
CAUSES = (
    "a door, a vehicle or a person that came or left during the run",
    "light from one side of the room, in which returns are missing while the robot faces it",
)
"""Possible causes; the second one only for parts of walls."""


def find_at_walls(checked: Checked) -> list[Doubt]:
    """Return an unmapped disc whose centre is inside a wall of the map: only a bulge of the wall is visible.

    At a site with known-good runs the test is skipped. Maps are inaccurate at walls everywhere, and the clutter floor
    accounts for it.
    """
    view, gains = checked.view, checked.gains
    data = view.data
    if data.site.is_known:
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
                family="object_at_wall",
                statement=f"readings end in front of {wall} near ({x:.1f}, {y:.1f}) m: an object stands against the wall, "
                "or the wall is reflective there",
                misfit=gains[index],
                statistic=gains[index],
                threshold=SCAN.selection.threshold,
                failed=frozenset([index]),
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


OBJECT_AT_WALL = Unnamed(
    titles={"object_at_wall": "an object that stands against a wall"}, find=find_at_walls
)


def find_temporary(checked: Checked) -> list[Doubt]:
    """Return a fixed object that is absent for one part of the run: a door, for example, instead of a pane."""
    view, settings = checked.view, SCAN.goodness_of_fit
    data, fitted = view.data, view.fitted
    least = SCAN.selection.threshold + data.price(2)  # for the times at which it leaves and returns
    out = []
    for index, a in enumerate(fitted.model):
        if a.effect.place not in ("wall", "obstacle", "spot"):
            continue
        rest = without(fitted.model, index)
        bare = log_p_at(data, rest, fitted.state)
        off_edge = fitted.cast.expected.p_alternative < SCAN.likelihood.min_edge_chance
        better = np.where(off_edge, bare - view.log_p, 0.0)
        first, last, gain = best_run(better.sum(axis=1)[None])
        n_better = int((better[first[0] : last[0] + 1] > settings.clearly_better).sum())
        if gain[0] > least and n_better > settings.min_rays / 2:
            begin, end = data.stamps[first[0]], data.stamps[last[0]]
            out.append(
                Doubt(
                    family="temporary_object",
                    statement=f"{a.effect.title} at {a.place or 'its spot'} is absent from "
                    f"{begin - data.begin:.0f} s to {end - data.begin:.0f} s of the run",
                    misfit=float(gain[0]),
                    statistic=float(gain[0]),
                    threshold=least,
                    failed=frozenset([index]),
                    size=ScanError(wrong=n_better / view.log_p.size),
                    causes=CAUSES[: 2 if a.effect.on_part_of_wall else 1],
                )
            )
    return out


TEMPORARY_OBJECT = Unnamed(
    titles={"temporary_object": "an object that is present for a part of the run only"}, find=find_temporary
)
