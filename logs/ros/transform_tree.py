"""The transform tree of a ROS log, and the pose of one frame in another over time."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from heapq import heappop, heappush

import numpy as np

from logs.signals import SECOND
from logs.transforms import Stamps, interpolate, to_planar, to_translation_quaternion, wrap
from logs.types import Floats

HOLD_NS = SECOND
"""[ns] time for which a slow correction such as map -> odom stays valid after its last sample."""


MIN_MOTION = 1e-3
"""[m, rad] smaller changes of a transform are rounding and noise, not motion."""
MAX_SWAY = (0.05, np.radians(2.0))
"""[m, rad] Larger motion of a laser on its robot makes poses of the robot wrong."""
MAX_SWAYING = 0.1
"""Share of the time above which such motion is no single wrong transform."""
MOVES = "the laser moves on the robot by "
"""Begin of the note on such motion."""


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
    """Whether no edge of the chain was published over time."""

    @property
    def moves(self) -> bool:
        """Return whether the pose changes by more than `MIN_MOTION`."""
        return bool(self.change.max() > MIN_MOTION)

    @property
    def change(self) -> Floats:
        """Return distance [m] and turn [rad] of each pose from the first one (n, 2)."""
        change = self.poses - self.poses[0]
        return np.column_stack([np.hypot(change[:, 0], change[:, 1]), np.abs(wrap(change[:, 2]))])

    @property
    def moving_text(self) -> str:
        """Return the note on a mount that moves; `MOVES` begins it if poses of the robot would often be wrong."""
        way, turn = self.change.max(axis=0)
        often = (np.quantile(self.change, 1.0 - MAX_SWAYING, axis=0) > MAX_SWAY).any()
        begin = MOVES if often else "the laser moves on the robot, a little or rarely, by "
        return f"{begin}up to {way:.2f} m and {np.degrees(turn):.0f}°: its first mount was used"


@dataclass(frozen=True)
class Edge:
    """The samples of the transform from a frame to its child."""

    parent: str
    child: str
    stamps: Stamps
    """(n,) [ns]"""
    transforms: Floats
    """(n, 7) translation and quaternion of the child in the parent"""
    is_static: bool
    logged: Stamps
    """(n,) [ns] log times"""
    n_repeated: int = 0
    """Number of samples that were there twice and were dropped."""

    @property
    def is_sampled(self) -> bool:
        """Return whether the transform was published over time."""
        return not self.is_static and len(self.stamps) > 1

    @cached_property
    def is_constant(self) -> bool:
        """Return whether all samples are equal."""
        return not self.is_sampled or float(np.ptp(self.transforms, axis=0).max()) == 0.0


@dataclass
class TransformTree:
    """The frames of a log and the transforms between them."""

    edges: dict[tuple[str, str], Edge] = field(default_factory=dict)
    """(parent, child) -> the transform; a child with two parents has two edges."""
    notes: list[str] = field(default_factory=list)
    """Notes on transforms that were left out."""

    def add(
        self,
        parent: str,
        child: str,
        stamps: Stamps,
        transforms: Floats,
        *,
        is_static: bool,
        logged: Stamps | None = None,
    ) -> None:
        """Add the samples (n,) [ns], (n, 7) of one edge; equal samples with equal stamps count once."""
        logged = stamps if logged is None else logged
        known = self.edges.get((parent, child))
        if known is not None:
            stamps = np.concatenate([known.stamps, stamps])
            transforms = np.concatenate([known.transforms, transforms])
            logged = np.concatenate([known.logged, logged])
            is_static = is_static and known.is_static
        order = np.argsort(stamps, kind="stable")
        is_same = (np.diff(stamps[order]) == 0) & (np.diff(transforms[order], axis=0) == 0).all(axis=1)
        kept = np.sort(order[np.insert(~is_same, 0, True)])  # in the order of the log
        self.edges[parent, child] = Edge(
            parent, child, stamps[kept], transforms[kept], is_static, logged[kept],
            len(stamps) - len(kept) + (known.n_repeated if known is not None else 0),
        )  # fmt: skip

    @property
    def conflicts(self) -> list[str]:
        """Return the frames with several parents, as text."""
        parents: dict[str, list[str]] = {}
        for parent, child in self.edges:
            parents.setdefault(child, []).append(parent)
        return [
            f"{child} (under {' and '.join(names)})" for child, names in parents.items() if len(names) > 1
        ]

    @property
    def faults(self) -> list[str]:
        """Return notes on transforms that were left out, static ones with several values, and frames with two parents."""
        restated = [
            f"static transform {edge.parent} -> {edge.child} has {n} different values: the last one was used"
            for edge in self.edges.values()
            if edge.is_static and (n := len(np.unique(edge.transforms.round(6), axis=0))) > 1
        ]
        parents = [f"frames with two parents: {', '.join(self.conflicts)}"] if self.conflicts else []
        return [*self.notes, *restated, *parents]

    @property
    def frames(self) -> list[str]:
        """Return the names of all frames, in the order of the log."""
        return list(dict.fromkeys(frame for key in self.edges for frame in key))

    def lines(self) -> list[str]:
        """Describe each edge in one line."""
        return [
            f"{edge.parent} -> {edge.child}"
            + (" (static)" if edge.is_static else f" ({len(edge.stamps):,} samples")
            + ("" if edge.is_static else f", {edge.n_repeated} repeated)" if edge.n_repeated else ")")
            for edge in self.edges.values()
        ]

    def in_namespace_of(self, frame: str, name: str) -> str:
        """Return a standard frame name in the namespace of `frame`, if the tree contains it.

        For example, base_link for amr7/laser gives amr7/base_link.
        """
        frames, space = set(self.frames), frame
        while "/" in space:
            space = space.rpartition("/")[0]
            if f"{space}/{name}" in frames:
                return f"{space}/{name}"
        return name

    def path(self, frame: str, other: str) -> list[tuple[Edge, bool]] | None:
        """Return the edges from one frame to another, each with whether it is passed against its direction.

        Of several paths, the one with the fewest edges upwards is used, so that an ancestor is connected by its own
        chain. None: the frames are not connected.
        """
        near: dict[str, list[tuple[str, Edge, bool]]] = {}
        for edge in self.edges.values():
            near.setdefault(edge.parent, []).append((edge.child, edge, False))
            near.setdefault(edge.child, []).append((edge.parent, edge, True))
        done: set[str] = set()
        queue: list[tuple[int, int, int, str, list[tuple[Edge, bool]]]] = [(0, 0, 0, frame, [])]
        n_queued = 0
        while queue:
            up, length, _, here, chain = heappop(queue)
            if here == other:
                return chain
            if here in done:
                continue
            done.add(here)
            for there, edge, is_inverse in near.get(here, ()):
                n_queued += 1
                step = (up + is_inverse, length + 1, n_queued, there, [*chain, (edge, is_inverse)])
                heappush(queue, step)
        return None

    def is_ancestor(self, frame: str, other: str) -> bool:
        """Return whether a frame is another one, or above it."""
        chain = self.path(frame, other)
        return frame == other or (chain is not None and not any(is_inverse for _, is_inverse in chain))

    def place(self, frame: str, other: str) -> RelativePose | None:
        """Return the pose of another frame in `frame`; None if they are not connected, or never at the same time.

        The chain is sampled at the stamps of its fastest edge. Slower edges are interpolated, and held for one second
        after their last sample. Moving edges are treated as planar, constant edges are used as they are.
        """
        chain = self.path(frame, other)
        if chain is None or not chain:
            return None
        sampled = [edge for edge, _ in chain if edge.is_sampled]
        moving = [edge for edge in sampled if not edge.is_constant]
        fastest = max(moving or sampled, key=lambda edge: len(edge.stamps), default=None)
        at = np.zeros(1, dtype=np.int64) if fastest is None else np.unique(fastest.stamps)
        for edge in moving:
            at = at[(at >= edge.stamps.min()) & (at <= edge.stamps.max() + HOLD_NS)]
        if len(at) == 0:
            return None
        total = np.broadcast_to(np.eye(4), (len(at), 4, 4))
        for edge, is_inverse in chain:
            sample = _sample(edge, at)
            total = total @ (np.linalg.inv(sample) if is_inverse else sample)
        yaw = np.arctan2(total[:, 1, 0], total[:, 0, 0])
        return RelativePose(
            stamps=at,
            poses=np.column_stack([total[:, :2, 3], yaw]),
            height=float(np.median(total[:, 2, 3])),
            up=float(np.median(total[:, 2, 2])),
            is_static=not sampled,
        )


def _sample(edge: Edge, at: Stamps) -> Floats:
    """Return the matrices (n, 4, 4) of an edge at the times (n,)."""
    if edge.is_constant:
        return to_matrices(edge.transforms[-1:])
    order = np.argsort(edge.stamps, kind="stable")
    order = order[np.append(np.diff(edge.stamps[order]) > 0, True)]  # of several with one stamp, the last
    stamps, transforms = edge.stamps[order], edge.transforms[order]
    when, since = (at - stamps[0]).astype(np.float64), (stamps - stamps[0]).astype(np.float64)
    planar = interpolate(when, since, to_planar(transforms))
    return to_matrices(to_translation_quaternion(planar, float(np.median(transforms[:, 2]))))
