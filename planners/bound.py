"""Lower bound on the time of drives made of whole moves: turns on the spot and straight moves.

Definitions. A drive of whole moves alternates two kinds of moves. A turn on the spot by one heading bin takes
turn = 2π / (headings omega) [s]. A straight move, forward or backward, leads from the middle of one cell to
the middle of another, in a direction within the robot's heading bin. It takes its length over v.
Accelerations and walls are neglected. Between two moves the robot is in a bin (cell, heading); the drive
visits these bins. `lower_bound` is at most the time of any such drive that visits all bins of `need`.

Bound. Consider one cell. Let f[k] and g[k] be the numbers of turns from heading k to k + 1 and to k - 1. Let
p[k] and q[k] be the numbers of straight moves that enter and that leave at heading k. Let s[k] be the time of
the shortest straight move within heading bin k. The time spent in the cell is at least the optimum of a
linear programme:

    Minimise   turn Σ (f + g) + Σ s (p + q) / 2.
    Balance    f[k-1] + g[k+1] + p[k] = f[k] + g[k] + q[k]   for every k.
    Visits     f[k-1] + g[k+1] + p[k] ≥ 1                    for every k of `need`.
    Entry      Σ p ≥ 1,   with f, g, p, q ≥ 0.

The bound of the drive is the sum over cells, minus max s. (D. Krupke, Near-optimal coverage path planning
with turn costs, ALENEX 2024, has this programme for cells; headings add one dimension.)

Proof. Add a straight move into the drive's first bin and one out of its last. This adds half of each to the
time, in total at most max s. Split the time of each straight move equally between the cell it leaves and the
cell it enters. The time is then a sum over cells. Each bin is left as often as it is entered (balance). Each
bin of `need` is entered (visits). A straight move enters the cell (entry). A straight move at heading k takes
at least s[k]. ∎

Rare sets of headings have a weaker bound in closed form. Visiting n headings takes n entries, one of them by
a straight move. As many straight moves leave as enter, so each entry costs at least min(turn, min s). The
cell costs at least min s + (n - 1) min(turn, min s).

Scope. Robots that drift while they turn, as those of the search, do not drive whole moves. For them the bound
is a reference value without a proof: they can be faster, for example on a drive through few bins.

Cars do not drive whole moves either. The only bound for an arbitrary drive is that each bin needs one logged
pose, so n bins take n - 1 periods of the log. It is weak: about a fifth of the time of cars. Counting the bin
borders that a drive can cross at its limits would give a larger number but no bound. A drive that oscillates
about a corner of the grid visits eight bins in almost no time.
"""

from __future__ import annotations

import numpy as np
from scipy import optimize

from planners.types import Bools, Floats
from planners.vehicle import Limits, Vehicle

MAX_PATTERNS = 100
"""Number of different heading sets per cell that are solved as linear programmes, most frequent first; about 1 s."""
OFFSETS = 8
"""[cells] Maximum offset of a straight move that is enumerated; longer moves count as this length."""


def lower_bound(need: Bools, vehicle: Vehicle, cell: float, rate: float, drive_time: float = np.inf) -> float:
    """Return a lower bound [s] on the time of drives of whole moves through the bins `need` (nx, ny, n_phi).

    For cars, and for a drive that is faster than this bound, return the bound of an arbitrary drive.

    Parameters
    ----------
    cell : [m] Side of a cell.
    rate : [Hz] Rate of the log.
    drive_time : [s] Time of a drive that visits these bins.
    """
    any_drive = max(int(need.sum()) - 1, 0) / rate
    if vehicle.drive != "diff":
        return any_drive
    whole = whole_moves_bound(need, vehicle.limits, cell)
    return whole if whole <= drive_time else any_drive


def whole_moves_bound(need: Bools, limits: Limits, cell: float) -> float:
    """Return the bound [s] of the module docstring for the bins `need` (nx, ny, n_phi)."""
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
    """Return the shortest grid step (headings,) [cells] within each heading bin, forward or backward."""
    i, j = (part.ravel() for part in np.mgrid[-OFFSETS : OFFSETS + 1, -OFFSETS : OFFSETS + 1])
    other = (i != 0) | (j != 0)
    direction, length = np.arctan2(j[other], i[other]), np.hypot(i[other], j[other])
    width = 2 * np.pi / headings
    ahead = abs((direction - np.arange(headings)[:, None] * width + np.pi) % (2 * np.pi) - np.pi)
    within = np.minimum(ahead, np.pi - ahead) <= 0.5 * width + 1e-9
    return np.asarray(np.where(within, length, float(OFFSETS)).min(axis=1))


def _cell_time(need: Bools, limits: Limits, steps: Floats) -> float:
    """Solve the linear programme of one cell; return its optimum [s].

    Parameters
    ----------
    need : (n_phi,) Headings to visit.
    steps : (n_phi,) [m] Shortest straight move at each heading.
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
