"""Rays next to a step in depth, and those behind them that meet the same wall; compiled, because a building has many.

`depth_edges` describes the chance of a ray to pass an edge.
"""

from __future__ import annotations

import math

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Floats, Ints

GRAZING = 0.02
"""Minimum cosine to the normal at which a ray meets the extension of a wall."""


@kernel
def add_rays_behind(
    best: tuple[Floats, Floats, Floats],
    edges: tuple[Ints, Ints, Floats, Floats],
    other: tuple[Ints, Floats],
    rays: tuple[Floats, Floats, Floats, Floats, Floats],
    wall: Ints,
    walls: Floats,
    onward: Ints,
    bearings: Floats,
    blur: tuple[float, float],
    limits: tuple[float, float, float, float, float],
) -> None:
    """Enter the ray next to each edge, and those behind it that meet the same wall, where the edge is their most likely one.

    Parameters
    ----------
    best : (n_scans, n_rays) each: probability of the other side, range there [m], standard deviation [m]; changed in
        place. Of equally likely edges, the last one wins.
    edges : (k,) each: scan, ray next to the edge, its angle [rad] from the edge, and the edge's blur [rad].
    other : (k,) each: wall on the other side, negative without one, and range [m] at which the neighbour met it.
    rays : (n_scans, n_rays) each: origin x, y [m], direction x, y, range [m].
    wall : (n_scans, n_rays) Wall that each ray meets.
    walls : (n_walls, 2, 2) [m]
    onward : (n_rays,) The next ray away from the edge; -1 at the end.
    bearings : (n_rays,) [rad]
    blur : Standard deviations of a ray's direction [rad] and place [m].
    limits : Number of blurs up to which rays behind are entered, minimum probability, minimum step in depth [m],
        maximum range of a return [m], and maximum standard deviation [m].
    """
    turn, place = blur
    reach, least, step, farthest, widest = limits
    chances, others, spreads = best
    scan, first, away, edge_blur = edges
    ox, oy, ux, uy, ranges = rays
    for e in range(len(scan)):
        i, m, angle, behind = scan[e], first[e], away[e], other[0][e]
        while True:
            chance = min(0.5 * math.erfc(angle / edge_blur[e] / math.sqrt(2.0)), 0.5)
            beyond, cosine = other[1][e], 1.0
            if behind >= 0:
                ax, ay = walls[behind, 0, 0], walls[behind, 0, 1]
                dx, dy = walls[behind, 1, 0] - ax, walls[behind, 1, 1] - ay
                length = max(math.hypot(dx, dy), 1e-12)
                nx, ny = dy / length, -dx / length
                across = ux[i, m] * nx + uy[i, m] * ny
                cosine = abs(across)
                if cosine > GRAZING:
                    r = ((ax - ox[i, m]) * nx + (ay - oy[i, m]) * ny) / across
                    if r > 0:
                        beyond = r
            own = ranges[i, m]
            if (
                chance > least
                and chance >= chances[i, m]
                and abs(beyond - own) > step
                and math.isfinite(own)
                and beyond > 0
                and min(own, beyond) < farthest  # otherwise neither side returns
            ):
                spread = 0.0
                if math.isfinite(beyond):
                    sine = math.sqrt(max(1 - cosine * cosine, 0.0))
                    spread = min(math.hypot(turn * beyond * sine, place) / cosine, widest)
                chances[i, m], others[i, m], spreads[i, m] = chance, beyond, spread
            further = onward[m]
            if not angle < reach * edge_blur[e] or further < 0 or wall[i, further] != wall[i, m]:
                break
            angle += abs((bearings[further] - bearings[m] + np.pi) % (2 * np.pi) - np.pi)
            m = further
