"""Whether the rays point where the sensor's bearings say, each part of the field of view by itself.

The bearing error is a piecewise linear function of the bearing, fitted together with poses, map and mount. Where walls
are met at a slant a small error moves readings either way, so that the mean over all that one bearing has read tells
nothing of it, and noise would be taken for the cause.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from sensorgraph.diagnosis.scan.column_fit import fit_columns
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.effect_laws import Doubt
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Floats

STRETCHED = (
    "a field of view other than stated: angle_min, angle_max or angle_increment of the driver",
    "a scan with a ray more or fewer than the driver believes",
)
UNEVEN = (
    "a mirror or an encoder that is not centred, so that rays are not evenly spaced",
    "bearings that were calibrated for another unit",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class BearingErrors:
    """Bearing errors of a laser, as a run tells them."""

    knots: Floats
    """(k,) [rad] bearings, ascending."""
    errors: Floats
    """(k,) [rad] by which the rays there point further to the left; the mean over all rays is 0."""
    gain: float
    """[nats] that they make the readings likelier."""
    amplitude_z: float
    """Size of the errors as a whole over its standard error, by the scatter between parts of the run."""
    offset: float
    """[m] root mean square of what they do to readings."""
    affected: float
    """Share of readings."""

    @property
    def stretch(self) -> float:
        """Return how much wider the true field of view is: the slope of the errors over the bearing."""
        return float(np.polyfit(self.knots, self.errors, 1)[0])

    @property
    def is_stretched(self) -> bool:
        """Tell whether a wider or narrower field of view is nearly all of it."""
        left = self.errors - np.polyval(np.polyfit(self.knots, self.errors, 1), self.knots)
        return float((left**2).sum()) < SCAN.bearings.max_uneven_share * float((self.errors**2).sum())

    def sentence(self) -> str:
        """Say it in words."""
        worst = int(np.abs(self.errors).argmax())
        most = abs(float(np.degrees(self.errors[worst])))
        if self.is_stretched:
            width = float(np.degrees(self.knots[-1] - self.knots[0]))
            wider = "wider" if self.stretch > 0 else "narrower"
            return (
                f"the field of view is {100 * abs(self.stretch):.2g} % {wider} than stated, {width * (1 + self.stretch):.1f}° "
                f"in place of {width:.1f}°"
            )
        return f"bearings are off by up to {most:.2g}°, most at {np.degrees(self.knots[worst]):.0f}°, in a way that depends on the bearing"


def bearing_errors(fitted: Fitted) -> BearingErrors | None:
    """Fit bearing errors beside the effects and nuisances of a fit; None where rays or scans are too few."""
    data, solver = fitted.solver.data, fitted.solver
    settings, bearings = SCAN.bearings, data.sensor.bearings
    if data.sensor.is_composite or measures_cones(data.sensor):
        return None
    if data.n_rays < settings.min_rays * settings.n_knots or data.n_scans < 2 * SCAN.constancy.n_parts:
        return None
    knots = np.linspace(bearings.min(), bearings.max(), settings.n_knots)
    hats, turned = _hats(bearings, knots), solver.stack[:, Nuisance.MOUNT_YAW]
    got = fit_columns(fitted, turned[:, None, :] * hats, np.zeros(len(knots)), rounds=settings.rounds)
    used = solver.jacobian.valid & data.returned
    mass = hats @ used.sum(axis=0)
    errors = got.values - float(mass @ got.values) / max(float(mass.sum()), 1.0)
    information = np.linalg.inv(got.covariance)
    along = information @ errors / max(float(errors @ information @ errors), 1e-12)
    scatter = float(np.sqrt(np.square(got.each @ along).sum()))
    off = ((errors @ hats) * turned)[used]
    return BearingErrors(
        knots=knots,
        errors=errors,
        gain=got.gain,
        amplitude_z=1 / max(scatter, 1e-9),
        offset=float(np.sqrt(np.square(off).mean())) if off.size else 0.0,
        affected=float(used.mean()),
    )


def wrong_bearings(fitted: Fitted, null: Fitted | None = None) -> list[Doubt]:
    """Doubt bearings that are sure to be off and matter.

    Parameters
    ----------
    null : the fit without effects: where bearing errors alone explain more than all effects, these stand for them
    """
    found, failed = _sure(fitted), frozenset[int]()
    if fitted.model and null is not None:
        alone = _sure(null)
        if alone is not None and null.j + alone.gain - _price(alone) > fitted.j:
            found, failed = alone, frozenset(range(len(fitted.model)))
    if found is None:
        return []
    return [
        Doubt(
            statement=found.sentence(),
            misfit=found.gain,
            statistic=found.amplitude_z,
            threshold=_least_z(),
            failed=failed,
            size=ScanError(offset=found.offset, affected=found.affected),
            causes=STRETCHED if found.is_stretched else UNEVEN,
        )
    ]


def _sure(fitted: Fitted) -> BearingErrors | None:
    """Return bearing errors that likelihood and parts of the run speak for; None where there are none."""
    found = bearing_errors(fitted)
    if found is None or found.gain - _price(found) < SCAN.selection.threshold:
        return None
    if found.amplitude_z < _least_z():
        return None
    solver = fitted.solver
    hats = _hats(solver.data.sensor.bearings, found.knots)
    columns = solver.stack[:, Nuisance.BIAS][:, None, :] * hats
    biased = fit_columns(fitted, columns, np.zeros(len(hats)), rounds=SCAN.bearings.rounds)
    return found if found.gain > biased.gain else None  # else readings are off there, not bearings


def _price(found: BearingErrors) -> float:
    return SCAN.selection.price * len(found.knots)


def _least_z() -> float:
    """Return what the size must exceed in standard errors, though its direction was chosen among so many."""
    k, n = SCAN.bearings.n_knots, SCAN.constancy.n_parts
    return float(np.sqrt(k * fdtri(k, n - 1, SCAN.constancy.confidence)))


def _hats(bearings: Floats, knots: Floats) -> Floats:
    """Return the piecewise linear functions (k, n_rays) that are 1 at one knot and 0 at the others."""
    width = knots[1] - knots[0]
    return np.asarray(np.maximum(0.0, 1 - np.abs(bearings - knots[:, None]) / width))
