"""Whether short readings are of people: somebody is as wide as a body, walks, and is not drawn along by the robot.

A second laser's ghosts, rays that stick, dust, and a floor that rises to the laser shorten readings, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import bdtr

from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.ray_order import neighbouring_rays

PLACE = 0.5
"""[m] to which the place of most readings is told."""
STRAY_CAUSES: tuple[str, ...] = (
    "a second laser, or the robot's own light reflected",
    "dust, fog, rain or a dirty window",
    "parts of the robot, cables, or things on it within view",
)
STANDING_CAUSES: tuple[str, ...] = (
    "furniture, doors or walls that the map lacks",
    "things that have been moved a little, or are drawn too large or too small",
)
REPEATED_CAUSES: tuple[str, ...] = (
    "a driver or a filter that passes old readings on",
    "rays of the laser that stick",
)
WRAPPED_CAUSES: tuple[str, ...] = (
    "a laser that measures a phase, whose ranges begin anew beyond a distance",
    "an echo of the pulse before",
)
PLACE_CAUSES: tuple[str, ...] = (
    "steam, dust or spray that comes up there at times",
    "a door, a curtain, a plant or a machine that moves there",
)
WIDE_CAUSES: tuple[str, ...] = (
    "a ramp, a kerb or a tilt of the robot, so that the laser sees the floor",
    "furniture, vehicles or walls that the map lacks",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Clusters:
    """Short readings of one scan that lie beside each other, as things."""

    scan: Ints
    """(n,)"""
    n_rays: Ints
    """(n,)"""
    xy: Floats
    """(n, 2) [m, map] middle of the ends of their rays."""
    width: Floats
    """(n,) [m] from the end of the first ray to that of the last."""


def why_not_people(view: FitResiduals, short: Bools) -> tuple[str, tuple[str, ...]]:
    """Return why short readings (n_scans, n_rays) are no people, and what they may be; empty: they may be people."""
    settings = SCAN.goodness_of_fit
    short_ones = f"{100 * short.mean():.1f} % of the readings are short"
    if clustered(view, short) < least_clustered(view, short):
        return f"{short_ones}, one by one: too scattered for people", STRAY_CAUSES
    z = view.z[short]
    if at_one_range := _at_one_range(view, short):
        return f"{short_ones}, most of them at {at_one_range:.2f} m", STRAY_CAUSES
    lacking = view.mu[short] - z  # of what the map has in the direction of the ray
    lacking = lacking[np.isfinite(lacking)]
    usual = float(np.median(lacking)) if len(lacking) else 0.0
    alike = np.abs(lacking - usual) < max(settings.range_bin, 3 * view.data.sensor.sigma)
    if alike.sum() > settings.min_wrapped_share * len(z) and usual > settings.min_wrap:
        return f"{short_ones}, most of them by {usual:.2f} m", WRAPPED_CAUSES
    repeated = repeated_share(view, short)
    if repeated > settings.max_repeated_share:
        return f"{short_ones}, and {100 * repeated:.0f} % of these repeat the scan before", REPEATED_CAUSES
    if view.sensor.n_rays > 1 and not view.sensor.is_composite:
        things = clusters_of(view, short)
        wide = things.width > settings.max_person_width
        share = float(things.n_rays[wide].sum() / max(things.n_rays.sum(), 1))
        if share > settings.max_wide_share:
            return f"{short_ones}, {100 * share:.0f} % of these of things too wide for a person", WIDE_CAUSES
        found, followed = _found_again(view, things)
        least = settings.min_found_share
        is_seldom = followed >= settings.min_followed and found < least * followed
        if is_seldom or bdtr(found, followed, least) < settings.lost_by_chance:
            return (
                f"{short_ones}, but of what they show only {100 * found / followed:.0f} % is there in the next scan, within "
                "what somebody walks meanwhile",
                STRAY_CAUSES,
            )
        if _drawn_along(view, things) > settings.max_drawn_along:
            return f"{short_ones}, of things that turn and move with the robot", STRAY_CAUSES
    if standing := where_things_stand(view, short):
        return f"{short_ones}, {standing}: what stands there does not walk", STANDING_CAUSES
    if again := _again_at_one_place(view, short):
        return f"{short_ones}, {again}", PLACE_CAUSES
    return "", ()


def _at_one_range(view: FitResiduals, short: Bools) -> float:
    """Return the range at which most short readings lie again and again [m]; 0: there is none."""
    settings = SCAN.goodness_of_fit
    bins = (np.maximum(view.z[short], 0.0) // settings.range_bin).astype(np.intp)
    counts = np.bincount(bins)
    fullest = int(counts.argmax())
    when = view.data.stamps[np.nonzero(short)[0]][bins == fullest]
    seconds = len(np.unique(np.floor(when - view.data.stamps[0])))
    least = min(settings.min_bin_seconds, int(np.ptp(view.data.stamps)))
    if counts[fullest] <= settings.max_bin_share * len(bins) or seconds < least:
        return 0.0
    return settings.range_bin * (fullest + 0.5)


def _again_at_one_place(view: FitResiduals, short: Bools) -> str:
    """Say that short readings end at one place again and again, as in a cloud, and where; empty: they do not.

    What is seen at one moment fills the place, or, where nothing is ever seen elsewhere, a good part of it: a door that
    swings. Somebody who walks up and down there is narrow, and elsewhere each time.
    """
    settings = SCAN.goodness_of_fit
    ends, scan = view.ends(short), np.nonzero(short)[0]
    middle = np.median(ends, axis=0)

    def is_near(points: Floats) -> Bools:
        return np.asarray(np.hypot(*(points - middle).T) < settings.one_place)

    near, least = is_near(ends), settings.min_place_share
    if near.mean() < least or is_near(view.ends(view.returned)).mean() > 1 - least:
        return ""
    _, at, count = np.unique(scan[near], return_inverse=True, return_counts=True)
    centres = np.stack([np.bincount(at, column) / count for column in ends[near].T], axis=1)[at]
    within = float(np.square(ends[near] - centres).sum(axis=1).mean())
    between = float(np.square(centres - middle).sum(axis=1).mean())
    times = 1 + int((np.diff(view.data.stamps[np.unique(scan[near])]) > settings.standing_time).sum())
    most = between / 4 if near.mean() > settings.never_elsewhere else between  # half as wide
    if times < settings.min_place_times or within < most:
        return ""
    x, y = middle
    return (
        f"{100 * near.mean():.0f} % of these within {settings.one_place:g} m of ({x:.1f}, {y:.1f}) m, {times} times in the run: "
        "people come from elsewhere"
    )


def where_things_stand(view: FitResiduals, some: Bools) -> str:
    """Say that readings (n_scans, n_rays) end where others do, later or before, and where most; empty: they do not."""
    settings = SCAN.goodness_of_fit
    still = _standing_share(view, some)
    if still <= settings.max_standing_share:
        return ""
    ends = view.ends(some)
    cell, count = np.unique(np.floor(ends / PLACE).astype(np.intp), axis=0, return_counts=True)
    x, y = PLACE * (cell[count.argmax()] + 0.5)
    return (
        f"and at {100 * still:.0f} % of the places where they end rays end there, too, that come {settings.standing_time:g} s to "
        f"{settings.standing_window:g} s later or before (most at ({x:.1f}, {y:.1f}) m)"
    )


def repeated_share(view: FitResiduals, some: Bools) -> float:
    """Return the share of readings that their rays have read in the scan before, beyond what coarse steps make equal."""
    later = some[1:]
    if not later.any():
        return 0.0
    step = view.data.sensor.resolution
    with np.errstate(invalid="ignore"):
        same = later & (np.abs(view.z[1:] - view.z[:-1]) < 0.5 * max(step, 1e-9))
    # two draws of the noise fall on one step by chance
    by_chance = min(1.0, step / (2 * np.sqrt(np.pi) * view.data.sensor.sigma))
    share = float(same.sum() / later.sum())
    return max(0.0, (share - by_chance) / (1 - by_chance)) if by_chance < 1 else 0.0


def clusters_of(view: FitResiduals, short: Bools) -> Clusters:
    """Group short readings of neighbouring rays at similar ranges; one ray may be missing between."""
    scan, ray = np.nonzero(short)
    if not len(scan):
        none = np.zeros(0, dtype=np.intp)
        return Clusters(scan=none, n_rays=none, xy=np.zeros((0, 2)), width=np.zeros(0))
    apart = (np.diff(scan) > 0) | (np.diff(ray) > 2)
    apart |= np.abs(np.diff(view.z[scan, ray])) >= SCAN.goodness_of_fit.neighbour_distance
    label = np.concatenate([[0], np.cumsum(apart)])
    first = np.flatnonzero(np.concatenate([[True], apart]))
    last = np.append(first[1:] - 1, len(scan) - 1)
    ends, count = view.ends(short), np.bincount(label)
    return Clusters(
        scan=scan[first],
        n_rays=count,
        xy=np.stack([np.bincount(label, column) for column in ends.T], axis=1) / count[:, None],
        width=np.hypot(*(ends[last] - ends[first]).T),
    )


def _found_again(view: FitResiduals, things: Clusters) -> tuple[int, int]:
    """Count the things of two rays and more that the next scan shows near their place, of those that it looks at.

    It looks at a place where a ray comes within half its step and the map lets it pass beyond.
    """
    settings, beams, stamps = SCAN.goodness_of_fit, view.beams, view.data.stamps
    step = float(np.median(np.diff(stamps)))
    found = followed = 0
    spacing = _spacing(view)
    starts = np.searchsorted(things.scan, np.arange(len(stamps) + 1))
    for k in np.unique(things.scan[things.n_rays >= 2]):
        if k + 1 >= len(stamps) or stamps[k + 1] - stamps[k] > 2 * step:
            continue
        mine = slice(starts[k], starts[k + 1])
        at = things.xy[mine][things.n_rays[mine] >= 2]
        ox, oy = (np.broadcast_to(o, beams.ux.shape)[k + 1, 0] for o in (beams.ox, beams.oy))
        away = at - (ox, oy)
        along = away @ np.stack([beams.ux[k + 1], beams.uy[k + 1]])  # (n, n_rays)
        across = np.abs(away @ np.stack([beams.uy[k + 1], -beams.ux[k + 1]]))
        across = np.where(along > 0, across, np.inf)
        ray = across.argmin(axis=1)
        distance = along[np.arange(len(at)), ray]
        seen = across.min(axis=1) <= 0.5 * spacing * distance + 1e-9
        seen &= view.mu[k + 1, ray] > distance + settings.neighbour_distance
        there = things.xy[starts[k + 1] : starts[k + 2]]
        reach = settings.walking_speed * (stamps[k + 1] - stamps[k]) + settings.walking_slack
        for place in at[seen]:
            followed += 1
            found += bool(len(there)) and bool(np.hypot(*(there - place).T).min() < reach)
    return found, followed


def _drawn_along(view: FitResiduals, things: Clusters) -> float:
    """Return how surely things stay with the robot rather than in the room [standard errors]; below 0 the room is surer.

    From one scan to the next somebody moves as they like in the map, and besides that as the robot does in its own frame;
    ghosts move as they like in the frame of the robot. Seconds of the run are judged as one.
    """
    settings, beams, stamps = SCAN.goodness_of_fit, view.beams, view.data.stamps
    step, wide = float(np.median(np.diff(stamps))), things.n_rays >= 2
    xy, scan = things.xy[wide], things.scan[wide]
    ox, oy = (np.broadcast_to(o, beams.ux.shape)[scan, 0] for o in (beams.ox, beams.oy))
    c, s, away = beams.ux[scan, 0], beams.uy[scan, 0], xy - np.stack([ox, oy], axis=1)
    own = np.stack([c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]], axis=1)
    starts = np.searchsorted(scan, np.arange(len(stamps) + 1))
    nearer = np.zeros(1 + int(stamps[-1] - stamps[0]))
    for k in np.unique(scan):
        last = k + 1 >= len(stamps) or stamps[k + 1] - stamps[k] > 2 * step
        now, then = slice(starts[k], starts[k + 1]), slice(starts[min(k + 1, len(stamps) - 1)], None)
        then = slice(then.start, starts[k + 2]) if not last else slice(0, 0)
        if then.stop <= then.start:
            continue
        reach = settings.walking_speed * (stamps[k + 1] - stamps[k]) + settings.walking_slack
        in_map, in_frame = (
            np.hypot(*(p[now][:, None] - p[then][None]).transpose(2, 0, 1)) for p in (xy, own)
        )
        same = (in_map + in_frame).argmin(axis=1)
        a, b = (d[np.arange(len(d)), same] for d in (in_map, in_frame))
        nearer[int(stamps[k] - stamps[0])] += float((a**2 - b**2)[a + b < 2 * reach].sum())
    spread = float(np.sqrt(np.square(nearer).sum()))
    return float(nearer.sum()) / spread if spread > 0 else 0.0


def _spacing(view: FitResiduals) -> float:
    """Return the angle between neighbouring rays [rad]."""
    right, left = neighbouring_rays(view.sensor)
    return float(np.median((view.sensor.bearings[left] - view.sensor.bearings[right]) % (2 * np.pi)))


def _standing_share(view: FitResiduals, short: Bools) -> float:
    """Return at how many of the places where short readings end something stands for a while, later or before.

    It is near 1 for what stands, also where it came or left during the run, and near 0 for what walked through.
    """
    settings = SCAN.goodness_of_fit
    beams, z, stamps = view.beams, view.z, view.data.stamps
    ends, at = view.ends(short), stamps[np.nonzero(short)[0]]
    step = -(-len(ends) // settings.standing_places)
    stands, judged = 0, 0
    for (x, y), when in zip(ends[::step], at[::step], strict=True):
        along, across = beams.towards(x, y)
        comes = (along > 0) & (np.abs(across) < settings.standing_reach) & view.returned
        ends_there = comes & (np.abs(z - along) < 4 * settings.standing_reach)
        reaches = ends_there | comes & (z > along)
        later = stamps - when
        shares = []
        for side in (later, -later):
            scans = (side > settings.standing_time) & (side < settings.standing_window)
            n = int(reaches[scans].sum())
            if n >= settings.min_standing_rays:
                shares.append(float(ends_there[scans].sum()) / n)
        if shares:
            judged += 1
            stands += max(shares) > settings.standing_ray_share
    return stands / judged if judged >= settings.min_standing_places else 0.0


def least_clustered(view: FitResiduals, some: Bools) -> float:
    """Return the share of short readings (n_scans, n_rays) with a neighbour below which they are no people.

    A leg that is w rays wide, at most 2, gives a ray that meets it a neighbour with chance 2 (w - 1) / w: none, where rays
    are farther apart. Scattered readings have one with twice their share, by chance.
    """
    settings = SCAN.goodness_of_fit
    if view.sensor.n_rays < 2 or not some.any():
        return settings.min_clustered_share
    rays = np.clip(settings.leg_width / np.maximum(view.z[some] * _spacing(view), 1e-9), 1.0, 2.0)
    chance = float(np.mean(2 * (rays - 1) / rays))
    by_chance = 2 * 2 * float(some.mean())
    return settings.min_clustered_share * min(1.0, max(chance, by_chance / settings.min_clustered_share))


def clustered(view: FitResiduals, some: Bools) -> float:
    """Return the share of readings with a neighbour of their kind at a similar range in the same scan."""
    if not some.any():
        return 0.0
    z = np.where(some, view.z, np.nan)
    right, left = neighbouring_rays(view.sensor)
    with np.errstate(invalid="ignore"):
        near = np.abs(z[:, left] - z[:, right]) < SCAN.goodness_of_fit.neighbour_distance
    has = np.zeros(some.shape, dtype=np.bool_)
    has[:, left] |= near
    has[:, right] |= near
    return float(has[some].mean())
