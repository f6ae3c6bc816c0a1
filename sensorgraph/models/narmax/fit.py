"""Fit of the model `narmax`: from training scans to the arrays of the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from logs.sensor import median_step
from robotmodic_ident import Scale, Terms
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.narmax.candidates import NarmaxForm, ReadingColumns, ReadingScale
from sensorgraph.models.narmax.noise import RayEstimate, estimate
from sensorgraph.models.narmax.search import ChosenTerms, SharedMoments
from sensorgraph.models.narmax.sequences import ScanSequence, held
from sensorgraph.models.narmax.settings import NARMAX
from sensorgraph.models.polynomial.support import ROWS_PER_TERM
from sensorgraph.models.residual_memory import MAX_MEMORY
from sensorgraph.types import Floats, Ints, Progress

TURN_QUANTILE = 0.95
"""Quantile of the turns between scans [rad] up to which the neighbours reach."""
MAX_SEARCH_ROWS = 20_000
"""Maximum number of scans in the search for terms, evenly spread; coefficients are estimated on all scans."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingRows:
    """Training scans as rows of a regression; a row's lags lie in its stretch."""

    motion: ScanSequence
    ranges: Floats
    """(n, n_rays) [m] measured ranges; nan without a return."""
    readings: Floats
    """(n, n_rays) [m] last return of each ray."""
    rows: Ints
    """Indices of the scans with a full history."""

    @classmethod
    def of(cls, scans: TrainingScans, lags: int) -> TrainingRows:
        """Divide scans into stretches and select the rows.

        Raises
        ------
        SensorgraphError : No stretch is long enough, or no ray returned.
        """
        motion = sequence_of(scans)
        rows = np.flatnonzero(motion.position >= lags)
        if len(rows) < 2:
            raise SensorgraphError(
                f"no stretch of {lags + 2} scans without a gap among {len(scans)} training scans; give a log with consecutive "
                "scans, fewer `lags`, or split `block` instead of `every10`"
            )
        ranges = np.where(np.isfinite(scans.ranges), scans.ranges, np.nan)
        if not np.isfinite(ranges[rows]).any():
            raise SensorgraphError(
                "no ray of any training scan returned a range; record where the sensor sees something"
            )
        return cls(motion=motion, ranges=ranges, readings=held(ranges, motion.position), rows=rows)

    @property
    def dropped(self) -> int:
        """Number of scans at the start of a stretch, which serve as lags only."""
        return len(self.ranges) - len(self.rows)


def sequence_of(scans: TrainingScans) -> ScanSequence:
    """Return the stretches of training scans; no stretch extends over two runs.

    Raises
    ------
    SensorgraphError : The scans have no stamps.
    """
    if scans.stamps is None or scans.sequence is None:
        raise SensorgraphError("lags need the stamps of the scans; build from runs, with `build`")
    breaks = (np.diff(scans.run) != 0) | (np.diff(scans.sequence) != 0)
    return ScanSequence(
        poses=scans.poses, stamps=scans.stamps, sequence=np.r_[0, np.cumsum(breaks)].astype(np.intp)
    )


def ray_spacing(data: TrainingRows, bearings: Floats, neighbours: int) -> int:
    """Return the distance between neighbours in rays, so that they reach as far as the robot turns between scans."""
    if len(bearings) < 2 or neighbours < 1:
        return 1
    row = data.rows
    turn = np.abs(np.pi - (np.pi - (data.motion.poses[row, 2] - data.motion.poses[row - 1, 2])) % (2 * np.pi))
    farthest = float(np.quantile(turn, TURN_QUANTILE)) / median_step(bearings, np.inf)
    most = max(1, min(NARMAX.max_spacing, (len(bearings) - 1) // neighbours))
    return int(np.clip(np.ceil(farthest / neighbours), 1, most))


def fit_rays(
    data: TrainingRows, form: NarmaxForm, scale: Scale, progress: Progress | None = None
) -> dict[str, Any]:
    """Search, estimate and test the terms of every ray; return the arrays of the model by name."""
    n_rays = data.ranges.shape[1]
    readings = ReadingScale.of(data.ranges)
    step = -(-len(data.rows) // MAX_SEARCH_ROWS)
    some = data.rows[::step]
    columns = ReadingColumns(form, readings, data.readings, data.motion, some)
    phi = form.shared.matrix(data.motion.signals(some, form.lags), scale)
    moments = SharedMoments(phi, columns, data.ranges[some], form)
    total = 2 * n_rays

    def tick(done: int, _: int) -> None:
        if progress is not None:
            progress(done, total)

    lagged = list(moments.searches(is_static=False, progress=tick))
    static = list(moments.searches(is_static=True))
    del moments, phi
    estimator = _Estimator(data, form, scale, readings)
    k = max(1, max(len(found.order) for found in lagged))
    out = _empty(n_rays, k, max(1, max(len(found.order) for found in static)), form.noise_lags)
    for ray in range(n_rays):
        _store(out, ray, lagged[ray], static[ray], estimator)
        if progress is not None:
            progress(n_rays + ray + 1, total)
    return out | {"readings": readings}


def _empty(q: int, k: int, k_start: int, noise_lags: int) -> dict[str, Any]:
    return {
        "order": np.full((q, k), -1, dtype=np.int64),
        "err": np.zeros((q, k)),
        "theta": np.zeros((q, k)),
        "stderr": np.zeros((q, k)),
        "noise": np.zeros((q, noise_lags)),
        "noise_stderr": np.zeros((q, noise_lags)),
        "tests": np.full((q, 3), -1.0),
        "rows": np.zeros(q, dtype=np.int64),
        "start_order": np.full((q, k_start), -1, dtype=np.int64),
        "start_theta": np.zeros((q, k_start)),
    }


def _store(
    out: dict[str, Any], ray: int, found: ChosenTerms, start: ChosenTerms, estimator: _Estimator
) -> None:
    known = estimator.known(ray)
    out["rows"][ray] = len(known)
    if len(known) == 0:
        return
    result = estimator.lagged(ray, found.order, known)
    n = int(result.kept.sum())
    out["order"][ray, :n], out["err"][ray, :n] = found.order[result.kept], found.err[result.kept]
    out["theta"][ray, :n], out["stderr"][ray, :n] = result.theta, result.stderr
    out["noise"][ray], out["noise_stderr"][ray] = result.noise, result.noise_stderr
    out["tests"][ray] = np.where(np.isfinite(result.tests), result.tests, -1.0)
    n = len(start.order)
    out["start_order"][ray, :n] = start.order
    out["start_theta"][ray, :n] = estimator.static(ray, start.order, known)


class _Estimator:
    """Regression of one ray at a time: the columns of its terms over all its scans, and the coefficients."""

    def __init__(self, data: TrainingRows, form: NarmaxForm, scale: Scale, readings: ReadingScale) -> None:
        self.data, self.form, self.scale = data, form, scale
        self.columns = ReadingColumns(form, readings, data.readings, data.motion, data.rows)
        self.signals = data.motion.signals(data.rows, form.lags)
        self.all_known = self.columns.all_known()

    def known(self, ray: int) -> Ints:
        """Return the rows, by index, at which a ray returned and all its candidate readings are known."""
        return np.flatnonzero(self.all_known[:, ray] & np.isfinite(self.data.ranges[self.data.rows, ray]))

    def lagged(self, ray: int, order: Ints, known: Ints) -> RayEstimate:
        """Estimate the lagged equation of a ray on some rows."""
        m = len(self.form.shared)
        columns = np.empty((len(known), len(order)))
        shared = order < m
        columns[:, shared] = self._shared(order[shared], known)
        columns[:, ~shared] = self.columns.of_ray(ray, order[~shared] - m, known)
        rows = self.data.rows[known]
        return estimate(
            columns,
            self.data.ranges[rows, ray],
            self.data.motion.twists[rows],
            rows + self.data.motion.sequence[rows],  # a gap skips a number
            self.form.noise_lags,
        )

    def static(self, ray: int, order: Ints, known: Ints) -> Floats:
        """Return the coefficients of the start equation of a ray."""
        y = self.data.ranges[self.data.rows[known], ray]
        return np.asarray(np.linalg.lstsq(self._shared(order, known), y, rcond=None)[0])

    def _shared(self, order: Ints, known: Ints) -> Floats:
        terms: Terms = self.form.shared[order.tolist()]
        some = {name: self.signals[name][known] for name in terms.signals}
        return terms.matrix(some, self.scale, n=len(known))


def fit_dropouts(ranges: Floats, phi: Floats, position: Ints) -> tuple[Floats, Floats]:
    """Fit the probability of no return by least squares: P(k) = phi(k)·theta + memory missing(k-1).

    Parameters
    ----------
    ranges : (n, n_rays) Measured ranges; +inf: no return, nan: broken.
    phi : (n, m) Terms of the pose, the constant first.

    Returns
    -------
    theta (n_rays, m), memory (n_rays,)
    """
    n_rays, m = ranges.shape[1], phi.shape[1]
    theta, memory = np.zeros((n_rays, m)), np.zeros(n_rays)
    broken = np.isnan(ranges)
    missing = np.isposinf(ranges)
    for ray in np.flatnonzero(missing.any(axis=0)).tolist():
        before = np.r_[True, broken[:-1, ray]]
        use = ~broken[:, ray] & ~before & (position > 0)
        rows = np.column_stack([phi[use], np.r_[False, missing[:-1, ray]][use]])
        if len(rows) <= ROWS_PER_TERM:
            theta[ray, 0] = missing[:, ray].mean()
            continue
        y = missing[use, ray].astype(np.float64)
        if len(rows) < ROWS_PER_TERM * rows.shape[1]:
            rows[:, 1:-1] = 0.0  # too few rows for terms of the pose
        coefficients = np.linalg.lstsq(rows, y, rcond=None)[0]
        theta[ray], memory[ray] = coefficients[:-1], np.clip(coefficients[-1], 0.0, MAX_MEMORY)
    return theta, memory
