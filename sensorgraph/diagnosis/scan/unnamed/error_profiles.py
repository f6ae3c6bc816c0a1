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

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.engine.ledger import as_name
from sensorgraph.diagnosis.result import Profile
from sensorgraph.diagnosis.scan.consequence import CAUSES, length
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.columns import (
    N_PARTS,
    ColumnEstimate,
    Columns,
    Words,
    find_columns,
    used_readings,
)
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Floats

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
N_KNOTS = 12
"""Number of bearings, or ranges, between which errors are interpolated."""
MAX_UNEVEN = 0.1
"""Maximum share of the squared errors that a line may leave if it explains a profile: a stretch of the field of view, or a scale."""
MOST_RANGES = 0.99
"""Quantile of the ranges at which their profile ends."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ProfileColumns(Columns):
    """A profile, linear in the errors at its knots.

    Its values are errors of the bearing [rad], positive to the left, or of the reading [m]. Their mean over all rays is 0.
    """

    kind: str
    """BEARING_ERROR, BIAS_BY_BEARING or BIAS_BY_RANGE."""
    knots: Floats
    """(k,) [rad or m] bearings or ranges, ascending."""

    @classmethod
    def of(cls, kind: str, knots: Floats, columns: Floats) -> ProfileColumns:
        """Return a profile without its mean, which the mount or the bias of the whole laser explains."""
        return cls(family=as_name(kind), columns=columns, is_contrast=True, kind=kind, knots=knots)

    def words(self, estimate: ColumnEstimate, fitted: Fitted) -> Words | None:
        """Return the words of a profile; None for errors by range that walls off by half a pixel, or a scale, explain."""
        errors, grain, slope = estimate.values, fitted.solver.data.grain, self._slope(estimate.values)
        worst = int(np.abs(errors).argmax())
        most, at = abs(float(errors[worst])), float(self.knots[worst])
        if self.kind == BEARING_ERROR:
            statement, causes = self._stretched(slope) if slope else _uneven(most, at)
        elif self.kind == BIAS_BY_BEARING:
            statement = (
                f"readings are off by up to {length(most)}, most at {np.degrees(at):.0f}°; the error depends on the bearing, "
                "and no single sector explains it"
            )
            causes = (CAUSES["bearing"]["bias"],)
        elif most < 2 * grain or slope:
            return None
        else:
            statement = (
                f"readings are off by up to {length(most)}, most at {at:.1f} m; the error depends on the range, and neither a "
                "bias nor a scale explains it"
            )
            causes = (CAUSES["range"]["bias"],)
        profile = Profile(
            of="bearing" if self.kind == BEARING_ERROR else "reading",
            over="range" if self.kind == BIAS_BY_RANGE else "bearing",
            at=tuple(self.knots.tolist()),
            error=tuple(errors.tolist()),
            stderr=tuple(estimate.stderr.tolist()),
        )
        return Words(statement=statement, causes=causes, profile=profile)

    def _slope(self, errors: Floats) -> float:
        """Return the slope of a line through errors (k,), as of a wider field of view; 0 unless it accounts for nearly all."""
        line = np.polyfit(self.knots, errors, 1)
        left = errors - np.polyval(line, self.knots)
        is_even = float((left**2).sum()) < MAX_UNEVEN * float((errors**2).sum())
        return float(line[0]) if is_even else 0.0

    def _stretched(self, stretch: float) -> tuple[str, tuple[str, ...]]:
        """Return a field of view with another width in words, and its possible causes."""
        width = float(np.degrees(self.knots[-1] - self.knots[0]))
        wider = "wider" if stretch > 0 else "narrower"
        return (
            f"the field of view is {100 * abs(stretch):.2g} % {wider} than specified, {width * (1 + stretch):.1f}° instead of "
            f"{width:.1f}°"
        ), STRETCHED


def _uneven(most: float, at: float) -> tuple[str, tuple[str, ...]]:
    """Return unevenly spaced bearings in words, with their largest error [rad] and its bearing, and their causes."""
    return (
        f"bearings are off by up to {np.degrees(most):.2g}°, most at {np.degrees(at):.0f}°; the error depends on the bearing"
    ), UNEVEN


def find(checked: Checked) -> list[Doubt]:
    """Return the error profiles of the laser; at most one is sure."""
    return find_columns(checked, profiles)


def profiles(fitted: Fitted) -> list[ProfileColumns]:
    """Return the profiles that can be tested; none if there are too few rays or scans."""
    data, solver = fitted.solver.data, fitted.solver
    bearings = data.sensor.bearings
    if data.sensor.is_composite or measures_cones(data.sensor):
        return []
    if data.n_rays < SCAN.intake.min_rays * N_KNOTS or data.n_scans < 2 * N_PARTS:
        return []
    used = used_readings(fitted)
    if not used.any():
        return []
    turned, biased = (solver.stack[:, one][:, None, :] for one in (Nuisance.MOUNT_YAW, Nuisance.BIAS))
    angles = np.linspace(bearings.min(), bearings.max(), N_KNOTS)
    ranges = np.where(used, solver.expected.reading, 0.0)
    lengths = np.linspace(float(ranges[used].min()), float(np.quantile(ranges[used], MOST_RANGES)), N_KNOTS)
    by_bearing, by_range = _hats(bearings, angles), _hats(np.minimum(ranges, lengths[-1]), lengths)
    return [
        ProfileColumns.of(BEARING_ERROR, angles, turned * by_bearing),
        ProfileColumns.of(BIAS_BY_BEARING, angles, biased * by_bearing),
        ProfileColumns.of(BIAS_BY_RANGE, lengths, biased * by_range),
    ]


def _hats(at: Floats, knots: Floats) -> Floats:
    """Return the piecewise linear functions (..., k, n) of values (..., n) that are 1 at one knot and 0 at the others."""
    width = knots[1] - knots[0]
    return np.asarray(np.maximum(0.0, 1 - np.abs(at[..., None, :] - knots[:, None]) / width))


ERROR_PROFILES = Unnamed(
    titles={
        as_name(BEARING_ERROR): "an error of the bearings that depends on the bearing",
        as_name(BIAS_BY_BEARING): "a bias that depends on the bearing",
        as_name(BIAS_BY_RANGE): "a bias that depends on the range",
    },
    find=find,
    is_cause=True,
)
