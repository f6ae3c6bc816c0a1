"""Key frames: the scans from which cells are made, kept with the model so that later runs can be added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from logs.transforms import compose
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.stored_numbers import check_shape
from sensorgraph.types import Bools, Floats, Ints

STEP = 1e-6
"""[m, rad] Resolution of stored ranges and of the motion during a scan; ranges up to 4 km fit into 32 bits."""
TOO_CLOSE, NO_RETURN, BROKEN = 0, 0xFFFFFFFF, 0xFFFFFFFE
"""Codes of stored ranges."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KeyFrames:
    """Scans far enough apart that their counts are independent, rounded as they are stored."""

    poses: Floats
    """(n, 3) [m, m, rad] poses of the laser in map, or (n, n_rays, 3) for a sweep."""
    ranges: Floats
    """(n, n_rays) [m]; +inf: no return, -inf: too close, nan: broken."""
    n_scans: int
    """Number of scans that they represent."""

    @classmethod
    def of(cls, scans: TrainingScans) -> Self:
        """Select the key frames of training scans."""
        keep = is_key_frame(scans.poses, scans.run)
        own_poses = scans.poses if scans.ray_poses is None else scans.ray_poses
        frames = cls(
            poses=compose(own_poses[keep], scans.laser_mount),
            ranges=scans.ranges[keep],
            n_scans=len(scans),
        )
        return cls.restore(*frames.state())

    def joined(self, more: KeyFrames) -> KeyFrames:
        """Return these key frames, followed by those of later runs."""
        mine, theirs = self.poses, more.poses
        if mine.ndim != theirs.ndim:  # only one of the lasers swept
            shape = (-1, self.ranges.shape[1], 3)
            mine, theirs = (
                np.broadcast_to(p.reshape(len(p), -1, 3), (len(p), *shape[1:])) for p in (mine, theirs)
            )
        return KeyFrames(
            poses=np.concatenate([mine, theirs]),
            ranges=np.concatenate([self.ranges, more.ranges]),
            n_scans=self.n_scans + more.n_scans,
        )

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays: poses of scans, integers of `STEP` for the motion during a scan and for ranges."""
        codes = np.full(self.ranges.shape, BROKEN, dtype=np.uint32)
        valid = np.isfinite(self.ranges)
        codes[valid] = np.clip(np.rint(self.ranges[valid] / STEP), 1, BROKEN - 1)
        codes[np.isposinf(self.ranges)], codes[np.isneginf(self.ranges)] = NO_RETURN, TOO_CLOSE
        arrays: dict[str, NDArray[Any]] = {"ranges": codes, "poses": self.poses}
        if self.poses.ndim == 3:
            arrays["poses"] = self.poses[:, 0]
            moved = np.rint((self.poses - self.poses[:, :1]) / STEP).astype(np.int32)
            arrays["motion"] = np.diff(moved, axis=1, prepend=0)  # from ray to ray: small numbers
        return {"n_scans": self.n_scans}, arrays

    @classmethod
    def restore(cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Recreate the key frames from the output of `state`.

        Raises
        ------
        ValueError : An array has a wrong shape.
        """
        codes, poses = arrays["ranges"], arrays["poses"]
        check_shape("ranges", codes, (len(codes), *codes.shape[1:2]), "u")
        check_shape("poses", poses, (len(codes), 3), "f")
        ranges = STEP * codes.astype(np.float64)
        for code, value in ((TOO_CLOSE, -np.inf), (NO_RETURN, np.inf), (BROKEN, np.nan)):
            ranges[codes == code] = value
        if "motion" in arrays:
            check_shape("motion", arrays["motion"], (*codes.shape, 3), "i")
            poses = poses[:, None] + STEP * np.cumsum(arrays["motion"], axis=1)
        return cls(poses=poses, ranges=ranges, n_scans=int(header["n_scans"]))


def is_key_frame(poses: Floats, run: Ints) -> Bools:
    """Return a mask of key frames: the first scan of each run, and each scan far enough from the last key frame."""
    keep = np.zeros(len(poses), dtype=np.bool_)
    last = -1
    for i, (x, y, phi) in enumerate(poses.tolist()):
        if last >= 0 and run[i] == run[last]:
            x0, y0, phi0 = poses[last]
            turn = np.pi - abs(np.pi - abs(phi - phi0) % (2 * np.pi))
            if np.hypot(x - x0, y - y0) < CELLS.key_frame_distance and turn < CELLS.key_frame_turn:
                continue
        keep[i] = True
        last = i
    return keep
