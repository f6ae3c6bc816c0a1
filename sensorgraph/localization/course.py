"""Odometry whose positions contradict its heading: found by the course of its positions, and corrected.

A robot on wheels drives along its heading, ahead or backwards. The true heading is a phi, where phi is the stated one and
the scans measure the factor a, 1 or a unit. The course of the positions is s phi + c, modulo a half turn.

| s | c | cause |
|---|---|---|
| a | 0 | none |
| a | other | the heading has another zero than the positions, as that of a compass |
| 2 a | any | a twist in the frame of the odometry was integrated as if it were that of the robot |
| -a | any | the positions are mirrored: y to the right, or x and y exchanged |
| 1 | any | the positions were integrated with a heading in another unit (a is not 1) |

The length of each step remains, and its direction becomes the heading. A robot that can drive sideways may have any course, so
that the scans must confirm this; they also decide whether it drives ahead or backwards.

Quaternions that do not have half the heading, but all of it (z = sin(yaw), w = cos(yaw)) or a quarter, make a heading that
turns twice, or half, as fast as the scans. So does one of wheels with a wrong base, but these integrate their positions with the
heading that they state. Here the course fits the heading times the factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from logs.motion import Motion
from logs.transforms import compose, distances_along, invert
from logs.usability import MIN_STEP
from sensorgraph.localization.settings import N_REWEIGHTED
from sensorgraph.types import Floats

HALF = 0.5
"""Factor from the heading of quaternions with the whole heading to the true one, which is then known up to a half turn."""
QUATERNIONS = {
    HALF: "quaternions with the whole heading",
    1.0 / HALF: "quaternions with a quarter of the heading",
}
"""Factor to the true heading -> what has been read."""
MIN_MOVING = 5
"""Minimum number of steps by the scans that are longer than `MIN_STEP` [m, rad], for a comparison step by step. The course is
compared over steps of this length, well above the resolution of an odometry."""
MIN_ALIGNED = 0.9
"""Mean resultant length of the differences of course and heading, doubled, from which the robot drives along its heading times
a factor: 1 for equal angles, 0 for random ones (Mardia and Jupp 2000) ..."""
SOUND = 0.98
"""... and its part in phase from which the odometry is sound: a scatter, or a constant difference, of up to 0.1 rad, as of a mount
or of slip."""
MIN_BETTER = 0.5
"""Share of the differences between scans and odometry that a correction leaves at most."""

MAX_RATIO = 3.0
"""Maximum ratio of such a step between odometry and scans, and its inverse."""
MIN_ERROR = 0.02
"""Error of a step, relative to its length, below which it counts fully."""
MAX_UNEXPLAINED = 0.6
"""Maximum error of a step, relative to its length, for a comparison of directions."""
LEVER = 0.3
"""[m] Standard deviation of the distance of a laser of unknown mount from the robot's centre."""


def course_steps(poses: Floats, least: float = MIN_STEP) -> tuple[Floats, Floats]:
    """Return steps (m, 2) [m] of a length `least` or more, and the mean heading (m,) [rad] during each.

    Parameters
    ----------
    poses : (n, 3) [m, m, rad] Odometry, its heading without jumps of a full turn.
    least : [m] 0: from one pose to the next.
    """
    chosen = poses
    if least > 0:
        way = distances_along(poses)
        chosen = poses[np.unique(np.searchsorted(way, np.arange(0.0, way[-1], least)))]
    return np.diff(chosen[:, :2], axis=0), (chosen[1:, 2] + chosen[:-1, 2]) / 2.0


def alignment(poses: Floats, factor: float, least: float = MIN_STEP) -> complex:
    """Return the mean of exp(2i (course - factor * heading)), weighted by length; 1 for a robot that hardly moves.

    Its length is 1 if the course fits the heading up to a constant, and its angle is twice this constant.
    """
    steps, heading = course_steps(poses, least)
    length = np.hypot(*steps.T)
    if length.sum() < MIN_STEP:
        return 1.0 + 0.0j
    off = np.arctan2(steps[:, 1], steps[:, 0]) - factor * heading
    return complex((length * np.exp(2j * off)).sum() / length.sum())


def with_course(motion: Motion, turn_factor: float, stamps: Floats, seen: Floats) -> Motion | None:
    """Return odometry that moves along its heading; None if it does already, or if the scans deny it.

    Parameters
    ----------
    turn_factor : Factor from the stated heading to the true one, which remains for the caller to apply.
    stamps, seen : (m + 1,) [s], (m, 3) [m, m, rad] Steps by the scans alone: ahead, left and turn.
    """
    fits = {s: _best_alignment(motion.poses, s) for s in (turn_factor, 2.0 * turn_factor, -turn_factor, 1.0)}
    best = max(fits, key=lambda s: abs(fits[s]))
    is_sound = fits[turn_factor].real > SOUND and turn_factor != HALF
    if is_sound or abs(fits[best]) < MIN_ALIGNED:
        return None
    offset = float(np.angle(fits[best])) / 2.0
    ways = [_moved_along(motion.poses, best, turn_factor, one) for one in (offset, offset + np.pi)]
    found = min(
        (replace(motion, poses=poses) for poses in ways),
        key=lambda one: _misfit(one, turn_factor, stamps, seen),
    )
    least = MIN_BETTER * _misfit(motion, turn_factor, stamps, seen)
    return found if _misfit(found, turn_factor, stamps, seen) < least else None


def turn_units(poses: Floats, units: Mapping[float, str]) -> dict[float, str]:
    """Return units of a heading, with those of wrong quaternions that explain the course of poses (n, 3) and 1 does not."""
    is_along = abs(alignment(poses, 1.0)) > MIN_ALIGNED
    wrong = {f: name for f, name in QUATERNIONS.items() if abs(alignment(poses, f)) > MIN_ALIGNED}
    return {**units, **({} if is_along else wrong)}


def _best_alignment(poses: Floats, factor: float) -> complex:
    """Return the alignment of steps between poses or of longer ones: whichever fits better, as coarse positions need these."""
    return max((alignment(poses, factor, least) for least in (0.0, MIN_STEP)), key=abs)


def _moved_along(poses: Floats, factor: float, turn_factor: float, offset: float) -> Floats:
    """Return poses (n, 3) whose steps go along the heading times `turn_factor`; they go along `factor` times it + `offset`."""
    steps, heading = course_steps(poses, 0.0)
    way = (steps[:, 0] + 1j * steps[:, 1]) * np.exp(-1j * (factor * heading + offset))
    places = np.concatenate([[0.0], np.cumsum(way * np.exp(1j * turn_factor * heading))])
    return np.column_stack([places.real, places.imag, poses[:, 2]])


def _misfit(motion: Motion, turn_factor: float, stamps: Floats, seen: Floats) -> float:
    """Return the mean difference of the directions by odometry and scans, as the chord of unit vectors; 0 if unknown."""
    poses = motion.at(stamps) * [1.0, 1.0, turn_factor]
    driven = compose(invert(poses[:-1]), poses[1:])
    a, b = (steps[:, 0] + 1j * steps[:, 1] for steps in (seen, driven))
    use = (np.abs(a) > MIN_STEP) & (np.abs(b) > 0)
    if use.sum() < MIN_MOVING:
        return 0.0
    return float(np.abs(a[use] / np.abs(a[use]) - b[use] / np.abs(b[use])).mean())


def direction_of(seen: Floats, driven: Floats) -> tuple[float, float] | None:
    """Return the angle [rad] from the odometry's motion (n, 3) to that of the scans, and its standard error.

    The robot moves by b and turns by θ; its laser, at l with the yaw ψ, moves by a, all in complex numbers:

        a = e^(-iψ) (b + (e^(iθ) - 1) l)

    This is linear in e^(-iψ) and in e^(-iψ) l. The latter has the prior `LEVER`. Errors are relative to the step.
    None if too few steps move, or if one motion does not explain the other.
    """
    a, b = (steps[:, 0] + 1j * steps[:, 1] for steps in (seen, driven))
    use = (np.abs(a) > MIN_STEP) & (np.abs(b) > 0)
    if use.any():
        ratio = np.log(np.abs(b[use]) / np.abs(a[use]))
        use[use] = np.abs(ratio - np.median(ratio)) < np.log(MAX_RATIO)  # no jumps of the odometry
    if use.sum() < MIN_MOVING:
        return None
    length = np.abs(a[use])
    rows = np.column_stack([b[use], np.exp(1j * driven[use, 2]) - 1.0]) / length[:, None]
    prior, wanted = np.array([[0.0, MIN_ERROR / LEVER]]), a[use] / length
    size = np.full(len(rows), MIN_ERROR)
    for _ in range(N_REWEIGHTED):  # least absolute deviations
        scale = np.sqrt(MIN_ERROR / np.maximum(size, MIN_ERROR))
        design = np.vstack([rows * scale[:, None], prior])
        found = np.linalg.lstsq(design, np.append(wanted * scale, 0.0))[0]
        size = np.abs(wanted - rows @ found)
    sigma = max(float(np.median(size)) / 1.177, MIN_ERROR)  # per component, by Rayleigh's distribution
    if sigma > MAX_UNEXPLAINED:
        return None
    variance = sigma**2 * np.linalg.pinv(design.conj().T @ design).real[0, 0]
    return float(np.angle(found[0])), float(np.sqrt(variance) / max(abs(found[0]), 1e-9))
