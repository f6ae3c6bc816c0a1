"""Model `cells`: faces in 5 cm cells, whose visibility is one learned polynomial of the surrounding evidence.

It is meant for cluttered environments without long walls and for noisy poses. Evidence (hits and passes by direction)
is collected in one pass. The probability that a cell stops a ray is a polynomial of this evidence, learned on
stretches of the log that the evidence omits. A prediction traverses the cells and returns a mixture of possible hits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from logs.transforms import compose
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import POINTS, Point, Prediction, TrainingScans, check_options
from sensorgraph.models.cells.distribution import KNOTS, fill_log_likelihoods, shape_mixtures
from sensorgraph.models.cells.drawing import draw_readings
from sensorgraph.models.cells.evidence import CELL_SIZE, MAX_REACH, MIN_RANGE, CellEvidence
from sensorgraph.models.cells.grid import per_ray
from sensorgraph.models.cells.key_frames import KeyFrames
from sensorgraph.models.cells.learning import is_set_aside, n_folds_of
from sensorgraph.models.cells.ray_march import RATES, CellTable, list_candidates, new_work, tabulate
from sensorgraph.models.cells.set_aside import learn_visibility, summarise_poses
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.cells.visibility import TERMS
from sensorgraph.models.distribution import Mixture
from sensorgraph.models.mixture import NO_RETURN, P_OFF, to_prediction, which_of
from sensorgraph.models.stored_numbers import check_positive, check_range, check_shape, with_prefix
from sensorgraph.types import Bools, Floats, Ints, Progress

MIN_CELL, MAX_CELL = 0.01, 0.5
"""[m] Limits of the cell size."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CellModel:
    """A table of cells, and the visibility polynomial it was made with."""

    name: ClassVar[str] = "cells"
    OPTIONS: ClassVar[Mapping[str, Any]] = {"cell": float}

    sensor: RangeSensor
    mount: Floats
    """(3,) [m, m, rad] pose of the laser in the frame of the poses."""
    table: CellTable
    beta: Floats
    """(n_terms,) coefficients of the visibility polynomial."""
    reliability: Floats
    """(3, n_knots) observed probability of being off at the predicted ones in `KNOTS`, for each of `POINTS`."""
    tails: Floats
    """(3,) Share of wide errors about a face, and factors of the standard deviation of narrow and wide ones."""
    nothing: float
    """Share of missing returns among the readings beyond reach; the others are longer ranges."""
    counts: Mapping[str, int]
    """Numbers of training data: scans, key_frames, set_aside, hits."""
    frames: KeyFrames
    """Scans from which the cells were made."""

    @classmethod
    def fit(
        cls,
        scans: TrainingScans,
        *,
        before: KeyFrames | None = None,
        progress: Progress | None = None,
        **options: Any,
    ) -> Self:
        """Collect evidence from all key frames, after learning visibility and calibration on stretches set aside.

        Parameters
        ----------
        before : Key frames of earlier runs, to which those of the scans are added.

        Raises
        ------
        SensorgraphError : An option is unknown, the cell size is out of range, or no ray returned within reach.
        """
        check_options(cls, options)
        cell = float(options.get("cell", CELL_SIZE))
        if not MIN_CELL <= cell <= MAX_CELL:
            raise SensorgraphError(f"cell is {cell:g} m, expected {MIN_CELL:g} to {MAX_CELL:g}")
        frames = KeyFrames.of(scans) if before is None else before.joined(KeyFrames.of(scans))
        poses, ranges = frames.poses, frames.ranges
        bearings = scans.sensor.bearings
        reach = min(MAX_REACH, scans.sensor.range_max)
        if not ((ranges > MIN_RANGE) & (ranges < reach)).any():
            raise SensorgraphError(
                f"no ray of any training scan returned between {MIN_RANGE} and {reach:g} m"
            )
        report = progress or (lambda done, total: None)
        beta, spread, reliability, tails = learn_visibility(poses, ranges, bearings, cell, reach, report)
        evidence = CellEvidence.of(poses, ranges, bearings, cell=cell, reach=reach)
        table = tabulate(evidence.widened(), beta, spread)
        report(5, 5)
        far, none = int((ranges >= reach).sum()), int(np.isposinf(ranges).sum())
        counts = {
            "scans": frames.n_scans,
            "key_frames": len(poses),
            "set_aside": sum(int(is_set_aside(len(poses), k).sum()) for k in range(n_folds_of(len(poses)))),
            "hits": int(evidence.hits[: evidence.n_rows].sum()),
        }
        return cls(
            sensor=scans.sensor, mount=scans.laser_mount, table=table, beta=beta, reliability=reliability,
            tails=tails, nothing=none / max(far, 1), counts=counts, frames=frames,
        )  # fmt: skip

    def updated(self, scans: TrainingScans, *, progress: Progress | None = None) -> Self:
        """Fit again to the key frames of the earlier runs and of new scans of the same laser.

        Raises
        ------
        SensorgraphError : No ray returned within reach.
        """
        scans = scans.with_mount(self.mount)
        return self.fit(scans, before=self.frames, progress=progress, cell=self.table.cell)

    def predict(self, poses: Floats, rays: Ints, point: Point) -> Prediction:
        """Predict rays (n_rays,) at poses (n_poses, 3)."""
        out, near, unobserved = summarise_poses(
            self.table, compose(poses, self.mount), self.sensor.bearings[rays], point
        )
        out[..., P_OFF] = np.interp(out[..., P_OFF], KNOTS, self.reliability[which_of(point)])
        beyond = out[..., NO_RETURN] > 0.5
        out[..., NO_RETURN] *= self.nothing
        answered = (unobserved <= CELLS.max_unseen_length) & np.where(
            beyond, out[..., NO_RETURN] > 0.5, near >= 0.5
        )
        return to_prediction(out, point, answered)

    def mixture(self, poses: Floats, rays: Ints) -> Mixture:
        """Return the mixtures of rays (n_rays,) at poses (n_poses, 3), within reach; the arrays are large."""
        means, weights, widths, survival = list_candidates(
            self.table, compose(poses, self.mount), self.sensor.bearings[rays], room=2
        )
        reliability = self.reliability[which_of("mode")]
        shape_mixtures(means, weights, widths, self.table.reach, reliability, self.tails)
        none = survival * self.nothing
        total = np.maximum(weights.sum(axis=2) + none, 1e-300)
        return Mixture(
            means=means,
            weights=weights / total[..., None],
            widths=widths,
            sources=np.full(means.shape, -1),
            p_no_return=none / total,
        )

    def log_likelihood(self, ranges: Floats, poses: Floats, rays: Ints) -> tuple[Floats, Bools]:
        """Return log-likelihoods (n_poses, n_rays) of readings (n_poses or 1, n_rays) [m], and which rays data support."""
        out, supported = self.log_likelihoods(ranges[..., None], poses, rays)
        return out[..., 0], supported

    def log_likelihoods(self, ranges: Floats, poses: Floats, rays: Ints) -> tuple[Floats, Bools]:
        """Compute `log_likelihood` of several readings of each ray: (n_poses or 1, n_rays, n_readings) [m]."""
        supported = np.empty((len(poses), len(rays)), dtype=np.bool_)
        out = np.empty((*supported.shape, ranges.shape[2]))
        longest = max(self.sensor.range_max - self.table.reach, self.table.cell)
        fill_log_likelihoods(
            per_ray(compose(poses, self.mount)), self.sensor.bearings[rays], self.table,
            new_work(self.table, 2), self.reliability[which_of("mode")], self.tails, (self.nothing, 1.0 / longest), np.ascontiguousarray(ranges),
            self.sensor.range_min, out, supported,
        )  # fmt: skip
        return out, supported

    def draw(
        self, poses: Floats, uniform: Floats, normal: Floats, rays: Ints | slice = slice(None)
    ) -> Floats:
        """Draw one reading of rays (n_rays,) at poses (n_poses, 3) from the mixture, as `draw_readings` does."""
        return draw_readings(self, poses, np.arange(self.sensor.n_rays)[rays], uniform, normal)

    def equation(self, ray: int) -> str:
        """Return the equations of a ray's range and the coefficients of the visibility polynomial as text."""
        bearing = np.degrees(self.sensor.bearings[ray])
        lines = [
            f"ray {ray}, bearing {bearing:.2f} deg: the faces k of the cells that it crosses, sorted by range, give",
            "r_k = (d_k - n_k . q) / (n_k . u)   [m]   q: laser, u: direction, n_k . p = d_k: line through the hits",
            "w_k = (1 - (1 - a_k)^(l_k / g)) * (probability that no cell before stopped it)   "
            f"l_k: length in the cell, g = {self.table.cell:g} m",
            f"a mixture of Gaussians with variance {self.table.sigma:.4f}^2 + {self.table.across:.4f}^2 tan^2(incidence) m^2 about "
            f"a line, {self.table.rough:.4f}^2 m^2 without a line; the remaining weight is no return within {self.table.reach:g} m",
            f"of these errors, {100 * self.tails[0]:.0f} % are {self.tails[2]:.2f} times as wide, the others {self.tails[1]:.2f} times",
            "",
            f"logit a = sum of {len(TERMS)} terms; counts enter as log(1 + 3 count)",
        ]
        lines += [f"{value:>14.6g}  {name}" for name, value in zip(TERMS, self.beta, strict=True)]
        return "\n".join(lines)

    def summary(self) -> Mapping[str, str]:
        """Return number of cells, training data, spread and reach."""
        c = self.counts
        return {
            "form": f"{len(self.table.rate) - 1} cells of {self.table.cell:g} m, one polynomial of {len(TERMS)} terms for all",
            "from": f"{c['hits']} hits of {c['key_frames']} key frames ({c['scans']} scans); "
            f"{c['set_aside']} of them set aside to learn visibility",
            "sigma": f"{self.table.sigma:.3g} m about a line, {self.table.rough:.3g} m without one",
            "reach": f"{self.table.reach:g} m; {100 * self.nothing:.0f} % of the readings beyond are missing returns, the others are not answered",
        }

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that hold the whole model."""
        t = self.table
        header = {
            "cell": t.cell,
            "reach": t.reach,
            "sigma": t.sigma,
            "across": t.across,
            "rough": t.rough,
            "nothing": self.nothing,
            "counts": dict(self.counts),
            "shape": list(t.rows.shape),
        }
        arrays: dict[str, NDArray[Any]] = {
            "low": t.low,
            "kept": np.packbits(t.rows >= 0),
            "rate": t.rate,
            "angle": t.angle,
            "offset": t.offset,
            "is_seen": t.is_seen,
            "beta": self.beta,
            "said": self.reliability,
            "tails": self.tails,
            "mount": self.mount,
        }
        header["frames"], own = self.frames.state()
        return header, arrays | {f"frames.{name}": array for name, array in own.items()}

    @classmethod
    def restore(
        cls, sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Self:
        """Recreate the model from the output of `state`.

        Raises
        ------
        ValueError : An array has a wrong shape, or a number is out of range.
        """
        nx, ny = map(int, header["shape"])
        if min(nx, ny) < 1 or (nx * ny + 7) // 8 != arrays["kept"].size:
            raise ValueError(f"{arrays['kept'].size} bytes cannot hold {nx} x {ny} cells")
        kept = np.unpackbits(arrays["kept"], count=nx * ny).astype(np.bool_).reshape(nx, ny)
        n = int(kept.sum())
        index = np.full((nx, ny), -1, dtype=np.int32)
        index[kept] = np.arange(n, dtype=np.int32)
        expected = {
            "rate": (n + 1, 16), "angle": (n + 1, 16), "offset": (n + 1, 16), "is_seen": (n + 1,),
            "beta": (len(TERMS),), "said": (len(POINTS), len(KNOTS)), "mount": (3,), "low": (2,), "tails": (3,),
        }  # fmt: skip
        for name, shape in expected.items():
            kind = {"rate": "u1", "angle": "u1", "is_seen": "u1", "offset": "i1"}.get(name, "f8")
            if arrays[name].dtype != kind:
                raise ValueError(f"{name} holds {arrays[name].dtype}, expected {np.dtype(kind)}")
            check_shape(name, arrays[name], shape)
        check_range("rate", arrays["rate"], 0, len(RATES) - 1)
        check_range("said", arrays["said"], 0, 1)
        check_range("nothing", header["nothing"], 0, 1)
        for name in ("cell", "reach", "sigma", "rough"):
            check_positive(name, header[name])
        check_range("across", header["across"], 0)
        check_range("share of wide errors", arrays["tails"][0], 0, 1)
        check_positive("the smaller factor of tails", arrays["tails"][1:].min())
        table = CellTable(
            low=arrays["low"], cell=float(header["cell"]), reach=float(header["reach"]), rows=index,
            rate=arrays["rate"], angle=arrays["angle"], offset=arrays["offset"],
            sigma=float(header["sigma"]), across=float(header["across"]),
            rough=float(header["rough"]), is_seen=arrays["is_seen"],
        )  # fmt: skip
        return cls(
            sensor=sensor, mount=arrays["mount"], table=table, beta=arrays["beta"], reliability=arrays["said"],
            tails=arrays["tails"], nothing=float(header["nothing"]), counts=header["counts"],
            frames=KeyFrames.restore(header["frames"], with_prefix("frames.", arrays)),
        )  # fmt: skip
