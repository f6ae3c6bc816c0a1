"""The face in a cell for each sector: a line through the surrounding hits, or a distance along the ray."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel, kernel
from sensorgraph.models.cells.evidence import N_MOMENTS, CellEvidence
from sensorgraph.models.cells.grid import N_SECTORS, CellIndices, RowGrid
from sensorgraph.types import Floats

Codes = NDArray[np.uint8]
Offsets = NDArray[np.int8]

NO_LINE = 255
"""Code of a face without a line: only its distance along the ray is known."""
N_ANGLES = 255
"""Number of codes of the normal's angle in [0, pi): 0 ... 254."""
OFFSET_STEP = 0.001
"""[m] Resolution of the stored distance of a line from the centre of its cell (one byte)."""
MAX_STEPS = 127.4
"""Largest offset in steps that fits into a signed byte after rounding."""
RADIUS, FALLBACK_RADIUS = 2, 1
"""Neighbourhood whose hits determine the line of a cell, and the distance where there is no line, in cells."""
SIMILAR_SECTORS = 3
"""Number of sectors to each side whose hits are from the same side of a surface."""
MIN_HITS, MIN_ELONGATION = 2.5, 4.0
"""Minimum number of hits of a line, and minimum ratio of their variances along and across it."""
MIN_LENGTH_CELLS, MAX_OFFSET_CELLS = 0.6, 1.5
"""Minimum standard deviation of hits along a line, and maximum distance of a face without a line from the centre, in cells."""
COS = np.cos(np.arange(N_ANGLES) * np.pi / N_ANGLES)
SIN = np.sin(np.arange(N_ANGLES) * np.pi / N_ANGLES)


@inner_kernel
def sum_neighbourhood(
    i: int, j: int, radius: int, cell: float, index: RowGrid, face: RowGrid, moments: Floats, b: int,
    out: Floats,
) -> None:  # fmt: skip
    """Sum the moments of sector b in the cells within radius, relative to the centre of cell (i, j).

    `moments` are sums over similar sectors already.
    """
    for k in range(len(out)):
        out[k] = 0.0
    for di in range(-radius, radius + 1):
        for dj in range(-radius, radius + 1):
            row = index[i + di, j + dj]
            if row < 0 or face[row] < 0:
                continue
            m = moments[face[row], b]
            n, x0, y0 = m[0], di * cell, dj * cell
            out[0] += n
            out[1] += m[1] + n * x0
            out[2] += m[2] + n * y0
            out[3] += m[3] + 2.0 * x0 * m[1] + n * x0 * x0
            out[4] += m[4] + x0 * m[2] + y0 * m[1] + n * x0 * y0
            out[5] += m[5] + 2.0 * y0 * m[2] + n * y0 * y0


@inner_kernel
def fit_line(m: Floats, cell: float) -> tuple[bool, float, float, float]:
    """Fit a line to moments (6,) by total least squares.

    The variances along and across the line are the eigenvalues of the covariance. They
    are (½ (xx + yy) ± sqrt(¼ (xx - yy)² + xy²)). The normal has the angle ½ atan2(2 xy, xx - yy) + π/2.

    Returns
    -------
    whether there is a line, angle of its normal [rad], its offset [m], standard deviation across it [m]
    """
    if m[0] < MIN_HITS:
        return False, 0.0, 0.0, 0.0
    x, y = m[1] / m[0], m[2] / m[0]
    xx, xy, yy = m[3] / m[0] - x * x, m[4] / m[0] - x * y, m[5] / m[0] - y * y
    half, root = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    small, large = half - root, half + root
    if not (large > MIN_ELONGATION * small and large > (MIN_LENGTH_CELLS * cell) ** 2):
        return False, 0.0, 0.0, 0.0
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi  # perpendicular to the long axis
    return True, angle, x * math.cos(angle) + y * math.sin(angle), math.sqrt(max(small, 0.0))


@kernel
def fill_local_lines(
    places: CellIndices, cell: float, index: RowGrid, face: RowGrid, moments: Floats, angle: Codes,
    offset: Offsets,
) -> None:  # fmt: skip
    """Fill angle and offset (n, 16) for every cell in places (n, 2); moments are sums over similar sectors."""
    m = np.empty(N_MOMENTS)
    for k in range(len(places)):
        i, j = places[k]
        any_near = False
        for di in range(-RADIUS, RADIUS + 1):
            for dj in range(-RADIUS, RADIUS + 1):
                row = index[i + di, j + dj]
                if row >= 0 and face[row] >= 0:
                    any_near = True
        if not any_near:
            continue
        for b in range(N_SECTORS):
            sum_neighbourhood(i, j, RADIUS, cell, index, face, moments, b, m)
            found, normal, d, _ = fit_line(m, cell)
            if found:
                code = round(normal / math.pi * N_ANGLES)  # adding pi reverses the normal
                if (code // N_ANGLES) % 2 != 0:
                    d = -d
                code %= N_ANGLES
                if abs(d) < MAX_STEPS * OFFSET_STEP:
                    angle[k, b], offset[k, b] = code, round(d / OFFSET_STEP)
                    continue
            sum_neighbourhood(i, j, FALLBACK_RADIUS, cell, index, face, moments, b, m)
            if m[0] > 0.0:
                direction = 2.0 * math.pi * b / N_SECTORS
                d = (m[1] * math.cos(direction) + m[2] * math.sin(direction)) / m[0]
                if abs(d) < MAX_OFFSET_CELLS * cell:
                    offset[k, b] = round(d / OFFSET_STEP)


def local_lines(evidence: CellEvidence) -> tuple[Codes, Offsets]:
    """Return coded angle and offset (n_rows + 1, 16) of the face in each cell for each sector."""
    angle = np.full((evidence.n_rows + 1, N_SECTORS), NO_LINE, dtype=np.uint8)
    offset = np.zeros((evidence.n_rows + 1, N_SECTORS), dtype=np.int8)
    own = evidence.moments[: evidence.n_faces]
    similar = np.sum([np.roll(own, d, axis=1) for d in range(-SIMILAR_SECTORS, SIMILAR_SECTORS + 1)], axis=0)
    fill_local_lines(
        evidence.window.places(), evidence.window.cell, evidence.window.index, evidence.face, similar,
        angle, offset,
    )  # fmt: skip
    return angle, offset
