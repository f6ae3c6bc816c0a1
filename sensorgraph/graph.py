"""The sensorgraph: what the sensor perceives at every (x, y, phi), where this is supported by data, and its file."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from logs.html_table import html_table
from logs.motion import to_ray_starts
from logs.run import PoseFrame, RangeSensor
from logs.transforms import compose
from sensorgraph.arguments import Count, NotNegative
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.graph_file import read_graph, write_graph
from sensorgraph.models.base import Model, Point, Prediction
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.thin_rays import noise_of_poses
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.models.unknown_space import UnknownSpace
from sensorgraph.nearby_likelihood import NearbyLikelihood
from sensorgraph.sensor_model import (
    GraphRays,
    Unanswered,
    each_ray,
    likelihood_of,
    near_of,
    sample_of,
    unknown_space,
    warn_of_sweep,
)
from sensorgraph.sensor_model_input import check_poses, check_readings, numbers_of, rays_of
from sensorgraph.show.figures.model_figure import model_figure
from sensorgraph.types import Floats, Progress, RayChoice

POSES_AT_A_TIME = 2048
"""Number of poses predicted together; it limits memory and sets the interval of progress reports."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensorgraph:
    """A fitted model of perception, its sensor and its origin."""

    model: Model
    sensor: RangeSensor
    pose_frame: PoseFrame
    """Frame of the poses that `predict` takes: that of the training poses."""
    origin: Mapping[str, Any]
    """Origin of the graph as plain data: `version`, `inputs`, `options`, `split` and counts."""
    memory: ResidualMemory | None = None
    """Correlation of the residuals between places and times, for draws and likelihoods; None: not identified."""

    @as_sensorgraph_error
    def predict(
        self, poses: ArrayLike, *, rays: RayChoice = None, point: Point = "mode", progress: Progress | None = None
    ) -> Prediction:  # fmt: skip
        """Predict what the sensor perceives.

        Parameters
        ----------
        poses : (n_poses, 3) or (3,) [m, m, rad] of `pose_frame` in map; or (n_poses, n_rays, 3), one pose for each ray,
            as while a laser sweeps on a moving robot (`logs.motion.ray_poses`).
        rays : Indices of the predicted rays, or a mask (n_rays,) of bool. None: all rays.
        point : Point value of the mixture that `Prediction.ranges` holds.
        progress : Called with the number of poses done and the total.

        Returns
        -------
        Prediction with arrays (n_poses, n_rays)

        Raises
        ------
        SensorgraphError : The poses have another shape, one is not finite or too far away, a ray or point value is unknown,
            or headings are in degrees (above 100 rad, or above a turn where all are whole numbers).
        """
        where, index = self._asked(poses, rays)
        parts = []
        for first in range(0, max(len(where), 1), POSES_AT_A_TIME):
            if progress is not None:
                progress(first, len(where))
            parts.append(self._predict_some(where[first : first + POSES_AT_A_TIME], index, point))
        found = parts[0] if len(parts) == 1 else Prediction.concatenate(parts)
        return replace(found, rays=GraphRays(graph=self, poses=where.copy(), rays=index))

    @as_sensorgraph_error
    def log_likelihood(
        self, ranges: ArrayLike, poses: ArrayLike, *, rays: RayChoice = None, correlated: bool = True,
        per_ray: bool = False, unanswered: Unanswered = "broad",
    ) -> Floats:  # fmt: skip
        """Return the log-likelihood of readings at poses: log p(ranges | pose), as a particle filter needs it.

        A return has a density [1/m]. No return (+inf or beyond range_max), too close (-inf or below range_min) and a
        broken reading (nan, which counts nothing) are readings, too (`models.likelihood` has the equations).

        Parameters
        ----------
        ranges : (n_rays,) [m] one scan, judged at every pose; or (n_poses, n_rays): one scan for each pose.
        poses : (n_poses, 3) or (3,) [m, m, rad] of `pose_frame` in map; or (n_poses, n_rays, 3), one pose for each ray.
        rays : Indices of the rays that count. None: all rays.
        correlated : Temper the sum by the correlation of neighbouring readings, which `memory` knows.
        per_ray : Return the terms of the sum, (n_poses, n_rays).
        unanswered : What rays count that no training ray crossed. "broad": the distribution of `unknown_space`; "skip": nothing.

        Returns
        -------
        (n_poses,) log-likelihoods, or (n_poses, n_rays) with `per_ray`.

        Raises
        ------
        SensorgraphError : The ranges are of another sensor or unit, or all poses are outside the map.
        """
        where, index = self._asked(poses, rays)
        if where.ndim == 2 and self.sensor.scan_duration > 0:
            warn_of_sweep(self.sensor.scan_duration)
        readings = check_readings(ranges, len(where), index, self.sensor)
        return likelihood_of(
            self, readings, where, index, correlated=correlated, per_ray=per_ray, unanswered=unanswered
        )

    @as_sensorgraph_error
    def near(
        self, ranges: ArrayLike, poses: ArrayLike, *, rays: RayChoice = None,
        correlated: bool = True, unanswered: Unanswered = "broad",
    ) -> NearbyLikelihood:  # fmt: skip
        """Tabulate `log_likelihood` of one scan (n_rays,) [m] around poses near each other, as the particles of a filter.

        A few casts of each ray serve all poses (n_poses, 3), which span the tables; within 0.3 m the error is small. The
        options are those of `log_likelihood`.

        Raises
        ------
        SensorgraphError : As for `log_likelihood`, or there is no pose, or the rays start at several points.
        """
        where, index = self._asked(poses, rays)
        if len(where) == 0:
            raise SensorgraphError("poses is empty; expected the poses around which the tables are made")
        readings = check_readings(ranges, 1, index, self.sensor)
        return near_of(self, readings, where, index, correlated=correlated, unanswered=unanswered)

    @as_sensorgraph_error
    def sample(
        self,
        poses: ArrayLike,
        n: Count = 1,
        seed: Count = 0,
        *,
        rays: RayChoice = None,
        residual_memory: bool = True,
    ) -> Floats:
        """Draw scans at poses: (n, n_poses, n_rays) [m]; +inf: no return, -inf: closer than range_min.

        Parameters
        ----------
        poses : (n_poses, 3) or (3,) [m, m, rad] of `pose_frame` in map; or (n_poses, n_rays, 3), one pose for each ray.
        n : Number of draws; each is of another possible world, which all poses share.
        seed : Random seed; the same seed gives the same scans.
        residual_memory : Draw readings that end near each other with correlated errors, as the log had them.

        Raises
        ------
        SensorgraphError : `n` or `seed` is not a whole number from 0 on; poses and rays as for `predict`.
        """
        where, index = self._asked(poses, rays)
        return sample_of(self, where, n, seed, index, residual_memory=residual_memory)

    @cached_property
    def unknown_space(self) -> UnknownSpace:
        """Distribution of readings in space that no training ray has crossed."""
        return unknown_space(self)

    def lasers(self, poses: ArrayLike) -> Floats:
        """Return the poses (..., 3) of the laser in map for poses (..., 3) of `pose_frame`."""
        mount = getattr(self.model, "mount", self.sensor.mount)
        where = numbers_of(poses, "poses")
        return where if self.pose_frame == "laser" else np.asarray(compose(where, mount))

    def _asked(self, poses: ArrayLike, rays: RayChoice) -> tuple[Floats, NDArray[np.intp]]:
        """Return checked poses, one for each ray where the rays start at several points, and the indices of rays."""
        where = np.atleast_2d(numbers_of(poses, "poses"))
        index = rays_of(rays, self.sensor.n_rays)
        check_poses(where, len(index))
        if where.ndim == 3 and where.shape[1] == 1:
            where = where[:, 0]
        if where.ndim == 2 and self.sensor.is_composite and self.model.name != "polynomial":
            where = to_ray_starts(where[:, None], self.sensor, self.pose_frame)[:, index]
        return where, index

    def _predict_some(self, poses: Floats, index: NDArray[np.intp], point: Point) -> Prediction:
        """Predict the rays `index` at one batch of poses, (n, 3) or (n, n_rays, 3)."""
        if poses.ndim == 2:
            return self.model.predict(poses, index, point)
        of_rays = [self.model.predict(there, ray, point) for there, ray in each_ray(poses, index)]
        return Prediction.concatenate(of_rays, axis=1)

    def __repr__(self) -> str:
        """Summarise the contents and the origin in a few lines."""
        facts = "; ".join(f"{label}: {text}" for label, text in self.model.summary().items())
        inputs = ", ".join(str(entry.get("name", "?")) for entry in self.origin.get("inputs", ()))
        lines = [
            f"Sensorgraph of model {self.model.name}: {self.sensor.n_rays} rays, poses of {self.pose_frame}",
            facts,
            f"built from {inputs or 'unknown runs'}",
        ]
        return "\n".join(textwrap.shorten(line, 160, placeholder=" ...") for line in lines)

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows: facts of the model and its training runs."""
        inputs = ", ".join(str(entry.get("name", "?")) for entry in self.origin.get("inputs", ()))
        rows = [
            ("rays", f"{self.sensor.n_rays}, poses of {self.pose_frame}"),
            *self.model.summary().items(),
            ("built from", inputs or "unknown runs"),
        ]
        return html_table(f"Sensorgraph, model {self.model.name}", rows)

    def facts(self) -> dict[str, str]:
        """Return the main facts of the model and of the memory, if there is one, as label -> text."""
        return {
            **self.model.summary(),
            **({} if self.memory is None else {"memory": self.memory.summary()}),
        }

    @as_sensorgraph_error
    def with_pose_errors(
        self, sigma_xy: NotNegative | None = None, sigma_yaw: NotNegative | None = None
    ) -> Sensorgraph:
        """Return the graph for uncertain poses, whose errors widen the distribution of every reading.

        Without this, faces predict for the exact pose. Cells and polynomials contain the pose errors of their own logs
        and are returned unchanged. The errors are standard deviations [m] of x and of y and [rad] of phi; None: those of
        the poses in the graph's logs.

        Raises
        ------
        SensorgraphError : A standard deviation is not a number from 0 on.
        """
        if not isinstance(self.model, Faces):
            return self
        noise = noise_of_poses(self.model, sigma_xy, sigma_yaw)
        return replace(self, model=replace(self.model, noise=noise))

    def plot(self) -> Any:
        """Draw the faces or cells of the graph in a figure of matplotlib; `sensorgraph show --picture` adds a run.

        Raises
        ------
        SensorgraphError : The model has neither faces nor cells, or no surface.
        """
        if not isinstance(self.model, Faces | CellModel):
            raise SensorgraphError(f"the model {self.model.name} has neither faces nor cells to draw")
        return model_figure(self.model)

    def equation(self, ray: int) -> str:
        """Return the explicit equation of one ray, given by index.

        Raises
        ------
        SensorgraphError : There is no such ray.
        """
        rays_of([ray], self.sensor.n_rays)
        return self.model.equation(ray)

    @as_sensorgraph_error
    def save(self, path: Path | str) -> None:
        """Write one file; the same graph gives the same bytes.

        Raises
        ------
        SensorgraphFileError : The file cannot be written.
        """
        write_graph(
            Path(path), model=self.model, sensor=self.sensor, pose_frame=self.pose_frame, origin=self.origin,
            memory=self.memory,
        )  # fmt: skip

    @classmethod
    @as_sensorgraph_error
    def load(cls, path: Path | str) -> Sensorgraph:
        """Read a file written by `save`; no code of the file is executed.

        Raises
        ------
        SensorgraphError : The file does not exist, is not a sensorgraph, is damaged, or has a newer version.
        """
        return cls(**read_graph(Path(path)))


@as_sensorgraph_error
def load(path: Path | str) -> Sensorgraph:
    """Load a sensorgraph from its file; no code of the file is executed.

    Raises
    ------
    SensorgraphError : The file does not exist, is not a sensorgraph, is damaged, or has a newer version.
    """
    return Sensorgraph.load(path)
