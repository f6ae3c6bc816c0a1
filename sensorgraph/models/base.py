"""What every model of perception takes and gives: Scans in, Prediction out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, Self, get_args

import numpy as np
from numpy.typing import NDArray

from logs.files import atomic_file
from logs.run import PoseFrame, RangeSensor
from sensorgraph.types import Bools, Floats, Ints, Progress

Point = Literal["mode", "median", "mean"]
POINTS: tuple[str, ...] = get_args(Point)
OFF_DISTANCE = 0.05
"""[m] farther from the measured range than this, a prediction shows another surface: it is wrong."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingScans:
    """Scans with poses, from one or several runs, in the order of the log."""

    sensor: RangeSensor
    poses: Floats
    """(n_scans, 3) [m, m, rad] finite."""
    ranges: Floats
    """(n_scans, n_rays) [m]; +inf nothing seen, -inf too close, nan broken."""
    run: Ints
    """(n_scans,) which run a scan comes from; neighbours in time stand beside each other."""
    bounds: tuple[float, float, float, float] | None = None
    """(x_min, y_min, x_max, y_max) [m] of the arena, if it is known."""
    pose_frame: PoseFrame = "base_link"
    """Whose poses these are; base_link carries the laser at `sensor.mount`."""
    ray_poses: Floats | None = None
    """(n_scans, n_rays, 3) [m, m, rad] where each ray of a sweep was taken; None: all rays of a scan at `poses`."""
    stamps: Floats | None = None
    """(n_scans,) [s] of each run; None: not known."""
    sequence: Ints | None = None
    """(n_scans,) stretch without a gap, a scan left out or a pose missing that a scan is of, counted in each run."""

    @property
    def laser_mount(self) -> Floats:
        """(3,) [m, m, rad] laser in the frame of the poses."""
        return np.zeros(3) if self.pose_frame == "laser" else self.sensor.mount

    @property
    def poses_of_rays(self) -> Floats:
        """(n_scans, n_rays, 3) where each ray was taken, whether the laser sweeps or not."""
        if self.ray_poses is not None:
            return self.ray_poses
        return np.broadcast_to(self.poses[:, None], (*self.ranges.shape, 3))

    def part(self, index: slice) -> TrainingScans:
        """Return some of the scans."""
        return replace(
            self,
            poses=self.poses[index],
            ranges=self.ranges[index],
            run=self.run[index],
            ray_poses=None if self.ray_poses is None else self.ray_poses[index],
            stamps=None if self.stamps is None else self.stamps[index],
            sequence=None if self.sequence is None else self.sequence[index],
        )

    def __len__(self) -> int:
        return len(self.poses)


SAVED_ARRAYS = ("ranges", "median", "mode", "mean", "sigma", "p_no_return", "answered")
"""Of a prediction, in its file."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """What the sensor should see; every array is (n_poses, n_rays), lengths in m."""

    ranges: Floats
    """The chosen point value; +inf where no return is the likelier outcome."""
    median: Floats
    """Of the mixture given a return; so are mode and mean."""
    mode: Floats
    mean: Floats
    sigma: Floats
    """Standard deviation given a return, sensor noise included."""
    p_no_return: Floats
    """Chance that nothing is seen out to range_max."""
    p_off: Floats
    """Said chance that a measured return is more than `OFF_DISTANCE` from the chosen point value."""
    answered: Bools
    """The training data support this answer."""

    def __post_init__(self) -> None:
        shapes = {name: np.shape(getattr(self, name)) for name in self.__dataclass_fields__}
        if len(set(shapes.values())) != 1:
            raise ValueError(f"a prediction has shapes {shapes}, expected one shape (n_poses, n_rays)")

    @classmethod
    def concatenate(cls, parts: Sequence[Self], *, axis: int = 0) -> Self:
        """Put predictions one after the other: of poses (`axis` 0), or of rays (1)."""
        names = cls.__dataclass_fields__
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts], axis) for name in names})

    def save(self, path: Path) -> None:
        """Write the arrays of SAVED_ARRAYS, each (n_poses, n_rays), as NPZ.

        Raises
        ------
        OSError : the file cannot be written
        """
        with atomic_file(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **{name: getattr(self, name) for name in SAVED_ARRAYS})

    def point(self, name: Point) -> Floats:
        """Return one point value given a return.

        Raises
        ------
        ValueError : there is no such point value
        """
        if name not in POINTS:
            raise ValueError(f"point is {name!r}, expected one of {', '.join(POINTS)}")
        return np.asarray(getattr(self, name), dtype=np.float64)


class Model(Protocol):
    """A fitted model; `restore(*model.state())` gives it back."""

    name: ClassVar[str]

    @classmethod
    def fit(cls, scans: TrainingScans, *, progress: Progress | None = None, **options: Any) -> Self:
        """Identify the model from scans."""
        ...

    def predict(self, poses: Floats, rays: Ints, point: Point) -> Prediction:
        """Predict rays (n_rays,) at poses (n_poses, 3)."""
        ...

    def equation(self, ray: int) -> str:
        """Print what the model says of one ray, with its numbers."""
        ...

    def summary(self) -> Mapping[str, str]:
        """Return what a reader wants to know first, label -> text."""
        ...

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that hold the whole model."""
        ...

    @classmethod
    def restore(
        cls, sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Self:
        """Build the model from what `state` gave; a wrong shape is a ValueError."""
        ...
