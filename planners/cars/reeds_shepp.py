"""Quickest path of a car between two poses without obstacles: compiled words of Reeds and Shepp, and of Dubins.

A word is a chain of up to five arcs of minimum radius and straight pieces, with signed lengths word[k] in
radii. Of all words between two poses, the result has the least cost:

    cost = radius Σ |word[k]| + gear_change_cost (number of gear changes).

(OMPL's `ReedsSheppStateSpace` minimises the length alone.)

Sources: J. A. Reeds and L. A. Shepp, Optimal paths for a car that goes both forwards and backwards, Pacific
J. Math. 145 (1990), section 8; L. E. Dubins, On curves of minimal length ..., Am. J. Math. 79 (1957), in the
closed forms of A. M. Shkel and V. Lumelsky, Classification of the Dubins set, Robotics and Autonomous Systems
34 (2001).
"""

from __future__ import annotations

from math import tau
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel, kernel, outer_kernel
from planners.types import ROUND_OFF, Floats, Ints

Pose = tuple[float, float, float]
"""[m, m, rad]"""
FAMILY_BENDS = np.array(
    [
        [1, 0, 1, 0, 0],
        [1, 0, -1, 0, 0],
        [1, -1, 1, 0, 0],
        [1, -1, 1, -1, 0],
        [1, -1, 1, -1, 0],
        [1, -1, 0, 1, 0],
        [1, -1, 0, -1, 0],
        [1, -1, 0, 1, -1],
    ]
)
"""(N_FAMILIES, MAX_ARCS) 1 steers left, -1 right."""
N_FAMILIES, MAX_ARCS = FAMILY_BENDS.shape
"""Number of word families of Reeds and Shepp, without mirror images, and of arcs of the longest word."""
HAS_REVERSED_FORM = np.array([False, False, True, False, False, True, True, False])
"""(N_FAMILIES,) families whose reversed words belong to another family."""
DUBINS_BENDS = np.array([[1, 0, 1], [-1, 0, -1], [1, 0, -1], [-1, 0, 1], [-1, 1, -1], [1, -1, 1]])
"""(6, 3) 1 steers left, -1 right."""


class Arcs(NamedTuple):
    """A chain of arcs, or memory for one."""

    length: Floats
    """(most,) [m]"""
    bend: Ints
    """(most,) 1 counter-clockwise, 0 straight, -1 clockwise."""
    gear: Ints
    """(most,) 1 forward, -1 backward."""


def take_arcs(arcs: Arcs, which: slice | NDArray[np.generic]) -> Arcs:
    """Return a copy of some of the arcs."""
    return Arcs(arcs.length[which].copy(), arcs.bend[which].copy(), arcs.gear[which].copy())


def concatenate_arcs(parts: list[Arcs]) -> Arcs:
    """Join chains of arcs."""
    lengths, bends, gears = zip(*parts, strict=True)
    return Arcs(np.concatenate(lengths), np.concatenate(bends), np.concatenate(gears))


@kernel
def empty_arcs(most: int) -> Arcs:
    """Return memory for `most` arcs."""
    return Arcs(np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64))


@outer_kernel
def arc_end(pose: Pose, length: float, bend: int, gear: int, radius: float) -> Pose:
    """Return the pose at the end of an arc; headings are continuous (not wrapped)."""
    x, y, phi = pose
    if bend == 0:
        return x + gear * length * np.cos(phi), y + gear * length * np.sin(phi), phi
    heading = phi + bend * length / radius
    side = gear * bend * radius
    x, y = x + side * (np.sin(heading) - np.sin(phi)), y - side * (np.cos(heading) - np.cos(phi))
    return x, y, heading


@outer_kernel
def quickest_word(
    start: Pose,
    goal: Pose,
    radius: float,
    gear_before: int,
    gear_after: int,
    gear_change_cost: float,
    can_reverse: bool,
    shortest: float,
    first_entry: int,
    word: Floats,
    out: Arcs,
) -> int:
    """Write the quickest word to `out` from entry `first_entry`; return its number of arcs, -1: none.

    Parameters
    ----------
    gear_before, gear_after : Gears before and after the word; 0: any.
    gear_change_cost : [m] Cost of a gear change.
    can_reverse : Whether the car has a reverse gear.
    shortest : [m] Minimum length of an arc; arcs of zero length are left out.
    word : (MAX_ARCS,) Work memory.
    """
    dx, dy = goal[0] - start[0], goal[1] - start[1]
    cos, sin = np.cos(start[2]), np.sin(start[2])
    x, y = (cos * dx + sin * dy) / radius, (cos * dy - sin * dx) / radius
    phi = _wrap(goal[2] - start[2])
    if can_reverse:
        return _reeds_shepp(
            x, y, phi, radius, gear_before, gear_after, gear_change_cost, shortest, first_entry, word, out
        )
    return _dubins(x, y, phi, radius, shortest, first_entry, word, out)


@inner_kernel
def _wrap(angle: float) -> float:
    """Return an angle in (-pi, pi]."""
    angle = angle % tau
    return angle - tau if angle > np.pi else angle


@inner_kernel
def _reeds_shepp(
    x: float,
    y: float,
    phi: float,
    radius: float,
    gear_before: int,
    gear_after: int,
    gear_change_cost: float,
    shortest: float,
    first_entry: int,
    word: Floats,
    out: Arcs,
) -> int:
    best, n_best = np.inf, -1
    cos, sin = np.cos(phi), np.sin(phi)
    for family in range(N_FAMILIES):
        for is_reversed in range(2 if HAS_REVERSED_FORM[family] else 1):
            u = x * cos + y * sin if is_reversed else x
            v = x * sin - y * cos if is_reversed else y
            for mirror in range(4):
                gears, sides = 1 - 2 * (mirror & 1), 1 - (mirror & 2)
                n = _word(family, gears * u, sides * v, gears * sides * phi, word)
                length = 0.0
                for k in range(n):
                    length += abs(word[k]) * radius
                if n == 0 or length >= best or is_too_short(word, n, radius, shortest):
                    continue
                cost, gear = length, gear_before
                for k in range(n):
                    part = word[n - 1 - k if is_reversed else k] * gears
                    if abs(part) * radius < ROUND_OFF:
                        continue
                    part_gear = 1 if part > 0 else -1
                    cost += gear_change_cost * (gear != 0 and part_gear != gear)
                    gear = part_gear
                cost += gear_change_cost * (gear != 0 and gear_after != 0 and gear != gear_after)
                if cost >= best:
                    continue
                best, n_best = cost, 0
                for k in range(n):
                    at = n - 1 - k if is_reversed else k
                    if abs(word[at]) * radius >= ROUND_OFF:
                        part_gear = 1 if word[at] * gears > 0 else -1
                        out.length[first_entry + n_best] = abs(word[at]) * radius
                        out.gear[first_entry + n_best] = part_gear
                        out.bend[first_entry + n_best] = FAMILY_BENDS[family, at] * sides * part_gear
                        n_best += 1
    return n_best


@inner_kernel
def is_too_short(word: Floats, n: int, radius: float, shortest: float) -> bool:
    """Return whether one of the `n` arcs of a word is shorter than `shortest` [m] but longer than zero."""
    is_short = False
    for k in range(n):
        is_short |= ROUND_OFF <= abs(word[k]) * radius < shortest
    return is_short


@inner_kernel
def _word(family: int, x: float, y: float, phi: float, word: Floats) -> int:
    """Write a family's word to (x, y, phi), as signed lengths [radii]; return their number, 0: no word."""
    if family == 0:
        return _left_straight_left(x, y, phi, word)
    if family == 1:
        return _left_straight_right(x, y, phi, word)
    if family == 2:
        return _three_arcs(x, y, phi, word)
    if family == 3:
        return _four_arcs_outer(x, y, phi, word)
    if family == 4:
        return _four_arcs_inner(x, y, phi, word)
    if family == 5:
        return _quarter_left(x, y, phi, word)
    if family == 6:
        return _quarter_right(x, y, phi, word)
    return _two_quarters(x, y, phi, word)


@inner_kernel
def _left_straight_left(x: float, y: float, phi: float, word: Floats) -> int:
    """L+ S+ L+, (8.1)."""
    dx, dy = x - np.sin(phi), y - 1 + np.cos(phi)
    t = np.arctan2(dy, dx)
    v = _wrap(phi - t)
    if t < 0 or v < 0:
        return 0
    word[0], word[1], word[2] = t, np.hypot(dx, dy), v
    return 3


@inner_kernel
def _left_straight_right(x: float, y: float, phi: float, word: Floats) -> int:
    """L+ S+ R+, (8.2)."""
    dx, dy = x + np.sin(phi), y - 1 - np.cos(phi)
    square = dx * dx + dy * dy
    if square < 4:
        return 0
    u = np.sqrt(square - 4)
    t = _wrap(np.arctan2(dy, dx) + np.arctan2(2.0, u))
    v = _wrap(t - phi)
    if t < 0 or v < 0:
        return 0
    word[0], word[1], word[2] = t, u, v
    return 3


@inner_kernel
def _three_arcs(x: float, y: float, phi: float, word: Floats) -> int:
    """L+ R- L and, reversed, the other words of three arcs, (8.3) and (8.4)."""
    dx, dy = x - np.sin(phi), y - 1 + np.cos(phi)
    far = np.hypot(dx, dy)
    if far > 4:
        return 0
    u = -2 * np.arcsin(0.25 * far)
    t = _wrap(np.arctan2(dy, dx) + 0.5 * u + np.pi)
    if t < 0:
        return 0
    word[0], word[1], word[2] = t, u, _wrap(phi - t + u)
    return 3


@inner_kernel
def _ends_of_four(u: float, v: float, dx: float, dy: float, phi: float) -> tuple[float, float]:
    """Return the first and the last arc of a word of four, (8.6)."""
    delta = _wrap(u - v)
    a, b = np.sin(u) - np.sin(delta), np.cos(u) - np.cos(delta) - 1
    t = np.arctan2(dy * a - dx * b, dx * a + dy * b)
    if 2 * (np.cos(delta) - np.cos(v) - np.cos(u)) + 3 < 0:
        t += np.pi
    t = _wrap(t)
    return t, _wrap(t - u + v - phi)


@inner_kernel
def _four_arcs_outer(x: float, y: float, phi: float, word: Floats) -> int:
    """L+ R(u)+ L(u)- R-, (8.7)."""
    dx, dy = x + np.sin(phi), y - 1 - np.cos(phi)
    share = 0.25 * (2 + np.hypot(dx, dy))
    if share > 1:
        return 0
    u = np.arccos(share)
    t, v = _ends_of_four(u, -u, dx, dy, phi)
    if t < 0 or v > 0:
        return 0
    word[0], word[1], word[2], word[3] = t, u, -u, v
    return 4


@inner_kernel
def _four_arcs_inner(x: float, y: float, phi: float, word: Floats) -> int:
    """L+ R(u)- L(u)- R+, (8.8)."""
    dx, dy = x + np.sin(phi), y - 1 - np.cos(phi)
    share = (20 - dx * dx - dy * dy) / 16
    if share < 0 or share > 1:
        return 0
    u = -np.arccos(share)
    t, v = _ends_of_four(u, u, dx, dy, phi)
    if t < 0 or v < 0:
        return 0
    word[0], word[1], word[2], word[3] = t, u, u, v
    return 4


@inner_kernel
def _quarter_left(x: float, y: float, phi: float, word: Floats) -> int:
    """L+ R(quarter)- S- L-, (8.9)."""
    dx, dy = x - np.sin(phi), y - 1 + np.cos(phi)
    square = dx * dx + dy * dy
    if square < 4:
        return 0
    r = np.sqrt(square - 4)
    t = _wrap(np.arctan2(dy, dx) + np.arctan2(r, -2.0))
    v = _wrap(phi - 0.5 * np.pi - t)
    if t < 0 or r < 2 or v > 0:
        return 0
    word[0], word[1], word[2], word[3] = t, -0.5 * np.pi, 2 - r, v
    return 4


@inner_kernel
def _quarter_right(x: float, y: float, phi: float, word: Floats) -> int:
    """L+ R(quarter)- S- R-, (8.10)."""
    dx, dy = x + np.sin(phi), y - 1 - np.cos(phi)
    far = np.hypot(dx, dy)
    t = np.arctan2(dx, -dy)
    v = _wrap(t + 0.5 * np.pi - phi)
    if far < 2 or t < 0 or v > 0:
        return 0
    word[0], word[1], word[2], word[3] = t, -0.5 * np.pi, 2 - far, v
    return 4


@inner_kernel
def _two_quarters(x: float, y: float, phi: float, word: Floats) -> int:
    """L+ R(quarter)- S- L(quarter)- R+, (8.11)."""
    dx, dy = x + np.sin(phi), y - 1 - np.cos(phi)
    square = dx * dx + dy * dy
    if square < 4:
        return 0
    u = 4 - np.sqrt(square - 4)
    if u > 0:
        return 0
    t = _wrap(np.arctan2((4 - u) * dx - 2 * dy, -2 * dx + (u - 4) * dy))
    v = _wrap(t - phi)
    if t < 0 or v < 0:
        return 0
    word[0], word[1], word[2], word[3], word[4] = t, -0.5 * np.pi, u, -0.5 * np.pi, v
    return 5


@inner_kernel
def _dubins(
    x: float, y: float, phi: float, radius: float, shortest: float, first_entry: int, word: Floats, out: Arcs
) -> int:
    d, theta = np.hypot(x, y), np.arctan2(y, x)
    a, b = (-theta) % tau, (phi - theta) % tau
    best, n_best = np.inf, -1
    for kind in range(len(DUBINS_BENDS)):
        is_word = _with_straight(kind, d, a, b, word) if kind < 4 else _without_straight(kind, d, a, b, word)
        length = (word[0] + word[1] + word[2]) * radius
        if not is_word or length >= best or is_too_short(word, 3, radius, shortest):
            continue
        best, n_best = length, 0
        for k in range(3):
            if word[k] * radius >= ROUND_OFF:
                out.length[first_entry + n_best] = word[k] * radius
                out.gear[first_entry + n_best] = 1
                out.bend[first_entry + n_best] = DUBINS_BENDS[kind, k]
                n_best += 1
    return n_best


@inner_kernel
def _with_straight(kind: int, d: float, a: float, b: float, word: Floats) -> bool:
    """LSL, RSR, LSR and RSL over d radii along the x axis, from heading a to heading b."""
    one, other = DUBINS_BENDS[kind, 0], DUBINS_BENDS[kind, 2]
    dx = d + one * np.sin(a) - other * np.sin(b)
    dy = other * np.cos(b) - one * np.cos(a)
    across = 0.0 if one == other else 2.0
    square = dx * dx + dy * dy - across * across
    if square < 0:
        return False
    p = np.sqrt(square)
    heading = np.arctan2(dy, dx) + one * np.arctan2(across, p)
    word[0], word[1], word[2] = (one * (heading - a)) % tau, p, (other * (b - heading)) % tau
    return True


@inner_kernel
def _without_straight(kind: int, d: float, a: float, b: float, word: Floats) -> bool:
    """RLR and LRL, as `_with_straight`."""
    one = DUBINS_BENDS[kind, 0]
    dx = d + one * (np.sin(a) - np.sin(b))
    dy = one * (np.cos(b) - np.cos(a))
    square = dx * dx + dy * dy
    if square > 16:
        return False
    p = tau - np.arccos(1 - square / 8)
    t = (one * (np.arctan2(dy, dx) - a) + 0.5 * p) % tau
    word[0], word[1], word[2] = t, p, (one * (b - a) - t + p) % tau
    return True
