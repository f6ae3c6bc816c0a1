"""A map of pixels of a real building, counted as slam_toolbox does (Karto), and written as map_server reads it.

    python -m benchmarks.slam_map LOCATED.mcap -o FOLDER

A cell that two rays or more reach is occupied where at least a tenth of them end in it, and else free (Konolige, Grisetti,
Kümmerle, Burgard, Limketkai and Vincent 2010, Efficient sparse pose adjustment for 2D mapping; Karto's parameters
`MinPassThrough` 2, `OccupancyThreshold` 0.1). No line of it comes from the project.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.arguments import existing, parser_of
from benchmarks.places import write_map
from logs import pair, read
from logs.transforms import compose
from planners.types import Floats

MIN_PASS_THROUGH, OCCUPANCY = 2, 0.1
CELL = 0.05  # [m]
OCCUPIED, FREE, UNKNOWN = 0, 254, 205
MAX_USED = 20.0  # [m] a longer reading is followed up to here, and ends nowhere
MARGIN = 1.0  # [m] around what was reached
LONGEST_TURN = 0.02  # [rad] from scan to scan: in faster turns poses are worst, and maps get shadows


def grey_of(
    poses: Floats, ranges: Floats, bearings: Floats, cell: float
) -> tuple[NDArray[np.uint8], tuple[float, float]]:
    """Return the picture of a map, row 0 on top, and the place [m] of its lower left corner.

    Parameters
    ----------
    poses : (n, 3) [m, m, rad] of the laser
    ranges : (n, n_rays) [m]
    """
    angle = poses[:, 2:] + bearings
    ends_here = np.isfinite(ranges) & (ranges < MAX_USED) & (ranges > 0.05)
    reach = np.where(np.isfinite(ranges) & (ranges > 0.05), np.minimum(ranges, MAX_USED), 0.0)
    x, y = poses[:, :1] + reach * np.cos(angle), poses[:, 1:2] + reach * np.sin(angle)
    low = np.array([x.min(), y.min()]) - MARGIN
    shape = np.ceil((np.array([x.max(), y.max()]) + MARGIN - low) / cell).astype(int)
    hits, passes = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    for k in range(len(poses)):
        steps = np.arange(0.0, reach[k].max(initial=0.0), cell / 2)
        on_way = steps[:, None] < reach[k] - cell / 2
        px = (poses[k, 0] + steps[:, None] * np.cos(angle[k]))[on_way]
        py = (poses[k, 1] + steps[:, None] * np.sin(angle[k]))[on_way]
        ray = np.broadcast_to(np.arange(len(bearings)), on_way.shape)[on_way]
        i, j = ((px - low[0]) / cell).astype(int), ((py - low[1]) / cell).astype(int)
        once = np.unique((ray * shape[0] + i) * shape[1] + j) % (shape[0] * shape[1])
        np.add.at(passes.reshape(-1), once, 1)
        i = ((x[k, ends_here[k]] - low[0]) / cell).astype(int)
        j = ((y[k, ends_here[k]] - low[1]) / cell).astype(int)
        np.add.at(hits, (i, j), 1)
    reached = hits + passes
    grey = np.full(shape, UNKNOWN, dtype=np.uint8)
    known = reached >= MIN_PASS_THROUGH
    grey[known] = np.where(hits[known] >= OCCUPANCY * reached[known], OCCUPIED, FREE)
    return np.ascontiguousarray(grey.T[::-1]), (float(low[0]), float(low[1]))


def main() -> None:
    """Map a log."""
    parser = parser_of(__doc__)
    parser.add_argument("log", type=existing)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    log = read(options.log)
    pairing = pair(log)
    kept = np.flatnonzero(pairing.paired)
    poses = pairing.poses[kept]
    turn = np.abs(np.diff(np.unwrap(poses[:, 2]), prepend=poses[0, 2]))
    slow = turn < LONGEST_TURN
    lasers = compose(poses, log.sensor.mount)
    grey, origin = grey_of(lasers[slow], log.ranges[kept][slow], log.sensor.bearings, CELL)
    print(
        f"{int(slow.sum())} of {len(kept)} scans, {int((grey == OCCUPIED).sum())} cells occupied, "
        f"{int((grey == FREE).sum())} free; wrote {write_map(options.output, grey, origin, CELL)}"
    )


if __name__ == "__main__":
    main()
