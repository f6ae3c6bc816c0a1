"""Planar poses and ROS transform trees as arrays; knows no file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from logs.types import Floats

Stamps = NDArray[np.int64]

HOLD_NS = 1_000_000_000  # a slow correction such as map -> odom is held this long past its last sample


def wrap(angle: Floats) -> Floats:
    """Wrap angles [rad] into (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)


def compose(T_a_b: Floats, T_b_c: Floats) -> Floats:
    """Return T_a_c of planar poses (..., 3) [m, m, rad]."""
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = T_a_b[..., 0] + cos * T_b_c[..., 0] - sin * T_b_c[..., 1]
    y = T_a_b[..., 1] + sin * T_b_c[..., 0] + cos * T_b_c[..., 1]
    return np.stack([x, y, wrap(T_a_b[..., 2] + T_b_c[..., 2])], axis=-1)


def invert(T_a_b: Floats) -> Floats:
    """Return T_b_a of planar poses (..., 3) [m, m, rad]."""
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = -cos * T_a_b[..., 0] - sin * T_a_b[..., 1]
    y = sin * T_a_b[..., 0] - cos * T_a_b[..., 1]
    return np.stack([x, y, wrap(-T_a_b[..., 2])], axis=-1)


def interpolate(at: Floats, stamps: Floats, poses: Floats) -> Floats:
    """Interpolate planar poses (n, 3) at the times `at` (m,), the ends held, headings the short way round."""
    columns = (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))
    out = np.stack([np.interp(at, stamps, column) for column in columns], axis=-1)  # (m, 3)
    out[:, 2] = wrap(out[:, 2])
    return out


def twists_of(stamps: Floats, poses: Floats) -> Floats:
    """Return body velocities (v, omega) (n, 2) by central differences, for odometry that does not say them."""
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


def to_planar(transforms: Floats) -> Floats:
    """Return x, y and the yaw of the x axis (n, 3) of translations with quaternions (n, 7)."""
    x, y, z, w = transforms[:, 3:].T
    yaw = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return np.column_stack([transforms[:, :2], yaw])


def to_matrices(transforms: Floats) -> Floats:
    """Return homogeneous matrices (n, 4, 4) of translations with quaternions (n, 7)."""
    x, y, z, w = (transforms[:, 3:] / np.linalg.norm(transforms[:, 3:], axis=1, keepdims=True)).T
    out = np.zeros((len(transforms), 4, 4))
    out[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1)
    out[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1)
    out[:, 2, :3] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    out[:, :3, 3] = transforms[:, :3]
    out[:, 3, 3] = 1.0
    return out


@dataclass(frozen=True)
class Placement:
    """Where a frame is in another, sample by sample."""

    stamps: Stamps
    """(n,) [ns]; one sample at 0 where nothing in the chain moves."""
    poses: Floats
    """(n, 3) [m, m, rad] the x axis seen from above."""
    height: float
    """[m] median z."""
    up: float
    """Median cosine between the z axes: 1 upright, -1 upside down."""
    is_static: bool


@dataclass(frozen=True)
class _Edge:
    parent: str
    stamps: Stamps
    transforms: Floats
    is_static: bool


@dataclass
class TransformTree:
    """The frames of a log and what joins them."""

    edges: dict[str, _Edge] = field(default_factory=dict)
    """Child frame -> its edge."""
    conflicts: list[str] = field(default_factory=list)
    """Frames that have more than one parent; the one with most samples was taken."""

    def add(self, parent: str, child: str, stamps: Stamps, transforms: Floats, *, is_static: bool) -> None:
        """Add the samples (n,) [ns], (n, 7) of one edge."""
        known = self.edges.get(child)
        if known is not None and known.parent != parent:
            self.conflicts.append(f"{child} (under {known.parent} and {parent})")
            if len(known.stamps) >= len(stamps):
                return
        order = np.argsort(stamps, kind="stable")
        self.edges[child] = _Edge(parent, stamps[order], transforms[order], is_static)

    def lines(self) -> list[str]:
        """Say each edge in one line."""
        return [
            f"{edge.parent} -> {child}"
            + (" (static)" if edge.is_static else f" ({len(edge.stamps)} samples)")
            for child, edge in self.edges.items()
        ]

    def has(self, frame: str) -> bool:
        """Tell whether the frame stands in the tree."""
        return frame in self.edges or any(edge.parent == frame for edge in self.edges.values())

    def first_ancestor(self, frame: str, names: Iterable[str]) -> str | None:
        """Return the first of `names` from which `frame` hangs."""
        above = self._above(frame)
        return next((name for name in names if name in above), None)

    def place(self, ancestor: str, frame: str) -> Placement | None:
        """Compose the chain ancestor -> frame, or return None where there is none.

        The chain is sampled where its fastest edge is; slower edges are interpolated, and held for a second
        past their last sample. Edges that move are taken as planar, edges that do not as they are.
        """
        chain: list[_Edge] = []
        above = self._above(frame)
        if ancestor not in above:
            return None
        for child in above[: above.index(ancestor)]:
            chain.insert(0, self.edges[child])
        moving = [edge for edge in chain if not edge.is_static and len(edge.stamps) > 1]
        at = max((edge.stamps for edge in moving), key=len, default=np.zeros(1, dtype=np.int64))
        for edge in moving:
            at = at[(at >= edge.stamps[0]) & (at <= edge.stamps[-1] + HOLD_NS)]
        total = np.broadcast_to(np.eye(4), (len(at), 4, 4))
        for edge in chain:
            total = total @ _sample(edge, at)
        if len(at) == 0:
            return None
        yaw = np.arctan2(total[:, 1, 0], total[:, 0, 0])
        return Placement(
            stamps=at,
            poses=np.column_stack([total[:, :2, 3], yaw]),
            height=float(np.median(total[:, 2, 3])),
            up=float(np.median(total[:, 2, 2])),
            is_static=not moving,
        )

    def _above(self, frame: str) -> list[str]:
        """Return the frame and those it hangs from, nearest first."""
        above = [frame]
        while above[-1] in self.edges and self.edges[above[-1]].parent not in above:
            above.append(self.edges[above[-1]].parent)
        return above


def _sample(edge: _Edge, at: Stamps) -> Floats:
    """Return matrices (n, 4, 4) of an edge at the times (n,)."""
    if edge.is_static or len(edge.stamps) == 1:
        return to_matrices(edge.transforms[-1:])
    start = edge.stamps[0]
    stamps, when = (edge.stamps - start).astype(np.float64), (at - start).astype(np.float64)
    planar = interpolate(when, stamps, to_planar(edge.transforms))
    return to_matrices(to_translation_quaternion(planar, float(np.median(edge.transforms[:, 2]))))
