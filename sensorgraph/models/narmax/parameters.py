"""What the model `narmax` consists of: the form, the terms of every ray and their coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from logs.run import RangeSensor
from robotmodic_ident import Scale
from sensorgraph.models.narmax.candidates import NarmaxForm, ReadingScale
from sensorgraph.models.polynomial.support import Support
from sensorgraph.types import Floats, Ints

QUANTILES = np.linspace(0.0, 1.0, 33)
"""Shares at which the size of the residuals is kept."""
START, ONE_STEP, FREE_RUN = range(3)
"""Rows of `sigma` and `spread`: a pose alone, one step ahead, free run."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NarmaxParameters:
    """The equations of all rays, and where they may be trusted."""

    sensor: RangeSensor
    form: NarmaxForm
    scale: Scale
    readings: ReadingScale
    order: Ints
    """(n_rays, n_max) terms of each ray in order of choice, shared ones first, then its readings; -1 beyond them."""
    err: Floats
    """(n_rays, n_max) error reduction ratio of each choice."""
    theta: Floats
    """(n_rays, n_max) [m] coefficients of the scaled terms."""
    stderr: Floats
    """(n_rays, n_max) [m]"""
    noise: Floats
    """(n_rays, noise_lags) coefficients of e(k-1), ...; 0 where none are needed."""
    noise_stderr: Floats
    """(n_rays, noise_lags)"""
    tests: Floats
    """(n_rays, 3) p-values of the residual against its own past, v and omega; -1: too few scans."""
    rows: Ints
    """(n_rays,) scans that the equation of a ray rests on."""
    start_order: Ints
    """(n_rays, n_start) terms of the start equation."""
    start_theta: Floats
    """(n_rays, n_start) [m]"""
    theta_none: Floats
    """(n_rays, n_static) chance of no return after a return, over the terms of a pose alone."""
    memory: Floats
    """(n_rays,) what no return before adds to that chance."""
    sigma: Floats
    """(3, n_rays) [m] of a pose alone, one step ahead, free run."""
    spread: Floats
    """(3, n_rays, len(QUANTILES)) [m] quantiles of the size of the residual."""
    root: Floats
    """(n_static, n_static) W with W W' = (Φ'Φ)⁻¹ over the training poses: leverage is |φ W|²."""
    leverage_limit: float
    support: Support
    used: Mapping[str, int]
    """Counts of scans: `scans`, `rows` (with a whole look back), `dropped` (at the start of a stretch), `stretches`."""

    @property
    def n_rays(self) -> int:
        """Count of rays."""
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
