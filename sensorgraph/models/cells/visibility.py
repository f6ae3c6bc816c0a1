"""Visibility of cells: one polynomial of the surrounding evidence predicts how probably a cell stops a ray.

Equation: logit(p) = beta·phi. A ray in the direction of a sector stops within one cell side with probability p.
Terms phi: 1, the `FEATURES` of (cell, sector), all squares and products of `SELF_PRODUCTS`, and the products of
`NEIGHBOUR_PRODUCTS` with `PRODUCT_PARTNERS`. One beta holds for all cells of a building, and transfers to others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planners.kernel import kernel, outer_kernel
from sensorgraph.models.cells.evidence import CellEvidence, Counts
from sensorgraph.models.cells.grid import N_SECTORS, CellIndices, RowGrid
from sensorgraph.types import Floats

Floats32 = NDArray[np.float32]

FEATURES = (
    "Hs", "Is", "Ho", "Io", "Qs", "Qo", "Q",
    "S side 1", "S side 2", "Qs side 1", "Qs side 2",
    "S +1", "S +2", "S +3", "S -1", "S -2", "Qs +1", "Qs +2", "Qs +3", "Qs -1", "Qs -2",
    "S diagonal +", "S diagonal -", "O +1", "O +2", "O -1", "O side",
    "unseen", "all unseen", "L", "L5", "S5",
    "S5 +4", "S5 -4", "S5 side 4", "S5 both sides 4", "seen 11", "H11", "Q11", "unseen +4",
)  # fmt: skip
"""Names of the features: H hits, I interpolated hits, S both, Q passes, L log ratio of hits to passes.
O: hits and interpolated hits from other directions. Suffix s: from similar directions, o: from other directions.
The suffix + is farther from the sensor, - is nearer. Numbers 5, 11: within 5 x 5 and 11 x 11 cells.
The value of "both sides" is the smaller one."""
SELF_PRODUCTS = (
    "Hs", "Ho", "Is", "Io", "Qs", "Qo", "S side 1", "Qs side 1", "L", "L5", "S5", "seen 11", "H11",
)  # fmt: skip
NEIGHBOUR_PRODUCTS = (
    "S +1", "S +2", "S -1", "S -2", "Qs +1", "Qs +2", "Qs -1", "Qs -2", "S diagonal +", "S diagonal -", "O +1", "all unseen",
    "S5 +4", "S5 -4", "S5 side 4", "S5 both sides 4",
)  # fmt: skip
PRODUCT_PARTNERS = ("Hs", "Is", "Qs", "L")
N_FEATURES = len(FEATURES)
# the numbers below define the features, for which the shipped coefficients were learned
NEIGHBOUR_STEP = 1.2
"""Distance between neighbours along and across a ray, in cells; above 1 so that diagonal neighbours differ."""
COUNT_SCALE, BOX_SCALE = 3.0, 5.0
"""Scale of counts n in log(1 + scale n), for one cell and for hits within 5 x 5 cells."""
INTERPOLATED, OTHER = 0.5, 0.3
"""Weight of an interpolated hit relative to a hit, and of a count in another direction relative to one in a similar one."""
PRIOR_HITS, PRIOR_PASSES = 0.05, 0.25
"""Prior numbers of hits and passes in the log ratio of both."""
BOX_CELLS, SURROUNDING_CELLS = 5 * 5, 11 * 11

_COLUMN = {name: k for k, name in enumerate(FEATURES)}
PAIRS = np.array(
    [(_COLUMN[a], _COLUMN[b]) for i, a in enumerate(SELF_PRODUCTS) for b in SELF_PRODUCTS[i:]]
    + [(_COLUMN[a], _COLUMN[b]) for a in NEIGHBOUR_PRODUCTS for b in PRODUCT_PARTNERS]
)
"""(n_products, 2) indices of the multiplied features."""
TERMS = ("1", *FEATURES, *(f"{FEATURES[a]} * {FEATURES[b]}" for a, b in PAIRS))
"""Names of the terms, in the order of beta."""


def neighbour_offsets(b: int) -> CellIndices:
    """Return the offsets (n, 2) of a cell's neighbours in the frame of sector b, in the order of `_NEIGHBOURS`."""
    angle = b * 2 * np.pi / N_SECTORS
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    return np.array(
        [np.round(NEIGHBOUR_STEP * (a * along + side * across)) for a, side in _NEIGHBOURS]
    ).astype(np.int64)


_NEIGHBOURS = (
    (0, 1), (0, -1), (0, 2), (0, -2), (1, 0), (2, 0), (3, 0), (-1, 0), (-2, 0), (1, 1), (1, -1), (-1, 1), (-1, -1),
    (3.3, 0), (-3.3, 0), (0, 3.3), (0, -3.3),
)  # fmt: skip


@outer_kernel
def fill_sector_maps(
    b: int, n_rows: int, hits: Counts, interpolated: Counts, passes: Counts, raw: Floats32, logs: Floats32
) -> None:
    """Fill raw and logs (n_rows + 1, 14) with the counts of every cell for sector b; the last row stays 0."""
    half = N_SECTORS // 2
    for row in range(n_rows):
        hs = i_s = h_all = i_all = q_all = 0.0
        for k in range(N_SECTORS):
            h_all += hits[row, k]
            i_all += interpolated[row, k]
        for k in range(half):
            q_all += passes[row, k]
        for d in range(-2, 3):
            hs += hits[row, (b + d) % N_SECTORS]
            i_s += interpolated[row, (b + d) % N_SECTORS]
        q = passes[row, b % half]
        qs = q + passes[row, (b + 1) % half] + passes[row, (b - 1) % half]
        raw[row, 0], raw[row, 1], raw[row, 2], raw[row, 3] = (
            hs,
            i_s,
            max(h_all - hs, 0.0),
            max(i_all - i_s, 0.0),
        )
        raw[row, 4], raw[row, 5], raw[row, 6] = qs, max(q_all - qs, 0.0), q
        raw[row, 7], raw[row, 8] = hs + i_s, max(h_all - hs, 0.0) + max(i_all - i_s, 0.0)
        raw[row, 9] = 1.0 if h_all + i_all + q_all > 0.0 else 0.0
        for k in range(9):
            logs[row, k] = math.log(1.0 + COUNT_SCALE * raw[row, k]) if raw[row, k] > 0.0 else 0.0


@outer_kernel
def add_box_sums(places: CellIndices, index: RowGrid, raw: Floats32, logs: Floats32) -> None:
    """Add the sums over 5 x 5 cells of S and O to the maps of one sector."""
    for row in range(len(places)):
        i, j = places[row]
        s5 = o5 = 0.0
        for di in range(-2, 3):
            for dj in range(-2, 3):
                near = index[i + di, j + dj]
                s5 += raw[near, 7]
                o5 += raw[near, 8]
        raw[row, 10], raw[row, 11] = s5, o5
        logs[row, 10] = math.log(1.0 + BOX_SCALE * s5)


@kernel
def add_surroundings(
    places: CellIndices, index: RowGrid, hits: Counts, interpolated: Counts, passes: Counts, logs: Floats32
) -> None:
    """Add sums over 11 x 11 cells and all sectors to logs: share of observed cells, hits and passes per 5 x 5 cells."""
    nx, ny = index.shape
    total = np.zeros((nx + 1, ny + 1, 3))  # summed-area table: sums over all cells before (i, j)
    own = np.zeros(3)
    for i in range(nx):
        for j in range(ny):
            row = index[i, j]
            own[:] = 0.0
            if row >= 0:
                own[1], own[2] = hits[row].sum() + interpolated[row].sum(), passes[row].sum()
                own[0] = 1.0 if own[1] + own[2] > 0.0 else 0.0
            for k in range(3):
                total[i + 1, j + 1, k] = total[i, j + 1, k] + total[i + 1, j, k] - total[i, j, k] + own[k]
    for row in range(len(places)):
        i, j = places[row]
        a, b, c, d = max(i - 5, 0), min(i + 6, nx), max(j - 5, 0), min(j + 6, ny)
        for k in range(3):
            inside = total[b, d, k] - total[a, d, k] - total[b, c, k] + total[a, c, k]
            logs[row, 11 + k] = (
                inside / SURROUNDING_CELLS
                if k == 0
                else math.log(1.0 + COUNT_SCALE * max(inside, 0.0) / BOX_CELLS)
            )


@kernel
def fill_features(
    i: int, j: int, index: RowGrid, raw: Floats32, logs: Floats32, around: CellIndices, f: Floats32
) -> None:
    """Fill f (40,) with the features of cell (i, j) from the maps of one sector; `around` are `neighbour_offsets`."""
    row = index[i, j]
    for k in range(7):
        f[k] = logs[row, k]
    n = np.empty(17, dtype=np.int64)
    for k in range(17):
        n[k] = index[i + around[k, 0], j + around[k, 1]]
    f[7] = 0.5 * (logs[n[0], 7] + logs[n[1], 7])
    f[8] = 0.5 * (logs[n[2], 7] + logs[n[3], 7])
    f[9] = 0.5 * (logs[n[0], 4] + logs[n[1], 4])
    f[10] = 0.5 * (logs[n[2], 4] + logs[n[3], 4])
    for k in range(5):  # ahead by 1, 2, 3, behind by 1, 2
        f[11 + k] = logs[n[4 + k], 7]
        f[16 + k] = logs[n[4 + k], 4]
    f[21] = 0.5 * (logs[n[9], 7] + logs[n[10], 7])
    f[22] = 0.5 * (logs[n[11], 7] + logs[n[12], 7])
    f[23], f[24], f[25] = logs[n[4], 8], logs[n[5], 8], logs[n[7], 8]
    f[26] = 0.5 * (logs[n[0], 8] + logs[n[1], 8])
    f[27] = 1.0 - raw[row, 9]
    seen = raw[row, 9] + raw[n[4], 9] + raw[n[0], 9] + raw[n[1], 9]
    f[28] = 1.0 if seen == 0.0 else 0.0
    s5, o5 = raw[row, 10], raw[row, 11]
    hits = (
        raw[row, 0]
        + INTERPOLATED * raw[row, 1]
        + OTHER * raw[row, 2]
        + OTHER * INTERPOLATED * raw[row, 3]
        + PRIOR_HITS
    )
    free = raw[row, 4] + OTHER * raw[row, 5] + PRIOR_PASSES
    f[29] = math.log(hits / free)
    f[30] = math.log((s5 + OTHER * o5 + PRIOR_HITS) / free)
    f[31] = logs[row, 10]
    f[32], f[33] = logs[n[13], 10], logs[n[14], 10]
    f[34], f[35] = 0.5 * (logs[n[15], 10] + logs[n[16], 10]), min(logs[n[15], 10], logs[n[16], 10])
    f[36], f[37], f[38] = logs[row, 11], logs[row, 12], logs[row, 13]
    f[39] = 1.0 - raw[n[13], 9]


@outer_kernel
def evaluate_logit(f: Floats32, beta: Floats, pairs: CellIndices) -> float:
    """Return beta·phi(f) for features f (40,)."""
    total = beta[0]
    for k in range(len(f)):
        total += beta[1 + k] * f[k]
    for k in range(len(pairs)):
        total += beta[1 + len(f) + k] * f[pairs[k, 0]] * f[pairs[k, 1]]
    return float(total)


@kernel
def fill_logits(
    places: CellIndices, index: RowGrid, raw: Floats32, logs: Floats32, around: CellIndices, beta: Floats,
    pairs: CellIndices, out: Floats32,
) -> None:  # fmt: skip
    """Fill out (n,) with the logit in every cell of places (n, 2), from the maps of one sector."""
    f = np.zeros(N_FEATURES, dtype=np.float32)
    for k in range(len(places)):
        fill_features(places[k, 0], places[k, 1], index, raw, logs, around, f)
        out[k] = evaluate_logit(f, beta, pairs)


@outer_kernel
def fill_all_features(
    places: CellIndices, index: RowGrid, raw: Floats32, logs: Floats32, around: CellIndices, out: Floats32
) -> None:
    """Fill out (n, 40) with the features of every cell of places (n, 2), from the maps of one sector."""
    for k in range(len(places)):
        fill_features(places[k, 0], places[k, 1], index, raw, logs, around, out[k])


def sector_maps(evidence: CellEvidence, places: CellIndices) -> Iterator[tuple[int, Floats32, Floats32]]:
    """Yield each sector with its maps, raw and logs (n_rows + 1, 14), which the next one overwrites."""
    counts, index = (evidence.hits, evidence.interpolated, evidence.passes), evidence.window.index
    raw, logs = (np.zeros((evidence.n_rows + 1, 14), dtype=np.float32) for _ in range(2))
    add_surroundings(places, index, *counts, logs)
    for b in range(N_SECTORS):
        fill_sector_maps(b, evidence.n_rows, *counts, raw, logs)
        add_box_sums(places, index, raw, logs)
        yield b, raw, logs


def logits(evidence: CellEvidence, beta: Floats) -> Floats32:
    """Return the logits (n_rows + 1, 16) of all cells and sectors; the last row is an unobserved cell."""
    places = evidence.window.places()
    out = np.empty((evidence.n_rows + 1, N_SECTORS), dtype=np.float32)
    out[-1] = evaluate_logit(unobserved_features(), beta, PAIRS)
    column = np.empty(evidence.n_rows, dtype=np.float32)
    for b, raw, logs in sector_maps(evidence, places):
        fill_logits(places, evidence.window.index, raw, logs, neighbour_offsets(b), beta, PAIRS, column)
        out[:-1, b] = column
    return out


def unobserved_features() -> Floats32:
    """Return the features (40,) of a cell that no ray crossed."""
    found = np.zeros(N_FEATURES, dtype=np.float32)
    found[[27, 28, 39]] = 1.0
    found[[29, 30]] = math.log(PRIOR_HITS / PRIOR_PASSES)
    return found


def features(evidence: CellEvidence, rows: CellIndices, sectors: CellIndices) -> Floats32:
    """Return the features (n, 40) of cells in rows (n,) for sectors (n,); row -1 is a cell that no ray crossed."""
    places = evidence.window.places()
    out = np.tile(unobserved_features(), (len(rows), 1))
    for b, raw, logs in sector_maps(evidence, places):
        here = np.flatnonzero((sectors == b) & (rows >= 0))
        part = np.empty((len(here), N_FEATURES), dtype=np.float32)
        fill_all_features(places[rows[here]], evidence.window.index, raw, logs, neighbour_offsets(b), part)
        out[here] = part
    return out


def expand_products(f: Floats32) -> Floats32:
    """Return the terms phi (n, n_terms) of features (n, 40)."""
    one = np.ones((len(f), 1), dtype=np.float32)
    return np.hstack([one, f, f[:, PAIRS[:, 0]] * f[:, PAIRS[:, 1]]])
