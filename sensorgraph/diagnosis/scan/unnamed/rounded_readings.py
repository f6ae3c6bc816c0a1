"""Noise that is not normally distributed but bounded, as from rounding with unequal steps."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed

NAME = "rounded_readings"
WIDENED = 2.0
"""Ratio of fitted to nominal noise above which an effect accounts for most of the noise."""
FAR = 4.0
"""Standard deviations within which the shape of the noise is tested; farther readings are outliers."""
FLAT = -0.3
"""Maximum excess kurtosis of non-Gaussian noise: 0 for a normal distribution, -1.2 for a uniform one."""


def find(checked: Checked) -> list[Doubt]:
    """Return the effects whose noise is bounded."""
    found = [flat_noise(checked.view, i, gain) for i, gain in checked.gains.items()]
    return [doubt for doubt in found if doubt is not None]


def flat_noise(view: FitResiduals, index: int, gain: float) -> Doubt | None:
    """Return noise that is not normally distributed but bounded, as from rounding with unequal steps.

    Where an effect accounts for most of the noise, the fourth moment of the residuals must be normal: 3 times the squared
    variance. A uniform distribution has 1.8 times.

    Parameters
    ----------
    gain : [nats] Gain of the effect.
    """
    effect, settings = view.fitted.model[index].effect, SCAN.goodness_of_fit
    if effect.stage != "noise" or effect.diagnostics.is_lattice or effect.diagnostics.explains:
        return None
    wide = view.returned & view.valid & (view.sigma > WIDENED * view.data.sensor.sigma)
    wide &= view.fitted.cast.expected.p_alternative < SCAN.likelihood.min_edge_chance
    wide &= np.abs(view.residual) < FAR * view.sigma
    n = int(wide.sum())
    if n < settings.min_rays:
        return None
    squares = np.square(view.residual[wide] / view.sigma[wide])
    excess = float(np.square(squares).mean() / squares.mean() ** 2) - 3.0
    if excess + 3 * np.sqrt(24 / n) > FLAT:
        return None
    return Doubt(
        family=NAME,
        statement="readings are distributed between two limits instead of normally, as if rounded to steps that grow "
        "with the range",
        misfit=settings.failed_law_share * gain,
        statistic=excess,
        threshold=FLAT,
        failed=frozenset([index]),
        size=ScanError(noise=float(np.median(view.sigma[wide])), affected=float(wide.mean())),
        causes=(
            "ranges that are stored in few bits",
            "a laser whose resolution step grows with the range",
        ),
    )


ROUNDED_READINGS = Unnamed(titles={NAME: "readings rounded to steps that grow with the range"}, find=find)
