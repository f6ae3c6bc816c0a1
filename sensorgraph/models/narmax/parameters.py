"""Parameters of the model `narmax`: the form, and the terms and coefficients of every ray."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from logs.run import RangeSensor
from robotmodic_ident import Scale
from sensorgraph.models.narmax.candidates import NarmaxForm, ReadingScale
from sensorgraph.models.polynomial.support import Support
from sensorgraph.types import Floats, Ints

START, ONE_STEP, FREE_RUN = range(3)
"""Rows of `sigma` and `spread`: a pose alone, one step ahead, free run."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NarmaxParameters:
    """The equations of all rays, and where they are supported by data."""

    sensor: RangeSensor
    form: NarmaxForm
    scale: Scale
    readings: ReadingScale
    order: Ints
    """(n_rays, n_max) terms of each ray in order of selection, indices of shared terms, then of readings; -1: none."""
    err: Floats
    """(n_rays, n_max) error reduction ratio of each term."""
    theta: Floats
    """(n_rays, n_max) [m] coefficients of the scaled terms."""
    stderr: Floats
    """(n_rays, n_max) [m] standard errors."""
    noise: Floats
    """(n_rays, noise_lags) coefficients of e(k-1), ...; 0 where no noise terms are needed."""
    noise_stderr: Floats
    """(n_rays, noise_lags) standard errors."""
    tests: Floats
    """(n_rays, 3) p-values of the residual against its own past, v and omega; -1: too few scans."""
    rows: Ints
    """(n_rays,) number of scans used for the equation of each ray."""
    start_order: Ints
    """(n_rays, n_start) terms of the start equation."""
    start_theta: Floats
    """(n_rays, n_start) [m] coefficients of the start equation."""
    theta_none: Floats
    """(n_rays, n_static) coefficients of the probability of no return after a return, over the static terms."""
    memory: Floats
    """(n_rays,) increase of that probability after a missing return."""
    sigma: Floats
    """(3, n_rays) [m] standard deviation for a pose alone, one step ahead, and in free run."""
    spread: Floats
    """(3, n_rays, len(QUANTILES)) [m] quantiles of the absolute residual."""
    root: Floats
    """(n_static, n_static) W with W W' = (Φ'Φ)⁻¹ over the training poses: leverage is |φ W|²."""
    leverage_limit: float
    support: Support
    used: Mapping[str, int]
    """Counts of scans: `scans`, `rows` (with full history), `dropped` (at the start of a stretch), `stretches`."""

    @property
    def n_rays(self) -> int:
        """Number of rays."""
        return len(self.order)

    def scale_of_ray(self, ray: int) -> Scale:
        """Return the scale of x, y and the readings that one ray may use."""
        h = self.form.reach
        names = tuple(f"r{j}" for j in range(max(ray - h, 0), min(ray + h + 1, self.n_rays)))
        n = len(names)
        return Scale(
            (*self.scale.variables, *names),
            (*self.scale.centres, *n * [self.readings.centre]),
            (*self.scale.widths, *n * [self.readings.width]),
        )
