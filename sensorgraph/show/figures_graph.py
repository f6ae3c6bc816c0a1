"""A picture of a sensorgraph: its faces, how likely each stops a ray, how far off they are, and what was never looked through."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from logs.run import Run, pair
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.evaluate import evaluate, poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.cells.model import Cells
from sensorgraph.models.cells.ray_march import RATES
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.ray_march import FAINT
from sensorgraph.show.figures import ALARM, FLOOR, INK, SOFT, SOLID, new_figure, quiet, save_figure
from sensorgraph.types import Floats, Ints
from sensorgraph.world.raycast import laser_poses

BIN = 0.10  # [m] of a face, or side of a cell, over which residuals are averaged
NEAR = 0.06  # [m] a predicted end point belongs to the face this near
ASIDE = 0.02  # [m] towards the seen side: back to back faces are two
FEWEST = 5  # rays of a mean residual
SAME = 0.2  # [m] a larger residual shows another surface and tells nothing of this one
PATCH = 0.2  # [m] side of the cells that residuals are averaged over where there are no faces


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """Pieces of faces to colour."""

    ends: Floats
    """(n, 2, 2) [m] from, to."""
    normals: Floats
    """(n, 2) towards the side that is seen."""
    values: Floats
    """(n,) nan where nothing is known."""


def graph_picture(graph: Sensorgraph, path: Path, *, run: Run | None = None) -> None:
    """Draw a graph as PNG: visibility on the left; on the right residuals against `run`, else what the graph keeps.

    White has been looked through, grey never.
    """
    model = graph.model
    if not isinstance(model, (Faces, Cells)):
        raise SensorgraphError(
            f"the model {model.name} has neither faces nor cells to draw; build with --model faces, "
            "or look at it with sensorgraph review"
        )
    where = None if run is None else _residuals(graph, run)
    (x0, y0), (x1, y1) = _extent(model)
    width = 12.0
    tall = float(np.clip(0.46 * width * (y1 - y0) / (x1 - x0), 2.5, 10.0))
    figure = new_figure(width, tall + 0.9)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes in (left, right):
        _space(axes, model)
        axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
        axes.set_xlabel("x [m]", color=INK)
        quiet(axes)
    left.set_ylabel("y [m]", color=INK)
    _visibility(figure, left, model)
    if where is not None:
        _off(figure, right, model, *where)
    elif isinstance(model, Faces):
        _kept(figure, right, model)
    else:
        right.set_title("residuals: give --run RUN", loc="left", fontsize=10, color=SOFT)
    save_figure(figure, path)


def stretches(model: Faces) -> Pieces:
    """Return the visible stretches of all faces with their visibility."""
    owner, edge = _seen(model)
    return _pieces(
        model, owner, model.faces.edges[edge], model.faces.edges[edge + 1], model.faces.levels[edge]
    )


def residual_pieces(model: Faces, ends: Floats, directions: Floats, residual: Floats) -> Pieces:
    """Average residuals over pieces of `BIN` along the faces.

    Parameters
    ----------
    ends : (n, 2) [m] predicted end points of rays with directions (n, 2) and residuals (n,) [m]
    """
    owner, edge = _seen(model)
    starts, stops = model.faces.edges[edge], model.faces.edges[edge + 1]
    parts = np.maximum(np.ceil((stops - starts) / BIN - 1e-9).astype(int), 1)
    first = np.cumsum(parts) - parts
    step = np.arange(parts.sum()) - np.repeat(first, parts)
    size = np.repeat((stops - starts) / parts, parts)
    low = np.repeat(starts, parts) + step * size
    pieces = _pieces(model, np.repeat(owner, parts), low, low + size, np.full(len(low), np.nan))
    if not len(low) or not len(ends):
        return pieces
    middles = pieces.ends.mean(axis=1) + ASIDE * pieces.normals
    off, found = cKDTree(middles).query(ends - ASIDE * directions, distance_upper_bound=NEAR + BIN / 2)
    piece = np.asarray(found, dtype=np.intp)
    return Pieces(
        ends=pieces.ends, normals=pieces.normals, values=_means(piece, residual, np.isfinite(off), len(low))
    )


def _means(index: Ints, values: Floats, use: NDArray[np.bool_], n: int) -> Floats:
    """Average values (m,) by index; nan under `FEWEST`."""
    count = np.bincount(index[use], minlength=n)
    total = np.bincount(index[use], weights=values[use], minlength=n)
    return np.asarray(np.where(count >= FEWEST, total / np.maximum(count, 1), np.nan))


def _seen(model: Faces) -> tuple[Ints, Ints]:
    """Return face and first edge of every visible stretch."""
    owner = np.repeat(np.arange(model.faces.n_faces), np.diff(model.faces.first))
    edge = np.flatnonzero(model.faces.levels > FAINT)
    return owner[edge], edge


def _pieces(model: Faces, owner: Ints, low: Floats, high: Floats, values: Floats) -> Pieces:
    faces = model.faces
    foot = faces.normals[owner] * faces.offsets[owner, None]
    along = faces.tangents[owner]
    ends = np.stack([foot + along * low[:, None], foot + along * high[:, None]], axis=1)
    return Pieces(ends=ends, normals=faces.normals[owner], values=values)


def _residuals(graph: Sensorgraph, run: Run) -> tuple[Floats, Floats, Floats]:
    """Return predicted end points (n, 2), directions (n, 2) and residuals (n,) [m] of answered rays, same surface."""
    found = evaluate(graph, run)
    poses = poses_for(graph, run.pose_frame, run.sensor.mount, pair(run).poses[found.scan_indices])
    assert isinstance(graph.model, (Faces, Cells))
    lasers = laser_poses(poses, graph.model.mount)
    bearing = lasers[:, 2:] + graph.sensor.bearings
    directions = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    ends = lasers[:, None, :2] + found.prediction.mode[..., None] * directions
    use = (np.abs(np.nan_to_num(found.residual, nan=np.inf)) < SAME) & found.prediction.answered
    use &= found.prediction.p_no_return < 0.5
    return ends[use], directions[use], found.residual[use]


def _extent(model: Faces | Cells) -> tuple[Floats, Floats]:
    """Return the corners of what is drawn, with a margin."""
    corner, side, known = _known(model)
    index = np.argwhere(known)
    if isinstance(model, Faces) and model.faces.n_faces:
        ends = stretches(model).ends.reshape(-1, 2)
        low, high = ends.min(axis=0), ends.max(axis=0)
    elif len(index):
        low, high = corner + index.min(axis=0) * side, corner + (index.max(axis=0) + 1) * side
    else:
        raise SensorgraphError("the graph knows no surface; there is nothing to draw")
    margin = 0.03 * float((high - low).max()) + 0.05
    return low - margin, high + margin


def _known(model: Faces | Cells) -> tuple[Floats, float, NDArray[np.bool_]]:
    """Return corner [m], side [m] and cells (nx, ny) that training rays have crossed."""
    if isinstance(model, Faces):
        return model.crossed.origin, model.crossed.cell, model.crossed.counts > 0
    table = model.table
    return table.low, table.cell, table.is_seen[table.rows] > 0


def _image(axes: Any, corner: Floats, side: float, values: Any, **style: Any) -> Any:
    nx, ny = values.shape[:2]
    extent = (corner[0], corner[0] + nx * side, corner[1], corner[1] + ny * side)
    turned = values.transpose(1, 0, *range(2, values.ndim))
    return axes.imshow(turned, origin="lower", extent=extent, interpolation="nearest", **style)


def _space(axes: Any, model: Faces | Cells) -> None:
    """Paint what rays went through white, and leave the rest grey."""
    from matplotlib.colors import to_rgb

    axes.set_facecolor(SOLID)
    corner, side, known = _known(model)
    paint = np.where(known[..., None], to_rgb(FLOOR), to_rgb(SOLID))
    _image(axes, corner, side, paint, zorder=0)


def _cells(model: Faces | Cells) -> Cells | None:
    return model if isinstance(model, Cells) else model.cells


def _visibility(figure: Any, axes: Any, model: Faces | Cells) -> None:
    """Draw how likely a ray that meets a face or a cell stops there."""
    title = "chance that a ray stops"
    cells, image = _cells(model), None
    if cells is not None:
        table = cells.table
        chance = -np.expm1(-RATES[table.rate] * table.cell).max(
            axis=1
        )  # from the direction that sees it best
        value = np.where(table.rows >= 0, chance[table.rows], 0.0)
        shown = np.ma.masked_less(value, 0.1)
        image = _image(axes, table.low, table.cell, shown, cmap="viridis_r", vmin=0, vmax=1, zorder=1)
        title += f" in each cell of {100 * table.cell:.0f} cm"
    else:
        assert isinstance(model, Faces)
        pieces = stretches(model)
        order = np.argsort(pieces.values, kind="stable")
        image = _draw(axes, pieces.ends[order], pieces.values[order], "viridis_r", (0.0, 1.0))
        title += f": {model.faces.n_faces} faces"
    axes.set_title(title, loc="left", fontsize=10, color=INK)
    _bar(figure, axes, image, "chance")


def _kept(figure: Any, axes: Any, model: Faces) -> None:
    """Draw the returns a metre that each stretch was identified from, and the hits that no face explains."""
    owner, edge = _seen(model)
    length = np.maximum(model.faces.edges[edge + 1] - model.faces.edges[edge], 1e-3)
    hits = model.hits[owner] if model.memory is None else model.memory.stops[edge]
    pieces = _pieces(model, owner, model.faces.edges[edge], model.faces.edges[edge + 1], hits / length)
    value = np.log10(np.maximum(pieces.values, 1.0))
    image = _draw(axes, pieces.ends, value, "magma_r", (0.0, max(float(value.max(initial=1.0)), 1.0)))
    axes.set_title("identified from so many returns a metre", loc="left", fontsize=10, color=INK)
    if model.memory is not None and len(model.memory.left.cells):
        axes.plot(*model.memory.left.centres.T, ".", ms=1.2, color=ALARM, alpha=0.5, zorder=2)
        axes.set_title(
            "identified from so many returns a metre; red: explained by no face", loc="left", fontsize=10, color=INK
        )  # fmt: skip
    _bar(figure, axes, image, "log10 of returns a metre")


def _off(
    figure: Any, axes: Any, model: Faces | Cells, ends: Floats, directions: Floats, residual: Floats
) -> None:
    """Draw the mean residual along each face, or in patches where cells predict."""
    if _cells(model) is None:
        assert isinstance(model, Faces)
        pieces = residual_pieces(model, ends, directions, residual)
        order = np.argsort(np.nan_to_num(np.abs(pieces.values), nan=-1.0), kind="stable")
        value = 100 * pieces.values[order]
        top = _top(value)
        image = _draw(axes, pieces.ends[order], value, "RdBu_r", (-top, top))
    else:
        low, high = ends.min(axis=0), ends.max(axis=0)
        corner = np.floor(low / PATCH) * PATCH
        nx, ny = (np.floor((high - corner) / PATCH).astype(int) + 1).tolist()
        i, j = np.floor((ends - corner) / PATCH).astype(int).T
        flat = np.ravel_multi_index((i, j), (nx, ny))
        value = 100 * _means(flat, residual, np.isfinite(residual), nx * ny).reshape(nx, ny)
        top = _top(value)
        image = _image(
            axes, corner, PATCH, np.ma.masked_invalid(value), cmap="RdBu_r", vmin=-top, vmax=top, zorder=1
        )
    axes.set_title(
        f"mean residual of {len(residual):,} answered rays; red: measured farther", loc="left", fontsize=10, color=INK
    )  # fmt: skip
    _bar(figure, axes, image, "measured − predicted [cm]")


def _top(value: Floats) -> float:
    """Return where colours end: nine in ten lie below."""
    known = np.abs(value[np.isfinite(value)])
    return max(float(np.quantile(known, 0.9)), 1e-3) if len(known) else 1.0


def _draw(axes: Any, ends: Floats, value: Floats, colours: str, limits: tuple[float, float]) -> Any:
    """Draw pieces (n, 2, 2) coloured by value (n,); nan is thin grey."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    known = np.isfinite(value)
    axes.add_collection(LineCollection(list(ends[~known]), colors=SOFT, linewidths=0.6, zorder=2))
    lines = LineCollection(
        list(ends[known]), array=value[known], cmap=colours, norm=Normalize(*limits), linewidths=2.2, zorder=3
    )
    lines.set_capstyle("butt")
    axes.add_collection(lines)
    return lines


def _bar(figure: Any, axes: Any, image: Any, label: str) -> None:
    bar = figure.colorbar(image, ax=axes, location="right", fraction=0.03, shrink=0.8, aspect=40, pad=0.015)
    bar.set_label(label, color=INK, fontsize=8)
    bar.ax.tick_params(labelsize=8, colors=INK)
    bar.outline.set_visible(False)
