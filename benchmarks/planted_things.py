"""Things planted into both halves of a located log: some stay, some come, some go, some move. Knows nothing of `watch`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely

from logs.run import RangeSensor
from logs.transforms import compose
from planners.types import Bools, Floats

ThingKind = Literal["stays", "came", "went", "moved"]
KINDS: tuple[ThingKind, ...] = "came", "went", "moved", "stays"
RADII, MOVES, BOARD = (0.10, 0.25), (0.15, 0.5), 0.8
"""[m] Radii of round things; ways of those that move; length of a board."""
TURNS = 0.35, 1.2
"""[rad] Turns of a board about one of its ends, as of a door."""
SHARE_OF_BOARDS = 0.25
NOISE = 0.01
"""[m] Standard deviation of a reading of a thing."""
IN_SIGHT, CLEAR, APART = 4.0, 0.35, 1.5
"""[m] Distance at which a thing counts as in sight; of its rim from walls and from the path; between things."""
LEAST_RAYS, LEAST_SCANS = 3, 20
"""Rays that show a thing in a scan; scans of the first half that do, from which its graph can know it."""
COMPARED = 5.0
"""[m] Distance from which the readings of both halves are compared."""
GAP = 10.0
"""[s] out of sight, after which another pass begins."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scans:
    """Scans with the true poses of the robot."""

    stamps: Floats
    """(n_scans,) [s]"""
    poses: Floats
    """(n_scans, 3) base_link in map."""
    ranges: Floats
    """(n_scans, n_rays) [m]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Thing:
    """A round thing or a board, where it stands in each half."""

    kind: ThingKind
    radius: float
    """[m] 0: a board."""
    before: Floats | None
    """(3,) [m, m, rad] of its centre in the first half; None: it is not there. `after`: in the second half."""
    after: Floats | None

    @property
    def places(self) -> list[Floats]:
        """Where it stands in either half."""
        return [one for one in (self.before, self.after) if one is not None]

    def __str__(self) -> str:
        x, y = self.places[-1][:2]
        what = f"{2 * self.radius:.2f} m wide" if self.radius else "a board"
        way = ""
        if self.kind == "moved" and self.before is not None and self.after is not None:
            dx, dy, turn = self.after - self.before
            way = f" by {np.hypot(dx, dy):.2f} m" + (f", {np.degrees(turn):.0f}°" if turn else "")
        return f"{self.kind}{way}, {what}, at ({x:.1f}, {y:.1f}) m"


def by_rays(at: Floats, lasers: Floats, bearings: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return cosine and sine of the rays of lasers (n, 3), and the way [m] along and aside of them to a place (2,); (n, n_rays)."""
    angles, off = lasers[:, 2:] + bearings, at - lasers[:, :2]
    cos, sin = np.cos(angles), np.sin(angles)
    return cos, sin, off[:, :1] * cos + off[:, 1:] * sin, off[:, :1] * sin - off[:, 1:] * cos


def reach(place: Floats, radius: float, lasers: Floats, bearings: Floats) -> Floats:
    """Return the ranges (n, n_rays) [m] at which rays of lasers (n, 3) meet a thing at a place (3,); inf: they do not."""
    cos, sin, along, aside = by_rays(place[:2], lasers, bearings)
    if radius:
        meets = np.abs(aside) < radius
        r = along - np.sqrt(np.where(meets, radius**2 - aside**2, 0.0))
    else:  # the ray p + r u meets the line c + s w where r = along + s w·u and 0 = aside + s w×u
        w = np.array([np.cos(place[2]), np.sin(place[2])])
        across = w[0] * sin - w[1] * cos
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -aside / across
        meets = np.abs(s) < BOARD / 2
        r = along + np.where(meets, s, 0.0) * (w[0] * cos + w[1] * sin)
    return np.where(meets & (r > 0.05), r, np.inf)


def near(place: Floats, scans: Scans) -> Bools:
    """Tell at which scans (n_scans,) a place is in sight, if nothing hides it."""
    return np.asarray(np.hypot(*(scans.poses[:, :2] - place[:2]).T) < IN_SIGHT)


def shown(place: Floats, radius: float, scans: Scans, sensor: RangeSensor) -> Bools:
    """Tell at which scans (n_scans,) a thing is, or would be, in sight ahead of everything else."""
    out = near(place, scans)
    lasers = compose(scans.poses[out], np.tile(sensor.mount, (int(out.sum()), 1)))
    is_nearer = (
        reach(place, radius, lasers, sensor.bearings) < np.nan_to_num(scans.ranges[out], posinf=1e3) - 0.1
    )
    out[out] = is_nearer.sum(axis=1) >= LEAST_RAYS
    return out


def with_things(
    scans: Scans, sensor: RangeSensor, places: Sequence[tuple[Floats, float]], rng: np.random.Generator
) -> Floats:
    """Return the ranges (n_scans, n_rays) [m] with things, each a place (3,) and a radius, that stop the rays."""
    lasers = compose(scans.poses, np.tile(sensor.mount, (len(scans.poses), 1)))
    ranges = scans.ranges.copy()
    for place, radius in places:
        r = reach(place, radius, lasers, sensor.bearings)
        r += NOISE * rng.normal(size=r.shape)
        ranges = np.where(np.isfinite(r) & (r <= sensor.range_max) & ~(ranges < r), r, ranges)
    return ranges


def passes_of(place: Floats, radius: float, scans: Scans, sensor: RangeSensor) -> list[tuple[float, float]]:
    """Return begin and end [s] of each pass with a thing in sight."""
    stamps = scans.stamps[shown(place, radius, scans, sensor)]
    if len(stamps) == 0:
        return []
    cuts = np.flatnonzero(np.diff(stamps) > GAP)
    first, last = np.concatenate([[0], cuts + 1]), np.concatenate([cuts, [len(stamps) - 1]])
    return [(float(stamps[a]), float(stamps[b])) for a, b in zip(first, last, strict=True)]


def drawn(kind: ThingKind, at: Floats, rng: np.random.Generator) -> Thing:
    """Draw a thing of a kind at about a place (2,)."""
    is_board = rng.random() < SHARE_OF_BOARDS
    radius = 0.0 if is_board else float(rng.uniform(*RADII))
    here = np.array([*at, rng.uniform(-np.pi, np.pi)])
    there = here.copy()
    if kind == "moved" and is_board and rng.random() < 0.5:  # as a door does
        turn = float(rng.uniform(*TURNS) * rng.choice([-1.0, 1.0]))
        there[2] += turn
        for side, angle in ((1.0, here[2]), (-1.0, there[2])):
            there[:2] += side * BOARD / 2 * np.array([np.cos(angle), np.sin(angle)])
    elif kind == "moved":
        way, heading = rng.uniform(*MOVES), rng.uniform(-np.pi, np.pi)
        there[:2] += way * np.array([np.cos(heading), np.sin(heading)])
    return Thing(
        kind=kind,
        radius=radius,
        before=None if kind == "came" else here,
        after=None if kind == "went" else there,
    )


def chosen_things(
    first: Scans,
    second: Scans,
    watched: Scans,
    sensor: RangeSensor,
    walls: Floats,
    n: int,
    rng: np.random.Generator,
) -> Iterator[Thing]:
    """Yield up to n things of all kinds in turn: off the path, off the walls, apart, passed three times.

    Parameters
    ----------
    watched : Scans of the second half in which the graph knows the surroundings.
    walls : (n_walls, 2, 2) [m]
    """
    found: list[Thing] = []
    first_kind = int(rng.integers(len(KINDS)))
    paths = np.concatenate([first.poses[:, :2], second.poses[:, :2]])
    lines = shapely.STRtree(shapely.linestrings(walls))
    for _ in range(6000):
        if len(found) == n:
            return
        at = watched.poses[rng.integers(len(watched.poses)), :2] + rng.uniform(-2.0, 2.0, 2)
        thing = drawn(KINDS[(first_kind + len(found)) % len(KINDS)], at, rng)
        reach_of = CLEAR + (thing.radius or BOARD / 2)
        if any(np.hypot(*(paths - one[:2]).T).min() < reach_of for one in thing.places):
            continue
        if any(
            len(lines.query(shapely.Point(one[:2]).buffer(reach_of), "intersects")) for one in thing.places
        ):
            continue
        if any(np.hypot(*(a[:2] - b[:2])) < APART for one in found for a in one.places for b in thing.places):
            continue
        if thing.before is not None and shown(thing.before, thing.radius, first, sensor).sum() < LEAST_SCANS:
            continue
        if len(passes_of(thing.places[-1], thing.radius, watched, sensor)) >= 3:
            found.append(thing)
            yield thing


def share_ending(at: Floats, scans: Scans, sensor: RangeSensor) -> float:
    """Return the share of the rays that come to a place (2,) which end there and do not pass; nan if none comes."""
    is_close = np.hypot(*(scans.poses[:, :2] - at).T) < COMPARED
    close = Scans(**{name: getattr(scans, name)[is_close] for name in ("stamps", "poses", "ranges")})
    lasers = compose(close.poses, np.tile(sensor.mount, (len(close.poses), 1)))
    _, _, along, aside = by_rays(at, lasers, sensor.bearings)
    comes = (np.abs(aside) < 0.08) & (along > 0.3) & np.isfinite(close.ranges)
    ends = comes & (np.abs(close.ranges - along) < 0.12)
    passes = comes & (close.ranges > along + 0.25)
    n = int(ends.sum() + passes.sum())
    return float(ends.sum() / n) if n else np.nan
