"""The maps of a review for the viewer: verdicts by place, and the (x, y, phi) cells above the floor."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from planners.coverage import HEADINGS
from sensorgraph.show.review.cells import SATURATING_UNANSWERED, RayCounts, ReviewCells
from sensorgraph.show.review.contents import RayVerdict
from sensorgraph.types import Bools, Floats

EMPTY, FREE = (40, 40, 46), (78, 84, 104)
"""Colours of cells in which no ray was scored: other cells, and free cells that were not visited."""
VERDICT_COLOURS = {
    RayVerdict.RIGHT: (60, 178, 165),
    RayVerdict.WRONG: (255, 60, 110),
    RayVerdict.UNANSWERED: (150, 115, 255),
}
VIRIDIS = np.array(
    [(68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 144, 141), (39, 173, 129), (92, 200, 99),
     (170, 220, 50), (253, 231, 37)], dtype=np.float64,
)  # fmt: skip
MANY_VISITS = 10
"""Number of scans in a cell at which its colour is brightest."""
RGB = NDArray[np.uint8]


def map_labels(cells: ReviewCells) -> dict[str, str]:
    """Return the available maps, name -> label, most important first; the report explains the colours."""
    out = {}
    if cells.ray_counts is not None:
        out["verdict"] = "teal right, pink wrong, violet not answered"
    if cells.expected_error_map is not None:
        out["next"] = "expected error"
    if cells.ray_counts is not None:
        out |= {"unanswered": "not answered", "wrong": "wrong", "error": "error"}
    return out | {"coverage": "coverage"}


def log_maps(recording: rr.RecordingStream, cells: ReviewCells) -> None:
    """Log every map as an image in place."""
    for name, image in images(cells).items():
        side = (
            cells.expected_error_map.cell
            if name == "next" and cells.expected_error_map is not None
            else cells.cell
        )
        place = rr.Transform3D(translation=[*cells.origin, 0], scale=[side, side, 1])
        recording.log(f"plan/{name}", place, static=True)
        pixels = rr.Image(image.transpose(1, 0, 2), draw_order=-10)
        recording.log(f"plan/{name}/image", pixels, static=True)


def images(cells: ReviewCells) -> dict[str, RGB]:
    """Return each map of `map_labels` as RGB (nx, ny, 3)."""
    share = (cells.counts > 0).mean(axis=2)
    out = {"coverage": colours(np.where(share > 0, share, np.nan))}
    if cells.ray_counts is not None and cells.error is not None:
        places = cells.ray_counts.by_place
        out["verdict"] = verdict_colours(places, places.saturating_wrong, cells.free & (share == 0))
        out["unanswered"] = colours(places.share_unanswered / SATURATING_UNANSWERED)
        out["wrong"] = colours(places.share_wrong / places.saturating_wrong)
        out["error"] = colours(_mean(cells.error, axis=2) / cells.error_top)
    if cells.expected_error_map is not None:
        out["next"] = colours(cells.expected_error_map.expected_error)
    return out


def verdict_colours(counts: RayCounts, saturating_wrong: float, free: Bools | None = None) -> RGB:
    """Colour cells by the verdicts on their rays; cells without scored rays are dark, `free` ones slate.

    With s = share wrong / `saturating_wrong` and u = share not answered / SATURATING_UNANSWERED, both limited to 1,
    the colour is (1 - u) (right + s (wrong - right)) + u not_answered.
    """
    right, wrong, open_ = (np.array(VERDICT_COLOURS[name], dtype=np.float64) for name in VERDICT_COLOURS)
    off = np.clip(np.nan_to_num(counts.share_wrong) / saturating_wrong, 0, 1)[..., None]
    dark = np.clip(np.nan_to_num(counts.share_unanswered) / SATURATING_UNANSWERED, 0, 1)[..., None]
    mixed = (right + off * (wrong - right)) * (1 - dark) + dark * open_
    base = np.full(mixed.shape, EMPTY, dtype=np.float64)
    if free is not None:
        base[free] = FREE
    return np.where((counts.scored > 0)[..., None], mixed, base).round().astype(np.uint8)


def log_voxels(recording: rr.RecordingStream, cells: ReviewCells) -> None:
    """Log the (x, y, phi) cells above the floor; the height of a full turn is half the width of the floor."""
    nx, ny, _ = cells.counts.shape
    high = 0.5 * max(nx, ny) * cells.cell / HEADINGS
    if cells.ray_counts is not None:
        chosen = cells.ray_counts.scored > 0
        colour = verdict_colours(cells.ray_counts, cells.ray_counts.by_place.saturating_wrong)[chosen]
    else:
        chosen = cells.counts > 0
        colour = colours(np.minimum(cells.counts[chosen] / MANY_VISITS, 1))
    grid = rr.VoxelGridMap(
        np.argwhere(chosen),
        [cells.cell, cells.cell, high],
        colors=colour,
        translation=[*cells.origin, 0.05],
    )
    recording.log("space/cells", grid, static=True)
    shade = np.where((cells.counts > 0).any(axis=2), 70, np.where(cells.free, 55, 40))
    floor = shade.astype(np.uint8).T  # (ny, nx)
    image = np.repeat(floor[::-1, :, None], 3, axis=2)
    recording.log(
        "space/floor",
        rr.GridMap(
            data=image.tobytes(),
            format=rr.components.ImageFormat(width=nx, height=ny, color_model="RGB", channel_datatype="U8"),
            cell_size=cells.cell,
            translation=[*cells.origin, 0],
        ),
        static=True,
    )


def colours(value: Floats) -> RGB:
    """Map values 0 ... 1 of any shape to viridis colours, RGB uint8; nan is dark grey."""
    place = np.clip(np.nan_to_num(value), 0, 1) * (len(VIRIDIS) - 1)
    low = np.minimum(place.astype(np.intp), len(VIRIDIS) - 2)
    mixed = VIRIDIS[low] + (place - low)[..., None] * (VIRIDIS[low + 1] - VIRIDIS[low])
    return np.where(np.isnan(value)[..., None], np.array(EMPTY), mixed.round()).astype(np.uint8)


def _mean(values: Floats, *, axis: int) -> Floats:
    seen = np.isfinite(values)
    count = seen.sum(axis=axis)
    return np.asarray(np.where(seen, values, 0.0).sum(axis=axis) / np.where(count > 0, count, np.nan))
