"""What driving buys: error of the graph against minutes driven, for ways of driving with one robot in one place.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.error_by_minutes [--arena office] [--seed 1]
    OPENBLAS_NUM_THREADS=1 python -m benchmarks.error_by_minutes --arena office 1001 1002 1003 1004 1005 --ways anytime views "wall following"
    OPENBLAS_NUM_THREADS=1 python -m benchmarks.error_by_minutes --arena floor.geojson@5.4,16.8 --ways anytime views

An arena is a shipped one, the seed of a random office of `benchmarks/offices.py`, or a file with the place where the robot
starts. With `--keep FILE` each result is kept there and not driven again, and means over all places that it holds for this
`--thin`, each the mean of its seeds, are printed and drawn with their 95 % intervals (`--keep FILE --table`: that alone;
`docs/pages/benchmarks/error_by_minutes.jsonl` holds the results of the page).

Each way is planned, driven by the embedded robot (lag, slip, noise of robot.yaml) and scanned; graphs are built from
its first minutes. A graph is asked for 1,000 fresh poses spread evenly over the floor and all headings. `views` are
planned for each length anew, since a tour is worth most at its end; the others are one drive, cut. With `--thin` n only
every n-th scan is built from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.arguments import half_interval, heads, keep, kept, parser_of
from benchmarks.places import arena_named, drive_and_log
from logs.run import Run
from planners import plan
from planners.arena import Arena
from planners.clearance import Barriers
from planners.reach import reach
from planners.trajectory import Trajectory
from planners.types import Floats
from sensorgraph.building.build import build
from sensorgraph.demo import N_CHECK_POSES, check_run
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.planning.survey import survey_of
from sensorgraph.planning.views import views_within
from sensorgraph.show.figures.style import INK, SOLID, new_figure, reduce_frame, save_figure
from sensorgraph.world.robot import Robot, default_robot

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
    print("\n" + heads("driven by", "places (runs)", *(f"{minutes} min" for minutes in ALL_MINUTES)))
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
    print("\n" + heads("place (seeds)", "driven by", *(f"{minutes} min" for minutes in ALL_MINUTES), text=2))
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


SECONDS_A_VIEW = 8.0
"""Of a tour, to start with; the number of views is then set by how long that tour took."""

Drive = Callable[[float], Run]
"""Minutes -> the run of so many minutes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """Where all drive, with one robot."""

    arena: Arena
    robot: Robot
    seed: int
    thin: int
    start: Floats | None = None
    """(3,) [m, m, rad] where all drives start; None: where each likes."""

    def planned(self, planner: str, cell: float, minutes: float) -> Run:
        """Plan by a planner and drive the first minutes."""
        duration = None if planner == "coverage" else 60.0 * minutes
        made = plan(
            self.arena, self.robot, planner=planner, cell=cell, seed=self.seed, rate=self.robot.sensor.rate,
            duration=duration, start=self.start,
        )  # fmt: skip
        return self.scanned(made.trajectory, minutes)

    def anytime(self, minutes: float) -> Run:
        """Drive the first minutes of an anytime plan."""
        made = plan(
            self.arena, self.robot, seed=self.seed, rate=self.robot.sensor.rate, start=self.start, order="anytime",
            survey=survey_of(self.arena, self.robot.sensor), budget=60.0 * minutes,
        )  # fmt: skip
        return self.scanned(made.trajectory, minutes)

    def tour(self, minutes: float) -> Run:
        """Drive through as many views as fit in the minutes."""

        def through(n: int) -> Trajectory:
            choose = partial(views_within, n=n, arena=self.arena, sensor=self.robot.sensor, seed=self.seed)
            return plan(
                self.arena, self.robot, planner="views", seed=self.seed, rate=self.robot.sensor.rate,
                start=self.start, targets=choose,
            ).trajectory  # fmt: skip

        n = max(round(60 * minutes / SECONDS_A_VIEW), 1)
        drive = through(n)
        return self.scanned(through(max(round(0.97 * n * 60 * minutes / drive.duration), 1)), minutes)

    def scanned(self, trajectory: Trajectory, minutes: float) -> Run:
        """Drive the first minutes of a trajectory (all of it where it is shorter) and log."""
        keep = trajectory.stamps <= 60.0 * minutes
        parts = {
            name: getattr(trajectory, name)[keep] for name in ("stamps", "poses", "twists", "primitives")
        }
        return drive_and_log(replace(trajectory, **parts), self.arena, self.robot, self.seed)

    def cut(self, run: Run, minutes: float) -> Run:
        """Return every `thin`-th scan of the first minutes."""
        return run.take_scans(np.flatnonzero(run.stamps <= 60.0 * minutes)[:: self.thin])


def ways(place: Place) -> dict[str, Drive]:
    """Return the ways of driving that are compared."""
    most = max(ALL_MINUTES)

    def cut(drive: Drive) -> Drive:
        whole = cache(lambda: drive(most))
        return lambda minutes: place.cut(whole(), minutes)

    return {
        "anytime": cut(place.anytime),
        "views": lambda minutes: place.cut(place.tour(minutes), minutes),
        "coverage, 1 m cells": cut(partial(place.planned, "coverage", 1.0)),
        "random bounce": cut(partial(place.planned, "random_bounce", 0.25)),
        "wall following": cut(partial(place.planned, "wall_following", 0.25)),
    }


def row(way: str, run: Run, found: Evaluation) -> DriveScore:
    """Collect the numbers of one graph."""
    wrong, of_answered = found.all["wrong_5cm"], found.answered_only["wrong_5cm"]
    median = found.all["median_m"]
    assert wrong is not None and of_answered is not None and median is not None
    return DriveScore(
        way=way,
        minutes=float(run.stamps[-1]) / 60,
        scans=run.n_scans,
        wrong=wrong,
        answered=found.answered,
        wrong_of_answered=of_answered,
        median=median,
    )


def place_of(name: str, robot: Robot, seed: int, thin: int) -> Place:
    """Return a place by the name of its arena: shipped, the seed of a random office, or FILE@X,Y."""
    path, _, at = name.partition("@")
    start = np.array([*(float(value) for value in at.split(",")), 0.0]) if at else None
    return Place(arena=arena_named(path), robot=robot, seed=seed, thin=thin, start=start)


def check_of(place: Place) -> Run:
    """Return scans at fresh poses, evenly over what the robot can reach."""
    rng = np.random.default_rng([place.seed, 99])
    if place.start is None:
        return check_run(place.arena, place.robot, rng)
    free = reach(
        place.arena, Barriers(place.arena), clearance=place.robot.footprint_radius + 0.02, cell=0.25, start=place.start
    )  # fmt: skip
    nodes = np.nonzero(free.mask)
    pick = rng.integers(len(nodes[0]), size=N_CHECK_POSES)
    poses = np.column_stack(
        [free.nodes((nodes[0][pick], nodes[1][pick])), rng.uniform(-np.pi, np.pi, len(pick))]
    )
    return check_run(place.arena, place.robot, rng, poses=poses)


def main() -> None:
    """Drive, build, ask; print a table, and draw what is kept."""
    parser = parser_of(__doc__)
    parser.add_argument("--arena", nargs="+", default=["office"])
    parser.add_argument("--ways", nargs="*", help="some of the ways; default: all")
    parser.add_argument("--seed", type=int, nargs="+", default=[1])
    parser.add_argument("--thin", type=int, default=1)
    parser.add_argument(
        "--keep", type=Path, help="file of results so far, a line each; what it holds is not driven again"
    )
    parser.add_argument("--table", action="store_true", help="only the means of what is kept")
    parser.add_argument("--out", type=Path, default=Path("anytime_error.png"))
    options = parser.parse_args()
    if options.table:
        rows = thinned(options.keep, options.thin)
        summary(rows, options.out)
        single_places(rows)
        return
    shown = "minutes", "scans", "wrong by > 5 cm", "answered", "of these wrong", "median error"
    print(heads("arena", "driven by", *shown, text=2))
    for name in options.arena:
        for seed in options.seed:
            place = place_of(name, default_robot(), seed, options.thin)
            check, short = check_of(place), Path(name.partition("@")[0]).name
            known = {
                (row["arena"], row["seed"], row["way"], row["minutes"])
                for row in thinned(options.keep, options.thin)
            }
            for way, drive in ways(place).items():
                if options.ways and way not in options.ways:
                    continue
                for minutes in ALL_MINUTES:
                    if (short, seed, way, minutes) in known:
                        continue
                    r = row(way, run := drive(minutes), evaluate(build([run]), check))
                    print(
                        f"| {short} {seed} | {way} | {r.minutes:.1f} | {r.scans:,} | {100 * r.wrong:.2f} % | "
                        f"{100 * r.answered:.1f} % | {100 * r.wrong_of_answered:.2f} % | {100 * r.median:.2f} cm |"
                    )
                    where = {"arena": short, "seed": seed, "minutes": minutes, "thin": options.thin}
                    keep(options.keep, asdict(r) | where)
    if options.keep:
        summary(thinned(options.keep, options.thin), options.out)


def thinned(path: Path | None, thin: int) -> list[dict[str, Any]]:
    """Return the results that a file holds of graphs built from every `thin`-th scan."""
    return [row for row in kept(path) if row["thin"] == thin]


if __name__ == "__main__":
    main()
