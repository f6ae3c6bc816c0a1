"""Deviations of poses along directions that the scans do not determine: those of dead reckoning.

Along a corridor, and in a turn about the middle of a round hall, the scans look the same. With the motion α_k of key frame k
along its open direction v_k, the wheel edge e from k to k + 1, with information I_e and derivatives B_e by the wheel
parameters p, gives

    α_{k+1} = α_k + ε_e + a_e · δp,  var ε_e = q_e = 1 / (vᵀ I_e v),  a_e = q_e vᵀ I_e B_e.

A stretch of such key frames is a random walk: free at both ends its deviations are from its mean; at an end where a key frame
determines all directions, they are from there; between two such ends, they are those of a bridge. The joint refinement
linearises at directions of surfaces that are not exact, which let a long motion along them cross them: it states too little.

The same holds for the motion during a slow sweep without odometry. A pose is that at the first ray; the scans determine where a
sweep was as a whole. If their velocities before and after differ by d, the velocity during a sweep of the duration T is uncertain
by d, and the pose at its first ray, T / 2 from its middle, by d T / 2.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from logs.transforms import compose, invert
from sensorgraph.localization.map_states import open_directions
from sensorgraph.localization.refinement import Refined
from sensorgraph.localization.result import WheelParameters, true_intervals
from sensorgraph.localization.scan_track import ScanTrack, turn_matrices
from sensorgraph.localization.wheel_edges import WheelEdges
from sensorgraph.types import Bools, Floats, Ints


def with_dead_reckoning(
    covariances: Floats, tracked: ScanTrack, refined: Refined, wheels: WheelParameters | None
) -> Floats:
    """Return the covariances (n_scans, 3, 3) of x, y, phi in map, at least those of dead reckoning along open directions.

    Parameters
    ----------
    refined : Key frames with the directions that they determine, and the wheel edges between them; without odometry, the
        edges have the deviations of an unknown motion.
    wheels : Wheel parameters with their standard errors; None: no odometry.
    """
    keys, out, edges = tracked.key_frames, covariances.copy(), refined.system.edges
    directions = open_directions(refined.system.rows.projections, len(keys))
    is_open: Bools = np.asarray(directions.any(axis=1))
    if not is_open.any():
        return out
    is_joined = (np.diff(tracked.piece) == 0) | tracked.is_carried
    first = np.flatnonzero(is_joined[edges.edges.first])
    has_edge = np.zeros(len(keys) + 1, dtype=np.bool_)  # k: from key frame k - 1 to k
    has_edge[edges.edges.first[first] + 1] = True
    number = np.zeros(len(keys) + 1, dtype=np.intp)
    number[edges.edges.first[first] + 1] = first
    variances = np.zeros(len(keys))
    known = (
        np.zeros(3) if wheels is None else np.where(np.isfinite(wheels.deviations), wheels.deviations, 0.0)
    )
    for start, stop in _stretches(is_open, has_edge):
        way = directions[start:stop] = _oriented(directions[start:stop])
        is_held = bool(has_edge[start]), bool(has_edge[stop])
        begin, end = start + (not is_held[0]), stop + is_held[1]
        toward = np.vstack([way, way[-1:]])[begin - start : end - start]
        walk = _walk(number[begin:end], toward, refined.poses[begin - 1 : end - 1], edges)
        variances[start:stop] = _variances(*walk, known, is_held)
    left, right, _ = tracked.between_key_frames()
    is_whole = tracked.piece[left] == tracked.piece[right]
    nearest = np.where(is_open[left] | ~is_whole, left, right)
    v = directions[nearest]
    square = np.maximum((v**2).sum(axis=1), 1e-12)
    stated = np.einsum("ni,nij,nj->n", v, out, v) / square**2  # of the motion along v
    missing = np.maximum(variances[nearest] - stated, 0.0)
    out += missing[:, None, None] * v[:, :, None] * v[:, None, :]
    return out


def _stretches(is_open: Bools, has_edge: Bools) -> list[tuple[int, int]]:
    """Return the stretches (start, stop) of open key frames that the wheels connect."""
    found = []
    for start, stop in true_intervals(is_open):
        cuts = [start, *(np.flatnonzero(~has_edge[start + 1 : stop]) + start + 1).tolist(), stop]
        found += list(pairwise(cuts))
    return found


def _oriented(directions: Floats) -> Floats:
    """Return open directions (m, 3) of one motion: of one sign, and all per radian if most of them turn."""
    out = directions.copy()
    turns = np.abs(out[:, 2])
    if np.median(turns) > 0:
        usable = turns > 0.5 * np.median(turns)
        out[usable] /= out[usable, 2:]
        return out
    for k in range(1, len(out)):
        if out[k] @ out[k - 1] < 0:
            out[k] = -out[k]
    return out


def _walk(number: Ints, toward: Floats, poses: Floats, edges: WheelEdges) -> tuple[Floats, Floats]:
    """Return the variances q (m,) of the steps of a walk, and their derivatives a (m, 3) by the wheel parameters."""
    turn = turn_matrices(-poses[:, 2])
    v = np.einsum("nij,nj->ni", turn, toward)
    weighted = np.einsum("ni,nij->nj", v, edges.edges.information[number])
    q = 1.0 / np.maximum(np.einsum("ni,ni->n", weighted, v), 1e-12)
    return q, q[:, None] * np.einsum("ni,nij->nj", weighted, edges.by_parameters[number])


def _variances(q: Floats, by: Floats, deviations: Floats, is_held: tuple[bool, bool]) -> Floats:
    """Return the variances of the positions of a walk with steps of variance q (m,), held before or after it.

    Parameters
    ----------
    by : (m, 3) Derivatives of the steps by parameters with `deviations` (3,).
    """
    before, after = is_held
    way = np.concatenate([[0.0], np.cumsum(q)])
    shift = np.vstack([np.zeros(3), np.cumsum(by, axis=0)])
    if before and after:
        share = way / way[-1]
        noise, moved = way * (1.0 - share), shift - share[:, None] * shift[-1]
        noise, moved = noise[1:-1], moved[1:-1]
    elif before:
        noise, moved = way[1:], shift[1:]
    elif after:
        noise, moved = (way[-1] - way)[:-1], (shift - shift[-1])[:-1]
    else:
        n = len(way)
        after_step = (n - 1 - np.arange(len(q))) / n  # share of the positions that a step moves
        noise = np.concatenate([[0.0], np.cumsum(q * (1.0 - after_step) ** 2)])
        noise = noise + np.concatenate([np.cumsum((q * after_step**2)[::-1])[::-1], [0.0]])
        moved = shift - shift.mean(axis=0)
    return np.asarray(noise + ((moved * deviations) ** 2).sum(axis=1))


def with_sweep_motion(covariances: Floats, stamps: Floats, poses: Floats, duration: float) -> Floats:
    """Return the covariances (n_scans, 3, 3) of x, y, phi in map with those of the unknown motion during a sweep.

    Parameters
    ----------
    stamps, poses : (n_scans,) [s], (n_scans, 3) [m, m, rad]
    duration : [s] Of a sweep.
    """
    if duration <= 0.0 or len(poses) < 3:
        return covariances
    took = np.diff(stamps)
    steps = compose(invert(poses[:-1]), poses[1:])
    steps[took > 0] /= took[took > 0, None]
    steps[took <= 0] = 0.0
    change = np.zeros_like(poses)
    change[1:-1] = np.abs(np.diff(steps, axis=0))
    change[0], change[-1] = change[1], change[-2]
    turn = turn_matrices(poses[:, 2])
    square = (0.5 * duration * change) ** 2
    return np.asarray(covariances + (turn * square[:, None, :]) @ turn.transpose(0, 2, 1))
