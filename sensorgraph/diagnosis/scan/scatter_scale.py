"""Estimate the scatter of a laser at all ranges, as a multiple of the specified standard deviation."""

from __future__ import annotations

from dataclasses import replace

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.fit import fit
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.model_selection import Explained
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.unnamed.family import Doubt
from sensorgraph.diagnosis.scan.unnamed.worse_than_specified import SCATTER
from sensorgraph.effects.range_noise import RANGE_NOISE
from sensorgraph.robust import robust_sigma

SIGMA_CAUSES = (
    "sensor.sigma in robot.yaml is too small: data sheets specify the best case",
    "a laser that vibrates, is worn, or measures through a dirty window",
)


def freed_scatter(data: ScanData, explained: Explained, noise_bounds: NoiseBounds) -> NoiseBounds | None:
    """Return noise bounds around the observed scatter if it explains more than the effects found; else None.

    If the noise may not exceed the specified value, twice that noise looks like noise that grows with the
    range. A specified value that is too small is therefore tested first.
    """
    final = explained.final
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
    got = fit(data, kept, state, free, outer=1, inner=6)
    needed = 0.0 if has_dropped else SCAN.selection.threshold
    return free if got.j > final.j + needed else None


def doubt_of_scatter(found: GoodnessOfFit, explained: Explained, data: ScanData) -> GoodnessOfFit:
    """Report a laser that scatters more than specified, unless another difference is already unexplained."""
    scale, sigma = explained.final.state.noise.core, data.sensor.sigma
    if found.is_doubted or scale < SCAN.nuisance.stretched_scale:
        return found
    told = Doubt(
        family=SCATTER,
        misfit=0.0,
        statement=f"the laser scatters by {scale:.1f} times sensor.sigma in robot.yaml, at all ranges "
        f"({1000 * scale * sigma:.0f} mm instead of {1000 * sigma:.0f} mm)",
        statistic=scale,
        threshold=SCAN.nuisance.stretched_scale,
        size=ScanError(noise=sigma * (scale**2 - 1) ** 0.5, affected=1.0),
        causes=SIGMA_CAUSES,
    )
    return replace(found, told=told)
