"""Plant effects in a real log, and see whether the diagnosis names them against a commissioning stretch of the same site.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.planted_effects [LOG] [--windows 0,3] [--only full]

The log's poses come from the scans themselves (SLAM), and nobody drew a map. So the even scans of each unbroken
stretch of the log make a map of short surfaces, and the odd scans, some 90 rays of each, are the measurement, in two
windows. (A log with a scan every few seconds only is one stretch, in windows of 72 scans or a few more.) One window is the run under test, all others are known to be good: the commissioning. Effects are planted
in the window under test alone, by code of its own that knows nothing of the project's effects: ranges are altered, real
beams given another bearing, poses and stamps shifted. The laser reports whole centimetres, which robot.yaml says here;
`--undithered` leaves that and the commissioning out, and the diagnosis should find the lattice.

With `--graph` the log is one that `sensorgraph locate` has written, the map a sensorgraph of its first half, and the
windows are of its second half, 90 rays of some 100 scans each. With `--another-day` the graph is of another log, and the
windows are of all of this one.

With `--pixels map.yaml` the map is one of pixels (`benchmarks.slam_map` makes it), the windows are samples of the whole log,
and there is no commissioning: what robot.yaml and the map say is all that is known.

Prints, per effect and size: windows, how often it is named first, in how many another name stands first, the median
evidence and the median of the estimated size; and the names given on untouched windows.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.arguments import existing, heads, parser_of, timed
from benchmarks.planted_changes import FULL_SIZE, HALF_SIZE, Plant
from benchmarks.planted_site import (
    SCANS_IN_GRAPH,
    LogWindow,
    graph_of_first_half,
    measurement,
    robot_of,
    scans_alone,
    spread_over_log,
    windows,
    windows_in_graph,
)
from logs import Run, read
from sensorgraph.diagnosis.commissioning import commission_all, learnt, merged, prepared
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.site_baseline import SiteBaseline
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import load_arena
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.robot import Robot

LOG = Path(__file__).parents[2] / "shared" / "data" / "ple-freiburg-079" / "freiburg-079-corrected.log.gz"


def names_text(finding: Finding) -> str:
    """Return all names, with their evidence [nats]."""
    named = [f"{a.name} {a.evidence:.0f}" for a in finding.effects]
    return ", ".join(named) + (" [unknown]" if finding.unknown else "") or "-"


@dataclass(frozen=True)
class Outcome:
    """What the diagnosis made of one planted effect in one window."""

    plant: Plant
    first_name: str
    """Of the effects named; empty: none."""
    nats: float
    """Evidence of the right name; nan where another, or none, stands first."""
    size: float
    """Estimated, in the unit of the planted size; nan likewise."""


@dataclass
class Results:
    """Everything that was diagnosed."""

    outcomes: list[Outcome] = field(default_factory=list)
    untouched: list[tuple[str, Finding]] = field(default_factory=list)
    """Name of a window and what was found in it as it is."""
    seconds: list[float] = field(default_factory=list)
    """CPU time of each diagnosis."""

    def lines(self) -> Iterator[str]:
        """Yield the table, and what was named where nothing was planted."""
        yield heads(
            "effect", "size", "windows", "named first", "another name", "nats, median", "size, median", text=2
        )
        for plant in dict.fromkeys(outcome.plant for outcome in self.outcomes):
            cases = [outcome for outcome in self.outcomes if outcome.plant == plant]
            found = sum(case.first_name == plant.name for case in cases)
            wrong = sum(case.first_name not in ("", plant.name) for case in cases)
            nats = np.nanmedian([case.nats for case in cases]) if found else np.nan
            size = np.nanmedian([case.size for case in cases]) if found else np.nan
            yield (
                f"| {plant.label} [{plant.name}] | {plant.size:g} {plant.unit} | {len(cases)} | {found} | {wrong} "
                f"| {nats:.0f} | {size:.3g} |"
            )
        false = [(name, names_text(finding)) for name, finding in self.untouched if finding.effects]
        doubted = sum(finding.unknown is not None for _, finding in self.untouched)
        yield (
            f"untouched: {len(self.untouched)} windows, {len(false)} with a name {false}, "
            f"{doubted} with something unknown"
        )
        yield f"CPU per diagnosis: median {np.median(self.seconds):.1f} s, longest {max(self.seconds):.1f} s"


def diagnose_window(
    results: Results,
    log: Run,
    window: LogWindow,
    robot: Robot,
    plants: Sequence[Plant],
    reference: SiteBaseline | None,
    number: int,
) -> None:
    """Diagnose a window as it is, then with each effect planted in it."""
    run = measurement(log, window.scans)
    for plant in (None, *plants):
        rng = np.random.default_rng([number, 7])
        planted = run if plant is None else plant.change(run, log, window, plant.size, rng)
        if plant is not None and planted is run:
            print(f"  {plant.label}: this window has no place for it")
            continue
        with timed() as took:
            finding = diagnose(planted, window.arena, robot, baseline=reference, plan_next=False)
        results.seconds.append(took.cpu)
        if plant is None:
            results.untouched.append((window.name, finding))
            label = "untouched"
        else:
            first = finding.effects[0].name if finding.effects else ""
            right = first == plant.name
            nats = finding.effects[0].evidence or 0.0 if right else np.nan
            size = plant.estimate(finding.effects[0].parameters) if right else np.nan
            results.outcomes.append(Outcome(plant, first, nats, size))
            label = f"{plant.label} {plant.size:g} {plant.unit}"
        print(f"  {label:<22} {results.seconds[-1]:5.1f} s  {names_text(finding)}")


def known_good(
    log: Run, parts: Sequence[LogWindow], robot: Robot, *, one_map: bool
) -> Callable[[int], SiteBaseline]:
    """Return what gives the baseline of all windows but one, as several good runs; each with a map of its own, or all with one."""

    @cache
    def alone(number: int) -> SiteBaseline:
        window = parts[number]
        return learnt(prepared(measurement(log, window.scans), window.arena, robot), robot, known=())

    def of_others(number: int) -> SiteBaseline:
        others = [k for k in range(len(parts)) if k != number]
        if one_map:
            runs = [measurement(log, parts[k].scans) for k in others]
            return commission_all(runs, parts[number].arena, robot)
        return merged([alone(k) for k in others])

    return of_others


def arguments_given() -> argparse.Namespace:
    """Read the command line."""
    parser = parser_of(__doc__)
    parser.add_argument("log", nargs="?", type=existing, default=str(LOG))
    parser.add_argument("--windows", default="", help="numbers, comma-separated; default: all")
    parser.add_argument(
        "--graph", type=Path, help="of the first half of a located log, built if it is not there"
    )
    parser.add_argument("--pixels", type=existing, help="map.yaml of the building of a located log")
    parser.add_argument(
        "--another-day", action="store_true", help="the graph is of another log of the building"
    )
    parser.add_argument(
        "--scans", type=int, default=SCANS_IN_GRAPH, help="of the log in a window against a graph"
    )
    parser.add_argument("--only", default="full,half", help="which lists of effects")
    parser.add_argument("--undithered", action="store_true", help="do not tell the resolution of the laser")
    return parser.parse_args()


def main() -> None:
    """Plant, diagnose, count."""
    arguments = arguments_given()
    log = read(arguments.log)
    if arguments.graph or arguments.pixels:
        log = scans_alone(log)
    lists = {"full": FULL_SIZE, "half": HALF_SIZE}
    plants = [p for part in arguments.only.split(",") if part in lists for p in lists[part]]
    wanted = [int(k) for k in arguments.windows.split(",")] if arguments.windows else None
    robot = robot_of(log, 0.001 if arguments.undithered else 0.01)
    if arguments.another_day:
        arena, first = arena_of(Sensorgraph.load(arguments.graph)), 0
    elif arguments.graph:
        arena, first = arena_of(graph_of_first_half(log, arguments.graph)), log.n_scans // 2
    if arguments.graph:
        parts = list(windows_in_graph(log, arena, first=first, n_scans=arguments.scans))
    elif arguments.pixels:
        parts = list(spread_over_log(log, load_arena(str(arguments.pixels))))
    else:
        parts = list(windows(log))
    print(f"{len(parts)} windows")
    baseline_of_others = known_good(log, parts, robot, one_map=arguments.graph is not None)
    results = Results()
    for number, window in enumerate(parts):
        if wanted is not None and number not in wanted:
            continue
        is_alone = arguments.undithered or arguments.pixels
        reference = None if is_alone else baseline_of_others(number)
        print(f"window {number}, scans {window.name}, {window.arena.n_walls} surfaces")
        if reference is not None:
            print(f"  {reference.to_dict('the others')}")
        diagnose_window(results, log, window, robot, plants, reference, number)
    for line in results.lines():
        print(line)


if __name__ == "__main__":
    main()
