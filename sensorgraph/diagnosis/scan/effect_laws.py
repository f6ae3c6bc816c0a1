"""Test whether the effects of a model satisfy their own assumptions: on the readings they absorb, place and combination."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.result import Deviation, Profile
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.fit import bare_cast, cast, log_p_at
from sensorgraph.diagnosis.scan.materiality import is_map_error
from sensorgraph.diagnosis.scan.people_law import (
    STANDING_CAUSES,
    STRAY_CAUSES,
    clustered,
    where_things_stand,
    why_not_people,
)
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.effect import Telltale, without
from sensorgraph.effects.places import part_of_wall
from sensorgraph.effects.proposals import best_run
from sensorgraph.types import Bools, Floats, Ints

LEAST_CHANGE = 1e-4
"""[m] minimum change of a reading by an effect."""
WIDENED = 2.0
"""Ratio of fitted to nominal noise above which an effect accounts for most of the noise."""
FAR = 4.0
"""Standard deviations within which the shape of the noise is tested; farther readings are outliers."""
FLAT = -0.3
"""Maximum excess kurtosis of non-Gaussian noise: 0 for a normal distribution, -1.2 for a uniform one."""
WALL_CAUSES: tuple[str, ...] = (
    "furniture that leans against the wall, an open door, a radiator",
    "a reflector, which appears wider than it is",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Doubt:
    """A difference that a model may not explain: a hypothesis without a name."""

    family: str
    """Key in `FAMILIES` (`scan.families`)."""
    statement: str
    misfit: float
    """[nats] approximate evidence for the difference."""
    statistic: float
    threshold: float
    """Threshold of the statistic."""
    deviation: Deviation | None = None
    """Deviation that shows it."""
    failed: frozenset[int] = frozenset()
    """Indices of the effects whose assumptions are violated."""
    size: ScanError | None = None
    """Error of a simulation without it; None if it cannot be quantified, which counts as material."""
    causes: tuple[str, ...] = ()
    """Possible causes, most likely first."""
    profile: Profile | None = None
    """Error over bearing or range, if the difference is one."""
    is_of_building: bool = False
    """Whether the building differs from its map; this concerns few rays, unlike an error of the sensor."""
    price: float = 0.0
    """[nats] Complexity penalty, which the misfit contains."""
    is_sure: bool = True
    """Whether the statistic exceeds its threshold; other doubts are only kept for the ledger."""


def sure(doubts: Sequence[Doubt]) -> list[Doubt]:
    """Return the doubts whose statistic exceeds its threshold."""
    return [doubt for doubt in doubts if doubt.is_sure]


def broken_laws(view: FitResiduals, gains: Mapping[int, float], gained: float) -> list[Doubt]:
    """List effects that absorb readings contrary to their assumptions, and implausible combinations of effects.

    Parameters
    ----------
    gains : [nats] Gain of each effect of the model.
    gained : [nats] Gain of all effects together; two effects that absorb the same readings gain little each.
    """
    settings = SCAN.goodness_of_fit
    out = []
    absorbed = gained - sum(gains[i] for i, a in enumerate(view.fitted.model) if not a.effect.absorber)
    model = view.fitted.model
    for index, a in enumerate(model):
        words, causes, odd_share = why_not_absorbed(view, a)
        if words:
            # a fringe of a strong effect's own readings is not a contradiction
            worth = settings.failed_law_share * max(gains[index], absorbed)
            out.append(
                Doubt(
                    family="absorbed_readings",
                    statement=words,
                    misfit=worth,
                    statistic=0.0,
                    threshold=0.0,
                    failed=frozenset([index]),
                    size=ScanError(wrong=odd_share),
                    causes=causes,
                    # an occupancy-grid map lacks moving and thin objects, so these outliers are not uniform
                    is_of_building=causes == STANDING_CAUSES
                    or (a.effect.diagnostics.explains == "strays" and view.data.grain > 0),
                )
            )
    out += [doubt for i, gain in gains.items() if (doubt := _flat_noise(view, i, gain)) is not None]
    for telltale in _telltales():
        members = [
            i
            for i, a in enumerate(model)
            if a.effect.diagnostics.telltale == telltale
            and a.ratio >= 1  # an immaterial effect is not evidence
            and not is_map_error(view.fitted, a)
        ]
        count = len({model[i].name for i in members}) if telltale.distinct else len(members)
        if count >= telltale.least:
            out.append(
                Doubt(
                    family="implausible_combination",
                    statement=telltale.statement,
                    misfit=settings.failed_law_share * sum(gains[i] for i in members),
                    statistic=float(count),
                    threshold=float(telltale.least),
                    failed=frozenset(members),
                )
            )
    return out


def _flat_noise(view: FitResiduals, index: int, gain: float) -> Doubt | None:
    """Report noise that is not normally distributed but bounded, as from rounding with unequal steps.

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
        family="rounded_readings",
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


def why_not_absorbed(view: FitResiduals, a: Amendment) -> tuple[str, tuple[str, ...], float]:
    """Return why the readings that an effect absorbs contradict its assumptions, their possible causes and their share.

    The reason is empty if they are consistent, or if the effect absorbs none.
    """
    explains = a.effect.diagnostics.explains
    responsibilities = view.fitted.solution.responsibilities
    off_edge = view.fitted.cast.expected.p_alternative < SCAN.likelihood.min_edge_chance
    odd = view.returned & (responsibilities.core + responsibilities.tail < 0.5) & off_edge
    if explains == "short readings":
        with np.errstate(invalid="ignore"):
            odd &= view.z < np.where(view.aimed, view.mu, view.range_max)
    if not explains or odd.sum() <= SCAN.goodness_of_fit.min_absorbed_rays:
        return "", (), 0.0
    why = why_not_people(view, odd) if explains == "short readings" else _why_not_random(view, odd)
    return (*why, float(odd.mean()))


def _telltales() -> list[Telltale]:
    """Return the combinations of effects that are implausible, each once."""
    found = [effect.diagnostics.telltale for effect in EFFECTS.values()]
    return list(dict.fromkeys(telltale for telltale in found if telltale is not None))


def in_walls(view: FitResiduals, gains: Mapping[int, float]) -> list[Doubt]:
    """Report an unmapped disc whose centre is inside a wall of the map: only a bulge of the wall is visible.

    At a site with known-good runs the test is skipped. Maps are inaccurate at walls everywhere, and the clutter floor
    accounts for it.

    Parameters
    ----------
    gains : [nats] Gain of each effect of the model.
    """
    data = view.data
    if data.clutter_nats:
        return []
    out = []
    for index, a in enumerate(view.fitted.model):
        if a.effect.place != "spot" or is_map_error(view.fitted, a):
            continue
        x, y = a["x"], a["y"]
        if data.arena.contains(np.array([[x, y]]))[0]:
            continue
        wall = data.arena.names[_nearest_wall(data.arena.walls, np.array([x, y]))]
        out.append(
            Doubt(
                family="object_at_wall",
                statement=f"readings end in front of {wall} near ({x:.1f}, {y:.1f}) m: an object stands against the wall, "
                "or the wall is reflective there",
                misfit=gains[index],
                statistic=gains[index],
                threshold=SCAN.selection.threshold,
                failed=frozenset([index]),
                size=_size_of(view, index),
                causes=WALL_CAUSES,
            )
        )
    return out


def _size_of(view: FitResiduals, index: int) -> ScanError:
    """Return the error of readings that are simulated without one effect of the model."""
    fitted, data = view.fitted, view.fitted.solver.data
    # cast both models again, because other effects may have moved since the cast of the fit
    whole, rest = (
        cast(data, model).expected.reading for model in (fitted.model, without(fitted.model, index))
    )
    with np.errstate(invalid="ignore"):
        off = np.abs(rest - whole)
    some = view.returned & (off > LEAST_CHANGE)
    return ScanError(
        offset=float(np.sqrt(np.square(off[some & np.isfinite(off)]).mean())) if some.any() else 0.0,
        affected=float(some.mean()),
    )


def _nearest_wall(walls: Floats, point: Floats) -> int:
    """Return the index of the wall, of (n, 2, 2) [m], that is nearest to a point (2,)."""
    way = walls[:, 1] - walls[:, 0]
    share = ((point - walls[:, 0]) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12)
    foot = walls[:, 0] + np.clip(share, 0.0, 1.0)[:, None] * way
    return int(np.argmin(np.hypot(*(foot - point).T)))


def absences(view: FitResiduals) -> list[Doubt]:
    """Report a fixed object that is absent for one part of the run: a door, for example, instead of a pane."""
    settings, data, fitted = SCAN.goodness_of_fit, view.data, view.fitted
    out = []
    for index, a in enumerate(fitted.model):
        if a.effect.place not in ("wall", "obstacle", "spot"):
            continue
        rest = without(fitted.model, index)
        bare = log_p_at(data, rest, fitted.state)
        off_edge = fitted.cast.expected.p_alternative < SCAN.likelihood.min_edge_chance
        better = np.where(off_edge, bare - view.log_p, 0.0)
        first, last, gain = best_run(better.sum(axis=1)[None])
        n_better = int((better[first[0] : last[0] + 1] > settings.clearly_better).sum())
        if gain[0] > settings.min_absence_gain and n_better > settings.min_absence_rays:
            begin, end = data.stamps[first[0]], data.stamps[last[0]]
            out.append(
                Doubt(
                    family="temporary_object",
                    statement=f"{a.effect.title} at {a.place or 'its spot'} is absent from "
                    f"{begin - data.begin:.0f} s to {end - data.begin:.0f} s of the run",
                    misfit=float(gain[0]),
                    statistic=float(gain[0]),
                    threshold=settings.min_absence_gain,
                    failed=frozenset([index]),
                    size=ScanError(wrong=n_better / view.log_p.size),
                    causes=("a door, a vehicle or a person that came or left during the run",),
                )
            )
    return out


def lost_by_direction(view: FitResiduals, gains: Mapping[int, float]) -> list[Doubt]:
    """Report a wall segment without returns if the missing returns depend on the direction in the room instead.

    In these directions, returns from other walls are missing as well; in other directions rays to the segment return.
    This is typical of light from one side.

    Parameters
    ----------
    gains : [nats] Gain of each effect of the model.
    """
    settings, beams = SCAN.goodness_of_fit, view.beams
    scene = view.fitted.cast.scene
    placed = [(i, a) for i, a in enumerate(view.fitted.model) if a.effect.on_part_of_wall]
    if not placed:
        return []
    bare = bare_cast(scene)
    n = settings.n_light_directions
    towards = np.broadcast_to(np.arctan2(beams.uy, beams.ux), view.lost.shape)
    direction = np.clip(((towards + np.pi) / (2 * np.pi) * n).astype(np.intp), 0, n - 1)
    is_near_enough = np.isfinite(bare.ranges) & (bare.ranges < view.range_max) & ~np.isnan(view.z)
    out = []
    for index, a in placed:
        on = is_near_enough & part_of_wall(scene, bare, a)

        def share(rays: Bools) -> tuple[Floats, Ints]:
            """Return the share of missing returns in each direction (n,), and the number of rays."""
            count = np.bincount(direction[rays], minlength=n)
            lost = np.bincount(direction[rays & view.lost], minlength=n)
            return lost / np.maximum(count, 1), count

        (on_part, n_on), (elsewhere, n_elsewhere) = share(on), share(is_near_enough & ~on)
        both = (n_on >= settings.min_rays) & (n_elsewhere >= settings.min_rays)
        # at the edge of the light, a direction is neither dark nor light
        least = settings.min_light_share
        dark, light = both & (on_part > 0.5), both & (on_part < settings.max_light_share)
        if (
            dark.any()
            and light.any()
            and (elsewhere[dark] > least).all()
            and (elsewhere[light] < least).all()
        ):
            out.append(
                Doubt(
                    family="missing_by_direction",
                    statement=f"returns are missing towards one side of the room ({np.degrees(_middle(dark)):.0f}° in the map), "
                    "at every wall in that direction",
                    misfit=gains[index],
                    statistic=float(elsewhere[dark].mean()),
                    threshold=least,
                    failed=frozenset([index]),
                    size=ScanError(wrong=float(view.lost.mean())),
                    causes=("light from that side: sun through a window, a lamp",),
                )
            )
    return out


def _middle(some: Bools) -> float:
    """Return the mean direction [rad] of some of the equal bins of a full turn."""
    at = (np.flatnonzero(some) + 0.5) / len(some) * 2 * np.pi - np.pi
    return float(np.angle(np.exp(1j * at).mean()))


def _why_not_random(view: FitResiduals, odd: Bools) -> tuple[str, tuple[str, ...]]:
    """Return why outliers are not uniform, and their possible causes; empty if they may be random."""
    settings = SCAN.goodness_of_fit
    share = float(odd.mean())
    u = np.sort(view.z[odd] / view.range_max)
    n = len(u)
    d = float(np.abs(u - (np.arange(n) + 0.5) / n).max())
    least, per_root = settings.max_uniform_distance
    constant, times = settings.max_clustered_strays
    strays = f"{100 * share:.1f} % of the readings are outliers"
    if d > max(least, per_root / np.sqrt(n)):
        words = f"{strays}, but their ranges are not uniformly distributed"
    elif clustered(view, odd) > constant + times * share:
        words = f"{strays} and form clusters"
    else:
        return "", ()
    if standing := where_things_stand(view, odd):
        return f"{strays}, {standing}: the map differs from the building there", STANDING_CAUSES
    return words, STRAY_CAUSES
