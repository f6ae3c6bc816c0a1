"""The surfaces of a sensorgraph as short or long straight walls, whatever its model."""

from __future__ import annotations

import numpy as np

from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.cells.local_lines import N_ANGLES, NO_LINE, OFFSET_STEP
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.cells.ray_march import RATES, CellTable
from sensorgraph.models.faces.model import Faces
from sensorgraph.types import Floats
from sensorgraph.world.identified_arena import walls_with_normals

LEAST_CHANCE = 0.5
"""Chance of stopping a ray on its way through a cell, from which on the cell holds a wall."""

LEAST_FACING = 0.5
"""Cosine between a ray and the normal of a wall, below which the ray passes along the wall."""


def walls_of_graph(graph: Sensorgraph) -> tuple[Floats, Floats]:
    """Return the walls (n, 2, 2) [m, map] that a graph of faces or of cells has identified, and their normals (n, 2).

    A normal points to where the wall was seen from: a wall with two sides is two walls, a wall's thickness apart.

    Raises
    ------
    SensorgraphError : the graph is of another model, or has no surface that is surely seen
    """
    if isinstance(graph.model, Faces):
        return walls_with_normals(graph)
    if not isinstance(graph.model, CellModel):
        raise SensorgraphError(
            f"the graph's model is {graph.model.name}, which has no surfaces; build one of faces or cells, or give a map"
        )
    walls, normals = _cell_walls(graph.model.table)
    if len(walls) == 0:
        raise SensorgraphError("the graph has no cell that surely stops a ray; build it from a longer log")
    return walls, normals


def _cell_walls(table: CellTable) -> tuple[Floats, Floats]:
    """Return for each cell that stops rays its face (n, 2, 2), as seen from where it stops most, and its normal (n, 2).

    A cell that stops rays from the other side, too, may be a thin wall: its normal is 0, 0.
    """
    i, j = np.nonzero(table.rows >= 0)
    rows = table.rows[i, j]
    rate = np.where(table.angle[rows] == NO_LINE, 0.0, np.asarray(RATES)[table.rate[rows]])
    chance = 1.0 - np.exp(-rate * table.cell)
    kept = chance.max(axis=1) > LEAST_CHANCE
    rows, chance, i, j = rows[kept], chance[kept], i[kept], j[kept]
    sector = chance.argmax(axis=1)
    angle = table.angle[rows, sector] * (np.pi / N_ANGLES)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    middle = table.low + (np.column_stack([i, j]) + 0.5) * table.cell
    middle = middle + normal * (table.offset[rows, sector] * OFFSET_STEP)[:, None]
    half = 0.5 * table.cell * np.column_stack([-normal[:, 1], normal[:, 0]])
    directions = 2 * np.pi * np.arange(chance.shape[1]) / chance.shape[1]
    ahead = np.cos(directions - angle[:, None])  # of rays, along the normal
    stopped = [((way * ahead > LEAST_FACING) & (chance > LEAST_CHANCE)).any(axis=1) for way in (-1.0, 1.0)]
    towards = (stopped[0].astype(float) - stopped[1])[:, None] * normal
    return np.stack([middle - half, middle + half], axis=1), towards
