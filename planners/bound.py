"""A certified lower bound for the time of drives made of whole moves: turns on the spot, and straight moves.

A drive of whole moves is a sequence of two kinds of moves: a turn on the spot by one heading bin, and a straight move, forward or
backward, from the middle of a cell to the middle of another, whose direction lies in the heading bin that the robot is in. A
turn takes 2π / (headings omega), a straight move its length over v; accelerations and walls are left out. The
drive visits the bins (cell, heading) in which it is between two moves. `lower_bound` is at most the time of any such drive
that visits all bins of `need`.

Proof. Let a straight move lead into the drive's first bin and another out of its last: that adds half of each, at most
the longest of the shortest moves s[k] below. Share the time of each straight move between the cell that it leaves and
the cell that it enters, half each. The time is then a sum over cells. In one cell, let f[k] and g[k] count the turns from
heading k to k + 1 and to k - 1, and p[k] and q[k] the straight moves that enter and leave at heading k. Each bin is
left as often as it is entered, each bin of `need` is entered, and a straight move enters the cell. A straight move at
heading k takes at least s[k], the shortest step of the grid within that heading bin over v. So what the cell takes is no
less than the least of turn (Σf + Σg) + Σ s (p + q) / 2 under these constraints: a linear programme over bins and moves (as D.
Krupke, Near-optimal coverage path planning with turn costs, ALENEX 2024, for cells; headings are one dimension more).
For sets of headings that few cells have there is a weaker bound in closed form: n headings need n entries, one of them
by a straight move, and as many straight moves leave as enter, so each entry takes at least a turn or the least s. ∎

Robots that drift while they turn, as those of the search, do not drive whole moves. The bound is a yardstick for them, too,
but no proof: physics allows drives that are shorter, and a drive that meets few bins in passing is.

Cars do not drive whole moves at all. For any drive there is only this: each bin needs a logged pose of its own, so n
bins take n - 1 periods of the log. It is of little use, a fifth of what cars take. Counting the borders that a drive can cross at its
limits would bring more and be wrong: a drive that dithers about a corner of the grid meets eight bins there, and
takes no time for it.
"""

from __future__ import annotations

import numpy as np
from scipy import optimize

from planners.types import Bools, Floats
from planners.vehicle import Limits, Vehicle

MAX_PATTERNS = 100
"""Different sets of headings in a cell that are solved, the most frequent, in about a second; the others have the closed form."""
OFFSETS = 8
"""[cells] Steps of the grid up to this are looked at; further ones count as long as this."""


def lower_bound(need: Bools, vehicle: Vehicle, cell: float, rate: float, drive_time: float = np.inf) -> float:
    """Return a time [s] that no drive of whole moves through the bins `need` (nx, ny, n_phi) falls below.

    Of a car, and for a drive that is shorter than that, it is the bound of any drive.

    Parameters
    ----------
    cell : [m] side of a cell
    rate : [Hz] of the log
    drive_time : [s] of a drive that meets these bins
    """
    any_drive = max(int(need.sum()) - 1, 0) / rate
    if vehicle.drive != "diff":
        return any_drive
    whole = whole_moves_bound(need, vehicle.limits, cell)
    return whole if whole <= drive_time else any_drive


def whole_moves_bound(need: Bools, limits: Limits, cell: float) -> float:
    """Return a time [s] that no drive of whole moves through the bins `need` (nx, ny, n_phi) falls below."""
    headings = need.shape[2]
    wanted = need[need.any(axis=2)]
    if not len(wanted):
        return 0.0
    patterns, counts = np.unique(wanted, axis=0, return_counts=True)
    most = np.argsort(-counts, kind="stable")
    patterns, counts = patterns[most], counts[most]
    steps = shortest_steps(headings) * cell
    move, turn = float(steps.min()) / limits.v, 2 * np.pi / headings / limits.omega
    times = move + (patterns.sum(axis=1) - 1) * min(move, turn)
    for k in range(min(len(patterns), MAX_PATTERNS)):
        times[k] = _cell_time(patterns[k], limits, steps)
    return max(float(times @ counts) - float(steps.max()) / limits.v, 0.0)


def shortest_steps(headings: int) -> Floats:
    """Return (headings,) [cells] the shortest step of the grid within each heading bin, forward or backward."""
    i, j = (part.ravel() for part in np.mgrid[-OFFSETS : OFFSETS + 1, -OFFSETS : OFFSETS + 1])
    other = (i != 0) | (j != 0)
    direction, length = np.arctan2(j[other], i[other]), np.hypot(i[other], j[other])
    width = 2 * np.pi / headings
    ahead = abs((direction - np.arange(headings)[:, None] * width + np.pi) % (2 * np.pi) - np.pi)
    within = np.minimum(ahead, np.pi - ahead) <= 0.5 * width + 1e-9
    return np.asarray(np.where(within, length, float(OFFSETS)).min(axis=1))


def _cell_time(need: Bools, limits: Limits, steps: Floats) -> float:
    """Return the least time [s] in a cell whose headings `need` (n_phi,) are visited.

    Parameters
    ----------
    steps : (n_phi,) [m] shortest straight move at each heading
    """
    n = len(need)
    eye, none = np.eye(n), np.zeros((n, n))
    on, back = np.roll(eye, 1, axis=0), np.roll(eye, -1, axis=0)
    enters = np.hstack([on, back, eye, none])  # (n, 4n): f, g, p, q
    leaves = np.hstack([eye, eye, none, eye])
    entry = np.concatenate([np.zeros(2 * n), np.ones(n), np.zeros(n)])
    turn = np.full(2 * n, 2 * np.pi / n / limits.omega)
    found = optimize.linprog(
        np.concatenate([turn, 0.5 * steps / limits.v, 0.5 * steps / limits.v]),
        A_ub=-np.vstack([enters[need], entry[None]]),
        b_ub=-np.ones(int(need.sum()) + 1),
        A_eq=enters - leaves,
        b_eq=np.zeros(n),
        method="highs",
    )
    return float(np.asarray(found.fun))
