"""Profiles of laser errors over bearing or range that no effect of the library has.

    reading += dr Σ_k errors_k hat_k(u).

The piecewise linear hat_k is 1 at knot k and 0 at the others. There are three kinds of profile.

- Bearing error: u is the bearing, and dr the derivative of the range by the bearing.
- Bias by bearing: u is the bearing, and dr = 1.
- Bias by range: u is the expected range, and dr = 1.

Each is fitted together with poses, map and mount, and the most likely one is reported. At slanted walls a bearing error
makes readings longer or shorter, so that it cancels in the mean residual of a bearing and would appear as noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from sensorgraph.diagnosis.engine.ledger import as_name
from sensorgraph.diagnosis.result import Profile
from sensorgraph.diagnosis.scan.column_fit import fit_columns, inverse_of_whole, is_better_alone
from sensorgraph.diagnosis.scan.consequence import CAUSES, ScanError, length
from sensorgraph.diagnosis.scan.effect_laws import Doubt
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Bools, Floats

BEARING_ERROR, BIAS_BY_BEARING, BIAS_BY_RANGE = "bearing error", "bias by bearing", "bias by range"
"""Kinds of profile."""
STRETCHED = (
    "a field of view other than specified: angle_min, angle_max or angle_increment of the driver",
    "a scan with one ray more or fewer than the driver assumes",
)
UNEVEN = (
    "a mirror or an encoder that is off centre, so that the rays are unevenly spaced",
    "bearings that were calibrated for another unit",
)
MOST_RANGES = 0.99
"""Quantile of the ranges at which their profile ends."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorProfile:
    """An error over bearing or range, as estimated from a run."""

    kind: str
    """BEARING_ERROR, BIAS_BY_BEARING or BIAS_BY_RANGE."""
    knots: Floats
    """(k,) [rad or m] bearings or ranges, ascending."""
    errors: Floats
    """(k,) [rad] error of the bearing, positive to the left, or [m] error of the reading; the mean over all rays is 0."""
    stderr: Floats
    """(k,) standard errors, from the scatter between parts of the run."""
    gain: float
    """[nats] gain of the profile."""
    amplitude_z: float
    """Amplitude of the whole profile over its standard error, from the scatter between parts of the run."""
    offset: float
    """[m] root mean square of its contribution to the readings."""
    affected: float
    """Share of the readings."""

    @property
    def stretch(self) -> float:
        """Slope of the errors over the knots; for bearing errors, the relative widening of the field of view."""
        return float(np.polyfit(self.knots, self.errors, 1)[0])

    @property
    def is_stretched(self) -> bool:
        """Whether a wider or narrower field of view accounts for nearly all of the profile."""
        if self.kind != BEARING_ERROR:
            return False
        left = self.errors - np.polyval(np.polyfit(self.knots, self.errors, 1), self.knots)
        return float((left**2).sum()) < SCAN.profiles.max_uneven_share * float((self.errors**2).sum())

    @property
    def causes(self) -> tuple[str, ...]:
        """Possible causes, most likely first."""
        if self.kind == BEARING_ERROR:
            return STRETCHED if self.is_stretched else UNEVEN
        return (CAUSES["bearing" if self.kind == BIAS_BY_BEARING else "range", "bias"],)

    @property
    def profile(self) -> Profile:
        """The numbers for the report."""
        return Profile(
            of="bearing" if self.kind == BEARING_ERROR else "reading",
            over="range" if self.kind == BIAS_BY_RANGE else "bearing",
            at=tuple(self.knots.tolist()),
            error=tuple(self.errors.tolist()),
            stderr=tuple(self.stderr.tolist()),
        )

    def sentence(self) -> str:
        """Return the profile as a statement."""
        worst = int(np.abs(self.errors).argmax())
        most, at = abs(float(self.errors[worst])), float(self.knots[worst])
        if self.is_stretched:
            width = float(np.degrees(self.knots[-1] - self.knots[0]))
            wider = "wider" if self.stretch > 0 else "narrower"
            return (
                f"the field of view is {100 * abs(self.stretch):.2g} % {wider} than specified, {width * (1 + self.stretch):.1f}° "
                f"instead of {width:.1f}°"
            )
        if self.kind == BEARING_ERROR:
            return (
                f"bearings are off by up to {np.degrees(most):.2g}°, most at {np.degrees(at):.0f}°; the error depends on the "
                "bearing"
            )
        if self.kind == BIAS_BY_BEARING:
            where = f"most at {np.degrees(at):.0f}°; the error depends on the bearing, and no single sector explains it"
        else:
            where = f"most at {at:.1f} m; the error depends on the range, and neither a bias nor a scale explains it"
        return f"readings are off by up to {length(most)}, {where}"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Columns:
    """A profile before the fit."""

    kind: str
    knots: Floats
    columns: Floats
    """(n_scans, k, n_rays) derivative of the readings by the value at each knot."""


def error_profiles(fitted: Fitted, *, least: float = 0.0) -> list[ErrorProfile]:
    """Fit each profile in addition to effects and nuisances if it is likely to first order; most likely first.

    Parameters
    ----------
    least : [nats] Minimum first-order gain for a fit; at least the complexity penalty.
    """
    return _fitted_profiles(fitted, _screened_profiles(fitted), least)


def profile_doubts(fitted: Fitted, null: Fitted | None = None) -> list[Doubt]:
    """Report the error profiles of the laser; at most one is sure.

    Parameters
    ----------
    null : The fit without effects. If a profile alone explains more than all effects together with a profile, the
        effects only imitate it.
    """
    screened, failed = _screened_profiles(fitted), frozenset[int]()
    found = _sure(fitted, screened)
    if fitted.model and null is not None:
        least = SCAN.profiles.min_first_order_share * (fitted.j - null.j)
        alone = _sure(null, _screened_profiles(null), least)
        beside = 0.0 if found is None else found.gain - _price()
        if alone is not None and is_better_alone(alone.gain - _price(), null, beside, fitted):
            found, failed = alone, frozenset(range(len(fitted.model)))
    unsure = [
        Doubt(
            family=as_name(one.kind),
            price=_price(),
            statement="",
            misfit=gain,
            statistic=gain,
            threshold=SCAN.selection.threshold,
            is_sure=False,
        )
        for one, gain in screened
        if found is None or one.kind != found.kind
    ]
    if found is None:
        return unsure
    return [
        Doubt(
            family=as_name(found.kind),
            price=_price(),
            statement=found.sentence(),
            misfit=found.gain,
            statistic=found.amplitude_z,
            threshold=_least_z(),
            failed=failed,
            size=ScanError(offset=found.offset, affected=found.affected),
            causes=found.causes,
            profile=found.profile,
        ),
        *unsure,
    ]


def _screened_profiles(fitted: Fitted) -> list[tuple[_Columns, float]]:
    """Return the profiles, each with its gain [nats] to first order."""
    return [(one, _screened(fitted, one)) for one in _profiles(fitted)]


def _fitted_profiles(
    fitted: Fitted, screened: Sequence[tuple[_Columns, float]], least: float
) -> list[ErrorProfile]:
    """Fit the profiles that gain more than `least` [nats], and the complexity penalty; most likely first."""
    found = [_fitted(fitted, one) for one, gain in screened if gain > max(least, _price())]
    return sorted(found, key=lambda one: -one.gain)


def _sure(
    fitted: Fitted, screened: Sequence[tuple[_Columns, float]], least: float = 0.0
) -> ErrorProfile | None:
    """Return the most likely profile if the likelihood and the parts of the run support it; None otherwise."""
    profiles = _fitted_profiles(fitted, screened, least)
    found = next((one for one in profiles if not _is_of_walls(one, fitted.solver.data.grain)), None)
    if found is None or found.gain - _price() < SCAN.selection.threshold:
        return None
    return found if found.amplitude_z > _least_z() else None


def _is_of_walls(found: ErrorProfile, grain: float) -> bool:
    """Return whether an error over range is within a pixel of the map, as from walls that are each off by half a pixel."""
    return found.kind == BIAS_BY_RANGE and float(np.abs(found.errors).max()) < 2 * grain


def _price() -> float:
    return SCAN.selection.price * SCAN.profiles.n_knots


def _least_z() -> float:
    """Return the minimum amplitude in standard errors, given that its direction was chosen from k dimensions."""
    k, n = SCAN.profiles.n_knots, SCAN.constancy.n_parts
    return float(np.sqrt(k * fdtri(k, n - 1, SCAN.constancy.confidence)))


def _profiles(fitted: Fitted) -> list[_Columns]:
    """Return the profiles that can be tested; none if there are too few rays or scans."""
    data, solver = fitted.solver.data, fitted.solver
    settings, bearings = SCAN.profiles, data.sensor.bearings
    if data.sensor.is_composite or measures_cones(data.sensor):
        return []
    if data.n_rays < settings.min_rays * settings.n_knots or data.n_scans < 2 * SCAN.constancy.n_parts:
        return []
    used = _used(fitted)
    if not used.any():
        return []
    turned, biased = (solver.stack[:, one][:, None, :] for one in (Nuisance.MOUNT_YAW, Nuisance.BIAS))
    angles = np.linspace(bearings.min(), bearings.max(), settings.n_knots)
    ranges = np.where(used, solver.expected.reading, 0.0)
    lengths = np.linspace(
        float(ranges[used].min()), float(np.quantile(ranges[used], MOST_RANGES)), settings.n_knots
    )
    by_bearing, by_range = _hats(bearings, angles), _hats(np.minimum(ranges, lengths[-1]), lengths)
    return [
        _Columns(kind=BEARING_ERROR, knots=angles, columns=turned * by_bearing),
        _Columns(kind=BIAS_BY_BEARING, knots=angles, columns=biased * by_bearing),
        _Columns(kind=BIAS_BY_RANGE, knots=lengths, columns=biased * by_range),
    ]


def _used(fitted: Fitted) -> Bools:
    """Return which readings (n_scans, n_rays) contribute to the size."""
    return fitted.solver.jacobian.valid & (fitted.solution.responsibilities.weight > 0)


def _screened(fitted: Fitted, profile: _Columns) -> float:
    """Return the gain of a profile to first order [nats]."""
    solver, solution = fitted.solver.with_columns(profile.columns), fitted.solution
    system = solver.assemble(solution.responsibilities.weight, fitted.state.pose_scale)
    k = len(profile.knots)
    x = np.concatenate([fitted.state.g, solution.p, np.zeros(k)])
    score = (system.right - system.matrix @ x)[-k:]
    covariance = inverse_of_whole([(system.matrix, system.right)], solver, solution)[-k:, -k:]
    return 0.5 * float(score @ covariance @ score)


def _fitted(fitted: Fitted, profile: _Columns) -> ErrorProfile:
    """Fit a profile jointly with all other unknowns."""
    knots, columns = profile.knots, profile.columns
    got = fit_columns(fitted, columns, np.zeros(len(knots)), rounds=SCAN.profiles.rounds)
    used = _used(fitted)
    mass = np.einsum("nkm,nm->k", np.abs(columns) > 0, used)
    errors = got.values - float(mass @ got.values) / max(float(mass.sum()), 1.0)
    along = got.information @ errors / max(float(errors @ got.information @ errors), 1e-12)
    scatter = float(np.sqrt(np.square(got.each @ along).sum()))
    off = np.matmul(errors, columns)[used]
    return ErrorProfile(
        kind=profile.kind,
        knots=knots,
        errors=errors,
        stderr=np.sqrt(np.square(got.each).sum(axis=0)),
        gain=got.gain,
        amplitude_z=1 / max(scatter, 1e-9),
        offset=float(np.sqrt(np.square(off).mean())),
        affected=float(used.mean()),
    )


def _hats(at: Floats, knots: Floats) -> Floats:
    """Return the piecewise linear functions (..., k, n) of values (..., n) that are 1 at one knot and 0 at the others."""
    width = knots[1] - knots[0]
    return np.asarray(np.maximum(0.0, 1 - np.abs(at[..., None, :] - knots[:, None]) / width))
