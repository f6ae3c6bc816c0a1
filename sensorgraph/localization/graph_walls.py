"""Surfaces of a sensorgraph of faces or cells as straight walls, and the space that its rays observed."""

from __future__ import annotations

import numpy as np

from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.cells.local_lines import N_ANGLES, NO_LINE, OFFSET_STEP
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.cells.ray_march import RATES, CellTable
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.seen_space import SeenSpace, seen_space
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats
from sensorgraph.world.identified_arena import walls_with_normals

MIN_FACING = 0.5
"""Minimum cosine between a ray and the normal of a wall; below, the ray passes along the wall."""


def walls_of_graph(graph: Sensorgraph) -> tuple[Floats, Floats]:
    """Return the walls (n, 2, 2) [m, map] of a sensorgraph of faces or cells, and their normals (n, 2).

    A normal points to the side from which the wall was observed. A wall observed from both sides is two
    walls, one wall thickness apart.

    Raises
    ------
    SensorgraphError : The sensorgraph has another model, or no reliably observed surface.
    """
    if isinstance(graph.model, Faces):
        return walls_with_normals(graph)
    if not isinstance(graph.model, CellModel):
        raise SensorgraphError(
            f"the sensorgraph's model is {graph.model.name}, which has no surfaces; build one with faces or cells, or give a map"
        )
    walls, normals = _cell_walls(graph.model.table)
    if len(walls) == 0:
        raise SensorgraphError(
            "the sensorgraph has no cell that reliably stops rays; build it from a longer log"
        )
    return walls, normals


def _cell_walls(table: CellTable) -> tuple[Floats, Floats]:
    """Return wall (n, 2, 2) and normal (n, 2) of each cell that stops rays, for the direction with most stops.

    A cell that also stops rays from the opposite side may be a thin wall: its normal is 0, 0.
    """
    i, j = np.nonzero(table.rows >= 0)
    rows = table.rows[i, j]
    rate = np.where(table.angle[rows] == NO_LINE, 0.0, np.asarray(RATES)[table.rate[rows]])
    chance = 1.0 - np.exp(-rate * table.cell)
    kept = chance.max(axis=1) > MAJORITY
    rows, chance, i, j = rows[kept], chance[kept], i[kept], j[kept]
    sector = chance.argmax(axis=1)
    angle = table.angle[rows, sector] * (np.pi / N_ANGLES)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    middle = table.low + (np.column_stack([i, j]) + 0.5) * table.cell
    middle = middle + normal * (table.offset[rows, sector] * OFFSET_STEP)[:, None]
    half = 0.5 * table.cell * np.column_stack([-normal[:, 1], normal[:, 0]])
    directions = 2 * np.pi * np.arange(chance.shape[1]) / chance.shape[1]
    ahead = np.cos(directions - angle[:, None])  # cosine between ray and normal
    stopped = [((way * ahead > MIN_FACING) & (chance > MAJORITY)).any(axis=1) for way in (-1.0, 1.0)]
    towards = (stopped[0].astype(float) - stopped[1])[:, None] * normal
    return np.stack([middle - half, middle + half], axis=1), towards


def seen_by_graph(graph: Sensorgraph) -> SeenSpace | None:
    """Return the space observed by the runs of a sensorgraph of faces or cells; None for other models."""
    return seen_space(graph.model) if isinstance(graph.model, Faces | CellModel) else None
