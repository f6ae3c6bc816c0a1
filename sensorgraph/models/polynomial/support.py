"""Support: poses near training poses, at which a model fitted to poses is supported by data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from robotmodic_ident import Scale
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.polynomial.settings import POLYNOMIAL
from sensorgraph.models.stored_numbers import check_positive, check_range, check_shape
from sensorgraph.types import Bools, Floats

CellKeys = NDArray[np.int64]

N_SECTORS = 8
"""Number of heading sectors."""
MIN_SUPPORTED = 0.95
"""Minimum share of the training poses that their neighbours support, for a cell size to be sufficient."""
FULL_CIRCLE = 1.95 * np.pi
"""[rad] Field of view above which the sensor sees all around."""
LEVERAGE_QUANTILE, LEVERAGE_FACTOR = 0.995, 2.0
"""A pose is an extrapolation above this multiple of that quantile of the leverage of training poses, each as if it were new."""
MAX_LEVERAGE = 1e12
"""Upper limit of the leverage that widens a standard deviation."""
MIN_EIGENVALUE = 1e-10
"""Lower limit of the eigenvalues of the Gram matrix relative to the largest: precision of unvaried directions."""
MIN_SIGMA = 1e-6
"""[m] Lower limit of a ray's standard deviation."""
ROWS_PER_TERM = 5
"""Minimum number of returns per term of a ray; with fewer it has fewer terms, at least the mean."""
POSES_PER_BLOCK = 4096
"""Number of poses processed at a time; it limits memory."""
QUANTILES = np.linspace(0.0, 1.0, 33)
"""Probabilities of the stored quantiles of the absolute residual."""
_KEY_SPAN = 1 << 28  # number of cells along an axis that a key distinguishes


@dataclass(frozen=True, kw_only=True, eq=False)
class Support:
    """Cells over (x, y, heading) that contain training poses; their neighbours are also supported."""

    cell: float
    """[m] Side of a position cell."""
    n_sectors: int
    """Number of heading sectors; 1 if the sensor sees all around."""
    origin: Floats
    """(2,) [m] corner of cell (0, 0)."""
    keys: CellKeys
    """(n_cells,) sorted keys of the visited cells."""

    @classmethod
    def of(cls, poses: Floats, *, sees_around: bool) -> Support:
        """Choose the smallest cell size for which enough of the poses (n, 3) have neighbours."""
        n_sectors = 1 if sees_around else N_SECTORS
        origin = poses[:, :2].min(axis=0)
        for cell in POLYNOMIAL.cell_sizes:
            keys, counts = np.unique(_keys(_cells(poses, cell, origin, n_sectors)), return_counts=True)
            support = cls(cell=cell, n_sectors=n_sectors, origin=origin, keys=keys)
            near = support._near(poses, counts) > 1  # another pose in addition to itself
            if near.mean() >= MIN_SUPPORTED:
                break
        return support

    def covers(self, poses: Floats) -> Bools:
        """Return a mask of the poses (n, 3) in a visited cell or next to one."""
        return self._near(poses, np.ones(len(self.keys), dtype=np.int64)) > 0

    def _near(self, poses: Floats, counts: CellKeys) -> CellKeys:
        """Sum the counts of each pose's cell and its neighbours."""
        home = _cells(poses, self.cell, self.origin, self.n_sectors)
        total = np.zeros(len(poses), dtype=np.int64)
        turns = (-1, 0, 1) if self.n_sectors >= 3 else (0,)
        for dx, dy, turn in product((-1, 0, 1), (-1, 0, 1), turns):
            cells = home + np.array([dx, dy, turn])
            cells[:, 2] %= self.n_sectors
            keys = _keys(cells)
            place = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
            total += np.where(self.keys[place] == keys, counts[place], 0)
        return total

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays."""
        header = {"cell": self.cell, "n_sectors": self.n_sectors, "origin": self.origin.tolist()}
        return header, {"visited": self.keys}

    @classmethod
    def restore(cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Support:
        """Recreate the support from the output of `state`.

        Raises
        ------
        ValueError : The keys are not a sorted array, or the cell size is not positive.
        """
        keys = arrays["visited"]
        check_shape("visited", keys, (max(keys.size, 1),), "i")
        if (keys[1:] <= keys[:-1]).any():
            raise ValueError("visited is not in increasing order")
        origin = np.array(header["origin"], dtype=np.float64)
        check_shape("the support's origin", origin, (2,))
        check_positive("the support's cell", header["cell"])
        check_range("n_sectors", header["n_sectors"], 1, N_SECTORS)
        return cls(
            cell=float(header["cell"]),
            n_sectors=int(header["n_sectors"]),
            origin=origin,
            keys=keys.astype(np.int64),
        )


def residual_spread(size: Floats, n_terms: float, most: float) -> tuple[float, Floats]:
    """Return the standard deviation [m] of a ray and the `QUANTILES` [m] of its absolute residual, from n returns.

    Both are corrected for k = `n_terms` coefficients: sigma² = sum size² / (n - k), and quantiles times sqrt(n / (n - k)).
    Without a degree of freedom the residual is taken as uniform up to `most` [m].

    Parameters
    ----------
    size : (n,) [m] Absolute residuals of the training returns.
    """
    free = len(size) - n_terms
    if free < 1:
        return most, most * QUANTILES
    grow = np.sqrt(len(size) / free)
    return max(float(grow * np.sqrt(np.mean(size**2))), MIN_SIGMA), grow * np.quantile(size, QUANTILES)


def leverage_root(gram: Floats) -> Floats:
    """Return W (m, m) with W W' = (Φ'Φ)⁻¹ from the Gram matrix Φ'Φ (m, m): the leverage of a pose is |φ W|².

    Directions in which the poses never varied keep a tiny variance, so that the leverage of a pose off them is huge.
    """
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors / np.sqrt(np.maximum(values, MIN_EIGENVALUE * values[-1])))


def leverage_limit(leverage: Floats) -> float:
    """Return the leverage above which a pose is an extrapolation, from the leverages (n,) of the training poses."""
    h = np.minimum(leverage, 1.0 - 1e-9)
    # h / (1 - h) is the leverage that a training pose would have as a new pose
    return float(LEVERAGE_FACTOR * np.quantile(h / (1.0 - h), LEVERAGE_QUANTILE))


def scale_of(scans: TrainingScans) -> Scale:
    """Return the scale of x and y, from the arena's bounds if known, otherwise from the poses."""
    if scans.bounds is not None:
        x0, y0, x1, y1 = scans.bounds
        return Scale.between({"x": (x0, x1), "y": (y0, y1)})
    return Scale.of({"x": scans.poses[:, 0], "y": scans.poses[:, 1]})


def sees_around(sensor: RangeSensor) -> bool:
    """Return whether a sensor sees all around, so that the observed space does not depend on its heading."""
    step = np.diff(sensor.bearings).mean() if sensor.n_rays > 1 else 0.0
    return bool(np.ptp(sensor.bearings) + step > FULL_CIRCLE)


def _cells(poses: Floats, cell: float, origin: Floats, n_sectors: int) -> CellKeys:
    """Return cell numbers (n, 3) along x, y and heading; sectors are centred on multiples of their width."""
    with np.errstate(invalid="ignore", over="ignore"):
        xy = np.floor((poses[:, :2] - origin) / cell)
        sector = np.mod(np.round(poses[:, 2] / (2 * np.pi / n_sectors)), n_sectors)
    table = np.column_stack([np.clip(xy, -_KEY_SPAN / 4, _KEY_SPAN / 4), sector])
    return np.where(np.isfinite(table), table, -_KEY_SPAN / 4).astype(np.int64)


def _keys(cells: CellKeys) -> CellKeys:
    shifted = cells[:, :2] + _KEY_SPAN // 2
    return np.asarray((shifted[:, 0] * _KEY_SPAN + shifted[:, 1]) * N_SECTORS + cells[:, 2], dtype=np.int64)
