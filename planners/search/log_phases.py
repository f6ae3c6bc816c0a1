"""Bins in which the log of a drive has a pose, for every phase of the log's clock (a compiled kernel).

A log of phase p has poses at first[p] + n / rate, n = 0, 1, ... The pose at time dt of a piece is the
integral of `curve`. For alpha = 0 and omega ≠ 0 it has a closed form, with end = phi + omega dt:

    Along x:   [(v + a dt) sin(end) - v sin(phi) + (a / omega) (cos(end) - cos(phi))] / omega.
    Along y:   [v cos(phi) - (v + a dt) cos(end) + (a / omega) (sin(end) - sin(phi))] / omega.
"""

from __future__ import annotations

import numpy as np

from planners.coverage import Coverage
from planners.curve import NODES, WEIGHTS, Curve
from planners.kernel import inner_kernel, outer_kernel
from planners.types import ROUND_OFF, Bools, Floats

PHASES = 10
"""Number of phases of the log's clock for which every bin must be recorded."""
MIN_CLOSED_FORM_TURN = 0.05
"""[rad] and [rad/s] above which the closed form of an arc keeps its precision; below, quadrature is used."""


def missed(curve: Curve, todo: Bools, grid: Coverage, rate: float) -> Bools:
    """Return the bins (nx, ny, n_phi) of `todo` that the log [Hz] of at least one phase misses."""
    return np.asarray(todo & ~met(curve, grid, rate).all(axis=0))


def met(curve: Curve, grid: Coverage, rate: float, clock: float = 0.0) -> Bools:
    """Return the bins (PHASES, nx, ny, n_phi) in the log [Hz] of each phase, for a curve that starts at `clock` [s]."""
    found = np.zeros((PHASES, *grid.reachable.shape), dtype=np.bool_)
    first = (np.arange(PHASES) / PHASES / rate - clock) % (1 / rate)
    ends = np.append(curve.starts[1:], curve.duration)
    origin = float(grid.origin[0]), float(grid.origin[1])
    mark(curve.starts, ends, curve.poses, curve.twists, curve.rates, first, rate, origin, grid.cell, found)
    return found


@outer_kernel
def mark(
    starts: Floats,
    ends: Floats,
    poses: Floats,
    twists: Floats,
    rates: Floats,
    first: Floats,
    rate: float,
    origin: tuple[float, float],
    cell: float,
    found: Bools,
) -> None:
    """Mark in `found` (p, nx, ny, n_phi) the bins in logs (p,) whose first poses are at stamps `first` [s]."""
    _, nx, ny, n_phi = found.shape
    n = len(starts)
    for p in range(len(first)):
        stamp, count = first[p], 0
        for k in range(n):
            last = ends[k] + (ROUND_OFF / rate if k == n - 1 else 0.0)
            while stamp < last or (k == n - 1 and stamp <= last):
                dt = min(stamp, ends[n - 1]) - starts[k]
                phi, omega, alpha = poses[k, 2], twists[k, 1], rates[k, 1]
                x, y = displacement(phi, twists[k, 0], rates[k, 0], omega, alpha, dt)
                i = int(np.floor((poses[k, 0] + x - origin[0]) / cell))
                j = int(np.floor((poses[k, 1] + y - origin[1]) / cell))
                b = (
                    int(np.floor((phi + omega * dt + 0.5 * alpha * dt * dt) * n_phi / (2 * np.pi) + 0.5))
                    % n_phi
                )
                if 0 <= i < nx and 0 <= j < ny:
                    found[p, i, j, b] = True
                count += 1
                stamp = first[p] + count / rate


@inner_kernel
def displacement(
    phi: float, v: float, a: float, omega: float, alpha: float, dt: float
) -> tuple[float, float]:
    """Return the displacement x, y [m] within `dt` [s]; see `curve.displace`."""
    if v == 0 and a == 0:
        return 0.0, 0.0
    if omega == 0 and alpha == 0:
        length = v * dt + 0.5 * a * dt * dt
        return length * np.cos(phi), length * np.sin(phi)
    if alpha == 0 and abs(omega) > MIN_CLOSED_FORM_TURN and abs(omega * dt) > MIN_CLOSED_FORM_TURN:
        end = phi + omega * dt
        c0, s0, c1, s1 = np.cos(phi), np.sin(phi), np.cos(end), np.sin(end)
        speed, bent = v + a * dt, a / omega
        return (speed * s1 - v * s0 + bent * (c1 - c0)) / omega, (
            v * c0 - speed * c1 + bent * (s1 - s0)
        ) / omega
    x, y = 0.0, 0.0
    for k in range(len(NODES)):
        t = dt * (0.5 + 0.5 * NODES[k])
        heading, weight = phi + omega * t + 0.5 * alpha * t * t, 0.5 * dt * WEIGHTS[k] * (v + a * t)
        x, y = x + weight * np.cos(heading), y + weight * np.sin(heading)
    return x, y
