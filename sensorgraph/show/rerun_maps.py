"""The maps of a review, for rerun: what was answered where, and the (x, y, phi) cells over the floor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from sensorgraph.types import Floats

if TYPE_CHECKING:
    from sensorgraph.show.review_cells import Cells, Tally

EMPTY, FREE = (40, 40, 46), (78, 84, 104)
VERDICT = {"right": (60, 178, 165), "wrong": (255, 60, 110), "not_answered": (150, 115, 255)}
VIRIDIS = np.array(
    [(68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 144, 141), (39, 173, 129), (92, 200, 99),
     (170, 220, 50), (253, 231, 37)], dtype=np.float64,
)  # fmt: skip
RGB = NDArray[np.uint8]


def tabs(cells: Cells) -> dict[str, str]:
    """Return the maps there are, name -> label, the most telling first; the report says what the colours mean."""
    out = {}
    if cells.tally is not None:
        out["verdict"] = "teal right, pink wrong, violet not answered"
    if cells.next is not None:
        out["next"] = "drive next"
    if cells.tally is not None:
        out |= {"unanswered": "unanswered", "wrong": "wrong", "error": "error"}
    return out | {"coverage": "coverage"}


def log_maps(recording: rr.RecordingStream, cells: Cells) -> None:
    """Log every map as an image in place."""
    for name, image in images(cells).items():
        side = cells.next.cell if name == "next" and cells.next is not None else cells.cell
        place = rr.Transform3D(translation=[*cells.origin, 0], scale=[side, side, 1])
        recording.log(f"plan/{name}", place, static=True)
        pixels = rr.Image(image.transpose(1, 0, 2), draw_order=-10)
        recording.log(f"plan/{name}/image", pixels, static=True)


def images(cells: Cells) -> dict[str, RGB]:
    """Return each map of `tabs` as RGB (nx, ny, 3)."""
    from sensorgraph.show.review_cells import MUCH_UNANSWERED

    share = (cells.counts > 0).mean(axis=2)
    out = {"coverage": colours(np.where(share > 0, share, np.nan))}
    if cells.tally is not None and cells.error is not None:
        flat = cells.tally.flat
        out["verdict"] = verdicts(flat, flat.much_wrong, cells.free & (share == 0))
        out["unanswered"] = colours(flat.share_unanswered / MUCH_UNANSWERED)
        out["wrong"] = colours(flat.share_wrong / flat.much_wrong)
        out["error"] = colours(_mean(cells.error, axis=2) / cells.error_top)
    if cells.next is not None:
        out["next"] = colours(cells.next.doubt)
    return out


def verdicts(tally: Tally, much_wrong: float, free: NDArray[np.bool_] | None = None) -> RGB:
    """Colour cells (...) by what came of their rays: dark where none was scored, slate where `free` and not visited.

    Right turns into wrong with the share of the answered rays that are wrong, and that into not answered with the
    share not answered, each along its own short scale: one wrong ray in twenty is much.
    """
    from sensorgraph.show.review_cells import MUCH_UNANSWERED

    right, wrong, open_ = (np.array(VERDICT[name], dtype=np.float64) for name in VERDICT)
    off = np.clip(np.nan_to_num(tally.share_wrong) / much_wrong, 0, 1)[..., None]
    dark = np.clip(np.nan_to_num(tally.share_unanswered) / MUCH_UNANSWERED, 0, 1)[..., None]
    mixed = (right + off * (wrong - right)) * (1 - dark) + dark * open_
    base = np.full(mixed.shape, EMPTY, dtype=np.float64)
    if free is not None:
        base[free] = FREE
    return np.where((tally.scored > 0)[..., None], mixed, base).round().astype(np.uint8)


def log_voxels(recording: rr.RecordingStream, cells: Cells) -> None:
    """Log the (x, y, phi) cells over the floor; a full turn is half as high as the floor is wide."""
    from sensorgraph.show.review_cells import HEADINGS

    nx, ny, _ = cells.counts.shape
    high = 0.5 * max(nx, ny) * cells.cell / HEADINGS
    if cells.tally is not None:
        chosen = cells.tally.scored > 0
        colour = verdicts(cells.tally, cells.tally.flat.much_wrong)[chosen]
    else:
        chosen = cells.counts > 0
        colour = colours(np.minimum(cells.counts[chosen] / 10, 1))
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
    """Colour values in 0 ... 1 (any shape) as RGB uint8 (viridis); nan is dark grey, unlike any value."""
    place = np.clip(np.nan_to_num(value), 0, 1) * (len(VIRIDIS) - 1)
    low = np.minimum(place.astype(np.intp), len(VIRIDIS) - 2)
    mixed = VIRIDIS[low] + (place - low)[..., None] * (VIRIDIS[low + 1] - VIRIDIS[low])
    return np.where(np.isnan(value)[..., None], np.array(EMPTY), mixed.round()).astype(np.uint8)


def _mean(values: Floats, *, axis: int) -> Floats:
    seen = np.isfinite(values)
    count = seen.sum(axis=axis)
    return np.asarray(np.where(seen, values, 0.0).sum(axis=axis) / np.where(count > 0, count, np.nan))
