"""Errors of the laser that depend on bearing or range in a way that no effect of the library has.

Three profiles, piecewise linear: by how much rays point elsewhere than their bearings say, by how much they read wrong at
each bearing, and at each range. Each is fitted together with poses, map and mount, and the likeliest is told. Where walls
are met at a slant a wrong bearing moves readings either way, so that the mean over all that one bearing has read tells
nothing of it, and noise would be taken for the cause.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

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
"""Kinds of profiles."""
STRETCHED = (
    "a field of view other than stated: angle_min, angle_max or angle_increment of the driver",
    "a scan with a ray more or fewer than the driver believes",
)
UNEVEN = (
    "a mirror or an encoder that is not centred, so that rays are not evenly spaced",
    "bearings that were calibrated for another unit",
)
MOST_RANGES = 0.99
"""Quantile of the ranges up to which their profile reaches."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorProfile:
    """An error over bearing or range, as a run tells it."""

    kind: str
    """BEARING_ERROR, BIAS_BY_BEARING or BIAS_BY_RANGE."""
    knots: Floats
    """(k,) [rad or m] bearings or ranges, ascending."""
    errors: Floats
    """(k,) [rad] by which rays point further to the left, or [m] by which they read more; the mean over all rays is 0."""
    stderr: Floats
    """(k,) of the errors, by the scatter between parts of the run."""
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
        """Return the slope of the errors over the knots: of bearing errors, how much wider the true field of view is."""
        return float(np.polyfit(self.knots, self.errors, 1)[0])

    @property
    def is_stretched(self) -> bool:
        """Tell whether a wider or narrower field of view is nearly all of it."""
        if self.kind != BEARING_ERROR:
            return False
        left = self.errors - np.polyval(np.polyfit(self.knots, self.errors, 1), self.knots)
        return float((left**2).sum()) < SCAN.profiles.max_uneven_share * float((self.errors**2).sum())

    @property
    def causes(self) -> tuple[str, ...]:
        """Return what it may be, the likeliest first."""
        if self.kind == BEARING_ERROR:
            return STRETCHED if self.is_stretched else UNEVEN
        return (CAUSES["bearing" if self.kind == BIAS_BY_BEARING else "range", "bias"],)

    @property
    def profile(self) -> Profile:
        """Return the numbers for the report."""
        return Profile(
            of="bearing" if self.kind == BEARING_ERROR else "reading",
            over="range" if self.kind == BIAS_BY_RANGE else "bearing",
            at=tuple(self.knots.tolist()),
            error=tuple(self.errors.tolist()),
            stderr=tuple(self.stderr.tolist()),
        )

    def sentence(self) -> str:
        """Say it in words."""
        worst = int(np.abs(self.errors).argmax())
        most, at = abs(float(self.errors[worst])), float(self.knots[worst])
        if self.is_stretched:
            width = float(np.degrees(self.knots[-1] - self.knots[0]))
            wider = "wider" if self.stretch > 0 else "narrower"
            return (
                f"the field of view is {100 * abs(self.stretch):.2g} % {wider} than stated, {width * (1 + self.stretch):.1f}° "
                f"in place of {width:.1f}°"
            )
        if self.kind == BEARING_ERROR:
            return (
                f"bearings are off by up to {np.degrees(most):.2g}°, most at {np.degrees(at):.0f}°, in a way that depends on the "
                "bearing"
            )
        if self.kind == BIAS_BY_BEARING:
            where = f"most at {np.degrees(at):.0f}°, in a way that depends on the bearing as no single sector does"
        else:
            where = (
                f"most at {at:.1f} m, in a way that depends on the range as neither a bias nor a scale does"
            )
        return f"readings are off by up to {length(most)}, {where}"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Columns:
    """A profile before it is fitted."""

    kind: str
    knots: Floats
    columns: Floats
    """(n_scans, k, n_rays) by its value at each knot."""


def error_profiles(fitted: Fitted, *, least: float = 0.0) -> list[ErrorProfile]:
    """Fit each profile beside the effects and nuisances of a fit, where it is likely to first order; the likeliest first.

    Parameters
    ----------
    least : [nats] to first order, below which a profile is not fitted; its price at least
    """
    least = max(least, _price())
    found = [_fitted(fitted, one) for one in _profiles(fitted) if _screened(fitted, one) > least]
    return sorted(found, key=lambda one: -one.gain)


def profile_doubts(fitted: Fitted, null: Fitted | None = None) -> list[Doubt]:
    """Doubt a laser of which a profile of errors is sure.

    Parameters
    ----------
    null : the fit without effects: where a profile alone explains more than all effects do, with a profile beside them, it
    stands for them
    """
    found, failed = _sure(fitted), frozenset[int]()
    if fitted.model and null is not None:
        alone = _sure(null, SCAN.profiles.min_first_order_share * (fitted.j - null.j))
        beside = 0.0 if found is None else found.gain - _price()
        if alone is not None and is_better_alone(alone.gain - _price(), null, beside, fitted):
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
            causes=found.causes,
            profile=found.profile,
        )
    ]


def _sure(fitted: Fitted, least: float = 0.0) -> ErrorProfile | None:
    """Return the likeliest profile if likelihood and parts of the run speak for it; None where none does."""
    profiles = error_profiles(fitted, least=least)
    found = next((one for one in profiles if not _is_of_walls(one, fitted.solver.data.grain)), None)
    if found is None or found.gain - _price() < SCAN.selection.threshold:
        return None
    return found if found.amplitude_z > _least_z() else None


def _is_of_walls(found: ErrorProfile, grain: float) -> bool:
    """Tell whether an error over range is within a pixel of the map: of near walls and far ones, each half a pixel off."""
    return found.kind == BIAS_BY_RANGE and float(np.abs(found.errors).max()) < 2 * grain


def _price() -> float:
    return SCAN.selection.price * SCAN.profiles.n_knots


def _least_z() -> float:
    """Return what the size must exceed in standard errors, though its direction was chosen among so many."""
    k, n = SCAN.profiles.n_knots, SCAN.constancy.n_parts
    return float(np.sqrt(k * fdtri(k, n - 1, SCAN.constancy.confidence)))


def _profiles(fitted: Fitted) -> list[_Columns]:
    """Return the profiles that may be asked for; none where rays or scans are too few."""
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
    """Tell which readings (n_scans, n_rays) tell a size."""
    return fitted.solver.jacobian.valid & (fitted.solution.responsibilities.weight > 0)


def _screened(fitted: Fitted, profile: _Columns) -> float:
    """Return how much likelier a profile makes the readings to first order [nats]."""
    solver, solution = fitted.solver.with_columns(profile.columns), fitted.solution
    system = solver.assemble(solution.responsibilities.weight, fitted.state.pose_scale)
    k = len(profile.knots)
    x = np.concatenate([fitted.state.g, solution.p, np.zeros(k)])
    score = (system.right - system.matrix @ x)[-k:]
    covariance = inverse_of_whole([(system.matrix, system.right)], solver, solution)[-k:, -k:]
    return 0.5 * float(score @ covariance @ score)


def _fitted(fitted: Fitted, profile: _Columns) -> ErrorProfile:
    """Fit a profile together with all else."""
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
