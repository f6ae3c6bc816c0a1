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
from sensorgraph.world.identified_arena import walls_of

LEAST_CHANCE = 0.5
"""Chance of stopping a ray on its way through a cell, from which on the cell holds a wall."""


def walls_of_graph(graph: Sensorgraph) -> Floats:
    """Return the walls (n, 2, 2) [m, map] that a graph of faces or of cells has identified.

    Raises
    ------
    SensorgraphError : the graph is of another model, or has no surface that is surely seen
    """
    if isinstance(graph.model, Faces):
        return walls_of(graph)
    if not isinstance(graph.model, CellModel):
        raise SensorgraphError(
            f"the graph's model is {graph.model.name}, which has no surfaces; build one of faces or cells, or give a map"
        )
    walls = _cell_walls(graph.model.table)
    if len(walls) == 0:
        raise SensorgraphError("the graph has no cell that surely stops a ray; build it from a longer log")
    return walls


def _cell_walls(table: CellTable) -> Floats:
    """Return for each cell that stops rays its face (n, 2, 2), as seen from where it stops most."""
    i, j = np.nonzero(table.rows >= 0)
    rows = table.rows[i, j]
    rate = np.where(table.angle[rows] == NO_LINE, 0.0, np.asarray(RATES)[table.rate[rows]])
    sector = rate.argmax(axis=1)
    kept = 1.0 - np.exp(-rate.max(axis=1) * table.cell) > LEAST_CHANCE
    rows, sector, i, j = rows[kept], sector[kept], i[kept], j[kept]
    angle = table.angle[rows, sector] * (np.pi / N_ANGLES)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    middle = table.low + (np.column_stack([i, j]) + 0.5) * table.cell
    middle = middle + normal * (table.offset[rows, sector] * OFFSET_STEP)[:, None]
    half = 0.5 * table.cell * np.column_stack([-normal[:, 1], normal[:, 0]])
    return np.stack([middle - half, middle + half], axis=1)
