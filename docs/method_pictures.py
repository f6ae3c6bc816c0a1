"""Draw two methods at work, with the product's own code: a decision of the coverage search, and the smoothing of a run.

python docs/method_pictures.py beam docs/pages/pictures/beam_search.png
python docs/method_pictures.py smoothing docs/pages/pictures/smoothing.png
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from logs.transforms import compose, invert, wrap
from planners.arena import Arena
from planners.clearance import Barriers
from planners.reach import reach
from planners.search.area import search_area
from planners.search.beam import beam_search
from planners.search.kernel_goals import cell_distances
from planners.search.motion_primitives import spin_primitives
from planners.search.search import CoverageSearch
from planners.search.settings import SPIN_ROOM
from planners.search.workspace import Workspace
from planners.vehicle import Limits
from sensorgraph.localization.smoothing import smooth
from sensorgraph.show.figures.style import ALARM, AMBER, INK, SOFT, TEAL, new_figure, save_figure
from sensorgraph.types import Floats

HEADINGS, CELL, RATE = 16, 0.25, 10.0
ROOM = shapely.Polygon([(0, 0), (3.5, 0), (3.5, 2.5), (1.75, 2.5), (1.75, 1.75), (0, 1.75)])
DECISIONS = 111
"""Number of decisions after which the beam is drawn."""


def beam() -> Any:
    """Return a figure of one decision: all nodes of the beam, the chosen sequence, and the part that is driven."""
    ends = np.array(ROOM.exterior.coords)
    walls = np.stack([ends[:-1], ends[1:]], axis=1)
    n = len(walls)
    arena = Arena(
        free=ROOM, walls=walls, names=tuple(f"room/edge_{k}" for k in range(n)), surfaces=("wall",) * n
    )
    free = reach(arena, Barriers(arena), clearance=0.22, cell=CELL)
    need = np.repeat(free.cells()[:, :, None], HEADINGS, axis=2)
    primitives = spin_primitives(Limits(), HEADINGS, RATE)
    search = CoverageSearch(search_area(free), primitives, need, RATE, settings=SPIN_ROOM)
    search.start_at(np.array([0.625, 0.625, 0.0, 0.0]))
    tables = search._tables()
    settings, workspace = tables.settings, tables.workspace
    left = int(need.sum())
    for _ in range(DECISIONS):
        _, left = search._decide(left, tables, None)  # type: ignore[arg-type]
    cell_distances(search.world, workspace.far, workspace.cell_queue)
    n, n_new = beam_search(search.state, tables)
    chosen = _chosen(workspace, n)

    figure = new_figure(9.6, 4.3)
    whole, near = figure.subplots(1, 2, width_ratios=(1.25, 1))
    for axes in (whole, near):
        _missing(axes, search.world.missing, free.origin)
        axes.plot(*ROOM.exterior.xy, color=INK, lw=1.6)
        nodes = _nodes(axes, workspace, axes is near)
        x, y = workspace.places[chosen].T
        axes.plot(x, y, color=ALARM, lw=2.2, label="best sequence")
        driven = max(round(settings.executed * primitives.n_headings), 1)
        axes.plot(x[: driven + 1], y[: driven + 1], color=INK, lw=3.0, label="part that is driven")
        axes.plot(*workspace.places[0], "o", color=INK, ms=5)
        axes.set_aspect("equal")
        axes.tick_params(labelsize=7, colors=SOFT)
    middle = workspace.places[chosen].mean(axis=0)
    near.set(xlim=(middle[0] - 0.55, middle[0] + 0.55), ylim=(middle[1] - 0.55, middle[1] + 0.55))
    whole.set_title(f"{left:,} of {int(need.sum()):,} bins are missing: number in each cell", fontsize=9)
    near.set_title(f"the beam, one revolution ahead: {n_new} new bins", fontsize=9)
    near.legend(fontsize=7, loc="upper right", frameon=True)
    figure.colorbar(nodes, ax=near, fraction=0.04).set_label("score", fontsize=8)
    return figure


def _chosen(workspace: Workspace, n: int) -> list[int]:
    """Return the nodes along the best sequence of n branches, from the root."""
    node = next(
        leaf
        for leaf in np.argsort(-workspace.scores[: _used(workspace)], kind="stable")
        if _branches(workspace, int(leaf)) == workspace.sequence[:n].tolist()
    )
    out = [int(node)]
    while workspace.parents[out[-1]] >= 0:
        out.append(int(workspace.parents[out[-1]]))
    return out[::-1]


def _branches(workspace: Workspace, node: int) -> list[int]:
    out: list[int] = []
    while workspace.parents[node] >= 0:
        out.append(int(workspace.branches[node]))
        node = int(workspace.parents[node])
    return out[::-1]


def _used(workspace: Workspace) -> int:
    """Return the number of nodes of the last search."""
    return (
        int(
            max(
                layer[:size].max(initial=0)
                for layer, size in zip(workspace.pool, workspace.pool_sizes, strict=True)
            )
        )
        + 1
    )


def _nodes(axes: Any, workspace: Workspace, is_near: bool) -> Any:
    """Draw each node of the beam as the line from its parent, coloured by its score."""
    from matplotlib.collections import LineCollection

    own = np.arange(1, _used(workspace))
    lines = np.stack([workspace.places[workspace.parents[own]], workspace.places[own]], axis=1)
    order = np.argsort(workspace.scores[own])
    some = LineCollection(lines[order], cmap="viridis", lw=0.5 if is_near else 0.3, alpha=0.6)
    some.set_array(workspace.scores[own][order])
    return axes.add_collection(some)


def _missing(axes: Any, missing: np.ndarray, origin: Floats) -> None:
    """Shade each cell by the number of its missing bins."""
    x0, y0 = origin
    nx, ny = missing.shape
    shown = np.where(missing > 0, missing, np.nan).T
    axes.imshow(
        shown,
        origin="lower",
        extent=(x0, x0 + nx * CELL, y0, y0 + ny * CELL),
        cmap="Greys",
        vmin=0,
        vmax=5 * HEADINGS,
    )
    for (i, k), n in np.ndenumerate(missing):
        if n:
            axes.text(
                x0 + (i + 0.5) * CELL, y0 + (k + 0.5) * CELL, str(n), size=6, color=INK, alpha=0.55, ha="center", va="center",
                clip_on=True,
            )  # fmt: skip


def smoothing() -> Any:
    """Return a figure of one run: steps alone, matched places, and the smoothed poses with their standard deviations."""
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 2 * np.pi, 181)
    xy = np.column_stack([2.4 * np.sin(t), 1.5 * np.sin(t) * np.cos(t) + 0.8 * np.cos(t)])
    ahead = np.gradient(xy, axis=0)
    truth = np.column_stack([xy, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))])
    sd = np.array([0.006, 0.004, 0.006])
    steps = compose(invert(truth[:-1]), truth[1:]) + rng.normal(size=(len(t) - 1, 3)) * sd + [0.0, 0.0, 0.003]
    step_information = np.tile(np.diag(1.0 / (sd**2 + 0.003**2)), (len(steps), 1, 1))
    place_sd = np.array([0.03, 0.03, 0.02])
    places = truth + rng.normal(size=truth.shape) * place_sd
    wrong = np.array([60, 61, 62])
    places[wrong] += [0.45, 0.35, 0.3]
    information = np.tile(np.diag(place_sd**-2.0), (len(t), 1, 1))
    is_matched = np.arange(len(t)) % 3 == 0
    is_matched[[*wrong]] = True
    is_matched[95:140] = False  # nothing of the map in sight
    information[~is_matched] = 0.0
    alone = [truth[0]]
    for step in steps:
        alone.append(compose(alone[-1], step))
    found = smooth(np.array(alone), steps, step_information, places, information)

    figure = new_figure(9.6, 4.3)
    plan, error = figure.subplots(1, 2, width_ratios=(1.25, 1))
    plan.plot(*truth[:, :2].T, color=SOFT, lw=3, alpha=0.5, label="truth")
    plan.plot(*np.array(alone)[:, :2].T, color=AMBER, lw=1.2, label="steps alone")
    plan.plot(*places[is_matched, :2].T, ".", color=INK, ms=3.5, label="matched places")
    plan.plot(*places[wrong, :2].T, "x", color=ALARM, ms=6, label="matched wrongly")
    plan.plot(*found.poses[:, :2].T, color=TEAL, lw=1.4, label="smoothed, ellipses of 2 s.d.")
    for k in range(0, len(t), 6):
        _ellipse(plan, found.poses[k, :2], found.covariances[k, :2, :2])
    plan.set_aspect("equal")
    plan.set(ylim=(-1.9, 1.9))
    plan.legend(fontsize=7, frameon=False, loc="upper left")
    plan.set(xlabel="x [m]", ylabel="y [m]")
    off = np.hypot(*(found.poses - truth)[:, :2].T)
    spread = np.sqrt(np.trace(found.covariances[:, :2, :2], axis1=1, axis2=2))
    error.fill_between(
        np.arange(len(t)), 200 * spread, color=TEAL, alpha=0.18, lw=0, label="2 s.d. as stated"
    )
    error.plot(100 * off, color=TEAL, lw=1.2, label="error")
    error.axvspan(95, 140, color=SOFT, alpha=0.12, lw=0)
    error.text(117, 7.6, "no place matched", color=SOFT, fontsize=7, ha="center")
    error.set(xlabel="scan", ylabel="position [cm]", ylim=(0, 8), xlim=(0, len(t) - 1))
    error.legend(fontsize=7, frameon=False, loc="upper left")
    for axes in (plan, error):
        axes.tick_params(labelsize=7)
    assert np.abs(wrap(found.poses[:, 2] - truth[:, 2])).max() < 0.2
    return figure


def _ellipse(axes: Any, at: Floats, covariance: Floats) -> None:
    """Draw the ellipse of two standard deviations."""
    turn = np.linspace(0.0, 2 * np.pi, 40)
    ring = 2 * np.linalg.cholesky(covariance) @ np.stack([np.cos(turn), np.sin(turn)])
    axes.plot(*(at[:, None] + ring), color=TEAL, lw=0.6)


if __name__ == "__main__":
    save_figure({"beam": beam, "smoothing": smoothing}[sys.argv[1]](), Path(sys.argv[2]))
