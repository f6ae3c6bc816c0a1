"""The cells of a model that training rays have crossed."""

from __future__ import annotations

from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.types import Bools, Floats


def crossed_cells(model: Faces | CellModel) -> tuple[Floats, float, Bools]:
    """Return corner [m], side [m] and cells (nx, ny) that training rays have crossed."""
    if isinstance(model, Faces):
        return model.observed.origin, model.observed.cell, model.observed.counts > 0
    table = model.table
    return table.low, table.cell, table.is_seen[table.rows] > 0
