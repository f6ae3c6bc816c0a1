"""Things that came, are gone or have moved, from the cells that have changed.

A thing that is gone and a new one are one that moved if this is more probable than two changes. With the share m of the things
gone that were moved, the density f of their ways, the density g of the ratio of the sizes of one thing seen twice, and g_0 of two
things, the odds for a distance d and sizes a and b are

    m f(d) g(log(b / a)) / ((1 - m) (n / A) g_0(log(b / a))),

where n new things lie anywhere on the area A that rays have crossed. Ways and logarithms of ratios are normally distributed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.ndimage import binary_dilation, label
from scipy.optimize import linear_sum_assignment
from scipy.special import expit

from sensorgraph.types import Floats
from sensorgraph.watching.place_cells import ThingCells
from sensorgraph.watching.settings import PlacePriors
from sensorgraph.world.cell_outline import outline

ChangeKind = Literal["new", "gone"]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceChange:
    """One connected thing that came or is gone."""

    kind: ChangeKind
    centre: Floats
    """(2,) [m, map]"""
    size: Floats
    """(2,) [m] along x and y"""
    outlines: tuple[Floats, ...]
    """Closed lines (n, 2) [m, map]"""
    first_seen: float
    """[s]"""
    last_seen: float
    passes: int
    """Number of passes that show it."""
    p: float
    """Mean probability of its cells."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "xy": _rounded(self.centre),
            "size_m": _rounded(self.size),
            "outline": [[_rounded(point) for point in line] for line in self.outlines],
            "first_seen": round(self.first_seen, 3),
            "last_seen": round(self.last_seen, 3),
            "passes": self.passes,
            "p": round(self.p, 4),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class MovedThing:
    """A thing that is gone at one place and new at another."""

    gone: PlaceChange
    new: PlaceChange
    p: float
    """Probability that they are one thing, if both changes are right."""

    @property
    def distance(self) -> float:
        """[m] between what is seen of it at the two places."""
        return float(np.hypot(*(self.new.centre - self.gone.centre)))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "from_xy": _rounded(self.gone.centre),
            "xy": _rounded(self.new.centre),
            "distance_m": round(self.distance, 3),
            "p": round(self.p, 4),
        }


def things_in(
    kind: ChangeKind, cells: ThingCells, shape: tuple[int, int], low: Floats, priors: PlacePriors
) -> list[PlaceChange]:
    """Return the connected things in cells that have probably changed.

    Parameters
    ----------
    shape : Number of cells along x and y; they are numbered along y first.
    low : (2,) [m, map] Lower left corner of the first cell.
    """
    found = cells.probable()
    if len(found) == 0:
        return []
    at = np.column_stack(np.unravel_index(found, shape))
    first = at.min(axis=0)
    is_changed = np.zeros(at.max(axis=0) - first + 3, dtype=np.bool_)
    where = tuple((at - first + 1).T)
    is_changed[where] = True
    beside = np.ones((3, 3), dtype=np.bool_)  # two sides of one thing, of which the inside is not seen
    number_of, n = label(binary_dilation(is_changed, beside), structure=beside)
    numbers = number_of[where]
    out = []
    for k in range(1, n + 1):
        own, there = found[numbers == k], at[numbers == k]
        if len(own) < priors.least_cells:
            continue
        begin, end = there.min(axis=0), there.max(axis=0) + 1
        part = np.zeros(end - begin, dtype=np.bool_)
        part[tuple((there - begin).T)] = True
        lines = outline(part, low + begin * priors.cell, priors.cell).geoms
        out.append(
            PlaceChange(
                kind=kind, centre=low + (there.mean(axis=0) + 0.5) * priors.cell, size=(end - begin) * priors.cell,
                outlines=tuple(np.asarray(line.exterior.coords) for line in lines),
                first_seen=float(np.nanmin(cells.cells.first[own])), last_seen=float(np.nanmax(cells.cells.last[own])),
                passes=int(cells.things.passes[own].max()), p=float(cells.things.p(own).mean()),
            )
        )  # fmt: skip
    return out


def moved_things(changes: Sequence[PlaceChange], area: float, priors: PlacePriors) -> list[MovedThing]:
    """Return the pairs of a thing gone and a new one that are probably one thing, of the most probable assignment.

    Parameters
    ----------
    area : [m²] that rays have crossed.
    """
    gone, new = ([one for one in changes if one.kind == kind] for kind in ("gone", "new"))
    if not gone or not new:
        return []
    odds = np.array([[_log_odds(a, b, len(new) / area, priors) for b in new] for a in gone])
    pairs = zip(*linear_sum_assignment(np.maximum(odds, 0.0), maximize=True), strict=True)
    return [
        MovedThing(gone=gone[i], new=new[j], p=float(expit(odds[i, j]))) for i, j in pairs if odds[i, j] > 0
    ]


def _log_odds(gone: PlaceChange, new: PlaceChange, density: float, priors: PlacePriors) -> float:
    """Return the log-odds that a thing gone and a new one are one thing, with a density [1/m²] of new things."""
    way = float(np.hypot(*(new.centre - gone.centre))) / priors.way
    ratio = math.log(float(new.size.max() / gone.size.max()))
    one, two = priors.like, priors.unlike
    of_way = -0.5 * way**2 - math.log(2 * math.pi * priors.way**2) - math.log(density)
    of_size = -0.5 * ratio**2 * (1 / one**2 - 1 / two**2) + math.log(two / one)
    return math.log(priors.moved / (1.0 - priors.moved)) + of_way + of_size


def _rounded(values: Floats) -> list[float]:
    return [round(float(v), 3) for v in values]
