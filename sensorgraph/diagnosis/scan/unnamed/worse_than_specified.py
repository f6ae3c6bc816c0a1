"""Reference poses, stamps, a map or a laser that are less accurate than specified."""

from __future__ import annotations

from dataclasses import replace

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.deviations import deviations
from sensorgraph.diagnosis.scan.fit import Fitted, fit
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects.range_noise import RANGE_NOISE
from sensorgraph.robust import robust_sigma

POSE_CAUSES = (
    "a reference pose that is less accurate than specified: a poor calibration, a slow filter, lost markers",
    "stamps of scans or poses that are late or jitter",
)
SIGMA_CAUSES = (
    "sensor.sigma in robot.yaml is too small: data sheets specify the best case",
    "a laser that vibrates, is worn, or measures through a dirty window",
)
LOSS_CAUSES = (
    "a weak or dirty window, or a worn laser",
    "sunlight, another laser, or a bad connection",
)
LEAST_LOSSES = 0.02
"""Least share of lost returns that is reported: lasers of several makers lose up to 1 % at random."""
MAP_CAUSES = (
    "a map that is less accurate than specified",
    "objects that have moved since the map was made",
)


def find(checked: Checked) -> list[Doubt]:
    """Return by how much a model needs tolerances far wider than the specified ones."""
    return beyond_tolerances(checked.fitted, SCAN.goodness_of_fit.max_tolerance_scale)


def beyond_tolerances(fitted: Fitted, limit: float) -> list[Doubt]:
    """Return poses and walls of a fit; sure are those at least `limit` times worse than their tolerances."""
    state, told = fitted.state, fitted.solver.data.tolerances
    return [
        Doubt(
            family=family,
            is_sure=bool(scale >= limit),
            statement=f"the {name} would have to be {scale:.1f} times worse than its tolerance",
            misfit=(scale - 1) * fitted.solver.data.n_scans,
            statistic=scale,
            threshold=limit,
            size=ScanError(offset=scale * tolerance, affected=1.0),
            causes=causes,
        )
        for family, name, scale, tolerance, causes in (
            ("reference_worse", "reference pose", state.pose_scale, told.pose_xy, POSE_CAUSES),
            ("map_worse", "map", state.map_scale, told.map, MAP_CAUSES),
        )
    ]


WORSE_THAN_SPECIFIED = Unnamed(
    titles={
        "reference_worse": "reference poses less accurate than specified",
        "map_worse": "a map less accurate than specified",
    },
    find=find,
)

WORSE_LASER = Unnamed(
    titles={
        "laser_scatter": "a laser that scatters more than specified",
        "laser_losses": "a laser that loses returns everywhere",
    }
)
"""Scatter and losses of the laser are tested before the effects."""


def freed_scatter(data: ScanData, final: Fitted, noise_bounds: NoiseBounds) -> NoiseBounds | None:
    """Return noise bounds around the observed scatter if it explains more than the effects of a fit; else None.

    If the noise may not exceed the specified value, twice that noise looks like noise that grows with the
    range. A specified value that is too small is therefore tested first.
    """
    low, high = noise_bounds.core
    kept = tuple(a for a in final.model if a.effect is not RANGE_NOISE or a.place)
    has_dropped = len(kept) < len(final.model)
    if not has_dropped and final.state.noise.core < high:
        return None
    seen = data.returned & final.cast.jacobian.valid
    off = final.solution.responsibilities.residual[seen]
    # for a normal distribution; outliers hardly change the median
    scale = robust_sigma(off) / data.sensor.sigma
    if not SCAN.nuisance.stretched_scale <= scale <= SCAN.site.wide_noise.core[1]:
        return None
    free = replace(noise_bounds, core=(low * scale, high * scale))
    state = final.state.copy()
    state.noise.core, state.noise.tail = scale, noise_bounds.tail[0]
    got = fit(data, kept, state, free)
    needed = 0.0 if has_dropped else SCAN.selection.threshold
    return free if got.j > final.j + needed else None


def freed_losses(data: ScanData, final: Fitted, noise_bounds: NoiseBounds) -> NoiseBounds | None:
    """Return noise bounds that allow more lost returns if these explain more than the effects of a fit, alike everywhere; else None.

    If few returns may be missing at random, surfaces that absorb light are put wherever some are missing.
    """
    low, high = noise_bounds.loss
    if final.state.noise.loss < high:
        return None
    free = replace(noise_bounds, loss=(low, SCAN.site.wide_noise.loss[1]))
    got = fit(data, final.model, final.state.copy(), free)
    if got.state.noise.loss < LEAST_LOSSES or got.j <= final.j + SCAN.selection.threshold:
        return None
    return None if any(d.family == "misses" for d in deviations(FitResiduals(data, got))) else free


def doubt_of_losses(final: Fitted) -> Doubt | None:
    """Return a laser that loses more returns than usual; None if it does not."""
    loss = final.state.noise.loss
    if loss < LEAST_LOSSES:
        return None
    return Doubt(
        family="laser_losses",
        misfit=0.0,
        statement=f"the laser loses {100 * loss:.1f} % of the returns, and no part of them surely more",
        statistic=loss,
        threshold=LEAST_LOSSES,
        size=ScanError(wrong=loss),
        causes=LOSS_CAUSES,
    )


def doubt_of_scatter(final: Fitted) -> Doubt | None:
    """Return a laser that scatters more than specified; None if it does not."""
    scale, sigma = final.state.noise.core, final.solver.data.sensor.sigma
    if scale < SCAN.nuisance.stretched_scale:
        return None
    return Doubt(
        family="laser_scatter",
        misfit=0.0,
        statement=f"the laser scatters by {scale:.1f} times sensor.sigma in robot.yaml, at all ranges "
        f"({1000 * scale * sigma:.0f} mm instead of {1000 * sigma:.0f} mm)",
        statistic=scale,
        threshold=SCAN.nuisance.stretched_scale,
        size=ScanError(noise=sigma * (scale**2 - 1) ** 0.5, affected=1.0),
        causes=SIGMA_CAUSES,
    )
