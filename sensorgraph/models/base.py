"""Interface of every model of perception: training scans in, `Prediction` out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from logs.files import atomic_file
from logs.run import PoseFrame, RangeSensor
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.models.distribution import Mixture
from sensorgraph.sensor_model_input import spread_over
from sensorgraph.types import Bools, Floats, Ints, Progress

Point = Literal["mode", "median", "mean"]
POINTS: tuple[str, ...] = get_args(Point)
OFF_DISTANCE = 0.05
"""[m] A prediction that differs from the measured range by more shows another surface and counts as wrong."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingScans:
    """Scans with poses from one or several runs, in the order of the log."""

    sensor: RangeSensor
    poses: Floats
    """(n_scans, 3) [m, m, rad] finite."""
    ranges: Floats
    """(n_scans, n_rays) [m]; +inf: no return, -inf: closer than range_min, nan: broken reading."""
    run: Ints
    """(n_scans,) index of each scan's run; scans of a run are consecutive and in the order of time."""
    bounds: tuple[float, float, float, float] | None = None
    """(x_min, y_min, x_max, y_max) [m] of the arena, if known."""
    pose_frame: PoseFrame = "base_link"
    """Frame of the poses; base_link carries the laser at `sensor.mount`."""
    ray_poses: Floats | None = None
    """(n_scans, n_rays, 3) [m, m, rad] pose at the time of each ray of a sweep; None: all rays of a scan at `poses`."""
    stamps: Floats | None = None
    """(n_scans,) [s] stamps within each run; None: unknown."""
    sequence: Ints | None = None
    """(n_scans,) number of each scan's stretch within its run; gaps, omitted scans and missing poses end a stretch."""

    @property
    def laser_mount(self) -> Floats:
        """(3,) [m, m, rad] pose of the laser in the frame of `poses`."""
        return np.zeros(3) if self.pose_frame == "laser" else self.sensor.mount

    @property
    def poses_of_rays(self) -> Floats:
        """(n_scans, n_rays, 3) pose at the time of each ray, for a sweeping laser or not."""
        if self.ray_poses is not None:
            return self.ray_poses
        return np.broadcast_to(self.poses[:, None], (*self.ranges.shape, 3))

    def with_mount(self, mount: Floats) -> TrainingScans:
        """Return the scans of a laser with an identified mount (3,) [m, m, rad]; poses of the laser need none."""
        is_mounted = self.pose_frame == "base_link"
        return replace(self, sensor=replace(self.sensor, mount=mount)) if is_mounted else self

    def part(self, index: slice) -> TrainingScans:
        """Return the scans of a slice."""
        return replace(
            self, poses=self.poses[index], ranges=self.ranges[index], run=self.run[index],
            ray_poses=None if self.ray_poses is None else self.ray_poses[index],
            stamps=None if self.stamps is None else self.stamps[index],
            sequence=None if self.sequence is None else self.sequence[index],
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.poses)


class PredictedRays(Protocol):
    """The rays of a prediction, from which their distribution is computed when it is needed."""

    @property
    def mixture(self) -> Mixture: ...
    def evaluate(self, function: Callable[[Mixture, Floats], Floats], values: Floats) -> Floats: ...
    def points(self, ranges: Floats) -> Floats: ...


SAVED_ARRAYS = ("ranges", "median", "mode", "mean", "sigma", "p_no_return", "answered")
"""Arrays of a prediction that its file holds."""
ARRAYS = (*SAVED_ARRAYS, "p_off")
"""Arrays of a prediction."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Predicted readings; every array is (n_poses, n_rays), lengths in m."""

    ranges: Floats
    """The chosen point value; +inf where no return is more probable than a return."""
    median: Floats
    """Median of the mixture given a return; `mode` and `mean` likewise."""
    mode: Floats
    mean: Floats
    sigma: Floats
    """Standard deviation given a return, including the sensor noise."""
    p_no_return: Floats
    """Probability of no return up to range_max."""
    p_off: Floats
    """Predicted probability that a measured return differs from the point value by more than `OFF_DISTANCE`."""
    answered: Bools
    """Whether the training data support the prediction."""
    rays: PredictedRays | None = field(default=None, repr=False)
    """The predicted rays; None in a prediction that was not made by `Sensorgraph.predict`."""

    def __post_init__(self) -> None:
        shapes = {name: np.shape(getattr(self, name)) for name in ARRAYS}
        if len(set(shapes.values())) != 1:
            raise ValueError(f"a prediction has shapes {shapes}, expected one shape (n_poses, n_rays)")

    @classmethod
    def concatenate(cls, parts: Sequence[Self], *, axis: int = 0) -> Self:
        """Concatenate predictions along the poses (`axis` 0) or the rays (`axis` 1)."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts], axis) for name in ARRAYS
        }
        return cls(**arrays)

    def take(self, index: slice | Bools | Ints) -> Self:
        """Return the arrays of some poses, without their distribution."""
        arrays: dict[str, Any] = {name: getattr(self, name)[index] for name in ARRAYS}
        return type(self)(**arrays)

    def __repr__(self) -> str:
        """Summarise the prediction in one line."""
        n_poses, n_rays = self.ranges.shape
        share = float(self.answered.mean()) if self.answered.size else 0.0
        return f"Prediction: {n_poses:,} pose{'s' if n_poses != 1 else ''} × {n_rays:,} rays, {100 * share:.0f} % answered"

    def pdf(self, z: ArrayLike) -> Floats:
        """Return the density [1/m] (n_poses, n_rays) of readings z [m], given a return; z is broadcast to that shape.

        Raises
        ------
        SensorgraphError : z is no number, or its shape cannot be broadcast. nan has the density nan.
        """
        return self._evaluated(Mixture.pdf, z, "z")

    def cdf(self, z: ArrayLike) -> Floats:
        """Return the probability (n_poses, n_rays) of readings below z [m], given a return; z is broadcast as in `pdf`.

        Raises
        ------
        SensorgraphError : z is no number, or its shape cannot be broadcast. nan has the probability nan.
        """
        return self._evaluated(Mixture.cdf, z, "z")

    def quantile(self, q: ArrayLike) -> Floats:
        """Return the ranges [m] (n_poses, n_rays) below which a return lies with probability q; q is broadcast.

        q is one number, or an array (n_rays,), (n_poses, 1) or (n_poses, n_rays).

        Raises
        ------
        SensorgraphError : q is not between 0 and 1, or its shape cannot be broadcast.
        """
        return self._evaluated(Mixture.quantile, q, "q")

    @as_sensorgraph_error
    def interval(self, p: float) -> tuple[Floats, Floats]:
        """Return lower and upper ranges [m], (n_poses, n_rays) each, between which a return lies with probability p.

        Raises
        ------
        SensorgraphError : p is not a number between 0 and 1.
        """
        if not 0 < p < 1:
            raise SensorgraphError(f"p is {p}, expected a number above 0 and below 1")
        return self.quantile(0.5 - 0.5 * p), self.quantile(0.5 + 0.5 * p)

    def components(self) -> tuple[Floats, Floats, Floats, Ints]:
        """Return weights, means [m], widths [m] and faces of the mixtures, (n_poses, n_rays, n_most) each.

        Weights are probabilities that the surface stops the ray; with `p_no_return` they sum to 1. Unused entries have
        weight 0, mean +inf and face -1.
        """
        found = self._rays.mixture
        return found.weights, found.means, found.widths, found.sources

    def points(self) -> Floats:
        """Return the predicted end points (n_poses, n_rays, 2) [m, map]; nan where no return is more probable."""
        return self._rays.points(self.ranges)

    def _evaluated(
        self, function: Callable[[Mixture, Floats], Floats], values: ArrayLike, name: str
    ) -> Floats:
        """Return a function of the mixtures and of values (n_poses, n_rays)."""
        rays = self._rays
        n_poses, n_rays = self.ranges.shape
        try:
            return rays.evaluate(function, spread_over(values, name, (n_poses, n_rays)))
        except ValueError as exc:
            raise SensorgraphError(str(exc)) from exc

    @property
    def _rays(self) -> PredictedRays:
        if self.rays is None:
            raise SensorgraphError(
                "the prediction has no distribution; only one that `Sensorgraph.predict` made has it"
            )
        return self.rays

    @as_sensorgraph_error
    def save(self, path: Path | str) -> None:
        """Write the arrays of SAVED_ARRAYS, each (n_poses, n_rays), as NPZ.

        Raises
        ------
        SensorgraphFileError : The file cannot be written.
        """
        with atomic_file(Path(path)) as part, part.open("wb") as file:
            np.savez_compressed(file, **{name: getattr(self, name) for name in SAVED_ARRAYS})

    def point(self, name: Point) -> Floats:
        """Return a point value of the range given a return.

        Raises
        ------
        SensorgraphError : The point value does not exist.
        """
        if name not in POINTS:
            raise SensorgraphError(f"point is {name!r}, expected one of {', '.join(POINTS)}")
        return np.asarray(getattr(self, name), dtype=np.float64)


class Model(Protocol):
    """A fitted model; `restore(*model.state())` recreates it."""

    name: ClassVar[str]
    OPTIONS: ClassVar[Mapping[str, Any]]
    """Options that `fit` takes -> their types."""

    @classmethod
    def fit(cls, scans: TrainingScans, *, progress: Progress | None = None, **options: Any) -> Self:
        """Identify the model from training scans."""
        ...

    def predict(self, poses: Floats, rays: Ints, point: Point) -> Prediction:
        """Predict rays (n_rays,) at poses (n_poses, 3)."""
        ...

    def mixture(self, poses: Floats, rays: Ints) -> Mixture:
        """Return the mixtures of rays (n_rays,) at poses (n_poses, 3)."""
        ...

    def log_likelihood(self, ranges: Floats, poses: Floats, rays: Ints) -> tuple[Floats, Bools]:
        """Return log-likelihoods (n_poses, n_rays) of readings (n_poses or 1, n_rays) [m], and which rays data support."""
        ...

    def equation(self, ray: int) -> str:
        """Return the model of one ray as text, with its numbers."""
        ...

    def summary(self) -> Mapping[str, str]:
        """Return the main facts as label -> text."""
        ...

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that describe the whole model."""
        ...

    @classmethod
    def restore(
        cls, sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Self:
        """Recreate the model from the output of `state`; a wrong shape raises a ValueError."""
        ...


def check_options(model: type[Model], options: Mapping[str, Any], others: Iterable[type[Model]] = ()) -> None:
    """Check that a model knows all options; `others` are models that may know them.

    Raises
    ------
    SensorgraphError : An option is unknown.
    """
    if unknown := sorted(options.keys() - model.OPTIONS.keys()):
        knowing = [other.name for other in others if other.OPTIONS.keys() >= set(unknown)]
        hint = f"; set `model` to {' or '.join(knowing)}, or remove the option" if knowing else ""
        raise SensorgraphError(
            f"option {', '.join(unknown)} is not known to the model {model.name}; expected {', '.join(model.OPTIONS)}{hint}"
        )
