"""Test whether short readings come from people.

    neighbours      share with a neighbour >= min_clustered_share 2 (w - 1) / w
    next scan       P(X <= found) >= lost_by_chance,   X ~ Binomial(followed, min_found_share)
    motion          Σ_s n_s / sqrt(Σ_s n_s²) <= max_drawn_along,   n_s = Σ (a² - b²) over second s

Here w is the width of a leg in rays; a and b are the displacements of a cluster in the map and in the robot
frame. A person is as wide as a body, walks, and does not move with the robot. Reflections of a second laser,
stuck rays, dust and the floor in front of a ramp also shorten readings, but violate at least one condition.
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
"""[m] Cell size of the reported place of most readings."""
STRAY_CAUSES: tuple[str, ...] = (
    "a second laser, or reflections of the laser's own light",
    "dust, fog, rain or a dirty window",
    "parts of the robot, cables or payload in the field of view",
)
STANDING_CAUSES: tuple[str, ...] = (
    "furniture, doors or walls that are missing in the map",
    "objects that were moved slightly, or are drawn too large or too small",
)
REPEATED_CAUSES: tuple[str, ...] = (
    "a driver or a filter that repeats old readings",
    "stuck rays of the laser",
)
WRAPPED_CAUSES: tuple[str, ...] = (
    "a laser that measures a phase, so that its ranges wrap around",
    "an echo of the previous pulse",
)
PLACE_CAUSES: tuple[str, ...] = (
    "intermittent steam, dust or spray",
    "a door, a curtain, a plant or a machine that moves",
)
WIDE_CAUSES: tuple[str, ...] = (
    "a ramp, a kerb or a tilt of the robot, so that the laser sees the floor",
    "furniture, vehicles or walls that are missing in the map",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Clusters:
    """Adjacent short readings of one scan, grouped as objects."""

    scan: Ints
    """(n,)"""
    n_rays: Ints
    """(n,)"""
    xy: Floats
    """(n, 2) [m, map] Mean of the end points of the rays."""
    width: Floats
    """(n,) [m] Distance between the end points of the first and the last ray."""


def why_not_people(view: FitResiduals, short: Bools) -> tuple[str, tuple[str, ...]]:
    """Return why short readings (n_scans, n_rays) are not people, and possible causes; empty if they may be people."""
    settings = SCAN.goodness_of_fit
    short_ones = f"{100 * short.mean():.1f} % of the readings are short"
    if clustered(view, short) < least_clustered(view, short):
        return f"{short_ones} and isolated, too scattered for people", STRAY_CAUSES
    z = view.z[short]
    if at_one_range := _at_one_range(view, short):
        return f"{short_ones}, most of them at {at_one_range:.2f} m", STRAY_CAUSES
    lacking = view.mu[short] - z  # [m] deficit relative to the expected range
    lacking = lacking[np.isfinite(lacking)]
    usual = float(np.median(lacking)) if len(lacking) else 0.0
    alike = np.abs(lacking - usual) < max(settings.range_bin, 3 * view.data.sensor.sigma)
    if alike.sum() > settings.min_wrapped_share * len(z) and usual > settings.min_wrap:
        return f"{short_ones}, most of them by {usual:.2f} m", WRAPPED_CAUSES
    repeated = repeated_share(view, short)
    if repeated > settings.max_repeated_share:
        return f"{short_ones}, and {100 * repeated:.0f} % of these repeat the previous scan", REPEATED_CAUSES
    if view.sensor.n_rays > 1 and not view.sensor.is_composite:
        things = clusters_of(view, short)
        wide = things.width > settings.max_person_width
        share = float(things.n_rays[wide].sum() / max(things.n_rays.sum(), 1))
        if share > settings.max_wide_share:
            return (
                f"{short_ones}, {100 * share:.0f} % of these from objects too wide for a person",
                WIDE_CAUSES,
            )
        found, followed = _found_again(view, things)
        least = settings.min_found_share
        is_seldom = followed >= settings.min_followed and found < least * followed
        if is_seldom or bdtr(found, followed, least) < settings.lost_by_chance:
            return (
                f"{short_ones}, but the next scan shows only {100 * found / followed:.0f} % of these objects again within "
                "walking distance",
                STRAY_CAUSES,
            )
        if _drawn_along(view, things) > settings.max_drawn_along:
            return f"{short_ones}, from objects that turn and move with the robot", STRAY_CAUSES
    if standing := where_things_stand(view, short):
        return f"{short_ones}, {standing}: a standing object is not a person", STANDING_CAUSES
    if again := _again_at_one_place(view, short):
        return f"{short_ones}, {again}", PLACE_CAUSES
    return "", ()


def _at_one_range(view: FitResiduals, short: Bools) -> float:
    """Return the range [m] at which most short readings lie for several seconds; 0 without one."""
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
    """Describe the place at which short readings end repeatedly, as in a cloud; empty without one.

    The readings of one scan must spread over the place, as wide as their means do from scan to scan. Half of
    that width suffices if almost no short reading lies elsewhere, as with a door that swings. A person who
    walks up and down there is narrow, and at another position each time.
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
        "people would also be seen elsewhere"
    )


def where_things_stand(view: FitResiduals, some: Bools) -> str:
    """Describe the places at which other rays end where some readings (n_scans, n_rays) end; empty without any."""
    settings = SCAN.goodness_of_fit
    still = _standing_share(view, some)
    if still <= settings.max_standing_share:
        return ""
    ends = view.ends(some)
    cell, count = np.unique(np.floor(ends / PLACE).astype(np.intp), axis=0, return_counts=True)
    x, y = PLACE * (cell[count.argmax()] + 0.5)
    return (
        f"and other rays end at {100 * still:.0f} % of the same places {settings.standing_time:g} s to "
        f"{settings.standing_window:g} s earlier or later (most at ({x:.1f}, {y:.1f}) m)"
    )


def repeated_share(view: FitResiduals, some: Bools) -> float:
    """Return the share of readings that equal the previous reading of their ray, corrected for quantisation."""
    later = some[1:]
    if not later.any():
        return 0.0
    step = view.data.sensor.resolution
    with np.errstate(invalid="ignore"):
        same = later & (np.abs(view.z[1:] - view.z[:-1]) < 0.5 * max(step, 1e-9))
    # probability that two noisy readings fall on the same step
    by_chance = min(1.0, step / (2 * np.sqrt(np.pi) * view.data.sensor.sigma))
    share = float(same.sum() / later.sum())
    return max(0.0, (share - by_chance) / (1 - by_chance)) if by_chance < 1 else 0.0


def clusters_of(view: FitResiduals, short: Bools) -> Clusters:
    """Group short readings of neighbouring rays with similar ranges; one ray may be missing in between."""
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
    """Count the clusters of at least two rays that the next scan shows again, and those whose place it observes.

    A place is observed if a ray passes within half the ray spacing and, according to the map, continues
    beyond it.
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
    """Return the evidence that clusters move with the robot and not with the room [standard errors].

        Σ_s n_s / sqrt(Σ_s n_s²),   n_s = Σ (a² - b²) over the clusters of second s

    Here a and b are the displacements to the nearest cluster of the next scan, in the map and in the robot
    frame. A person moves independently in the map, so that b also contains the motion of the robot. Reflections
    move independently in the robot frame. A negative result favours the room.
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
    """Return the share of end points of short readings at which something stands, earlier or later.

    The share is near 1 for standing objects, even if they came or left during the run. It is near 0 for
    people who walk through.
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
    """Return the minimum share of short readings (n_scans, n_rays) with a neighbour, for people.

        P(neighbour) = 2 (w - 1) / w,   w the width of a leg in rays, limited to 1 … 2

    The probability is 0 if the rays are farther apart than a leg is wide. Of scattered readings, twice their
    share of all readings have a neighbour by chance. The limit is at least twice that.
    """
    settings = SCAN.goodness_of_fit
    if view.sensor.n_rays < 2 or not some.any():
        return settings.min_clustered_share
    rays = np.clip(settings.leg_width / np.maximum(view.z[some] * _spacing(view), 1e-9), 1.0, 2.0)
    chance = float(np.mean(2 * (rays - 1) / rays))
    by_chance = 2 * 2 * float(some.mean())
    return settings.min_clustered_share * min(1.0, max(chance, by_chance / settings.min_clustered_share))


def clustered(view: FitResiduals, some: Bools) -> float:
    """Return the share of readings with a neighbour of the same kind at a similar range in the same scan."""
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
