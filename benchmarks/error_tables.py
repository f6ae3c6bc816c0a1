"""Tables and pictures of `error_by_minutes`: one place, the means of many, and each of these by itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.arguments import half_interval
from sensorgraph.show.figures.style import INK, SOLID, new_figure, reduce_frame, save_figure

ALL_MINUTES = (2, 5, 10, 20, 40)

COLOURS = ("#1b1b1b", "#d1345b", "#2a788e", "#7fb8c4", "#e08aa0", "#6a5acd", "#c9892b", "#8b90a0")
LEAST_DRAWN = 0.01
"""[%]"""


@dataclass(frozen=True, kw_only=True)
class DriveScore:
    """One graph: how it was driven for, how long, and how good it is on fresh poses."""

    way: str
    minutes: float
    scans: int
    wrong: float
    """Share of all rays more than 5 cm off."""
    answered: float
    wrong_of_answered: float
    median: float
    """[m]"""


def summary(rows: list[dict[str, Any]], path: Path) -> None:
    """Print the mean share wrong of each way with its 95 % interval over places, and by how much anytime differs; draw it."""
    print("\n| driven by | places (runs) | " + " | ".join(f"{minutes} min" for minutes in ALL_MINUTES) + " |")
    print("|---|---:|" + "---:|" * len(ALL_MINUTES))
    figure = new_figure(6.4, 3.4)
    axes = figure.subplots()
    ways_kept = list(dict.fromkeys(row["way"] for row in rows))
    for way, colour in zip(ways_kept, COLOURS, strict=False):
        shares = [np.array(list(wrong_by_place(rows, way, minutes).values())) for minutes in ALL_MINUTES]
        mean = np.array([some.mean() if len(some) else np.nan for some in shares])
        half = np.array([half_interval(some) for some in shares])
        runs = sum(row["way"] == way for row in rows) // len(ALL_MINUTES)
        print(line(f"{way} | {len(shares[-1])} ({runs})", shares))
        axes.plot(ALL_MINUTES, mean, color=colour, lw=1.8, marker="o", ms=4, label=way)
        axes.fill_between(
            ALL_MINUTES, np.maximum(mean - half, LEAST_DRAWN), mean + half, color=colour, alpha=0.15, lw=0
        )
    for other in [way for way in ways_kept if way != "anytime"] if "anytime" in ways_kept else []:
        both = common(rows, "anytime", other)
        pairs = [[wrong_by_place(both, way, m) for way in ("anytime", other)] for m in ALL_MINUTES]
        print(
            line(
                f"anytime less {other} | {len(pairs[-1][0])}",
                [np.array([a[p] - b[p] for p in a]) for a, b in pairs],
            )
        )
    axes.set_ylabel("rays wrong by more than 5 cm [%]", color=INK)
    axes.set_yscale("log")
    axes.set_ylim(bottom=LEAST_DRAWN)
    axes.set_xscale("log")
    axes.set_xticks(ALL_MINUTES, [str(m) for m in ALL_MINUTES])
    axes.minorticks_off()
    axes.set_xlabel("driven [min]", color=INK)
    axes.grid(color=SOLID, lw=0.6)
    reduce_frame(axes)
    figure.legend(loc="outside right center", frameon=False, fontsize=8, labelcolor=INK)
    save_figure(figure, path)


def single_places(rows: list[dict[str, Any]]) -> None:
    """Print the share wrong in each place by one anytime plan and by views, the mean of its seeds."""
    some = common(rows, "anytime", "views")
    print("\n| place (seeds) | driven by | " + " | ".join(f"{minutes} min" for minutes in ALL_MINUTES) + " |")
    print("|---|---|" + "---:|" * len(ALL_MINUTES))
    for place in dict.fromkeys(row["arena"] for row in some):
        n_seeds = len({row["seed"] for row in some if row["arena"] == place})
        shares = {
            way: [wrong_by_place(some, way, minutes)[place] for minutes in ALL_MINUTES]
            for way in ("anytime", "views")
        }
        for way, own in shares.items():
            other = shares["views" if way == "anytime" else "anytime"]
            cells = [f"**{a:.3g} %**" if a < b else f"{a:.3g} %" for a, b in zip(own, other, strict=True)]
            name = f"{place.removesuffix('.geojson')} ({n_seeds})" if way == "anytime" else ""
            print(f"| {name} | {way} | " + " | ".join(cells) + " |")


def wrong_by_place(rows: list[dict[str, Any]], way: str, minutes: float) -> dict[str, float]:
    """Return the share wrong [%] in each place, the mean of its seeds."""
    shares: dict[str, list[float]] = {}
    for row in rows:
        if (row["way"], row["minutes"]) == (way, minutes):
            shares.setdefault(row["arena"], []).append(100 * row["wrong"])
    return {arena: float(np.mean(some)) for arena, some in shares.items()}


def common(rows: list[dict[str, Any]], *some: str) -> list[dict[str, Any]]:
    """Return the results of places, seeds and minutes that were driven in all of some ways."""
    driven = [
        {(row["arena"], row["seed"], row["minutes"]) for row in rows if row["way"] == way} for way in some
    ]
    return [
        row for row in rows if all((row["arena"], row["seed"], row["minutes"]) in keys for keys in driven)
    ]


def line(name: str, shares: list[np.ndarray]) -> str:
    """Return a line of the table: means [%] and their intervals, a cell for each length of drive."""
    cells = " | ".join(
        f"{some.mean() if len(some) else np.nan:.3f} ± {half_interval(some):.3f} %" for some in shares
    )
    return f"| {name} | {cells} |"
