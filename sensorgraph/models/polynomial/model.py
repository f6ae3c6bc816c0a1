"""Model `polynomial`: r_j = sum_i theta_ji phi_i(x, y, phi), one polynomial for each ray j (published in 2004).

The terms phi_i are monomials of x and y times harmonics of phi. The rays share one dictionary and one pass over the
data. Each ray selects its terms by the error reduction ratio (ERR). The range is fitted to the returns; a second
polynomial of the same kind models the probability of no return.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from robotmodic_ident import Moments, Scale, Selection, Terms, fourier, polynomial, select
from robotmodic_ident.notation.expand import expand
from robotmodic_ident.notation.printing import sum_text
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import OFF_DISTANCE, Point, Prediction, TrainingScans, check_options
from sensorgraph.models.distribution import Mixture, single_mixture
from sensorgraph.models.likelihood import log_density
from sensorgraph.models.mixture import gaussian_prediction
from sensorgraph.models.polynomial.complexity import Auto, PolynomialForm, n_candidates, select_form
from sensorgraph.models.polynomial.stored_form import check_order, check_scale
from sensorgraph.models.polynomial.support import (
    MAX_LEVERAGE,
    POSES_PER_BLOCK,
    QUANTILES,
    ROWS_PER_TERM,
    Support,
    leverage_limit,
    leverage_root,
    residual_spread,
    scale_of,
    sees_around,
)
from sensorgraph.models.stored_numbers import check_range, check_shape
from sensorgraph.types import Bools, Floats, Ints, Progress

MAX_GRAM_NUMBERS = 1 << 23
"""Maximum number of entries (64 MB) of the Gram matrices with missing returns; more rays take several passes."""


def dictionary(degree: int, harmonics: int) -> Terms:
    """Return the products of monomials of x and y with harmonics of phi."""
    return polynomial(["x", "y"], degree) * fourier(["phi"], harmonics)


def columns(poses: Floats) -> dict[str, Floats]:
    """Return the columns of poses (n, 3) by variable name."""
    return {"x": poses[:, 0], "y": poses[:, 1], "phi": poses[:, 2]}


@dataclass(frozen=True, kw_only=True, eq=False)
class Polynomial:
    """Polynomials of all rays, and where they are supported by data."""

    name: ClassVar[str] = "polynomial"
    OPTIONS: ClassVar[Mapping[str, Any]] = dict.fromkeys(("degree", "harmonics", "n_terms"), Auto)

    sensor: RangeSensor
    form: PolynomialForm
    terms: Terms
    scale: Scale
    order: Ints
    """(n_rays, n_max) terms of each ray in order of selection; -1: none."""
    err: Floats
    """(n_rays, n_max) error reduction ratio of each term."""
    stderr: Floats
    """(n_rays, n_max) standard error of each coefficient."""
    theta: Floats
    """(n_rays, n_terms) [m] coefficients of the scaled terms."""
    theta_none: Floats
    """(n_rays, n_terms) coefficients of the probability of no return."""
    returns: Ints
    """(n_rays,) number of training scans with a return."""
    nothing: Ints
    """(n_rays,) number of training scans without a return (+inf)."""
    sigma: Floats
    """(n_rays,) [m] standard deviation of the residual."""
    spread: Floats
    """(n_rays, len(QUANTILES)) [m] quantiles of the absolute residual."""
    root: Floats
    """(n_terms, n_terms) W with W W' = (Φ'Φ)⁻¹ over all training scans: leverage is |φ W|²."""
    leverage_limit: float
    """Leverage above which a pose is an extrapolation."""
    support: Support

    @property
    def n_rays(self) -> int:
        """Number of rays."""
        return len(self.sigma)

    @classmethod
    def fit(
        cls,
        scans: TrainingScans,
        *,
        progress: Progress | None = None,
        **options: Auto,
    ) -> Self:
        """Select degree, harmonics and n_terms (the options) by cross-validation, then fit every ray.

        Raises
        ------
        SensorgraphError : An option is unknown, or no ray returned.
        """
        check_options(cls, options)
        if not np.isfinite(scans.ranges).any():
            raise SensorgraphError(
                "no ray of any training scan returned a range; record where the sensor sees something"
            )
        scale = scale_of(scans)
        form = select_form(scans, scale, dictionary, progress=progress, **options)
        terms = dictionary(form.degree, form.harmonics)
        fitted = _select_all(scans, terms, scale, form.n_terms, progress)
        root, limit = _leverage(scans, terms, scale, fitted.pop("gram"))
        draft = cls(
            sensor=scans.sensor, form=form, terms=terms, scale=scale, sigma=np.zeros(scans.sensor.n_rays),
            spread=np.zeros((scans.sensor.n_rays, len(QUANTILES))), root=root, leverage_limit=limit,
            support=Support.of(scans.poses, sees_around=sees_around(scans.sensor)), **fitted,
        )  # fmt: skip
        return draft._with_residuals(scans)

    def _with_residuals(self, scans: TrainingScans) -> Self:
        """Estimate sigma and spread from the residuals of the training scans, corrected for the number of terms."""
        residual = np.empty_like(scans.ranges)
        for rays in _rays_of_one_pose(scans, self.n_rays):
            for start in range(0, len(scans), POSES_PER_BLOCK):
                rows = slice(start, start + POSES_PER_BLOCK)
                phi = self.terms.matrix(columns(_poses(scans, rays, rows)), self.scale)
                residual[rows, rays] = np.abs(scans.ranges[rows, rays] - self._clip(phi @ self.theta[rays].T))
        sigma, spread = np.empty(self.n_rays), np.empty((self.n_rays, len(QUANTILES)))
        used = (self.order >= 0).sum(axis=1)
        span = self.sensor.range_max - self.sensor.range_min
        for i in range(self.n_rays):
            size = residual[np.isfinite(residual[:, i]), i]
            sigma[i], spread[i] = residual_spread(size, used[i], span)
        return type(self)(**{**self.__dict__, "sigma": sigma, "spread": spread})

    def _clip(self, ranges: Floats) -> Floats:
        return np.clip(ranges, self.sensor.range_min, self.sensor.range_max)

    def predict(self, poses: Floats, rays: Ints, point: Point) -> Prediction:
        """Predict rays (n_rays,) at poses (n_poses, 3); median, mode and mean are equal for a Gaussian."""
        shape = (len(poses), len(rays))
        value, sigma, none, off = (np.empty(shape) for _ in range(4))
        trusted = np.empty(len(poses), dtype=np.bool_)
        least = 0.5 / (self.returns[rays] + self.nothing[rays] + 1.0)
        for start in range(0, len(poses), POSES_PER_BLOCK):
            rows = slice(start, start + POSES_PER_BLOCK)
            phi = self.terms.matrix(columns(poses[rows]), self.scale)
            value[rows] = self._clip(phi @ self.theta[rays].T)
            none[rows] = np.clip(phi @ self.theta_none[rays].T, least, 1.0 - least)
            with np.errstate(over="ignore"):  # the value is limited
                leverage = np.minimum(((phi @ self.root) ** 2).sum(axis=1), MAX_LEVERAGE)
            widen = np.sqrt(1.0 + leverage)
            sigma[rows] = self.sigma[rays] * widen[:, None]
            for j, ray in enumerate(rays.tolist()):
                off[rows, j] = 1.0 - np.interp(OFF_DISTANCE / widen, self.spread[ray], QUANTILES)
            trusted[rows] = (leverage <= self.leverage_limit) & self.support.covers(poses[rows])
        known = self.returns[rays] + self.nothing[rays] > 0
        return gaussian_prediction(value, sigma, none, off, trusted[:, None] & known)

    def ray_terms(self, ray: int) -> Ints:
        """Return the indices of a ray's terms in order of selection."""
        return np.asarray(self.order[ray][self.order[ray] >= 0], dtype=np.intp)

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
        """Return one ray's equation in metres and radians, its sigma, and its terms as text."""
        chosen = self.ray_terms(ray)
        if len(chosen) == 0:
            return f"ray {ray} never returned in {self.nothing[ray]} training scans: no equation"
        terms, theta, _ = expand(self.terms[chosen.tolist()], self.theta[ray, chosen], self.scale)
        bearing = np.degrees(self.sensor.bearings[ray])
        cone = float(np.degrees(self.sensor.cones[ray])) if len(self.sensor.cones) else 0.0
        what = f", the nearest surface in a cone of {cone:.2f} deg" if cone > 0 else ""
        lines = [
            f"ray {ray}, bearing {bearing:.2f} deg{what}: {len(chosen)} terms, sigma {self.sigma[ray]:.4g} m, "
            f"{self.returns[ray]} returns, {self.nothing[ray]} missing returns",
            f"r{ray} = {sum_text(terms, theta, digits=8)}   [m; x, y in m, phi in rad]",
            "",
            "fitted terms, with "
            + ", ".join(
                f"{v} -> ({v} - {c:.6g}) / {w:.6g}"
                for v, c, w in zip(self.scale.variables, self.scale.centres, self.scale.widths, strict=True)
            )
            + ":",
            f"{'term':<22}{'theta [m]':>14}{'stderr [m]':>13}{'ERR':>14}",
        ]
        for j, i in enumerate(chosen.tolist()):
            lines.append(
                f"{self.terms.names[i]:<22}{self.theta[ray, i]:>14.6g}{self.stderr[ray, j]:>13.3g}"
                f"{self.err[ray, j]:>14.6e}"
            )
        return "\n".join(lines)

    def summary(self) -> Mapping[str, str]:
        """Return the form, how it was chosen, standard deviations and support as label -> text."""
        used = (self.order >= 0).sum(axis=1)
        return {
            "form": f"degree {self.form.degree} in x, y times {self.form.harmonics} harmonics of phi: "
            f"{len(self.terms)} candidates, {used.min()} to {used.max()} terms per ray",
            "chosen by": self.form.how,
            "sigma": f"{self.sigma.min():.3g} to {self.sigma.max():.3g} m, median {np.median(self.sigma):.3g} m",
            "support": f"{len(self.support.keys)} cells of {self.support.cell:g} m x "
            f"{360 / self.support.n_sectors:g} deg, leverage up to {self.leverage_limit:.3g}",
        }

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that describe the whole model."""
        support, arrays = self.support.state()
        header = {
            "choice": self.form.to_dict(),
            "scale": self.scale.to_dict(),
            "leverage_limit": self.leverage_limit,
            "support": support,
        }
        for name in _ARRAYS:
            arrays[name] = getattr(self, name)
        return header, arrays

    @classmethod
    def restore(
        cls, sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Self:
        """Recreate the model from the output of `state`.

        Raises
        ------
        ValueError : An array has a wrong shape or an invalid term index, or powers of the scaled poses would overflow.
        """
        form = PolynomialForm(**header["choice"])
        if not all(type(n) is int and n >= 0 for n in (form.degree, form.harmonics, form.n_terms)):
            raise ValueError(f"the form is {form}, expected integers of 0 or more")
        if n_candidates(form.degree, form.harmonics) != arrays["theta"].shape[-1]:
            raise ValueError(f"theta has shape {arrays['theta'].shape}, not of degree {form.degree}")
        terms = dictionary(form.degree, form.harmonics)
        q, m = sensor.n_rays, len(terms)
        k = arrays["order"].shape[-1]
        for name, shape in zip(_ARRAYS, _shapes(q, m, k), strict=True):
            check_shape(name, arrays[name], shape, "iu" if name in ("order", "returns", "nothing") else "f")
        check_order(arrays["order"], m)
        for name in ("returns", "nothing", "sigma", "spread"):
            check_range(name, arrays[name], 0)
        scale = Scale.from_dict(header["scale"])
        check_scale(scale, form.degree)
        return cls(
            sensor=sensor, form=form, terms=terms, scale=scale,
            leverage_limit=float(header["leverage_limit"]),
            support=Support.restore(header["support"], arrays), **{name: arrays[name] for name in _ARRAYS},
        )  # fmt: skip


_ARRAYS = ("order", "err", "stderr", "theta", "theta_none", "returns", "nothing", "sigma", "spread", "root")


def _shapes(q: int, m: int, k: int) -> tuple[tuple[int, ...], ...]:
    return ((q, k), (q, k), (q, k), (q, m), (q, m), (q,), (q,), (q,), (q, len(QUANTILES)), (m, m))


def _select_all(
    scans: TrainingScans, terms: Terms, scale: Scale, n_terms: int, progress: Progress | None
) -> dict[str, Any]:
    """Fit range and probability of no return of all rays, in passes of a few rays if returns are missing."""
    n, q, m = len(scans), scans.sensor.n_rays, len(terms)
    k = min(n_terms, m)
    out: dict[str, Any] = {
        "order": np.full((q, k), -1, dtype=np.int64),
        "err": np.zeros((q, k)),
        "stderr": np.zeros((q, k)),
        "theta": np.zeros((q, m)),
        "theta_none": np.zeros((q, m)),
        "returns": np.isfinite(scans.ranges).sum(axis=0),
        "nothing": np.isposinf(scans.ranges).sum(axis=0),
    }
    out["theta"][:, terms.names.index("1")] = np.where(out["returns"] > 0, 0.0, scans.sensor.range_max)
    step = max(1, min(q, MAX_GRAM_NUMBERS // (2 * m * m))) if scans.ray_poses is None else 1
    total = -(-n // POSES_PER_BLOCK) * -(-q // step)
    done = 0
    gram = np.zeros((m, m))
    for first in range(0, q, step):
        rays = np.arange(first, min(first + step, q))
        ranges = Moments(terms, len(rays), scale=scale)
        nothing = Moments(terms, len(rays), scale=scale)
        for start in range(0, n, POSES_PER_BLOCK):
            block = scans.ranges[start : start + POSES_PER_BLOCK, rays]
            there = _poses(scans, slice(first, first + step), slice(start, start + POSES_PER_BLOCK))
            phi = terms.matrix(columns(there), scale)
            ranges.add_rows(phi, np.where(np.isfinite(block), block, np.nan))
            nothing.add_rows(phi, np.where(np.isnan(block), np.nan, np.isposinf(block)))
            if first == 0:
                gram += phi.T @ phi
            done += 1
            if progress is not None:
                progress(done, total)
        for few, size in _by_size(ranges.count, k):
            picked = select(ranges.pick(outputs=few), size, keep=["1"])
            _store(out, rays[few], picked)
        both = np.flatnonzero((out["nothing"][rays] > 0) & (nothing.count > 0))
        for few, size in _by_size(nothing.count, k):
            few = np.intersect1d(few, both)
            if len(few):
                out["theta_none"][rays[few]] = select(nothing.pick(outputs=few), size, keep=["1"]).theta
    out["gram"] = gram
    return out


def _rays_of_one_pose(scans: TrainingScans, n_rays: int) -> list[slice]:
    """Return slices of rays with common poses: all rays, or single rays of a sweeping laser."""
    return [slice(0, n_rays)] if scans.ray_poses is None else [slice(j, j + 1) for j in range(n_rays)]


def _poses(scans: TrainingScans, rays: slice, rows: slice) -> Floats:
    """Return the poses (n, 3) of some scans; for a sweep, those of the first of the given rays."""
    return scans.poses[rows] if scans.ray_poses is None else scans.ray_poses[rows, rays.start]


def _by_size(count: NDArray[np.int64], k: int) -> list[tuple[Ints, int]]:
    """Group outputs by the number of terms that their data support: `k`, or the mean alone with too few rows."""
    rows = ROWS_PER_TERM * k
    rich, poor = np.flatnonzero(count >= rows), np.flatnonzero((count < rows) & (count > 0))
    return [(few, size) for few, size in ((rich, k), (poor, 1)) if len(few)]


def _store(out: dict[str, Any], rays: Ints, picked: Selection) -> None:
    k = picked.order.shape[1]
    out["order"][rays, :k] = picked.order
    out["err"][rays, :k] = picked.err
    out["theta"][rays] = picked.theta
    spread = np.sqrt((picked.inverse**2).sum(axis=2))  # square root of the diagonal of T T'
    out["stderr"][rays, :k] = np.nan_to_num(picked.sigma)[:, None] * spread


def _leverage(scans: TrainingScans, terms: Terms, scale: Scale, gram: Floats) -> tuple[Floats, float]:
    """Return W with W W' = (Φ'Φ)⁻¹, and the leverage above which a pose is an extrapolation."""
    root, parts = leverage_root(gram), []
    for start in range(0, len(scans), POSES_PER_BLOCK):
        phi = terms.matrix(columns(scans.poses[start : start + POSES_PER_BLOCK]), scale)
        parts.append(((phi @ root) ** 2).sum(axis=1))
    return root, leverage_limit(np.concatenate(parts))
