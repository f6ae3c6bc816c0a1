"""Parts of the data, or scans, that differ more from the model than simulated replicates or the rays within a scan explain.

The largest deviation of each kind is compared with that of simulated replicates, which are sampled from the model
(parametric bootstrap; Efron and Tibshirani 1993, chapter 6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.result import Deviation
from sensorgraph.diagnosis.scan.consequence import (
    SCATTER_CAUSES,
    ScanError,
    excess_noise,
    likely_causes,
    scan_error,
)
from sensorgraph.diagnosis.scan.deviations import MIN_SCATTER, deviations, dispersion, largest_z
from sensorgraph.diagnosis.scan.residuals import FitResiduals, replicate
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed

OF_SCANS = ("time", "omega", "speed", "acceleration", "robot place")
"""Partitions whose bins consist of whole scans."""


def find(checked: Checked) -> list[Doubt]:
    """Compare the largest deviation of each kind with replicates, which are simulated only for suspect kinds."""
    view, found, settings = checked.view, checked.deviations, SCAN.goodness_of_fit
    most = {family: z for family, z in largest_z(found).items() if z > 0}
    suspects = {family: z for family, z in most.items() if z > settings.min_z}
    out = [_deviating(view, found, family, settings.min_z) for family in most if family not in suspects]
    if not suspects:
        return out
    slack = float(np.clip(checked.fitted.state.stretch, 1.0, 2.0))
    drawn = _largest_z_of_replicates(checked)
    for family in suspects:
        threshold = max(settings.replicate_factor * max(drawn[family]), settings.min_z) * slack
        out.append(_deviating(view, found, family, threshold))
    return out


def _deviating(view: FitResiduals, found: Sequence[Deviation], family: str, threshold: float) -> Doubt:
    """Return the largest deviation of a kind, with those of the same partition; sure above a threshold of |z|."""
    worst = next(d for d in found if d.family == family)
    alike = [d for d in found if d.partition == worst.partition and d.family == family]
    z = largest_z(found)[family]
    return Doubt(
        family=f"unexplained_{family}",
        is_sure=bool(z > threshold),
        statement=worst.sentence(),
        misfit=float(sum(0.5 * d.z**2 for d in alike)),
        statistic=z,
        threshold=threshold,
        deviation=worst,
        size=scan_error(alike, view.data.sensor.sigma, view.data.ranges.size),
        causes=likely_causes([d for d in found if d.family == family]),
    )


def _largest_z_of_replicates(checked: Checked) -> dict[str, list[float]]:
    """Return the largest |z| of each replicate, by kind of deviation."""
    out: dict[str, list[float]] = {family: [] for family in MIN_SCATTER}
    count = SCAN.goodness_of_fit.n_replicates
    for done in range(count):
        if checked.tick is not None:
            checked.tick(done, count)
        again = FitResiduals(*replicate(checked.view.data, checked.fitted, checked.rng))
        found = deviations(again, checked.partitions)
        for family, z in largest_z(found).items():
            out[family].append(z)
    return out


UNEXPLAINED = Unnamed(
    titles={
        "unexplained_bias": "readings too long or too short in a part of the data",
        "unexplained_spread": "readings with more noise in a part of the data",
        "unexplained_outliers": "more outliers in a part of the data",
        "unexplained_misses": "more missing returns in a part of the data",
    },
    find=find,
)


def find_differing_scans(checked: Checked) -> list[Doubt]:
    """Return how much more scans differ from each other than the rays within a scan explain."""
    view, found = checked.view, checked.deviations
    scatter, limit = dispersion(view), SCAN.goodness_of_fit.max_dispersion
    noise = excess_noise(scatter.excess, view.data.sensor.sigma)
    is_of_walls = noise < view.data.grain  # scans at different places see walls with different errors
    where = next((d for d in found if d.family == "spread" and d.partition in OF_SCANS), None)
    place = "" if where is None else f", most at {where.partition} {where.label}"
    return [
        Doubt(
            family="scans_differ",
            is_sure=bool(scatter.ratio > limit and not is_of_walls),
            statement=f"scans differ from each other {scatter.ratio:.1f} times more than the rays within a scan explain"
            + place,
            misfit=(scatter.ratio - 1) / 2 * view.data.n_scans,
            statistic=scatter.ratio,
            threshold=limit,
            size=ScanError(noise=noise, affected=1.0),
            causes=SCATTER_CAUSES,
        )
    ]


SCANS_DIFFER = Unnamed(
    titles={"scans_differ": "scans that differ from each other"}, find=find_differing_scans
)
