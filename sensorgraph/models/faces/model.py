"""Model `faces`: on each visible face the range is exactly rational in (x, y, cos phi, sin phi).

Range of a ray from q in direction u to the face n·p = d: r = (d - n·q) / (n·u). It is linear in the unknowns.
Faces are selected by forward selection on pooled moments. Their visible stretches follow from EM over hits and passes
and from change points. A prediction is the mixture of all faces that a ray crosses, weighted by the probability that
it stops there. If long faces leave much unexplained (clutter, poses from SLAM), short ones in cells predict instead
(`cells`). The module `data` defines the fields of the class and their stored form.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from logs.run import RangeSensor
from logs.transforms import compose
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import OFF_DISTANCE, Point, Prediction, TrainingScans, check_options
from sensorgraph.models.calibration.calibrate import calibrate_faces, observed_by, rays_beside_faces
from sensorgraph.models.calibration.laser_calibration import Calibration
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.cones.fit import fit_cones, readings_of_cones
from sensorgraph.models.cones.prediction import cone_equations, cone_mixtures, cone_table
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.models.distribution import Mixture
from sensorgraph.models.faces.data import FacesData, restored_fields, stored
from sensorgraph.models.faces.equations import SHOWN_GROWTH, face_equations
from sensorgraph.models.faces.fit import fit_faces
from sensorgraph.models.faces.forward_selection import coarseness
from sensorgraph.models.faces.ray_march import (
    MIN_VISIBILITY,
    BucketGrid,
    bucket_grid,
)
from sensorgraph.models.faces.reduction import (
    SCANS_PER_BLOCK,
    Block,
    MapBlocks,
    Reduction,
    blocks_of,
    reduce_blocks,
)
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.sufficient_statistics import scale_of
from sensorgraph.models.faces.thin_rays import (
    draw_thin_rays,
    lasers,
    thin_likelihoods,
    thin_mixtures,
    thin_table,
)
from sensorgraph.models.faces.update import update_faces
from sensorgraph.models.likelihood import log_density
from sensorgraph.models.mixture import MODE, NO_RETURN, P_OFF, to_prediction, which_of
from sensorgraph.types import Bools, Floats, Ints, Progress, ProgressBars, no_progress


@dataclass(frozen=True, kw_only=True, eq=False)
class Faces(FacesData):
    """Faces with their visible stretches, the noise of returns, and the observed space."""

    name: ClassVar[str] = "faces"
    OPTIONS: ClassVar[Mapping[str, Any]] = dict.fromkeys(("calibrate", "cells"), bool | None)

    @classmethod
    def fit(cls, scans: TrainingScans, *, progress: Progress | None = None, **options: Any) -> Self:
        """Identify faces from scans; the options `calibrate` and `cells` are decided by the data if None.

        Raises
        ------
        SensorgraphError : An option is unknown, or no ray returned.
        """
        check_options(cls, options)
        fitted = cls.fit_blocks(
            blocks_of(scans), scans.sensor, scans.laser_mount, n_scans=len(scans),
            can_mount=scans.pose_frame != "laser", calibrate=options.get("calibrate"),
            progress=no_progress if progress is None else lambda label, unit: nullcontext(progress),
        )  # fmt: skip
        wanted = options.get("cells")
        cluttered = fitted.is_cluttered if wanted is None else bool(wanted)
        return fitted.with_cells(scans, progress=progress) if cluttered else fitted

    @cached_property
    def buckets(self) -> BucketGrid:
        """Grid of the faces near each place, for the march of rays."""
        return bucket_grid(self.faces)

    @property
    def is_cluttered(self) -> bool:
        """Return whether faces leave so much unexplained that cells predict better; cells need thin rays."""
        return self.noise.stray > FACES.max_stray and not measures_cones(self.sensor)

    def with_cells(self, scans: TrainingScans, *, progress: Progress | None = None) -> Self:
        """Add cells fitted to the same scans; these then predict in place of the faces."""
        return replace(self, cells=CellModel.fit(scans.with_mount(self.mount), progress=progress))

    @classmethod
    def fit_blocks(
        cls, blocks: Iterable[Block], sensor: RangeSensor, mount: Floats, *, n_scans: int,
        map_blocks: MapBlocks = map, can_mount: bool = True, calibrate: bool | None = None,
        progress: ProgressBars = no_progress,
    ) -> Self:  # fmt: skip
        """Identify faces from blocks of scans, which need not fit into memory together.

        Parameters
        ----------
        n_scans : Approximate number of scans in all blocks.
        map_blocks : Function that reduces the blocks; `map` runs here, one block after the other.
        can_mount : Whether the poses are those of a base that carries the laser. False: they are the laser's own.
        calibrate : Whether to identify the laser with the faces. None: decide by evidence.
        progress : Opens a bar for each stage: reading scans, fitting faces, testing and calibrating the laser.

        Raises
        ------
        SensorgraphError : No ray returned.
        """
        reduced = _reduced(blocks, sensor, mount, n_scans, map_blocks, progress)
        if measures_cones(sensor):
            return cls(**_fit_cones(reduced, sensor, mount, can_mount=can_mount, progress=progress))
        rays = reduced.sample.rays(sensor, mount)
        coarse = coarseness(reduced.sample.noise(sensor.bearings))
        with progress("fitting faces", "%") as tick:
            fitted = fit_faces(rays, hit_moments=reduced.hit_moments, coarse=coarse, progress=tick)
        found = calibrate_faces(
            reduced.sample, sensor, mount, fitted, coarse=coarse, can_mount=can_mount, calibrate=calibrate,
            progress=progress,
        )  # fmt: skip
        if not found.calibration.is_as_stated and len(found.rays) == reduced.n_rays:
            # for a larger log, the grid of all rays, a few cm off, is more complete than that of a sample
            reduced = replace(reduced, observed=observed_by(found.rays))
        fitted, scale = found.fitted, scale_of(found.rays, reduced.n_rays)
        return cls(
            sensor=sensor, faces=fitted.faces, noise=fitted.noise, hits=scale * fitted.hits,
            observed=reduced.observed.with_missing(found.rays.ranges, sensor.range_max),
            returns=reduced.n_returns / reduced.n_rays, mount=found.mount, calibration=found.calibration,
            n_rays=reduced.n_rays,
            statistics=None if fitted.statistics is None else fitted.statistics.scaled(scale),
        )  # fmt: skip

    def updated(
        self,
        blocks: Iterable[Block],
        *,
        n_scans: int,
        map_blocks: MapBlocks = map,
        progress: ProgressBars = no_progress,
    ) -> Self:
        """Add blocks of new scans of the same laser to the faces, without the old scans; cells are left as they are.

        Raises
        ------
        SensorgraphError : The model is of cones or lacks statistics, or no new ray returned.
        """
        if self.statistics is None:
            is_of_cones = measures_cones(self.sensor)
            why = "is of cones, which cannot be updated" if is_of_cones else "lacks its rays' statistics"
            raise SensorgraphError(f"the graph {why}; build it again from all runs")
        new = _reduced(blocks, self.sensor, self.mount, n_scans, map_blocks, progress)
        rays, pose_errors = rays_beside_faces(
            new.sample, self.sensor, self.mount, self.calibration, self.faces, self.noise
        )
        with progress("updating faces", "steps") as tick:
            tick(0, 1)
            faces, noise, statistics = update_faces(
                self.faces, self.noise, self.statistics, self.observed, rays,
                n_rays=new.n_rays, pose_errors=pose_errors,
            )  # fmt: skip
        return replace(
            self, faces=faces, noise=noise, hits=statistics.line_sums[:, 5].copy(),
            observed=self.observed.merge(new.observed.with_missing(rays.ranges, self.sensor.range_max)),
            returns=(self.returns * self.n_rays + new.n_returns) / (self.n_rays + new.n_rays),
            n_rays=self.n_rays + new.n_rays, statistics=statistics,
        )  # fmt: skip

    def predict(self, poses: Floats, rays: Ints, point: Point) -> Prediction:
        """Predict rays (n_rays,) at poses (n_poses, 3)."""
        if self.cells is not None:
            return self.cells.predict(poses, rays, point)
        if measures_cones(self.sensor):
            table, supported = cone_table(self, lasers(poses, self.mount), rays, which_of(point))
        else:
            table, supported = thin_table(self, self.buckets, poses, rays, which_of(point))
        by_noise = 2.0 * ndtr(
            -OFF_DISTANCE / self.noise.at(table[..., MODE])
        )  # of a surface that is known exactly
        most = by_noise + (1.0 - by_noise) * FACES.max_p_off
        is_clear = (table[..., P_OFF] < most) | (table[..., NO_RETURN] > 1 - FACES.max_p_off)
        return to_prediction(table, point, supported & is_clear)

    def mixture(self, poses: Floats, rays: Ints) -> Mixture:
        """Return the mixtures of rays (n_rays,) at poses (n_poses, 3)."""
        if self.cells is not None:
            return self.cells.mixture(poses, rays)
        if measures_cones(self.sensor):
            return cone_mixtures(self, lasers(poses, self.mount), rays)
        return thin_mixtures(self, self.buckets, poses, rays)

    def log_likelihood(self, ranges: Floats, poses: Floats, rays: Ints) -> tuple[Floats, Bools]:
        """Return log-likelihoods (n_poses, n_rays) of readings (n_poses or 1, n_rays) [m], and which rays data support."""
        if self.cells is not None:
            return self.cells.log_likelihood(ranges, poses, rays)
        if measures_cones(self.sensor):
            mixture, supported = self.mixture(poses, rays), self.predict(poses, rays, "mode").answered
            return log_density(mixture, ranges, self.sensor.range_min, self.noise.stray), supported
        return thin_likelihoods(self, self.buckets, ranges, poses, rays)

    def draw(
        self, poses: Floats, uniform: Floats, normal: Floats, rays: Ints | slice = slice(None)
    ) -> Floats:
        """Draw one reading of rays (n_rays,) at poses (n_poses, 3), with range noise and without the noise of poses.

        `uniform` and `normal` (n_poses, n_rays) are the random numbers; equal numbers give equal readings.
        """
        if self.cells is not None:
            return self.cells.draw(poses, uniform, normal, rays)
        if measures_cones(self.sensor):
            return self.mixture(poses, np.arange(self.sensor.n_rays)[rays]).draw(uniform, normal)
        return draw_thin_rays(self, self.buckets, poses, uniform, normal, rays)

    def equation(self, ray: int, *, every: bool = True) -> str:
        """Return the equations of one ray as text, face by face, those first that stop it at the most poses.

        `every` False leaves out faces and stretches that stop it at less than 1 % of the poses.
        """
        if measures_cones(self.sensor):
            return "\n".join(cone_equations(self, _start_of(ray, self.sensor, self.mount), ray))
        lines = face_equations(self, _start_of(ray, self.sensor, self.mount), ray=ray, every=every)
        if self.cells is not None:
            lines += ["", "the faces leave too much of this log unexplained, so cells predict:"]
            lines.append(self.cells.equation(ray))
        return "\n".join(lines)

    def summary(self) -> Mapping[str, str]:
        """Return the main facts as label -> text."""
        stretches = int((self.faces.levels > MIN_VISIBILITY).sum())
        grows = f" and {100 * self.noise.growth:.2f} %" if self.noise.growth > SHOWN_GROWTH else ""
        return {
            "faces": f"{self.faces.n_faces}, with {stretches} visible stretches",
            "noise": f"{1e3 * self.noise.sigma:.1f} mm{grows} of range, {1e3 * self.noise.sigma_xy:.1f} mm and "
            f"{math.degrees(self.noise.sigma_yaw):.3f}° of pose",
            "unexplained": f"{self.noise.stray:.2g} returns per metre of ray",
            **self.calibration.summary(),
            **({} if self.cells is None else {f"cells, {k}": v for k, v in self.cells.summary().items()}),
        }

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that describe the whole model."""
        return stored(self)

    @classmethod
    def restore(
        cls, sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Self:
        """Recreate the model from the output of `state`.

        Raises
        ------
        ValueError : An array has a wrong shape or invalid indices, or a number is out of range.
        """
        return cls(**restored_fields(sensor, header, arrays))


def _reduced(
    blocks: Iterable[Block], sensor: RangeSensor, mount: Floats, n_scans: int, map_blocks: MapBlocks,
    progress: ProgressBars,
) -> Reduction:  # fmt: skip
    """Return the reduction of blocks of about `n_scans` scans, with a sample that is spread evenly."""
    with progress("reading scans", "scans") as tick:
        found = reduce_blocks(
            blocks,
            mount=mount,
            n_rays=n_scans * sensor.n_rays,
            map_blocks=map_blocks,
            tick=_block_ticks(tick, n_scans),
        )
    if found is None or found.n_returns == 0:
        raise SensorgraphError(
            "no ray of the log returned; check range_max and the no-return code of the log"
        )
    return found.spread_evenly(sensor)


def _start_of(ray: int, sensor: RangeSensor, mount: Floats) -> Floats:
    """Return the start of a ray (3,) [m, m, rad] in the frame of the poses: the laser, or one of several sensors."""
    return compose(mount, np.append(sensor.origins[ray], 0.0)) if sensor.is_composite else mount


def _fit_cones(
    reduced: Reduction, sensor: RangeSensor, mount: Floats, *, can_mount: bool, progress: ProgressBars
) -> dict[str, Any]:
    """Return the fields of faces fitted to cones; the sensors are not calibrated."""
    with progress("fitting faces", "%") as tick:
        found = fit_cones(readings_of_cones(reduced.sample, sensor, mount), progress=tick)
    return {
        "sensor": sensor,
        "faces": found.faces,
        "noise": found.noise,
        "hits": found.hits * (reduced.n_rays / max(found.n_readings, 1)),
        "observed": found.observed,
        "returns": reduced.n_returns / reduced.n_rays,
        "mount": mount,
        "calibration": Calibration.none(sensor.n_rays, can_mount=can_mount),
        "n_rays": reduced.n_rays,
    }


def _block_ticks(tick: Progress, n_scans: int) -> Callable[[], None]:
    """Return a function to call after each block, which reports the number of scans read."""
    done = 0
    tick(0, n_scans)

    def next_block() -> None:
        nonlocal done
        done = min(done + SCANS_PER_BLOCK, n_scans)
        tick(done, n_scans)

    return next_block
