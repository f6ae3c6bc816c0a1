"""Planar poses as arrays: compose, invert, interpolate; convert to and from translations with quaternions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from logs.types import Floats

Stamps = NDArray[np.int64]
NORM_ERROR = 0.1
"""Largest relative error of the norm of a quaternion that is rounding, as of two decimals."""
MAX_WRONG_NORMS = 0.1
"""Share of quaternions with a wrong norm above which no quaternion of a signal is an orientation."""


def wrap(angle: Floats) -> Floats:
    """Wrap angles [rad] into (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)


def compose(T_a_b: Floats, T_b_c: Floats) -> Floats:
    """Return T_a_c = T_a_b T_b_c of planar poses (..., 3) [m, m, rad]."""
    if T_a_b.ndim == T_b_c.ndim == 1:  # ten times as fast as arrays of one element
        (x, y, phi), (dx, dy, dphi) = T_a_b.tolist(), T_b_c.tolist()
        c, s = _cos_sin(phi)
        return np.array(
            [x + c * dx - s * dy, y + s * dx + c * dy, math.pi - (math.pi - phi - dphi) % math.tau]
        )
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = T_a_b[..., 0] + cos * T_b_c[..., 0] - sin * T_b_c[..., 1]
    y = T_a_b[..., 1] + sin * T_b_c[..., 0] + cos * T_b_c[..., 1]
    return np.stack([x, y, wrap(T_a_b[..., 2] + T_b_c[..., 2])], axis=-1)


def invert(T_a_b: Floats) -> Floats:
    """Return T_b_a = T_a_b⁻¹ of planar poses (..., 3) [m, m, rad]."""
    if T_a_b.ndim == 1:
        x, y, phi = T_a_b.tolist()
        c, s = _cos_sin(phi)
        return np.array([-c * x - s * y, s * x - c * y, math.pi - (math.pi + phi) % math.tau])
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = -cos * T_a_b[..., 0] - sin * T_a_b[..., 1]
    y = sin * T_a_b[..., 0] - cos * T_a_b[..., 1]
    return np.stack([x, y, wrap(-T_a_b[..., 2])], axis=-1)


def difference(poses: Floats, others: Floats) -> Floats:
    """Return poses - others (..., 3) [m, m, rad], with headings in (-pi, pi]."""
    off = poses - others
    off[..., 2] = wrap(off[..., 2])
    return off


def distances_along(poses: Floats) -> Floats:
    """Return the distance (n,) [m] from the first of poses (n, 2) or (n, 3) to each, on straight lines between them."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])


def _cos_sin(phi: float) -> tuple[float, float]:
    return (math.cos(phi), math.sin(phi)) if math.isfinite(phi) else (math.nan, math.nan)


def interpolate(at: Floats, stamps: Floats, poses: Floats) -> Floats:
    """Interpolate planar poses (n, 3) linearly at the times `at` (m,).

    Times outside the stamps give the first or last pose. Headings take the shorter rotation.
    """
    columns = (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))
    out = np.stack([np.interp(at, stamps, column) for column in columns], axis=-1)  # (m, 3)
    out[:, 2] = wrap(out[:, 2])
    return out


def twists_of(stamps: Floats, poses: Floats) -> Floats:
    """Return body velocities (v, omega) (n, 2) by central differences, for odometry without a twist."""
    if len(stamps) < 3 or np.ptp(stamps) == 0:
        return np.zeros((len(stamps), 2))
    left, right = (
        np.clip(np.arange(len(stamps)) - 1, 0, None),
        np.clip(np.arange(len(stamps)) + 1, None, len(stamps) - 1),
    )
    step = stamps[right] - stamps[left]
    moved = compose(invert(poses[left]), poses[right]) / np.where(step > 0, step, np.inf)[:, None]
    return moved[:, [0, 2]]


def to_translation_quaternion(poses: Floats, z: float = 0.0) -> Floats:
    """Return x, y, z, qx, qy, qz, qw (n, 7) of planar poses (n, 3)."""
    out = np.zeros((len(poses), 7))
    out[:, :2] = poses[:, :2]
    out[:, 2] = z
    out[:, 5], out[:, 6] = np.sin(poses[:, 2] / 2), np.cos(poses[:, 2] / 2)
    return out


def are_oriented(quaternions: Floats) -> NDArray[np.bool_]:
    """Return whether each quaternion (n, 4) is an orientation.

    One that is not finite counts, because it is dropped later. The quaternion 0 0 0 0 does not count. Quaternions of
    equal norm are only scaled. Otherwise, those with a norm far from 1 do not count, and if there are many, no quaternion
    does: a driver that puts the yaw into z writes such quaternions.
    """
    norms = np.linalg.norm(quaternions, axis=1)
    absent = norms == 0
    there = norms[(norms > 0) & np.isfinite(norms)]
    is_scaled = len(there) > 0 and bool((np.abs(there / np.median(there) - 1) < NORM_ERROR).all())
    wrong = (np.abs(norms - 1) > NORM_ERROR) & ~absent & (not is_scaled)
    if wrong.sum() > MAX_WRONG_NORMS * len(wrong):
        wrong[:] = True
    return np.asarray(~(absent | wrong))


def to_planar(transforms: Floats) -> Floats:
    """Return x, y and the yaw of the x axis (n, 3) from translations with quaternions (n, 7)."""
    x, y, z, w = transforms[:, 3:].T
    yaw = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return np.column_stack([transforms[:, :2], yaw])


def dead_reckoning(stamps: Floats, twists: Floats) -> Floats:
    """Integrate twists (n, 3) [m/s, m/s, rad/s], ahead, left and turn, from the origin to poses (n, 3).

    A step has the mean of the twists at its ends. It is an arc with chord (v_x + i v_y) dt sinc(omega dt / 2) in the
    direction phi + omega dt / 2, which is exact for a constant twist.
    """
    steps = np.diff(stamps)
    mean = 0.5 * (twists[:-1] + twists[1:])
    turn = mean[:, 2] * steps
    phi = np.concatenate([[0.0], np.cumsum(turn)])
    chord = (mean[:, 0] + 1j * mean[:, 1]) * steps * np.sinc(turn / (2 * np.pi))
    place = np.concatenate([[0.0], np.cumsum(chord * np.exp(1j * (phi[:-1] + turn / 2)))])
    return np.column_stack([place.real, place.imag, wrap(phi)])
