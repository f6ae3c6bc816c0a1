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

from benchmarks.arguments import keep, kept, parser_of
from benchmarks.error_tables import ALL_MINUTES, DriveScore, single_places, summary
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
from sensorgraph.world.robot import Robot, default_robot

SECONDS_A_VIEW = 8.0
"""Of a tour, to start with; the number of views is then set by how long that tour took."""

Drive = Callable[[float], list[Run]]
"""Minutes -> the runs of so many minutes together."""


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

    def cut(drive: Callable[[float], Run]) -> Drive:
        whole = cache(lambda: drive(most))
        return lambda minutes: [place.cut(whole(), minutes)]

    return {
        "anytime": cut(place.anytime),
        "views": lambda minutes: [place.cut(place.tour(minutes), minutes)],
        "coverage, 1 m cells": cut(partial(place.planned, "coverage", 1.0)),
        "random bounce": cut(partial(place.planned, "random_bounce", 0.25)),
        "wall following": cut(partial(place.planned, "wall_following", 0.25)),
    }


def row(way: str, runs: list[Run], found: Evaluation) -> DriveScore:
    """Collect the numbers of one graph."""
    wrong, of_answered = found.all["wrong_5cm"], found.answered_only["wrong_5cm"]
    median = found.all["median_m"]
    assert wrong is not None and of_answered is not None and median is not None
    return DriveScore(
        way=way,
        minutes=sum(float(run.stamps[-1]) for run in runs) / 60,
        scans=sum(run.n_scans for run in runs),
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
    print(
        "| arena | driven by | minutes | scans | wrong by > 5 cm | answered | of these wrong | median error |"
    )
    print("|---|---|---:|---:|---:|---:|---:|---:|")
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
                    r = row(way, runs := drive(minutes), evaluate(build(runs), check))
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
