"""Compare measured with simulated scans, before and after the amendment, as arrays for pictures and views.

Both simulations are the bare simulator at the reference poses, as `record --effects` runs it. No nuisance parameter is
fitted, so that the pictures show what a user of the simulator sees. `held_out_gap` computes the gap that is reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.scan.deviations import covariates
from sensorgraph.diagnosis.scan.fit import Fitted, cast
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats, Ints

CLIP_SIGMAS = 10.0
"""Standard deviations at which residuals are clipped before averaging."""
TITLES = {"omega": "turn rate"}
UNDRAWN = ("direction in map", "acceleration")
"""Quantities without a panel in the picture of the residuals."""
MAGNIFICATIONS = (1, 2, 3, 5, 10, 20, 30, 50)
"""Magnifications of residuals in pictures."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedScans:
    """Scans simulated by one model, compared with the measurement; arrays (n_scans, n_rays)."""

    simulated: Floats
    """[m] expected reading, +inf where no return is more likely."""
    aimed: Floats
    """[m] range of the surface, inf where no surface is hit."""
    residual: Floats
    """[m] measured - simulated; nan without a comparison."""
    unexpected: Bools
    """Missing returns, unexpected returns, and outliers."""
    missing: Bools
    """No return where one is expected."""
    clear: Bools
    """Not near a depth edge."""
    sigma: Floats
    """[m] standard deviation expected by this model."""
    walls: Floats
    """(n_walls, 2, 2) [m] of this model."""

    @classmethod
    def of(cls, fitted: Fitted, effects: Sequence[Amendment]) -> SimulatedScans:
        """Simulate with effects and compare; outliers are those of the fit."""
        data = fitted.solver.data
        at = cast(data, effects)
        mu, expected, z = at.expected.reading, at.expected, data.ranges
        range_max = data.sensor.range_max
        returned, lost = np.isfinite(z), np.isinf(z)
        aimed = np.isfinite(mu)
        likely = aimed & (expected.p_return > 0.5)
        clear = expected.p_alternative < SCAN.likelihood.min_edge_chance
        missing = lost & likely & (mu < range_max - 3 * expected.sigma) & (mu > data.sensor.range_min) & clear
        compared = returned & likely
        residual = np.full(z.shape, np.nan)
        residual[compared] = z[compared] - mu[compared]
        return cls(
            simulated=np.where(likely & (mu < range_max), mu, np.inf),
            aimed=np.where(aimed, mu, np.inf),
            residual=residual,
            unexpected=missing
            | (returned & ~likely)
            | (returned & (fitted.solution.responsibilities.stray > 0.5)),
            missing=missing,
            clear=clear,
            sigma=np.maximum(expected.sigma, 1e-6),
            walls=at.scene.walls,
        )

    def rms(self, sigma: float) -> Floats:
        """Return the RMS [m] of each scan (n_scans,), with residuals clipped at CLIP_SIGMAS sigmas."""
        clipped = self.clipped(sigma)
        seen = np.isfinite(clipped)
        total = (np.where(seen, clipped, 0.0) ** 2).sum(axis=1)
        return np.asarray(np.sqrt(total / np.maximum(seen.sum(axis=1), 1)))

    def clipped(self, sigma: float) -> Floats:
        """Return residuals away from depth edges, clipped at CLIP_SIGMAS sigmas; nan elsewhere."""
        cut = np.where(self.clear, np.clip(self.residual, -CLIP_SIGMAS * sigma, CLIP_SIGMAS * sigma), np.nan)
        return np.asarray(cut)


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedScans:
    """Scans of a run, and their simulation without and with the effects that were found."""

    arena: Arena
    sensor: RangeSensor
    stamps: Floats
    """(n_scans,) [s] since the start of the run."""
    poses: Floats
    """(n_scans, 3)"""
    rays: Floats
    """(n_scans, n_rays, 4) [m, m, 1, 1] start and direction of each ray; in a cone, towards the nearest surface."""
    measured: Floats
    """(n_scans, n_rays) [m]"""
    covariates: Mapping[str, tuple[Floats, Floats]]
    """Label -> values (n_scans, n_rays) that residuals may depend on, and edges of bins."""
    before: SimulatedScans
    after: SimulatedScans
    is_amended: bool
    """Whether an effect of the scan channel is named, so that the two simulations differ."""

    @cached_property
    def sigma(self) -> float:
        """[m] nominal noise, or 1 cm if the sensor specifies none."""
        return self.sensor.sigma or 0.01

    @cached_property
    def typical_residual(self) -> float:
        """[m] 90 % quantile of the residuals before the amendment."""
        clipped = np.abs(self.before.clipped(self.sigma))
        return float(np.nanquantile(clipped, 0.9)) if np.isfinite(clipped).any() else self.sigma

    @cached_property
    def magnification(self) -> int:
        """Magnification that makes residuals visible in the arena."""
        room = 0.022 * self.diagonal
        return max(
            (k for k in MAGNIFICATIONS if k * max(self.typical_residual, self.sigma) <= room), default=1
        )

    @property
    def diagonal(self) -> float:
        """[m] of the arena."""
        x0, y0, x1, y1 = self.arena.bounds
        return float(np.hypot(x1 - x0, y1 - y0))

    @cached_property
    def limits(self) -> tuple[float, float, float, float]:
        """x0, y0, x1, y1 [m] of the drawing: the part of the arena that the run saw, with a margin.

        The limits extend to rays that end behind the walls.
        """
        low, high = np.reshape(self.arena.bounds, (2, 2))
        beyond = 0.45 * float((high - low).max())
        flat = np.flatnonzero(np.isfinite(self.measured))[::37]
        ends = np.concatenate([self.ends(flat, self.measured.ravel()[flat]), self.poses[:, :2]])
        first, last = np.quantile(ends, 0.004, axis=0), np.quantile(ends, 0.996, axis=0)
        margin = 0.05 * float((last - first).max())
        x0, y0 = np.maximum(first - margin, low - beyond).tolist()
        x1, y1 = np.minimum(last + margin, high + beyond).tolist()
        return x0, y0, x1, y1

    def enlarged_ranges(self, side: SimulatedScans) -> Floats:
        """Return ranges (n_scans, n_rays) [m] with magnified residuals; large residuals stay as measured."""
        large = self.magnification * side.residual
        with np.errstate(invalid="ignore"):
            return np.asarray(
                side.simulated + np.where(np.abs(large) < 0.06 * self.diagonal, large, side.residual)
            )

    def ends(self, flat: Ints, ranges: Floats) -> Floats:
        """Return the end points (k, 2) [m, map] of rays, given by flat index, with ranges (k,)."""
        rays = self.rays.reshape(-1, 4)[flat]
        return np.asarray(rays[:, :2] + ranges[:, None] * rays[:, 2:])

    def profile(self, values: Floats, index: Ints, count: int) -> tuple[Floats, Floats]:
        """Return mean and standard error (clustered by blocks of time) of the values in each bin."""
        blocks = (self.stamps / SCAN.block).astype(np.intp)
        n_blocks = int(blocks.max(initial=0)) + 1
        ok = (index >= 0) & np.isfinite(values)
        group = np.where(ok, blocks[:, None] * count + index, n_blocks * count).ravel()
        size = n_blocks * count + 1
        n = np.bincount(group, minlength=size)[:-1].reshape(n_blocks, count)
        s = np.bincount(group, np.where(ok, values, 0.0).ravel(), size)[:-1].reshape(n_blocks, count)
        rays = n.sum(axis=0)
        mean = np.where(rays >= SCAN.goodness_of_fit.min_rays, s.sum(axis=0) / np.maximum(rays, 1), np.nan)
        scatter = np.sqrt(((s - np.nan_to_num(mean) * n) ** 2).sum(axis=0))
        return mean, scatter / np.maximum(rays, 1)


def compare(finding: Finding) -> ComparedScans | None:
    """Collect the data for pictures; None if nothing was fitted."""
    if finding.explained is None:
        return None
    null, final = finding.explained.null, finding.explained.final
    data = null.solver.data
    beams = null.cast.beams
    starts = (np.broadcast_to(start, beams.ux.shape) for start in (beams.ox, beams.oy))
    # a mount that was calibrated from driving alone is already in the poses
    named = finding.channels["scan"].effects if "scan" in finding.channels else ()
    shared = [a for a in finding.shared if a.effect.channel == "scan"]
    before = SimulatedScans.of(null, shared)
    return ComparedScans(
        arena=data.arena,
        sensor=data.sensor,
        stamps=data.stamps - data.begin,
        poses=data.poses,
        rays=np.stack([*starts, beams.ux, beams.uy], axis=-1),
        measured=data.ranges,
        covariates={
            f"{TITLES.get(one.name, one.name)} [{'°' if one.unit == 'degrees' else one.unit}]": (
                one.scale * one.values,
                one.scale * one.edges,
            )
            for one in covariates(data, beams)
            if one.name not in UNDRAWN
        },
        before=before,
        after=SimulatedScans.of(final, (*shared, *named)) if named else before,
        is_amended=bool(named),
    )
