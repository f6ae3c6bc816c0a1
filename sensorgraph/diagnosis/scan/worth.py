"""Evidence of an effect after the penalties for its parameters, its place and site clutter, and apparent effects at a site.

    worth = J(with) - J(without) - ½ k log n - log m - clutter

Here k is the number of parameters, n that of readings, and m that of places.

At a site with known-good runs, the parts of the path must agree on an effect of the sensor:

    P(X >= number of parts with a positive gain) < disagreement,   X ~ Binomial(n_parts, 1/2)

The clutter of a site is local: a wall that is missing in the map, a cabinet that was moved, a door. An effect of the sensor shows
along the whole path. The run is therefore divided into parts in which the ends of beams move equally far, and a sign test checks
whether they agree. Parameters of the whole sensor have a sharper test: their size must exceed the spread over windows of
known-good runs (`site_baseline`), and counts with the precision with which parts of the run agree (jackknife).

A model that fits badly puts its largest discs at walls, or into unobserved space. The evidence of such discs in known-good runs is
added to the threshold of further discs. An object in known free space that stops the rays aimed at it is exempt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import bdtrc

from sensorgraph.diagnosis.scan.fit import Fitted, fit, solver_for, start_state
from sensorgraph.diagnosis.scan.normal_equations import System, boxed
from sensorgraph.diagnosis.scan.nuisance import UNIFORM, effects_with_nuisances, pose_prior
from sensorgraph.diagnosis.scan.residuals import with_poses_of_rays
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.places import obstacles
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.robot import Tolerances
from sensorgraph.world.sensor_parts import sensor_of_rays


def worth(data: ScanData, amendment: Amendment, better: Fitted, plain: Fitted) -> float:
    """Return the evidence [nats] of a fit over one without the effect, minus its penalties."""
    return evidence(data, amendment, better, plain) - price(amendment, data)


def price(amendment: Amendment, data: ScanData) -> float:
    """Return the penalty [nats] of an effect for its parameters, for the choice of its place, and for site clutter."""
    walls = {"wall": data.arena.n_walls, "obstacle": len(obstacles(data.arena))}
    places = walls.get(amendment.effect.place or "", 1)
    if amendment.place and amendment.effect.place is None:
        places = len(np.unique(sensor_of_rays(data.sensor)))
    paid = data.price(n_parameters(amendment)) + float(np.log(max(places, 1)))
    return paid + clutter_floor(amendment, data)


def n_parameters(amendment: Amendment) -> int:
    """Return the number of parameters of an effect that count for the complexity penalty."""
    effect = amendment.effect
    counted = [v != 0.0 or not effect.parameter(k).absent_at_zero for k, v in amendment.parameters.items()]
    return max(sum(counted), 1)


def evidence(data: ScanData, amendment: Amendment, better: Fitted, plain: Fitted) -> float:
    """Return the evidence [nats] of a fit over one without the effect.

    At a site with known-good runs, `spread_evidence` replaces it for effects that must show on the whole
    path.
    """
    if data.site.is_known and must_be_spread(amendment):
        return spread_evidence(data, better, plain)
    return better.j - plain.j


def must_be_spread(amendment: Amendment) -> bool:
    """Return whether an effect of the sensor has no sharper test than showing on all parts of the path.

    A warm-up has none: it starts where the robot starts, and readings may be slightly longer at another
    place.
    """
    effect = amendment.effect
    has_more = any(v != 0.0 and effect.parameter(k).absent_at_zero for k, v in amendment.parameters.items())
    is_of_sensor = effect.place in (None, "sector")
    return is_of_sensor and (has_more or not effect.nuisances)


def spread_evidence(data: ScanData, better: Fitted, plain: Fitted) -> float:
    """Return the evidence [nats]; at most 0 unless the parts of the path agree."""
    n, gained = SCAN.site.n_parts, _by_scan(data, better) - _by_scan(data, plain)
    by_part = np.bincount(parts_of_way(data), gained, minlength=n)
    chance = float(
        bdtrc(int((by_part > 0).sum()) - 1, n, 0.5)
    )  # of this many positive parts or more, if signs are random
    return better.j - plain.j if chance < SCAN.site.disagreement else min(better.j - plain.j, 0.0)


def _by_scan(data: ScanData, fitted: Fitted) -> Floats:
    """Return the log-likelihood (n_scans,) [nats] of the readings and of the pose of each scan."""
    delta = fitted.state.delta
    precision = pose_prior(data, fitted.state.pose_scale).inverse
    of_pose = 0.5 * np.einsum("ni,nij,nj->n", delta, precision, delta)
    return np.asarray(fitted.solution.responsibilities.log_p.sum(axis=1) - of_pose)


def parts_of_way(data: ScanData) -> Ints:
    """Return the part (n_scans,) of the path; in each part, the beam ends move equally far at a median range."""
    returned = data.ranges[data.returned]
    reach = float(np.median(returned)) if len(returned) else 1.0
    step = np.diff(data.poses, axis=0)
    judged = np.isfinite(data.ranges).sum(axis=1)[1:]
    moved = judged * (np.hypot(step[:, 0], step[:, 1]) + reach * np.abs(step[:, 2]))
    way = np.concatenate([[0.0], np.cumsum(moved)])
    share = way / way[-1] if way[-1] > 0 else np.zeros(len(way))
    return np.minimum((share * SCAN.site.n_parts).astype(np.intp), SCAN.site.n_parts - 1)


def clutter_floor(amendment: Amendment, data: ScanData) -> float:
    """Return the additional evidence [nats] that a name requires at this site."""
    floor = data.site.floor(amendment.name)
    return 0.0 if 0.0 < floor < np.inf and surely_stands(amendment, data) else floor


def surely_stands(amendment: Amendment, data: ScanData) -> bool:
    """Return whether an effect is a separate round object in known free space that stops the rays aimed at it.

    Counted are rays that are aimed at the inner part of the disc and, according to the map, continue beyond
    it. A ray that ends at the face of the disc was stopped; a ray that ends beyond it was not. A ray that
    ends before it carries no information. Rays that end next to the disc, at the same distance, indicate a
    larger object.
    """
    values, site = amendment.parameters, SCAN.site
    if amendment.effect.place != "spot" or "r" not in values:
        return False
    at, near = np.array([[values["x"], values["y"]]]), SCAN.goodness_of_fit.outline_distance
    if not data.arena.contains(at)[0] or data.barriers.distances(at)[0] < values["r"] + near:
        return False
    stopped, passed, beside = _met(data, at[0, 0], at[0, 1], values["r"])
    n_stopped, n_passed = int(stopped.sum()), int(passed.sum())
    return (
        n_stopped >= site.min_stopped_rays
        and n_stopped >= site.min_stopped_share * (n_stopped + n_passed)
        and int(stopped.any(axis=1).sum()) >= site.min_stopped_scans
        and int(beside.sum()) <= site.max_beside_share * n_stopped
    )


def _met(data: ScanData, x: float, y: float, r: float) -> tuple[Bools, Bools, Bools]:
    """Return which rays (n_scans, n_rays) end at the face of a disc at which they are aimed, beyond it, or next to it.

    A face out of range does not count, because a missing return does not show whether the ray met it.
    """
    beams, near = _beams(data), SCAN.goodness_of_fit.outline_distance
    ahead, aside = beams.towards(x, y)
    face = ahead - np.sqrt(np.maximum(r**2 - aside**2, 0.0))
    free = np.minimum(beams.ranges, data.sensor.range_max)
    ahead = np.where((face > 0) & (free > face + 2 * near), ahead, np.inf)
    aside = np.abs(aside)
    aimed = np.isfinite(ahead) & (aside < SCAN.site.inner_share * r)
    next_to = (aside > r + near) & (aside < r + 3 * near)
    with np.errstate(invalid="ignore"):
        stopped, passed = np.abs(data.ranges - face) <= near, data.ranges > face + near
        beside = next_to & (data.ranges < free - near) & (np.abs(data.ranges - ahead) < r + near)
    return aimed & stopped, aimed & passed, beside


def _beams(data: ScanData) -> Beams:
    """Return the rays in the map without effects."""
    return data.kept(b"bare map", lambda: data.scene().shoot())


def is_within_baseline(fitted: Fitted, amendment: Amendment) -> bool:
    """Return whether an effect is within the baseline of the site, given the agreement between parts of the run."""
    baseline = fitted.solver.data.site.intervals.get(amendment.name)
    if baseline is None:
        return False
    if baseline.contains(amendment):
        return True
    if not amendment.effect.nuisances or amendment.name not in fitted.names():
        return False
    return baseline.contains(amendment, cached_jackknife(fitted, amendment))


def cached_jackknife(fitted: Fitted, amendment: Amendment) -> dict[str, float]:
    """Return the jackknife standard errors of the parameters of a fitted effect, computed once per fit."""
    place = fitted.solver.n_g
    for other in fitted.model:
        if other.name == amendment.name:
            break
        place += len(other.steps)
    names, tau = list(other.steps), fitted.solver.scaled(fitted.state)

    def errors() -> dict[str, float]:
        found = jackknife(fitted, without_parts(fitted), tau, np.arange(place, place + len(names)))
        return dict(zip(names, found.tolist(), strict=True))

    return fitted.solver.data.kept(f"jackknife|{amendment.name}|{fitted.model!r}".encode(), errors)


def single_effects(fitted: Fitted) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """Add each smooth effect of the whole sensor to a fit separately.

    Returns
    -------
    Effect -> parameter -> size, and effect -> parameter -> jackknife standard error.
    """
    solver, left = fitted.solver, without_parts(fitted)
    sizes, stderrs = {}, {}
    for effect in effects_with_nuisances():
        chosen = np.array(effect.nuisances)
        if solver.locked[chosen].any():
            continue
        tau = solver.scaled(fitted.state)
        tau[chosen] = np.inf
        size = _solution(fitted, fitted.solution.system, tau)[chosen]
        errors = jackknife(fitted, left, tau, chosen)
        sizes[effect.name] = dict(zip(effect.steps, size.tolist(), strict=True))
        stderrs[effect.name] = dict(zip(effect.steps, errors.tolist(), strict=True))
    return sizes, stderrs


def without_parts(fitted: Fitted) -> list[list[System]]:
    """Return the normal equations without each part of the run in time, and without each part of its rays by bearing."""
    weight, out = fitted.solution.responsibilities.weight, []
    for part, count in zip(np.indices(weight.shape), weight.shape, strict=True):
        n = min(SCAN.site.n_parts, count)
        kept = (np.where(part * n // count == k, 0.0, weight) for k in range(n))
        out.append([fitted.solver.assemble(some, fitted.state.pose_scale) for some in kept])
    return out


def jackknife(fitted: Fitted, left: Sequence[Sequence[System]], tau: Floats, chosen: Ints) -> Floats:
    """Return the larger jackknife standard error of the `chosen` unknowns: over parts of the run, or of the rays.

        stderr = sqrt((n - 1) var(values))     (Efron and Stein 1981)

    The values are those of the n solutions that each leave out one part. A parameter of the whole sensor is the same at all
    times and at all bearings, unlike the effect of one wall or one sector.
    """
    values = [np.array([_solution(fitted, system, tau)[chosen] for system in systems]) for systems in left]
    return np.asarray(np.max([np.sqrt((len(one) - 1) * one.var(axis=0)) for one in values], axis=0))


def _solution(fitted: Fitted, system: System, tau: Floats) -> Floats:
    """Solve normal equations under priors `tau` and their bounds; return the unknowns (k,)."""
    bounds = SCAN.nuisance.max_tolerances * tau
    return boxed(system.matrix, system.right, tau, bounds, fitted.solver.locked).x


def pose_tolerances(data: ScanData, null: Fitted) -> Tolerances:
    """Return the pose tolerances with which one half of the bearings predicts the other half best.

    Parameters
    ----------
    null : Fit of the run without effects.
    """
    nominal = data.tolerances
    solver, _ = solver_for(data, ())
    state = replace(null.state, delta=data.pose_start, pose_scale=1.0)
    bearings = data.sensor.bearings
    half = np.floor((bearings - bearings[0]) / SCAN.site.sector).astype(np.intp) % 2 == 0
    factor = {"pose_xy": 1.0, "pose_yaw": 1.0}
    scores: dict[tuple[float, ...], float] = {}

    def score(trial: dict[str, float]) -> float:
        key = tuple(trial.values())
        if key not in scores:
            tolerances = replace(nominal, **{k: v * getattr(nominal, k) for k, v in trial.items()})
            solver.data = replace(data, tolerances=tolerances)
            scores[key] = sum(
                float(with_poses_of_rays(solver, state, rays)[0].log_p[:, ~rays].sum())
                for rays in (half, ~half)
            )
        return scores[key]

    for _ in range(2):
        for name in factor:
            factor[name] = max(SCAN.site.pose_factors, key=lambda f: score({**factor, name: f}))
    return replace(nominal, **{k: v * getattr(nominal, k) for k, v in factor.items()})


def shift_tolerances(data: ScanData, cuts: Sequence[int]) -> Tolerances:
    """Widen the tolerances of mount and stamps to the apparent shifts in a known-good run.

    The clock is fitted separately: while a robot turns in one direction only, a late clock looks like a yaw.

    Parameters
    ----------
    cuts : Numbers of windows into which the run is divided.
    """
    mount = [MOUNT_XY(dx=0.0, dy=0.0), MOUNT_YAW(delta=0.0)]
    clock = [LATENCY(tau=0.0)]
    nominal, noise, squares = data.tolerances, SCAN.site.wide_noise, []
    for window in (window for n in cuts for window in data.windows(n)):
        xy, yaw = fit(window, mount, start_state(window, noise), noise).model
        (late,) = fit(window, clock, start_state(window, noise), noise).model
        squares.append([xy["dx"] ** 2 / 2 + xy["dy"] ** 2 / 2, yaw["delta"] ** 2, late["tau"] ** 2])
    shift, turn, stamp = np.sqrt(np.mean(squares, axis=0))
    return replace(
        nominal,
        mount_xy=max(nominal.mount_xy, float(shift)),
        mount_yaw=max(nominal.mount_yaw, float(turn)),
        stamp=max(nominal.stamp, float(stamp) / UNIFORM),
    )
