"""Short readings or outliers that behave otherwise than the effect that absorbs them.

Laws of readings that an effect absorbs: people, scattered readings, and causes that resemble them.

A law predicts where a short reading or an outlier (bearing, range) lies, given those of other scans:

    log p(reading) = log[½ K(reading) + ½ U],   U = 1 / (fov min(mu, range_max))

K is the density of the law [1/(rad m)], and U that of readings anywhere: half of the readings may be new.

    strays          K = U
    people          K = r mean_j N(x - x_j; s² I), x in the map; j: readings of the previous scan; objects up to 2 PERSON
    wide            the same for objects that are wider
    repeated        K = mean_j [same ray and same reading] / (spacing step)
    range, wrapped  K = h(z) / fov, h(mu - z) / fov
    standing        K = r h(x); cells as wide as a leg
    place           K = r h(x); cells as wide as a person

h is the histogram of the readings that are at least LAG earlier or later. The score of a law is the sum over seconds of
its mean log p, because the readings of a second belong to few objects (predictive model comparison; Vehtari and
Ojanen 2012). People must lead every other law by the margin that decides between two effects. Strays are the simplest
law; another one must lead it by this margin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.ray_order import neighbouring_rays

NAME = "absorbed_readings"
PERSON = 0.5
"""[m] Width of a person; with arms and bags at most twice that."""
WALKING = 1.0
"""[m/s] Standard deviation along x or y of the velocity of a person, who walks at 1.4 m/s."""
LAG = 3.0
"""[s] Time in which a person walks about 4 m, away from where a standing object would be seen again."""
CELL = 0.1
"""[m] Bin width of the histograms, about the width of a leg."""
PEOPLE, STRAYS = "walking people", "strays"
STRAY_CAUSES: tuple[str, ...] = (
    "a second laser, or reflections of the laser's own light",
    "dust, fog, rain or a dirty window",
    "parts of the robot, cables or payload in the field of view",
)
STANDING_CAUSES: tuple[str, ...] = (
    "furniture, doors or walls that are missing in the map",
    "objects that were moved slightly, or are drawn too large or too small",
)
CAUSES: dict[str, tuple[str, ...]] = {
    STRAYS: STRAY_CAUSES,
    PEOPLE: STRAY_CAUSES,
    "range": STRAY_CAUSES,
    "standing": STANDING_CAUSES,
    "place": (
        "intermittent steam, dust or spray",
        "a door, a curtain, a plant or a machine that moves",
    ),
    "repeated": (
        "a driver or a filter that repeats old readings",
        "stuck rays of the laser",
    ),
    "wrapped": (
        "a laser that measures a phase, so that its ranges wrap around",
        "an echo of the previous pulse",
    ),
    "wide": (
        "a ramp, a kerb or a tilt of the robot, so that the laser sees the floor",
        "furniture, vehicles or walls that are missing in the map",
    ),
}
"""Law -> possible causes."""


def find(checked: Checked) -> list[Doubt]:
    """Return the effects that absorb readings contrary to their assumptions."""
    view, gains, out = checked.view, checked.gains, []
    model = view.fitted.model
    absorbed = checked.gained - sum(gains[i] for i, a in enumerate(model) if not a.effect.absorber)
    for index, a in enumerate(model):
        words, causes, odd_share = why_not_absorbed(view, a)
        if not words:
            continue
        # a fringe of a strong effect's own readings is not a contradiction
        worth = SCAN.goodness_of_fit.failed_law_share * max(gains[index], absorbed)
        out.append(
            Doubt(
                family=NAME,
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
    return out


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
    if not explains or odd.sum() <= SCAN.goodness_of_fit.min_rays / 2:
        return "", (), 0.0
    why = better_law(view, odd, PEOPLE if explains == "short readings" else STRAYS)
    return (*why, float(odd.mean()))


ABSORBED_READINGS = Unnamed(
    titles={NAME: "short readings or outliers that behave otherwise than the effect that absorbs them"},
    find=find,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class OddReadings:
    """Some readings (n,) of a run."""

    scan: Ints
    ray: Ints
    second: Ints
    """Of the run."""
    z: Floats
    """[m]"""
    lacking: Floats
    """[m] Expected minus measured range; inf where none is expected."""
    xy: Floats
    """(n, 2) [m, map]"""
    is_wide: Bools
    """Whether neighbouring rays end on the same surface, wider than 2 PERSON."""

    @classmethod
    def of(cls, view: FitResiduals, some: Bools) -> OddReadings:
        """Return some readings (n_scans, n_rays) of a fit; there must be at least one."""
        scan, ray = np.nonzero(some)
        z, xy = view.z[some], view.ends(some)
        apart = (np.diff(scan) > 0) | (np.diff(ray) > 2) | (np.abs(np.diff(z)) >= PERSON)
        first = np.flatnonzero(np.concatenate([[True], apart]))
        last = np.append(first[1:] - 1, len(scan) - 1)
        is_wide = np.hypot(*(xy[last] - xy[first]).T) > 2 * PERSON
        return cls(
            scan=scan,
            ray=ray,
            second=(view.data.stamps[scan] - view.data.stamps[0]).astype(np.intp),
            z=z,
            lacking=np.where(view.aimed[some], view.mu[some], np.inf) - z,
            xy=xy,
            is_wide=np.repeat(is_wide, last - first + 1),
        )

    @property
    def wrapped(self) -> Floats:
        """(n,) [m] Lacking length if ranges may have wrapped around, and no person is that wide; nan elsewhere."""
        return np.where(np.isfinite(self.lacking) & (self.lacking > 2 * PERSON), self.lacking, np.nan)


def better_law(view: FitResiduals, some: Bools, usual: str) -> tuple[str, tuple[str, ...]]:
    """Return why some readings (n_scans, n_rays) do not follow the usual law, and possible causes; empty if they do.

    Parameters
    ----------
    usual : PEOPLE or STRAYS
    """
    if view.sensor.n_rays < 2 or not some.any():
        return "", ()
    readings = OddReadings.of(view, some)
    scores = law_scores(view, readings)
    own = scores.pop(usual)
    best = max(scores, key=lambda law: scores[law])
    margin = SCAN.naming.rival_margin
    if own >= scores[best] + (margin if usual == PEOPLE else -margin):
        return "", ()
    kind = "short" if usual == PEOPLE else "outliers"
    return f"{100 * float(some.mean()):.1f} % of the readings are {kind}, {_words(best, readings)}", CAUSES[
        best
    ]


def law_scores(view: FitResiduals, readings: OddReadings) -> dict[str, float]:
    """Return the score of each law [nats] relative to U."""
    r, bearings = readings, view.sensor.bearings
    right, left = neighbouring_rays(view.sensor)
    spacing = float(np.median((bearings[left] - bearings[right]) % (2 * np.pi)))
    fov = view.sensor.n_rays * spacing
    anywhere = 1 / (fov * np.maximum(np.minimum(r.z + r.lacking, view.range_max), r.z))
    moving, repeated = _continued(view, r, spacing)
    densities = {
        STRAYS: anywhere,
        PEOPLE: np.where(r.is_wide, 0.0, moving),
        "wide": np.where(r.is_wide, moving, 0.0),
        "repeated": repeated,
        "range": _at_other_times(_bins(r.z), r.second) / (CELL * fov),
        "wrapped": _at_other_times(_bins(r.wrapped), r.second) / (CELL * fov),
        "standing": _at_other_times(_cells(r.xy, CELL), r.second) * r.z / CELL**2,
        "place": _at_other_times(_cells(r.xy, PERSON), r.second) * r.z / PERSON**2,
    }
    seconds, count = np.unique(r.second, return_counts=True)
    return {
        law: float((np.bincount(r.second, np.log(0.5 * k / anywhere + 0.5))[seconds] / count).sum())
        for law, k in densities.items()
    }


def _continued(view: FitResiduals, r: OddReadings, spacing: float) -> tuple[Floats, Floats]:
    """Return K of readings that continue those of the previous scan: as a moving object, and as repeated readings."""
    stamps = view.data.stamps
    longest = 2 * float(np.median(np.diff(stamps)))
    starts = np.searchsorted(r.scan, np.arange(len(stamps) + 1))
    step = max(view.data.sensor.resolution, SCAN.likelihood.min_resolution)
    moving, repeated = np.zeros(len(r.z)), np.zeros(len(r.z))
    for k in np.unique(r.scan[r.scan > 0]):
        dt = stamps[k] - stamps[k - 1]
        now, before = slice(starts[k], starts[k + 1]), slice(starts[k - 1], starts[k])
        if dt > longest or before.stop == before.start:
            continue
        variance = PERSON**2 / 12 + (WALKING * dt) ** 2
        square = np.square(r.xy[now][:, None] - r.xy[before][None]).sum(axis=2)
        near = np.exp(-0.5 * square / variance).mean(axis=1)
        moving[now] = r.z[now] * near / (2 * np.pi * variance)
        same = r.ray[now][:, None] == r.ray[before][None]
        same &= np.abs(r.z[now][:, None] - r.z[before][None]) < 0.5 * step
        repeated[now] = same.mean(axis=1) / (spacing * step)
    return moving, repeated


def _at_other_times(cell: Ints, second: Ints) -> Floats:
    """Return the share (n,) of the readings in the same cell, among those at least LAG earlier or later.

    Parameters
    ----------
    cell : (n,) Number of the cell of each reading; negative for none, whose share is 0.
    """
    known = cell >= 0
    cells, at = np.unique(cell[known], return_inverse=True)
    n, when = int(second.max()) + 1, second[known]
    table = np.zeros((len(cells) + 1, n))
    np.add.at(table, (at, when), 1.0)
    table[-1] = table[:-1].sum(axis=0)
    until = np.pad(table.cumsum(axis=1), ((0, 0), (1, 0)))
    begin, end = np.maximum(when - int(LAG) + 1, 0), np.minimum(when + int(LAG), n)
    here, every = (until[row, -1] - until[row, end] + until[row, begin] for row in (at, np.full_like(at, -1)))
    out = np.zeros(len(cell))
    out[known] = here / np.maximum(every, 1.0)
    return out


def _bins(values: Floats) -> Ints:
    """Return the number (n,) of the bin of each value [m]; -1 for nan."""
    return np.asarray(np.floor(np.nan_to_num(values, nan=-CELL) / CELL).astype(np.intp))


def _cells(xy: Floats, width: float) -> Ints:
    """Return a number (n,) for the square cell of each point (n, 2) [m]."""
    at = np.floor((xy - xy.min(axis=0)) / width).astype(np.intp)
    return np.asarray(at @ np.array([1, int(at[:, 0].max()) + 1]))


def _words(law: str, r: OddReadings) -> str:
    """Return how the readings of a law appear."""
    x, y = np.median(r.xy[_is_fullest(_cells(r.xy, PERSON))], axis=0)
    again = (
        f"and others end at the same places {LAG:g} s or more earlier or later (most at ({x:.1f}, {y:.1f}) m)"
    )
    length = r.wrapped if law == "wrapped" else r.z
    length = length[np.isfinite(length)]
    most = float(np.median(length[_is_fullest(_bins(length))]))
    return {
        STRAYS: "and the next scan does not show them again within walking distance",
        PEOPLE: "and form clusters that the next scan shows again",
        "wide": "from objects too wide for a person",
        "repeated": "and repeat the previous scan",
        "range": f"most of them at {most:.2f} m",
        "wrapped": f"most of them by {most:.2f} m",
        "standing": f"{again}: something stands there",
        "place": f"{again}: something moves or appears there repeatedly",
    }[law]


def _is_fullest(cell: Ints) -> Bools:
    """Return which readings (n,) are in the fullest of their cells."""
    _, at, count = np.unique(cell, return_inverse=True, return_counts=True)
    return np.asarray(at == count.argmax())
