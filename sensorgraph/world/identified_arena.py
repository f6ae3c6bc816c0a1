"""Arena of a sensorgraph of faces: visible stretches are walls, and space crossed by returning rays is free.

A later run can be diagnosed, planned or simulated in it, as in a drawn map.
"""

from __future__ import annotations

import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from shapely.geometry import MultiPolygon, Polygon

from planners.arena import Arena
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats, Ints
from sensorgraph.world.cell_outline import widened_outline

MIN_WALL_LENGTH = 0.01  # [m] of a wall
MERGE_DISTANCE = 0.004  # [m] ends this close are one corner
TOUCH_DISTANCE = 0.06  # [m] walls with ends this close belong to one object
WALL_THICKNESS = 0.05  # [m] not free behind a wall, even in free cells of 10 cm
MIN_HALF_WIDTH = 0.15  # [m] parts that are nowhere wider come from grid cells behind a wall


def arena_of(graph: Sensorgraph) -> Arena:
    """Return walls and free space of a sensorgraph of faces.

    Connected walls share a name: `room/edge_i` for those of largest extent, `thing_k/edge_i` for the others.
    """
    model, walls, normals = _faces_of(graph)
    component = _connected_walls(walls)
    size = [
        float(np.prod(np.ptp(walls[component == k].reshape(-1, 2), axis=0) + 0.1))
        for k in range(component.max() + 1)
    ]
    rank = np.argsort(-np.array(size), kind="stable")
    order = np.concatenate([np.flatnonzero(component == k) for k in rank])
    names = []
    for place, k in enumerate(rank):
        name = "room" if place == 0 else f"thing_{place}"
        names += [f"{name}/edge_{i}" for i in range(int((component == k).sum()))]
    return Arena(
        free=_free_space(model.observed, walls, normals),
        walls=walls[order],
        names=tuple(names),
        surfaces=("wall",) * len(walls),
        is_identified=True,
    )


def walls_of(graph: Sensorgraph) -> Floats:
    """Return the walls (n, 2, 2) [m, map] of a sensorgraph of faces, without the free space, which is slow to compute.

    Raises
    ------
    SensorgraphError : The sensorgraph has another model, or no reliably observed face.
    """
    return _faces_of(graph)[1]


def walls_with_normals(graph: Sensorgraph) -> tuple[Floats, Floats]:
    """Return `walls_of` a sensorgraph, and the unit normal (n, 2) of each towards the observed side."""
    return _faces_of(graph)[1:]


def _faces_of(graph: Sensorgraph) -> tuple[Faces, Floats, Floats]:
    """Return the model, and walls (n, 2, 2) with their normals (n, 2)."""
    model = graph.model
    if not isinstance(model, Faces):
        raise SensorgraphError(
            f"the sensorgraph's model is {model.name}, which has no walls; build one with faces, or give a map"
        )
    walls, normals = _walls(model)
    if len(walls) == 0:
        raise SensorgraphError(
            "the sensorgraph has no reliably observed face; build it from a longer log, or give a map"
        )
    return model, walls, normals


def _walls(model: Faces) -> tuple[Floats, Floats]:
    """Return the ends (n, 2, 2) of all reliably observed stretches, with merged corners, and their normals."""
    faces = model.faces
    owner = faces.owners
    at = np.flatnonzero(faces.levels > MAJORITY)
    joined = np.flatnonzero(
        (np.diff(at) == 1) & (owner[at[1:]] == owner[at[:-1]])
    )  # a change of visibility does not end a wall
    starts, stops = np.delete(at, joined + 1), np.delete(at, joined) + 1
    keep = faces.edges[stops] - faces.edges[starts] > MIN_WALL_LENGTH
    starts, stops = starts[keep], stops[keep]
    k = owner[starts]
    ends = np.stack([faces.points(k, faces.edges[e]) for e in (starts, stops)], axis=1)
    flat = ends.reshape(-1, 2)
    _, group = _group_points(flat, MERGE_DISTANCE)
    total = np.zeros((group.max() + 1 if len(group) else 0, 2))
    np.add.at(total, group, flat)
    corners = total / np.bincount(group)[:, None] if len(group) else total
    return corners[group].reshape(-1, 2, 2), faces.normals[k]


def _connected_walls(walls: Floats) -> Ints:
    """Return the component number of each wall; connected are ends that touch, and an end that touches a wall."""
    lines = [shapely.LineString(wall) for wall in walls]
    a, b = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=TOUCH_DISTANCE)
    n = len(walls)
    return np.asarray(
        connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n)))[1], dtype=np.intp
    )


def _group_points(points: Floats, distance: float) -> tuple[int, Ints]:
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    n = len(points)
    count, group = connected_components(coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n)))
    return int(count), np.asarray(group, dtype=np.intp)


def _free_space(crossed: ObservedSpace, walls: Floats, normals: Floats) -> Polygon | MultiPolygon:
    """Return the free cells, slightly widened, without the space behind walls.

    Where two walls meet in a corner, their ends leave a slit of micrometres to the cells behind them. So narrow parts are
    found with longer walls.
    """
    cells = widened_outline(crossed.free, np.asarray(crossed.origin), crossed.cell)
    free = cells.difference(_space_behind(walls, normals))
    closed = cells.difference(_space_behind(_lengthened(walls, MERGE_DISTANCE), normals))
    narrow = [p for p in _polygons(closed) if not _is_wide(p)]
    parts = [p for p in _polygons(free.difference(shapely.union_all(narrow))) if _is_wide(p)]
    if not parts:
        raise SensorgraphError("the sensorgraph has no free space; build it from a longer log, or give a map")
    return MultiPolygon(parts) if len(parts) > 1 else parts[0]


def _space_behind(walls: Floats, normals: Floats) -> shapely.Geometry:
    """Return the union of the strips (n_walls, 4, 2) behind walls."""
    strips = np.concatenate([walls, walls[:, ::-1] - WALL_THICKNESS * normals[:, None]], axis=1)
    return shapely.union_all(shapely.polygons(strips))


def _lengthened(walls: Floats, by: float) -> Floats:
    """Return walls (n_walls, 2, 2) that are longer by `by` [m] at each end."""
    along = walls[:, 1] - walls[:, 0]
    step = by * along / np.hypot(*along.T)[:, None]
    return np.asarray(walls + np.stack([-step, step], axis=1))


def _polygons(area: shapely.Geometry) -> list[Polygon]:
    return [part for part in shapely.get_parts(area) if isinstance(part, Polygon)]


def _is_wide(part: Polygon) -> bool:
    """Tell whether a disc of radius MIN_HALF_WIDTH fits into a part.

    The boundary at depth t has at most the length of the boundary plus 2 pi t per hole (Sz.-Nagy 1959; Makai
    1959). A part with more area than strips of this length is wide. Other parts are eroded, which takes
    seconds for a large floor.
    """
    longest = part.length + np.pi * len(part.interiors) * MIN_HALF_WIDTH
    return bool(part.area > MIN_HALF_WIDTH * longest or part.buffer(-MIN_HALF_WIDTH).area > 0)
