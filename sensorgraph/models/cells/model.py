"""Model `cells`: cell-faces in 5 cm cells, whose visibility is one learned polynomial of the evidence around them.

For worlds without long clean faces, and for poses with noise. Evidence (hits, passes, by direction) is gathered in
one pass; how likely a cell stops a ray is a polynomial of that evidence, learned on stretches of the log that the
evidence leaves out. A prediction marches through the cells and gives a mixture of what may be hit.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import OFF_DISTANCE, POINTS, Point, Prediction, TrainingScans
from sensorgraph.models.cells.evidence import CELL_SIZE, MAX_REACH, MIN_RANGE, CellEvidence
from sensorgraph.models.cells.grid import per_ray
from sensorgraph.models.cells.learning import fit_logistic, is_set_aside, training_samples
from sensorgraph.models.cells.probability_calibration import KNOTS, best_sigma, calibrate_p_off
from sensorgraph.models.cells.ray_march import RATES, CellTable, list_candidates, summarise_rays, tabulate
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.cells.visibility import TERMS
from sensorgraph.models.mixture import MODE, NO_RETURN, P_OFF, to_prediction, which_of
from sensorgraph.models.stored_numbers import check_positive, check_range, check_shape
from sensorgraph.types import Bools, Floats, Ints, Progress

MIN_CELL, MAX_CELL = 0.01, 0.5
"""[m] sides of a cell that may be asked for."""


@cache
def shipped_visibility() -> tuple[float, ...]:
    """Return the coefficients that come with the software, learned from several buildings.

    Raises
    ------
    ValueError : visibility.json has other terms than the polynomial
    """
    table = json.loads((files("sensorgraph.data") / "visibility.json").read_text())["beta"]
    if tuple(table) != TERMS:
        raise ValueError("visibility.json has other terms than the polynomial; learn it again")
    return tuple(table.values())


@dataclass(frozen=True, kw_only=True, eq=False)
class CellModel:
    """A table of cells, and the polynomial it was made with."""

    name: ClassVar[str] = "cells"

    sensor: RangeSensor
    mount: Floats
    """(3,) [m, m, rad] laser in the frame of the poses."""
    table: CellTable
    beta: Floats
    """(n_terms,) coefficients of visibility."""
    reliability: Floats
    """(3, n_knots) seen chance of being off at `KNOTS` of the said one, for each of `POINTS`."""
    nothing: float
    """Share of no return at all among the readings beyond reach; the others saw something farther."""
    counts: Mapping[str, int]
    """What it was made from: scans, key_frames, set_aside, hits."""

    @classmethod
    def fit(cls, scans: TrainingScans, *, progress: Progress | None = None, **options: Any) -> Self:
        """Gather evidence of all key frames; learn visibility and calibration on stretches set aside before.

        Raises
        ------
        SensorgraphError : an option is unknown, the cell has no sensible size, or no ray returned within reach
        """
        if unknown := set(options) - {"cell"}:
            raise SensorgraphError(
                f"option {', '.join(sorted(unknown))} is not known to the model cells; expected cell [m]"
            )
        cell = float(options.get("cell", CELL_SIZE))
        if not MIN_CELL <= cell <= MAX_CELL:
            raise SensorgraphError(f"cell is {cell:g} m, expected {MIN_CELL:g} to {MAX_CELL:g}")
        keep = is_key_frame(scans.poses, scans.run)
        mount = scans.laser_mount
        taken = scans.poses if scans.ray_poses is None else scans.ray_poses
        poses, ranges = laser_poses(taken[keep], mount), scans.ranges[keep]
        bearings = scans.sensor.bearings
        reach = min(MAX_REACH, scans.sensor.range_max)
        if not ((ranges > MIN_RANGE) & (ranges < reach)).any():
            raise SensorgraphError(
                f"no ray of any training scan returned between {MIN_RANGE} and {reach:g} m"
            )
        report = progress or (lambda done, total: None)
        beta, sigma, said = learn_visibility(poses, ranges, bearings, cell, reach, report)
        evidence = CellEvidence.of(poses, ranges, bearings, cell=cell, reach=reach)
        table = tabulate(evidence.widened(), beta, sigma)
        report(5, 5)
        far, none = int((ranges >= reach).sum()), int(np.isposinf(ranges).sum())
        counts = {
            "scans": len(scans),
            "key_frames": len(poses),
            "set_aside": int(is_set_aside(len(poses)).sum()) if len(poses) >= CELLS.learning.min_scans else 0,
            "hits": int(evidence.hits[: evidence.n_rows].sum()),
        }
        return cls(
            sensor=scans.sensor,
            mount=mount,
            table=table,
            beta=beta,
            reliability=said,
            nothing=none / max(far, 1),
            counts=counts,
        )

    def predict(self, poses: Floats, rays: Ints, point: Point) -> Prediction:
        """Predict rays (n_rays,) at poses (n_poses, 3)."""
        out, near, dark = summarise_poses(
            self.table, laser_poses(poses, self.mount), self.sensor.bearings[rays], point
        )
        out[..., P_OFF] = np.interp(out[..., P_OFF], KNOTS, self.reliability[which_of(point)])
        beyond = out[..., NO_RETURN] > 0.5
        out[..., NO_RETURN] *= self.nothing
        answered = (dark <= CELLS.answers.max_unseen_way) & np.where(
            beyond, out[..., NO_RETURN] > 0.5, near >= CELLS.answers.min_near_chance
        )
        return to_prediction(out, point, answered)

    def draw(
        self, poses: Floats, uniform: Floats, normal: Floats, rays: Ints | slice = slice(None)
    ) -> Floats:
        """Draw one reading of rays (n_rays,) at poses (n_poses, 3) from the mixture.

        `uniform` and `normal` (n_poses, n_rays) are the numbers drawn; the same ones give the same outcomes. The least
        uniform numbers have no return, those above it are off the mode, as often as `predict` says by what was seen, the
        farthest first and last those that only noise put there; a reading that is not off lies about the mode with the
        cells' sigma, as near as that.
        """
        out = np.full(uniform.shape, np.inf)
        bearings = self.sensor.bearings[rays]
        lasers = laser_poses(poses, self.mount)
        said, _, _ = summarise_poses(self.table, lasers, bearings, "mode")
        from scipy.special import ndtr, ndtri  # takes long to import, for drawing only

        sigma_here = self.table.sigma
        by_noise = max(math.erfc(OFF_DISTANCE / (math.sqrt(2.0) * sigma_here)), 1e-300)
        p_off = np.interp(said[..., P_OFF], KNOTS, self.reliability[which_of("mode")])
        chance = ndtr(normal)
        near = sigma_here * ndtri(0.5 * by_noise + (1.0 - by_noise) * chance)
        far = sigma_here * np.where(chance < 0.5, ndtri(by_noise * chance), -ndtri(by_noise * (1.0 - chance)))
        for i, pose in enumerate(lasers):
            r, w, sigma, left = (part[0] for part in list_candidates(self.table, pose[None], bearings))
            mode = said[i, :, MODE]
            beyond = (
                left * self.nothing
            )  # what goes beyond reach returns nothing by that share, else it is not known
            nothing = beyond / np.maximum(w.sum(axis=1) + beyond, 1e-300)
            off = np.where(np.abs(r - mode[:, None]) > OFF_DISTANCE, w, 0.0)
            to_end = np.cumsum(off[:, ::-1], axis=1)[:, ::-1]  # (n_rays, n_most) of this and all farther
            by_cells = to_end[:, 0]
            all_off = by_cells + by_noise * np.maximum(w.sum(axis=1) - by_cells, 0.0)
            rest = (uniform[i] - nothing) / np.maximum(1.0 - nothing, 1e-300)
            is_there = (rest >= 0) & (w > 0).any(axis=1)
            is_off = is_there & (rest < p_off[i]) & (all_off > 0)
            share = np.where(is_off, all_off * rest / np.maximum(p_off[i], 1e-300), np.inf)
            rows = np.flatnonzero(share < by_cells)
            k = (to_end[rows] > share[rows, None]).sum(axis=1) - 1
            by_chance, is_on = is_off & ~(share < by_cells), is_there & ~is_off
            out[i, rows] = r[rows, k] + sigma[rows, k] * normal[i, rows]
            out[i, by_chance] = mode[by_chance] + far[i, by_chance]
            out[i, is_on] = mode[is_on] + near[i, is_on]
        return out

    def equation(self, ray: int) -> str:
        """Print how a ray's range comes about, and the polynomial of visibility with its numbers."""
        bearing = np.degrees(self.sensor.bearings[ray])
        lines = [
            f"ray {ray}, bearing {bearing:.2f} deg: sorted by range, the faces k of the cells on its way give",
            "r_k = (d_k - n_k . q) / (n_k . u)   [m]   q: laser, u: direction, n_k . p = d_k: line through the hits",
            "w_k = (1 - (1 - a_k)^(l_k / g)) * (chance that no cell before stopped it)   "
            f"l_k: way in the cell, g = {self.table.cell:g} m",
            f"a mixture of Gaussians with sigma {self.table.sigma:.4f} m; what is left is no return within {self.table.reach:g} m",
            "",
            f"logit a = sum of {len(TERMS)} terms; counts enter as log(1 + 3 count)",
        ]
        lines += [f"{value:>14.6g}  {name}" for name, value in zip(TERMS, self.beta, strict=True)]
        return "\n".join(lines)

    def summary(self) -> Mapping[str, str]:
        """Return how many cells, what they come from, and the spread about them."""
        c = self.counts
        return {
            "form": f"{len(self.table.rate) - 1} cells of {self.table.cell:g} m, one polynomial of {len(TERMS)} terms for all",
            "from": f"{c['hits']} hits of {c['key_frames']} key frames ({c['scans']} scans); "
            f"{c['set_aside']} of them set aside to learn visibility",
            "sigma": f"{self.table.sigma:.3g} m about a face",
            "reach": f"{self.table.reach:g} m; {100 * self.nothing:.0f} % of what goes farther returns nothing, the rest is not answered",
        }

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that hold the whole model."""
        t = self.table
        header = {
            "cell": t.cell,
            "reach": t.reach,
            "sigma": t.sigma,
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
            "mount": self.mount,
        }
        return header, arrays

    @classmethod
    def restore(
        cls, sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Self:
        """Build the model from what `state` gave.

        Raises
        ------
        ValueError : an array has a wrong shape, or a number that no table has
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
            "beta": (len(TERMS),), "said": (len(POINTS), len(KNOTS)), "mount": (3,), "low": (2,),
        }  # fmt: skip
        for name, shape in expected.items():
            kind = {"rate": "u1", "angle": "u1", "is_seen": "u1", "offset": "i1"}.get(name, "f8")
            if arrays[name].dtype != kind:
                raise ValueError(f"{name} holds {arrays[name].dtype}, expected {np.dtype(kind)}")
            check_shape(name, arrays[name], shape)
        check_range("rate", arrays["rate"], 0, len(RATES) - 1)
        check_range("said", arrays["said"], 0, 1)
        check_range("nothing", header["nothing"], 0, 1)
        for name in ("cell", "reach", "sigma"):
            check_positive(name, header[name])
        table = CellTable(
            low=arrays["low"], cell=float(header["cell"]), reach=float(header["reach"]), rows=index,
            rate=arrays["rate"], angle=arrays["angle"], offset=arrays["offset"],
            sigma=float(header["sigma"]), is_seen=arrays["is_seen"],
        )  # fmt: skip
        return cls(
            sensor=sensor, mount=arrays["mount"], table=table, beta=arrays["beta"], reliability=arrays["said"],
            nothing=float(header["nothing"]), counts=header["counts"],
        )  # fmt: skip


def is_key_frame(poses: Floats, run: Ints) -> Bools:
    """Tell which scans are key frames: the first of each run, and each that is far enough from the last key frame."""
    keep = np.zeros(len(poses), dtype=np.bool_)
    last = -1
    for i, (x, y, phi) in enumerate(poses.tolist()):
        if last >= 0 and run[i] == run[last]:
            x0, y0, phi0 = poses[last]
            turn = np.pi - abs(np.pi - abs(phi - phi0) % (2 * np.pi))
            if (
                np.hypot(x - x0, y - y0) < CELLS.evidence.key_frame_distance
                and turn < CELLS.evidence.key_frame_turn
            ):
                continue
        keep[i] = True
        last = i
    return keep


def laser_poses(poses: Floats, mount: Floats) -> Floats:
    """Return the laser's pose in map (..., 3) for poses (..., 3) of the frame it is mounted in."""
    cos, sin = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x = poses[..., 0] + cos * mount[0] - sin * mount[1]
    y = poses[..., 1] + sin * mount[0] + cos * mount[1]
    return np.stack([x, y, poses[..., 2] + mount[2]], axis=-1)


def learn_visibility(
    poses: Floats, ranges: Floats, bearings: Floats, cell: float, reach: float, report: Progress
) -> tuple[Floats, float, Floats]:
    """Learn beta (n_terms,), sigma [m] and the calibration (3, n_knots) on stretches that the evidence leaves out."""
    beta = np.array(shipped_visibility())
    said = np.tile(KNOTS, (len(POINTS), 1))
    if len(poses) < CELLS.learning.min_scans:
        return beta, CELLS.answers.first_sigma, said
    aside = is_set_aside(len(poses))
    evidence = CellEvidence.of(poses[~aside], ranges[~aside], bearings, cell=cell, reach=reach).widened()
    report(1, 5)
    table = tabulate(evidence, beta, CELLS.answers.first_sigma)
    report(2, 5)
    apart = poses[aside], ranges[aside], bearings
    phi, label, weight = training_samples(evidence, *apart, table)
    beta = fit_logistic(phi, label, weight, beta, beta, steps=CELLS.learning.newton_steps)
    report(3, 5)
    table = tabulate(evidence, beta, CELLS.answers.first_sigma)
    table = table._replace(sigma=best_sigma(*apart, table))
    every = np.array(
        [summarise_poses(table, poses[aside], bearings, point)[0] for point in ("mode", "median", "mean")]
    )
    scored = (ranges[aside] > MIN_RANGE) & (ranges[aside] < reach)
    report(4, 5)
    return beta, table.sigma, calibrate_p_off(every, ranges[aside], scored)


def summarise_poses(
    table: CellTable, poses: Floats, bearings: Floats, point: Point
) -> tuple[NDArray[np.float64], Floats, Floats]:
    """March all rays from poses (n, 3), or (n, n_rays, 3); return (n_poses, n_rays, 6) summaries, chance within 10 cm of the median, way [m] never seen."""
    shape = (len(poses), len(bearings))
    out, near, dark = np.empty((*shape, 6)), np.empty(shape), np.empty(shape)
    summarise_rays(per_ray(poses), bearings, table, which_of(point), out, near, dark)
    return out, near, dark
