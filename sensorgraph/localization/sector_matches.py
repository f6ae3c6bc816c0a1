"""Find the part of the rays that matches the others better at another time, however far it is off.

Points of a part that is 0.2 s older are decimetres from those of the others, where no linearised residual sees them. So
points are counted: M[d, s, t] is the number of points of sector s, with its rays d later, in cells that have points of
sector t from other frames. If a part b of the sectors is d later than the others, its count rises most:

    gain(b, d) = sum over s in b, t not in b of M[d, s, t] + M[-d, t, s] - M[0, s, t] - M[0, t, s]
"""

from __future__ import annotations

import numpy as np

from logs.motion import Motion
from sensorgraph.localization.point_rows import FramePoints
from sensorgraph.localization.scans import scan_points
from sensorgraph.localization.turning_pieces import TurningPieces
from sensorgraph.types import Bools, Floats, Ints

SECTORS = 48
"""Number of sectors of the field of view. Ends of a part within larger ones hide it."""
_SECTOR = np.arange(SECTORS)
_PARTS = np.array(
    [(first <= _SECTOR) & (end > _SECTOR) for first in range(1, SECTORS) for end in range(first + 1, SECTORS + 1)]
)  # fmt: skip
CELL = 0.1
"""[m] Side of a cell: noise and curvature of the track stay within it, 50 ms of a turn do not."""
TIMES = np.arange(-6, 7) * 0.05
"""(13,) [s] Times that are tried."""
_ROW = 1_000_003
"""Number of cells in a row of the map, at most."""


def best_part(pieces: TurningPieces, poses: Floats, delays: Floats, motion: Motion) -> tuple[Bools, float]:
    """Return the rays (n_rays,) and the time [s] with which they match the others best; 0.0 if no other time is better.

    Parameters
    ----------
    poses : (n_frames, 3) of the pieces.
    delays : (n_rays,) [s]
    """
    sector = np.arange(len(delays)) * SECTORS // len(delays)
    matches = _matches(pieces, poses, delays, motion, sector)
    inside, outside = _PARTS.astype(np.float64), (~_PARTS).astype(np.float64)
    later = np.einsum("ps,dst,pt->pd", inside, matches, outside, optimize=True)
    found = later + np.einsum("pt,dts,ps->pd", outside, matches[::-1], inside, optimize=True)
    gains = found - found[:, len(TIMES) // 2, None]
    part, time = np.unravel_index(np.argmax(gains), gains.shape)
    return np.asarray(_PARTS[part][sector]), float(TIMES[time]) if gains[part, time] > 0 else 0.0


def _matches(pieces: TurningPieces, poses: Floats, delays: Floats, motion: Motion, sector: Ints) -> Floats:
    """Return the counts M (n_times, SECTORS, SECTORS). Even and odd frames are compared with each other."""
    placed = [_cells(pieces, poses, delays + time, motion, sector) for time in TIMES]
    out = np.zeros((len(TIMES), SECTORS, SECTORS))
    for is_odd in (False, True):
        cells, odd, sectors = placed[len(TIMES) // 2]
        known, index = np.unique(cells[odd == is_odd], return_inverse=True)
        has = np.zeros((len(known) + 1, SECTORS))  # the last row is for all other cells
        has[index, sectors[odd == is_odd]] = 1.0
        known = np.append(known, np.iinfo(np.int64).max)
        for count, (cells, odd, sectors) in zip(out, placed, strict=True):
            asked = cells[odd != is_odd]
            at = np.searchsorted(known, asked)
            np.add.at(count, sectors[odd != is_odd], has[np.where(known[at] == asked, at, len(known) - 1)])
    return out


def _cells(
    pieces: TurningPieces, poses: Floats, delays: Floats, motion: Motion, sector: Ints
) -> tuple[Ints, Bools, Ints]:
    """Return the cell of each point, whether its frame is odd, and its sector."""
    scans = scan_points(pieces.run, motion, delays=delays)
    frames = FramePoints.of(scans, np.arange(scans.n_scans))
    x, y = np.floor(frames.placed(poses)[0] / CELL).astype(np.int64).T
    return x * _ROW + y, frames.frame % 2 == 1, sector[scans.rays]
