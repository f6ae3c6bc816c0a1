"""Screen every smooth effect at once: the score test on the normal equations of the fit without it.

All that shifts readings smoothly lies in the span of the nuisances' columns: a moved wall, a moved obstacle and a
scaled map shift corners together; a bias, a scale, a mount have a tolerance-sized copy. So one assembled system
gives the expected gain of each effect, with its own prior opened and the nuisances refitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted, corners_of
from sensorgraph.diagnosis.scan.gauss_newton import boxed
from sensorgraph.diagnosis.scan.nuisance import BOX, DENSE, OWN
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.places import named_walls, outward
from sensorgraph.types import Bools, Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect worth fitting, with the gain that is expected of it."""

    amendment: Amendment
    gain: float
    """[nats] expected over the fit without it."""


def smooth_candidates(data: ScanData, fitted: Fitted, *, broad: bool = False) -> list[Candidate]:
    """Return every smooth effect with its start values and expected gain.

    Parameters
    ----------
    broad : weigh readings far off as well (effects far outside the noise)
    """
    solver, state = fitted.solver, fitted.state
    y = solver.y
    if broad:
        e = y[solver.jacobian.valid & data.returned]
        sigma = max(1.5 * float(np.median(np.abs(e))) if len(e) else 0.0, data.sensor.sigma)
        weight = np.where(data.returned, 1 / (1 + (y / (3 * sigma)) ** 2), 0.0) / sigma**2
        system = solver.assemble(weight, state.pose_scale)
    else:
        system = fitted.solution.system
    n = solver.n_g
    tau = solver.scaled(state)
    held = solver.locked
    reference, _ = _solved(system.matrix, system.right, tau, held, n)
    found = []
    for amendment, directions, own in hypotheses(data, fitted):
        big = np.concatenate([np.eye(len(system.right)), _padded(directions, len(system.right))], axis=1)
        matrix, right = big.T @ system.matrix @ big, big.T @ system.right
        locked = held.copy()
        for name in own:
            locked[DENSE.index(name)] = True
        value, x = _solved(matrix, right, tau, locked, n)
        size = x[-directions.shape[1] :]
        names = list(START[amendment.name])
        moved = amendment.moved_to(
            {k: amendment.parameters.get(k, 0.0) + float(v) for k, v in zip(names, size, strict=True)}
        )
        found.append(Candidate(amendment=moved, gain=value - reference))
    return sorted(found, key=lambda c: -c.gain)


START: dict[str, tuple[str, ...]] = {
    "range_bias": ("b",),
    "range_scale": ("s",),
    "range_drift": ("b1",),
    "mount_yaw": ("delta",),
    "mount_xy": ("dx", "dy"),
    "latency": ("tau",),
    "scan_skew": ("T",),
    "moved_wall": ("d",),
    "moved_obstacle": ("dx", "dy"),
    "map_scale": ("s", "dx", "dy"),
}


def hypotheses(data: ScanData, fitted: Fitted) -> list[tuple[Amendment, Floats, Sequence[str]]]:
    """List (effect at zero, its directions among the nuisances (n_g, k), its own copies)."""
    n = fitted.solver.n_g
    present = {(a.name, a.place) for a in fitted.model}
    out: list[tuple[Amendment, Floats, Sequence[str]]] = []
    for name, copies in OWN.items():
        held = [fitted.solver.locked[DENSE.index(copy)] for copy in copies]
        if (name, "") in present or all(held):
            continue
        directions = np.zeros((n, len(copies)))
        for k, copy in enumerate(copies):
            directions[DENSE.index(copy), k] = 1.0
        out.append((EFFECTS[name](**dict.fromkeys(START[name], 0.0)), directions, copies))
    return [*out, *_of_the_map(data, fitted, present)]


def _of_the_map(
    data: ScanData, fitted: Fitted, present: set[tuple[str, str]]
) -> list[tuple[Amendment, Floats, Sequence[str]]]:
    """List moved walls, moved obstacles and the scaled map, as shifts of the corners."""
    corners, n = corners_of(data), fitted.solver.n_g
    out: list[tuple[Amendment, Floats, Sequence[str]]] = []
    if corners.count == 0:
        return out
    arena = data.arena
    walls = fitted.cast.scene.walls
    for index, name in enumerate(arena.names):
        if name.split("/")[0] != arena.names[0].split("/")[0] or ("moved_wall", name) in present:
            continue
        normal = outward(arena, index)
        directions = np.zeros((n, 1))
        for corner in set(corners.ends[index]):
            directions[len(DENSE) + 2 * corner : len(DENSE) + 2 * corner + 2, 0] = normal
        out.append((EFFECTS["moved_wall"](d=0.0).at(name, arena.walls[index].mean(axis=0)), directions, ()))
    for feature in obstacles(data):
        if ("moved_obstacle", feature) in present or ("missing_obstacle", feature) in present:
            continue
        directions = np.zeros((n, 2))
        members = named_walls(arena, feature)
        for corner in set(corners.ends[members].ravel()):
            for axis in (0, 1):
                directions[len(DENSE) + 2 * corner + axis, axis] = 1.0
        centre = walls[members].reshape(-1, 2).mean(axis=0)
        out.append((EFFECTS["moved_obstacle"](dx=0.0, dy=0.0).at(feature, centre), directions, ()))
    if ("map_scale", "") not in present:
        x0, y0, x1, y1 = arena.bounds
        directions = np.zeros((n, 3))
        for index, ends in enumerate(corners.ends):
            for end, corner in enumerate(ends):
                at = len(DENSE) + 2 * corner
                place = arena.walls[index, end] - [(x0 + x1) / 2, (y0 + y1) / 2]
                directions[at : at + 2, 0] = place
                directions[at, 1] = directions[at + 1, 2] = 1.0
        out.append((EFFECTS["map_scale"](s=0.0, dx=0.0, dy=0.0), directions, ()))
    return out


def obstacles(data: ScanData) -> list[str]:
    """Return the names of the arena's features, the outline left out."""
    names = data.arena.names
    outline = names[0].rsplit("/", 1)[0]
    return [f for f in dict.fromkeys(name.rsplit("/", 1)[0] for name in names) if f != outline]


def _padded(directions: Floats, size: int) -> Floats:
    out = np.zeros((size, directions.shape[1]))
    out[: len(directions)] = directions
    return out


def _solved(matrix: Floats, right: Floats, tau: Floats, held: Bools, n: int) -> tuple[float, Floats]:
    """Return the maximum of the quadratic and where it is."""
    g, p = boxed(matrix, right, tau, BOX * tau, held)
    x = np.concatenate([g, p])
    value = float(right @ x - 0.5 * x @ matrix @ x - 0.5 * np.sum((g / tau) ** 2))
    return value, x
