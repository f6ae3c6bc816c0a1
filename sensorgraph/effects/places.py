"""Places of effects: sectors of bearings, parts of walls, obstacles; and the ranges behind them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from planners.arena import Arena
from planners.types import SAME_PLACE
from sensorgraph.effects.effect import Amendment, Parameter
from sensorgraph.effects.set_up import end_of_part_error
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.ray_intersection import nearest_from_each
from sensorgraph.world.scene import Scene


def in_sector(bearings: Floats, first: float, last: float) -> Bools:
    """Return which bearings [rad] are between `first` and, counter-clockwise, `last`."""
    turn = 2 * np.pi
    inside = (bearings - first) % turn <= (last - first) % turn + 1e-9
    return np.asarray(inside | (np.abs((bearings - first + np.pi) % turn - np.pi) < 1e-9))


def named_walls(arena: Arena, name: str) -> Ints:
    """Return the indices of the wall NAME/edge_i, or of all walls of the feature NAME.

    Raises
    ------
    SensorgraphError : The arena has no wall and no feature with this name.
    """
    found = _walls_by_name(arena.names).get(name)
    if found is None:
        near = ", ".join(arena.names[:6])
        raise SensorgraphError(f"the arena has no wall or obstacle {name!r}, expected one of {near}, ...")
    return found.copy()


@lru_cache(maxsize=8)
def _walls_by_name(names: tuple[str, ...]) -> dict[str, Ints]:
    """Return the name of each wall and of each feature -> indices of its walls."""
    found: dict[str, list[int]] = {}
    for i, wall in enumerate(names):
        for name in {wall, wall.rsplit("/", 1)[0]}:
            found.setdefault(name, []).append(i)
    return {name: np.array(walls, dtype=np.intp) for name, walls in found.items()}


def obstacles(arena: Arena) -> list[str]:
    """Return the names of the arena's features without the outline."""
    outline = arena.names[0].rsplit("/", 1)[0]
    features = dict.fromkeys(name.rsplit("/", 1)[0] for name in arena.names)
    return [name for name in features if name != outline]


def walls_of(scene: Scene, name: str) -> Ints:
    """Return the indices of the walls with this name in a scene.

    Raises
    ------
    SensorgraphError : The arena has no wall and no feature with this name.
    """
    return named_walls(scene.arena, name)


def part_of_wall(scene: Scene, beams: Beams, a: Amendment) -> Bools:
    """Return which rays (n_scans, n_rays) hit the part from a to b [m] of the amendment's wall.

    Raises
    ------
    SensorgraphError : The arena has no such wall.
    """
    on = np.isin(beams.wall, walls_of(scene, a.place))
    if not on.any():
        return on
    along = beams.along(scene.walls, on)
    with np.errstate(invalid="ignore"):
        return np.asarray(on & (along >= a["a"]) & (along <= a["b"]))


def ends_of_part(what: str) -> tuple[Parameter, Parameter]:
    """Return the parameters a and b, between which an effect acts on a wall.

    Parameters
    ----------
    what : Name of the part in the documentation, "the mirror" for example.
    """

    def end(name: str, doc: str) -> Parameter:
        return Parameter(
            name=name, unit="m", doc=doc, neutral=None, search_step=0.01, hidden=end_of_part_error
        )

    return end("a", f"start of {what}, along the wall from its first end"), end("b", f"end of {what}")


def seen_without(walls: Floats, hidden: Ints, beams: Beams, some: Bools) -> Floats:
    """Return the ranges (n,) [m] of rays `some` without some walls."""
    ox, oy = (np.broadcast_to(o, beams.ranges.shape)[some] for o in (beams.ox, beams.oy))
    others = np.delete(walls, hidden, axis=0)
    ranges, _ = nearest_from_each(
        others, ox[:, None], oy[:, None], beams.ux[some][:, None], beams.uy[some][:, None]
    )
    return np.asarray(ranges[:, 0])


def reflected(walls: Floats, beams: Beams, some: Bools) -> Floats:
    """Return the distance (n,) [m] from the hits of rays `some` to their hits after reflection."""
    ux, uy, nx, ny = (v[some] for v in (beams.ux, beams.uy, beams.nx, beams.ny))
    ox, oy = (np.broadcast_to(o, beams.ranges.shape)[some] for o in (beams.ox, beams.oy))
    r = beams.ranges[some] - SAME_PLACE
    into = ux * nx + uy * ny
    vx, vy = ux - 2 * into * nx, uy - 2 * into * ny
    x, y = ox + r * ux, oy + r * uy
    further, _ = nearest_from_each(walls, x[:, None], y[:, None], vx[:, None], vy[:, None])
    return further[:, 0]
