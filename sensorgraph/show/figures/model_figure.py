"""Draw a sensorgraph: the probability that each face or cell stops a ray, mean residuals, and unobserved space."""

from __future__ import annotations

from typing import Any

import numpy as np

from sensorgraph.errors import SensorgraphError
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.cells.ray_march import RATES
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.seen_space import seen_space
from sensorgraph.show.figures.face_pieces import (
    mean_by_index,
    pieces_of,
    residual_pieces,
    visible_edges,
    visible_pieces,
)
from sensorgraph.show.figures.style import (
    ALARM,
    FLOOR,
    INK,
    SOFT,
    SOLID,
    SUBTITLE,
    colour_bar,
    map_height,
    new_figure,
    reduce_frame,
)
from sensorgraph.types import Floats

PANEL_WIDTH = 6.0
"""[in] Width of a panel with its colour bar."""
PATCH_SIZE = 0.2
"""[m] Side of the squares over which residuals are averaged where there are no faces."""
MIN_PROBABILITY = 0.1
"""Probability that a cell stops a ray below which the cell is not drawn."""
COLOUR_BAR: dict[str, Any] = {
    "location": "right",
    "fraction": 0.03,
    "shrink": 0.8,
    "aspect": 40,
    "pad": 0.015,
}


def model_figure(model: Faces | CellModel, residuals: tuple[Floats, Floats, Floats] | None = None) -> Any:
    """Return the figure of a model of faces or cells.

    The left panel shows the probability that each face or cell stops a ray. The right panel shows the mean residuals
    of a run or, without a run, the density of the training returns of faces. White space was observed, grey space was not.

    Parameters
    ----------
    residuals : End points (n, 2) [m], directions (n, 2) and residuals (n,) [m] of the rays of a run. None: no run.

    Raises
    ------
    SensorgraphError : The model has no surface.
    """
    (x0, y0), (x1, y1) = _limits(model)
    n_panels = 2 if residuals is not None or isinstance(model, Faces) else 1
    tall = map_height(0.92 * PANEL_WIDTH, (x0, y0, x1, y1), 2.5, 10.0)
    figure = new_figure(PANEL_WIDTH * n_panels, tall + 0.9)
    panels = figure.subplots(1, n_panels, sharex=True, sharey=True, squeeze=False)[0]
    for axes in panels:
        _observed_space(axes, model)
        axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
        axes.set_xlabel("x [m]", color=INK)
        reduce_frame(axes)
    panels[0].set_ylabel("y [m]", color=INK)
    _visibility(figure, panels[0], model)
    if residuals is not None:
        _mean_residuals(figure, panels[1], model, *residuals)
    elif isinstance(model, Faces):
        _training_returns(figure, panels[1], model)
    return figure


def _limits(model: Faces | CellModel) -> tuple[Floats, Floats]:
    """Return the lower left and the upper right corner (2,) [m] of the picture."""
    seen = seen_space(model)
    if isinstance(model, Faces) and model.faces.n_faces:
        ends = visible_pieces(model).ends.reshape(-1, 2)
        low, high = ends.min(axis=0), ends.max(axis=0)
    elif seen.cells.any():
        low, high = seen.bounds
    else:
        raise SensorgraphError("the graph has no surface to draw; build it from a run with returns")
    margin = 0.03 * float((high - low).max()) + 0.05
    return low - margin, high + margin


def _image(axes: Any, corner: Floats, side: float, values: Any, **style: Any) -> Any:
    nx, ny = values.shape[:2]
    extent = (corner[0], corner[0] + nx * side, corner[1], corner[1] + ny * side)
    turned = values.transpose(1, 0, *range(2, values.ndim))
    return axes.imshow(turned, origin="lower", extent=extent, interpolation="nearest", **style)


def _observed_space(axes: Any, model: Faces | CellModel) -> None:
    """Paint the space crossed by training rays white, and other space grey."""
    from matplotlib.colors import to_rgb

    axes.set_facecolor(SOLID)
    seen = seen_space(model)
    paint = np.where(seen.cells[..., None], to_rgb(FLOOR), to_rgb(SOLID))
    _image(axes, seen.origin, seen.resolution, paint, zorder=0)


def _cells_of(model: Faces | CellModel) -> CellModel | None:
    return model if isinstance(model, CellModel) else model.cells


def _visibility(figure: Any, axes: Any, model: Faces | CellModel) -> None:
    """Draw the probability that a ray stops at a face or in a cell."""
    from matplotlib.colors import Normalize

    title = "probability that a ray stops"
    cells, image = _cells_of(model), None
    if cells is not None:
        table = cells.table
        per_direction = -np.expm1(-RATES[table.rate] * table.cell)
        probability = per_direction.max(axis=1)  # from the direction in which the cell is most visible
        value = np.where(table.rows >= 0, probability[table.rows], 0.0)
        shown = np.ma.masked_less(value, MIN_PROBABILITY)
        image = _image(axes, table.low, table.cell, shown, cmap="viridis_r", vmin=0, vmax=1, zorder=1)
        title += f", cells of {100 * table.cell:.0f} cm"
    else:
        assert isinstance(model, Faces)
        pieces = visible_pieces(model)
        order = np.argsort(pieces.values, kind="stable")
        image = _draw_pieces(axes, pieces.ends[order], pieces.values[order], "viridis_r", Normalize(0, 1))
        title += f": {model.faces.n_faces} faces"
    axes.set_title(title, loc="left", fontsize=SUBTITLE, color=INK)
    colour_bar(figure, image, axes, "probability", **COLOUR_BAR)


def _training_returns(figure: Any, axes: Any, model: Faces) -> None:
    """Draw the training returns per metre of each visible piece, and returns that no face explains."""
    from matplotlib.colors import LogNorm

    owner, edge = visible_edges(model)
    length = np.maximum(model.faces.edges[edge + 1] - model.faces.edges[edge], 1e-3)
    hits = model.hits[owner] if model.statistics is None else model.statistics.stops[edge]
    pieces = pieces_of(model, owner, model.faces.edges[edge], model.faces.edges[edge + 1], hits / length)
    value = np.maximum(pieces.values, 1.0)
    scale = LogNorm(1.0, max(float(value.max(initial=1.0)), 10.0))
    image = _draw_pieces(axes, pieces.ends, value, "viridis_r", scale)
    axes.set_title("training returns per metre", loc="left", fontsize=SUBTITLE, color=INK)
    if model.statistics is not None and len(model.statistics.unexplained_hits.cells):
        axes.plot(*model.statistics.unexplained_hits.centres.T, ".", ms=2.0, color=ALARM, alpha=0.6, zorder=2)
        axes.set_title(
            "training returns per metre; red: returns that no face explains", loc="left", fontsize=SUBTITLE, color=INK
        )  # fmt: skip
    colour_bar(figure, image, axes, "returns per metre", **COLOUR_BAR)


def _mean_residuals(
    figure: Any, axes: Any, model: Faces | CellModel, ends: Floats, directions: Floats, residual: Floats
) -> None:
    """Draw the mean residual along each face or, for a model with cells, in squares."""
    from matplotlib.colors import Normalize

    if _cells_of(model) is None:
        assert isinstance(model, Faces)
        pieces = residual_pieces(model, ends, directions, residual)
        order = np.argsort(np.nan_to_num(np.abs(pieces.values), nan=-1.0), kind="stable")
        value = 100 * pieces.values[order]
        top = _colour_limit(value, 100 * residual)
        image = _draw_pieces(axes, pieces.ends[order], value, "RdBu_r", Normalize(-top, top))
    else:
        low, high = ends.min(axis=0), ends.max(axis=0)
        corner = np.floor(low / PATCH_SIZE) * PATCH_SIZE
        nx, ny = (np.floor((high - corner) / PATCH_SIZE).astype(int) + 1).tolist()
        i, j = np.floor((ends - corner) / PATCH_SIZE).astype(int).T
        flat = np.ravel_multi_index((i, j), (nx, ny))
        value = 100 * mean_by_index(flat, residual, np.isfinite(residual), nx * ny).reshape(nx, ny)
        top = _colour_limit(value, 100 * residual)
        image = _image(
            axes,
            corner,
            PATCH_SIZE,
            np.ma.masked_invalid(value),
            cmap="RdBu_r",
            vmin=-top,
            vmax=top,
            zorder=1,
        )
    axes.set_title(
        f"mean residual of {len(residual):,} answered rays; red: measured farther", loc="left", fontsize=SUBTITLE, color=INK
    )  # fmt: skip
    colour_bar(figure, image, axes, "measured − predicted [cm]", **COLOUR_BAR)


def _colour_limit(means: Floats, residual: Floats) -> float:
    """Return the magnitude at which the colour scale ends, in the unit of the arguments.

    It is the 90 % quantile of the means, but at least the median of single residuals: means far below the noise of a
    reading stay white.
    """
    limits = [
        float(np.quantile(np.abs(values[np.isfinite(values)]), share))
        for values, share in ((means, 0.9), (residual, 0.5))
        if np.isfinite(values).any()
    ]
    return max([*limits, 1e-3])


def _draw_pieces(axes: Any, ends: Floats, value: Floats, colours: str, scale: Any) -> Any:
    """Draw pieces (n, 2, 2) coloured by value (n,) on a scale (a Normalize); nan is drawn as a thin grey line, and pale values keep a grey rim."""
    from matplotlib.collections import LineCollection

    known = np.isfinite(value)
    axes.add_collection(LineCollection(list(ends[~known]), colors=SOFT, linewidths=0.6, zorder=2))
    axes.add_collection(LineCollection(list(ends[known]), colors=SOFT, linewidths=3.2, zorder=2))
    lines = LineCollection(
        list(ends[known]), array=value[known], cmap=colours, norm=scale, linewidths=2.2, zorder=3
    )
    lines.set_capstyle("butt")
    axes.add_collection(lines)
    return lines
