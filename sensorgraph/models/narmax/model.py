"""Model `narmax`: r(k) = theta·phi(k) + sum_l c_l e(k-l) + e(k) for every ray.

The terms phi are monomials of lagged poses and the twist, and lagged readings of the ray and its neighbours. A scan is
predicted from earlier scans: one step ahead of measured readings, or in free run from predicted ones. For a pose
without history the start equation applies, a static polynomial of the same degree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from robotmodic_ident import Terms
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import OFF_DISTANCE, Point, Prediction, TrainingScans, check_options
from sensorgraph.models.distribution import Mixture, single_mixture
from sensorgraph.models.likelihood import log_density
from sensorgraph.models.mixture import gaussian_prediction
from sensorgraph.models.narmax import recursion
from sensorgraph.models.narmax.equations import equation_text, summary_of
from sensorgraph.models.narmax.fit import TrainingRows, fit_dropouts, fit_rays, ray_spacing, sequence_of
from sensorgraph.models.narmax.parameters import FREE_RUN, ONE_STEP, START, NarmaxParameters
from sensorgraph.models.narmax.sequences import ScanSequence
from sensorgraph.models.narmax.stored_form import ARRAYS, OPTIONS, form_of, restored
from sensorgraph.models.polynomial.support import (
    MAX_LEVERAGE,
    POSES_PER_BLOCK,
    QUANTILES,
    Support,
    leverage_limit,
    leverage_root,
    residual_spread,
    scale_of,
    sees_around,
)
from sensorgraph.types import Bools, Floats, Ints, Progress

SCORED_SCANS = 5000
"""Number of training scans, from the start, whose errors determine the standard deviations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RayNarmax(NarmaxParameters):
    """The equations of all rays, and where they are supported by data."""

    name: ClassVar[str] = "narmax"
    OPTIONS: ClassVar[Mapping[str, Any]] = OPTIONS

    @classmethod
    def fit(cls, scans: TrainingScans, *, progress: Progress | None = None, **options: Any) -> Self:
        """Select and estimate the terms of every ray; options: lags, degree, neighbours, noise_lags, n_terms.

        Raises
        ------
        SensorgraphError : An option is unknown or out of range, no stretch is long enough, or no ray returned.
        """
        check_options(cls, options)
        form = form_of(options)
        if scans.ray_poses is not None:
            raise SensorgraphError(
                "the model narmax needs the same pose for all rays of a scan; this laser sweeps, or several sensors are "
                "combined: choose model polynomial or faces"
            )
        data = TrainingRows.of(scans, form.lags)
        form = replace(form, spacing=ray_spacing(data, scans.sensor.bearings, form.neighbours))
        scale = scale_of(scans)
        fitted = fit_rays(data, form, scale, progress)
        static = form.shared[form.static.tolist()]
        phi = static.matrix(data.motion.signals(np.arange(len(scans)), 0), scale, n=len(scans))
        theta_none, memory = fit_dropouts(scans.ranges, phi, data.motion.position)
        root = leverage_root(phi.T @ phi)
        limit = leverage_limit(((phi @ root) ** 2).sum(axis=1))
        zero = np.zeros((3, scans.sensor.n_rays))
        draft = cls(
            sensor=scans.sensor, form=form, scale=scale, theta_none=theta_none, memory=memory, root=root,
            leverage_limit=limit, sigma=zero, spread=np.zeros((*zero.shape, len(QUANTILES))),
            support=Support.of(scans.poses, sees_around=sees_around(scans.sensor)),
            used={
                "scans": len(scans), "rows": len(data.rows), "dropped": data.dropped,
                "stretches": int(data.motion.sequence[-1]) + 1,
            },
            **fitted,
        )  # fmt: skip
        return draft._with_residuals(scans)

    def _with_residuals(self, scans: TrainingScans) -> Self:
        """Estimate sigma and spread on the first training scans, corrected for the number of terms."""
        scored = scans.part(slice(0, SCORED_SCANS))
        motion = sequence_of(scored)
        equations = self.equations(motion)
        after = motion.position >= self.form.lags
        predicted = [equations.start, recursion.run(equations, scored.ranges), recursion.run(equations)]
        used = [(self.start_order >= 0).sum(axis=1), *2 * [(self.order >= 0).sum(axis=1)]]
        most = self.sensor.range_max - self.sensor.range_min
        sigma, spread = np.empty((3, self.n_rays)), np.empty((3, self.n_rays, len(QUANTILES)))
        for kind in range(3):
            rows = slice(None) if kind == START else after
            size = np.abs(scored.ranges[rows] - predicted[kind][rows])
            for ray in range(self.n_rays):
                own = size[np.isfinite(size[:, ray]), ray]
                share = len(own) / max(self.rows[ray], len(own), 1)
                sigma[kind, ray], spread[kind, ray] = residual_spread(own, share * used[kind][ray], most)
        return replace(self, sigma=sigma, spread=spread)

    def equations(self, motion: ScanSequence) -> recursion.Equations:
        """Evaluate everything that does not depend on readings, for a sequence of scans."""
        n = len(motion.poses)
        chosen, weights = self._driven_terms
        rows = np.flatnonzero(motion.position >= self.form.lags)
        driven = np.zeros((n, self.n_rays))
        for start in range(0, len(rows), POSES_PER_BLOCK):
            some = rows[start : start + POSES_PER_BLOCK]
            signals = motion.signals(some, self.form.lags)
            driven[some] = chosen.matrix(signals, self.scale, n=len(some)) @ weights
        return recursion.Equations(
            form=self.form, scale=self.readings, gains=self._gains, noise=self.noise,
            limits=(self.sensor.range_min, self.sensor.range_max), position=motion.position,
            twists=motion.twists, start=self._start(motion.poses), driven=driven,
        )  # fmt: skip

    @cached_property
    def _driven_terms(self) -> tuple[Terms, Floats]:
        """Shared terms that any ray uses, and their coefficients (n_terms, n_rays)."""
        m = len(self.form.shared)
        weights = np.zeros((m, self.n_rays))
        ray, j = np.nonzero((self.order >= 0) & (self.order < m))
        weights[self.order[ray, j], ray] = self.theta[ray, j]
        terms = np.flatnonzero(weights.any(axis=1))
        return self.form.shared[terms.tolist()], weights[terms]

    @cached_property
    def _static_terms(self) -> Terms:
        return self.form.shared[self.form.static.tolist()]

    @cached_property
    def _gains(self) -> recursion.ReadingGains:
        return recursion.ReadingGains.of(self.form, self.order, self.theta)

    def no_return_chances(self, motion: ScanSequence, missing: Floats | Bools | None) -> Floats:
        """Return the probability of no return (n, n_rays) for consecutive scans.

        Parameters
        ----------
        missing : (n_rays,) Whether the preceding scan had no return. None: unknown.
        """
        base = self._static(motion.poses) @ self.theta_none.T
        if missing is None:
            return recursion.dropout_chances(base, self.memory, motion.position, None)
        return np.clip(base + self.memory * missing, 0.0, 1.0)

    def _static(self, poses: Floats) -> Floats:
        """Return the terms (n, n_static) of poses (n, 3) without history."""
        motion = ScanSequence(poses=poses, stamps=np.zeros(len(poses)), sequence=np.arange(len(poses)))
        return self._static_terms.matrix(motion.signals(np.arange(len(poses)), 0), self.scale, n=len(poses))

    def _start(self, poses: Floats) -> Floats:
        """Return the readings (n, n_rays) [m] of the start equation."""
        place = np.full(len(self.form.shared), -1)
        place[self.form.static] = np.arange(len(self.form.static))
        weights = np.zeros((len(self.form.static), self.n_rays))
        ray, j = np.nonzero(self.start_order >= 0)
        weights[place[self.start_order[ray, j]], ray] = self.start_theta[ray, j]
        out = np.empty((len(poses), self.n_rays))
        for start in range(0, len(poses), POSES_PER_BLOCK):
            some = slice(start, start + POSES_PER_BLOCK)
            out[some] = self._static(poses[some]) @ weights
        return np.clip(out, self.sensor.range_min, self.sensor.range_max)

    def predict(self, poses: Floats, rays: Ints, point: Point) -> Prediction:
        """Predict rays (n_rays,) at poses (n_poses, 3) without history, by the start equation."""
        none = np.clip(self._static(poses) @ self.theta_none.T / (1.0 - self.memory), 0.0, 1.0)
        return self._prediction(poses, self._start(poses), none, START, rays)

    def predict_sequence(
        self, motion: ScanSequence, rays: Ints, measured: Floats | None = None
    ) -> Prediction:
        """Predict consecutive scans: one step ahead of `measured` (n, n_rays of the graph) [m], or in free run.

        In `measured`, +inf is no return and nan a broken reading; the lags then use the last return.
        """
        base = self._static(motion.poses) @ self.theta_none.T
        missing = None if measured is None else np.where(np.isnan(measured), np.nan, np.isposinf(measured))
        none = recursion.dropout_chances(base, self.memory, motion.position, missing)
        value = recursion.run(self.equations(motion), measured)
        kind = FREE_RUN if measured is None else ONE_STEP
        return self._prediction(motion.poses, value, none, kind, rays)

    def _prediction(self, poses: Floats, value: Floats, none: Floats, kind: int, rays: Ints) -> Prediction:
        with np.errstate(over="ignore"):  # the value is limited
            leverage = np.minimum(((self._static(poses) @ self.root) ** 2).sum(axis=1), MAX_LEVERAGE)
        trusted: Bools = (leverage <= self.leverage_limit) & self.support.covers(poses)
        widen = np.sqrt(1.0 + leverage) if kind == START else np.ones(len(poses))
        off = np.stack(
            [
                1.0 - np.interp(OFF_DISTANCE / widen, self.spread[kind, ray], QUANTILES)
                for ray in rays.tolist()
            ],
            axis=1,
        )
        value, none = value[:, rays], none[:, rays]
        sigma, answered = self.sigma[kind, rays] * widen[:, None], trusted[:, None] & (self.rows[rays] > 0)
        return gaussian_prediction(value, sigma, none, off, answered)

    def mixture(self, poses: Floats, rays: Ints) -> Mixture:
        """Return the mixtures of rays (n_rays,) at poses (n_poses, 3): one Gaussian each."""
        found = self.predict(poses, rays, "mean")
        return single_mixture(found.mean, found.sigma, found.p_no_return)

    def log_likelihood(self, ranges: Floats, poses: Floats, rays: Ints) -> tuple[Floats, Bools]:
        """Return log-likelihoods (n_poses, n_rays) of readings (n_poses or 1, n_rays) [m], and which rays data support."""
        found = self.predict(poses, rays, "mean")
        mixture = single_mixture(found.mean, found.sigma, found.p_no_return)
        return log_density(mixture, ranges, self.sensor.range_min, 0.0), found.answered

    def equation(self, ray: int) -> str:
        """Return one ray's equation with lags in metres and radians, its tests, and the fitted terms as text."""
        return equation_text(self, ray)

    def summary(self) -> Mapping[str, str]:
        """Return form, fitted scans, standard deviations, tests and support as label -> text."""
        return summary_of(self)

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that describe the whole model."""
        support, arrays = self.support.state()
        header = {
            "form": self.form.to_dict(),
            "scale": self.scale.to_dict(),
            "readings": [self.readings.centre, self.readings.width],
            "leverage_limit": self.leverage_limit,
            "support": support,
            "used": dict(self.used),
        }
        return header, arrays | {name: getattr(self, name) for name in ARRAYS}

    @classmethod
    def restore(
        cls, sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Self:
        """Recreate the model from the output of `state`.

        Raises
        ------
        ValueError : An array has a wrong shape or an invalid term index.
        """
        return cls(**restored(sensor, header, arrays))
