"""The transform tree of a ROS log, and the pose of one frame in another over time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from logs.transforms import Stamps, interpolate, to_planar, to_translation_quaternion
from logs.types import Floats

HOLD_NS = 1_000_000_000
"""[ns] time for which a slow correction such as map -> odom stays valid after its last sample."""


def to_matrices(transforms: Floats) -> Floats:
    """Convert translations with quaternions (n, 7) to homogeneous matrices (n, 4, 4)."""
    x, y, z, w = (transforms[:, 3:] / np.linalg.norm(transforms[:, 3:], axis=1, keepdims=True)).T
    out = np.zeros((len(transforms), 4, 4))
    out[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1)
    out[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1)
    out[:, 2, :3] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    out[:, :3, 3] = transforms[:, :3]
    out[:, 3, 3] = 1.0
    return out


@dataclass(frozen=True)
class RelativePose:
    """The pose of one frame in another, sample by sample."""

    stamps: Stamps
    """(n,) [ns]; one sample at 0 if the chain is static."""
    poses: Floats
    """(n, 3) [m, m, rad] planar pose; the heading is that of the x axis projected on the floor."""
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
    """The frames of a log and the transforms between them."""

    edges: dict[str, _Edge] = field(default_factory=dict)
    """Child frame -> its edge."""
    conflicts: list[str] = field(default_factory=list)
    """Frames with more than one parent; the parent with the most samples is used."""

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
        """Describe each edge in one line."""
        return [
            f"{edge.parent} -> {child}"
            + (" (static)" if edge.is_static else f" ({len(edge.stamps)} samples)")
            for child, edge in self.edges.items()
        ]

    def has(self, frame: str) -> bool:
        """Return whether the frame is in the tree."""
        return frame in self.edges or any(edge.parent == frame for edge in self.edges.values())

    def in_namespace_of(self, frame: str, name: str) -> str:
        """Return a standard frame name in the namespace of `frame`, if the tree contains it.

        For example, base_link for amr7/laser gives amr7/base_link.
        """
        space = frame
        while "/" in space:
            space = space.rpartition("/")[0]
            if self.has(f"{space}/{name}"):
                return f"{space}/{name}"
        return name

    def first_ancestor(self, frame: str, names: Iterable[str]) -> str | None:
        """Return the first of `names` that is an ancestor of `frame`, or None."""
        above = self._above(frame)
        return next((name for name in names if name in above), None)

    def place(self, ancestor: str, frame: str) -> RelativePose | None:
        """Compose the chain ancestor -> frame; return None if the frames are not connected.

        The chain is sampled at the stamps of its fastest edge. Slower edges are interpolated, and held for one second
        after their last sample. Moving edges are treated as planar, static edges are used as they are.
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
        return RelativePose(
            stamps=at,
            poses=np.column_stack([total[:, :2, 3], yaw]),
            height=float(np.median(total[:, 2, 3])),
            up=float(np.median(total[:, 2, 2])),
            is_static=not moving,
        )

    def _above(self, frame: str) -> list[str]:
        """Return the frame and its ancestors, nearest first."""
        above = [frame]
        while above[-1] in self.edges and self.edges[above[-1]].parent not in above:
            above.append(self.edges[above[-1]].parent)
        return above


def _sample(edge: _Edge, at: Stamps) -> Floats:
    """Return the matrices (n, 4, 4) of an edge at the times (n,)."""
    if edge.is_static or len(edge.stamps) == 1:
        return to_matrices(edge.transforms[-1:])
    start = edge.stamps[0]
    stamps, when = (edge.stamps - start).astype(np.float64), (at - start).astype(np.float64)
    planar = interpolate(when, stamps, to_planar(edge.transforms))
    return to_matrices(to_translation_quaternion(planar, float(np.median(edge.transforms[:, 2]))))
