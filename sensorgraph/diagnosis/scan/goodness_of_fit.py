"""Goodness of fit: deviations compared with replicates, scans with each other, and effects with their assumptions.

The largest deviation of each kind is compared with that of simulated replicates, which are sampled from the model
(parametric bootstrap; Efron and Tibshirani 1993, chapter 6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.result import Deviation, Profile
from sensorgraph.diagnosis.scan.cast_place import as_cast
from sensorgraph.diagnosis.scan.consequence import (
    SCATTER_CAUSES,
    ScanError,
    excess_noise,
    likely_causes,
    scan_error,
)
from sensorgraph.diagnosis.scan.constancy import changes
from sensorgraph.diagnosis.scan.deviations import deviations, dispersion, largest_z
from sensorgraph.diagnosis.scan.effect_laws import (
    Doubt,
    absences,
    broken_laws,
    in_walls,
    lost_by_direction,
    sure,
)
from sensorgraph.diagnosis.scan.error_profiles import profile_doubts
from sensorgraph.diagnosis.scan.fit import Fitted, fit
from sensorgraph.diagnosis.scan.odd_scans import odd_scan_doubts
from sensorgraph.diagnosis.scan.partitions import Partition, partitions
from sensorgraph.diagnosis.scan.replicates import replicate
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.tolerance_scale import tolerance_scale
from sensorgraph.types import Progress
from sensorgraph.world.robot import Tolerances

OF_SCANS = ("time", "omega", "speed", "acceleration", "robot place")
"""Partitions whose bins consist of whole scans."""
POSE_CAUSES = (
    "a reference pose that is less accurate than specified: a poor calibration, a slow filter, lost markers",
    "stamps of scans or poses that are late or jitter",
)
STAMP_CAUSES = (
    "stamps of scans or poses that are late or jitter",
    "a laser that moves relative to the robot: a bracket with play, a swaying mast",
)
HEADING_CAUSES = (
    "a reference whose heading is less accurate than specified: a slow filter, a course over ground",
)
MAP_CAUSES = (
    "a map that is less accurate than specified",
    "objects that have moved since the map was made",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class GoodnessOfFit:
    """Result of the test whether a model leaves anything unexplained."""

    statement: str = ""
    """Statement of the unexplained difference; empty if the model is sufficient."""
    deviation: Deviation | None = None
    """Strongest deviation that exceeds the replicates."""
    statistic: float = 0.0
    threshold: float = 0.0
    misfit: float = 0.0
    """[nats] approximate evidence for the unexplained part."""
    failed: frozenset[int] = frozenset()
    """Indices of effects of the model whose assumptions are violated; they are clutter and not named."""
    size: ScanError | None = None
    """Error of a simulation without the unexplained part; None if it cannot be quantified."""
    causes: tuple[str, ...] = ()
    """Possible causes, most likely first."""
    immaterial: tuple[str, ...] = ()
    """Differences that are significant, but smaller than a user tolerates."""
    profile: Profile | None = None
    """Error over bearing or range, if the difference is one."""
    is_of_building: bool = False
    """Whether the only difference is between the building and its map."""
    family: str = ""
    """Key of the unexplained difference in `FAMILIES`; empty without one."""
    tested: tuple[Doubt, ...] = ()
    """All differences that were tested, for the ledger."""
    least: float = 0.0
    """[nats] misfit that inexact effects may leave."""

    @property
    def is_doubted(self) -> bool:
        """Whether a difference is unexplained."""
        return bool(self.statement)


def check(
    data: ScanData,
    fitted: Fitted,
    gained: float,
    gains: Mapping[int, float],
    *,
    rng: np.random.Generator,
    null: Fitted | None = None,
    n_replicates: int = SCAN.goodness_of_fit.n_replicates,
    tick: Progress | None = None,
) -> GoodnessOfFit:
    """Test whether a model explains the run.

    Parameters
    ----------
    gained : [nats] Gain of the model over the one without effects; a difference must exceed a share of it.
    gains : [nats] Gain of each effect of the model.
    null : The fit without effects.
    """
    nominal, sigma = data.tolerances, data.sensor.sigma
    data, fitted = _widened(data, fitted)
    data = as_cast(data, fitted.state)
    view = FitResiduals(data, fitted)
    parts = partitions(view)
    found = deviations(view, parts)
    laws = broken_laws(view, gains, gained)
    at_walls = in_walls(view, gains)
    # a fringe of another effect's readings, or a small bulge of a wall, is neither a difference nor a named effect
    fringes = frozenset(i for d in laws for i in d.failed if fitted.model[i].effect.diagnostics.explains)
    fringes |= frozenset(i for d in at_walls for i in d.failed)
    doubts = [
        *laws,
        *at_walls,
        *lost_by_direction(view, gains),
        *_stretched(view, nominal),
        *absences(view),
        *_dispersed(view, found),
    ]
    doubts += _against_replicates(view, parts, found, nominal, rng, n_replicates, tick)
    whole = [*changes(fitted, null), *profile_doubts(fitted, null), *odd_scan_doubts(fitted, null, rng=rng)]
    share = SCAN.goodness_of_fit.min_share_of_gain
    inexact = sum((a.effect.diagnostics.misfit_share or share) * gains[i] for i, a in enumerate(fitted.model))
    # each effect allows for the share of its evidence by which its model is inexact
    least = max(share * gained, inexact)
    tested = (*whole, *doubts)
    doubts = [d for d in _told_in_order(sure(whole), sure(doubts)) if d.misfit > least]
    trifles = [d for d in doubts if d.size is not None and not d.size.is_material(sigma)]
    doubts = [d for d in doubts if d not in trifles]
    immaterial = tuple(f"{d.statement}; {d.size.sentence()}" for d in trifles if d.size is not None)
    if not doubts:
        return GoodnessOfFit(failed=fringes, immaterial=immaterial, tested=tested, least=least)
    told = _of_doubts(doubts[0], doubts, doubts[0].causes or likely_causes(found), immaterial)
    return replace(told, failed=told.failed | fringes, tested=tested, least=least)


def _told_in_order(changed: Sequence[Doubt], doubts: Sequence[Doubt]) -> list[Doubt]:
    """Order by misfit, with changes in time, error profiles and odd scans before their consequences.

    They do not come first if a single place has a larger misfit: readings are then off at that place, and the change only
    imitates it.
    """
    at_places = [d.deviation.z for d in doubts if d.deviation is not None and d.deviation.xy is not None]
    most = max((0.5 * z**2 for z in at_places), default=0.0)
    first = sorted((d for d in changed if d.misfit >= most), key=lambda d: -d.misfit)
    rest = [d for d in (*changed, *doubts) if d not in first]
    return [*first, *sorted(rest, key=lambda d: -d.misfit)]


def _widened(data: ScanData, fitted: Fitted) -> tuple[ScanData, Fitted]:
    """Fit again with wider tolerances if the specified ones are too tight, and find the edges again."""
    state = fitted.state
    if state.stretch < SCAN.nuisance.stretched_scale:
        return data, fitted
    t = data.tolerances
    wide = replace(
        t,
        map=t.map * state.map_scale,
        pose_xy=t.pose_xy * state.pose_scale,
        pose_yaw=t.pose_yaw * state.pose_scale,
        stamp=t.stamp * state.pose_scale,
    )
    wider = replace(data, tolerances=wide, memo={})
    start = replace(state, pose_scale=1.0, map_scale=1.0)
    bounds = NoiseBounds(max_scale=SCAN.goodness_of_fit.widened_max_scale)
    return wider, fit(wider, fitted.model, start, bounds, outer=1, inner=3)


def _stretched(view: FitResiduals, nominal: Tolerances) -> list[Doubt]:
    """Report a model that needs tolerances far wider than the nominal ones."""
    state, t = view.fitted.state, view.data.tolerances
    poses = state.pose_scale * t.pose_xy / max(nominal.pose_xy, 1e-9)
    walls = state.map_scale * t.map / max(nominal.map, 1e-9)
    limit = SCAN.goodness_of_fit.max_tolerance_scale
    return _beyond_tolerances(poses, walls, nominal, view.data.n_scans, limit)


def _beyond_tolerances(
    poses: float, walls: float, nominal: Tolerances, n_scans: int, limit: float
) -> list[Doubt]:
    """Report poses and walls; sure are those at least `limit` times worse than their tolerances."""
    return [
        Doubt(
            family=family,
            is_sure=bool(scale >= limit),
            statement=f"the {name} would have to be {scale:.1f} times worse than its tolerance",
            misfit=(scale - 1) * n_scans,
            statistic=scale,
            threshold=limit,
            size=ScanError(offset=scale * tolerance, affected=1.0),
            causes=causes,
        )
        for family, name, scale, tolerance, causes in (
            ("reference_worse", "reference pose", poses, nominal.pose_xy, POSE_CAUSES),
            ("map_worse", "map", walls, nominal.map, MAP_CAUSES),
        )
    ]


def told_by_tolerances(fitted: Fitted) -> GoodnessOfFit | None:
    """Report tolerances of a fit that are far wider than specified; None if they are not.

    Where effects explain much of the residuals, no other test would detect this. For example, a room that is longer than in
    its plan is partly explained by a map scale, and its corners absorb the rest.
    """
    data, state, settings = fitted.solver.data, fitted.state, SCAN.goodness_of_fit
    limit = settings.max_tolerance_scale_beside_effects if fitted.model else settings.max_tolerance_scale
    scales = state.pose_scale, state.map_scale
    doubts = sure(_beyond_tolerances(*scales, data.tolerances, data.n_scans, limit))
    doubts += [] if data.from_scans else _one_part_of_the_poses(fitted)
    if not doubts:
        return None
    return _of_doubts(max(doubts, key=lambda d: d.statistic), doubts, doubts[0].causes, ())


def _one_part_of_the_poses(fitted: Fitted) -> list[Doubt]:
    """Report stamps or a heading that are far less accurate than specified, while the positions are not."""
    data, limit = fitted.solver.data, SCAN.goodness_of_fit.max_tolerance_scale
    speed, turn = np.hypot(*data.twists[:, :2].T), np.abs(data.twists[:, 2])
    far = float(np.median(data.ranges[data.returned])) if data.returned.any() else 0.0
    told = data.tolerances
    off = float(np.sqrt(np.mean(speed**2 + (far * turn) ** 2))) * told.stamp
    parts = (
        ("stamps of the scans", tolerance_scale(fitted, "stamp"), off, STAMP_CAUSES),
        (
            "heading of the reference",
            tolerance_scale(fitted, "pose_yaw"),
            far * told.pose_yaw,
            HEADING_CAUSES,
        ),
    )
    # where the robot turns, jitter of the stamps is equivalent to an error of the heading
    worse = sorted((part for part in parts if part[1] >= limit), key=lambda part: -part[1])
    if not worse:
        return []
    scale, one = worse[0][1:3]
    names = " or the ".join(name for name, *_ in worse)
    return [
        Doubt(
            family="stamps_or_heading_worse",
            statement=f"the {names} would have to be {scale:.1f} times worse than specified",
            misfit=(scale - 1) * data.n_scans,
            statistic=scale,
            threshold=limit,
            size=ScanError(offset=scale * one, affected=1.0),
            causes=tuple(cause for *_, causes in worse for cause in causes),
        )
    ]


def _of_doubts(
    first: Doubt, doubts: Sequence[Doubt], causes: tuple[str, ...], immaterial: tuple[str, ...]
) -> GoodnessOfFit:
    """Return the result for the first of several differences."""
    return GoodnessOfFit(
        family=first.family,
        statement=first.statement,
        deviation=next((d.deviation for d in doubts if d.deviation is not None), None),
        statistic=first.statistic,
        threshold=first.threshold,
        misfit=first.misfit,
        failed=frozenset(i for d in doubts for i in d.failed),
        size=first.size,
        causes=causes,
        immaterial=immaterial,
        profile=first.profile,
        is_of_building=all(d.is_of_building for d in doubts),
    )


def _dispersed(view: FitResiduals, found: Sequence[Deviation]) -> list[Doubt]:
    """Report how much more scans differ from each other than the rays within a scan explain."""
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


def _against_replicates(
    view: FitResiduals,
    parts: Sequence[Partition],
    found: Sequence[Deviation],
    nominal: Tolerances,
    rng: np.random.Generator,
    count: int,
    tick: Progress | None,
) -> list[Doubt]:
    """Compare the largest deviation of each kind with replicates, which are simulated only for suspect kinds."""
    settings, t = SCAN.goodness_of_fit, view.data.tolerances
    most = {family: z for family, z in largest_z(found).items() if z > 0}
    suspects = {family: z for family, z in most.items() if z > settings.min_z[family]}
    out = [
        _deviating(view, found, family, settings.min_z[family]) for family in most if family not in suspects
    ]
    if not suspects:
        return out
    wider = max(t.map / max(nominal.map, 1e-9), t.pose_xy / max(nominal.pose_xy, 1e-9))
    slack = float(np.clip(wider, 1.0, 2.0))
    drawn = _largest_z_of_replicates(view, parts, rng, count, tick)
    for family in suspects:
        d = np.array(drawn[family])
        beyond_largest = settings.replicate_factor * float(d.max())
        beyond_mean = float(d.mean() + settings.replicate_sigmas * d.std())
        threshold = max(beyond_largest, beyond_mean, settings.min_z[family]) * slack
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


def _largest_z_of_replicates(
    view: FitResiduals,
    parts: Sequence[Partition],
    rng: np.random.Generator,
    count: int,
    tick: Progress | None,
) -> dict[str, list[float]]:
    """Return the largest |z| of each replicate, by kind of deviation."""
    out: dict[str, list[float]] = {family: [] for family in SCAN.goodness_of_fit.min_z}
    for done in range(count):
        if tick is not None:
            tick(done, count)
        again = FitResiduals(*replicate(view.data, view.fitted, rng))
        found = deviations(again, parts, min_z=SCAN.goodness_of_fit.replicate_z)
        for family, z in largest_z(found).items():
            out[family].append(z)
    return out
