"""Planners of coverage side by side: what they cover, how long that drives, and how long it takes to plan.

    python -m benchmarks.coverage_planners                     # square, office, the coverage search, stops and spins
    python -m benchmarks.coverage_planners --arena --random 10 --planner coverage   # ten random offices
    python -m benchmarks.coverage_planners --drive dubins --arena square
    python -m benchmarks.coverage_planners --race square office -o docs/pages/pictures/coverage_by_time.png
    python -m benchmarks.coverage_planners --large 42 30   # one floor of 42 x 42 m with 30 rooms: some minutes
    python -m benchmarks.coverage_planners --floors ../kth-floors --keep floors.jsonl     # the smallest first
    python -m benchmarks.coverage_planners --floors ../kth-floors --keep floors.jsonl --raster FLOOR

The random offices and the large floor are those of `benchmarks/offices.py`, made by code of their own: seeds 1001 on, on which
nothing was tuned. A folder of floors holds `index.csv` (floor, start_x, start_y, area_m2) and `FLOOR.geojson` or
`FLOOR.geojson.gz`, such as the 21 floors of the KTH campus in kth_simulation_packages; `--raster` plans some of them also as
map_server maps of 5 cm. With `--keep` each plan is a line of that file, and is not made again: the command goes on where it
was stopped. `s/10k` is the time to plan 10,000 bins, `cpu` the processor time in it, of all processes, which another load on
the machine changes less; compiling is left out of both.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.arguments import heads, keep, kept, parser_of, peak_memory, timed
from benchmarks.offices import office
from benchmarks.places import arena_named, vehicle, write_map
from planners import PlanError, plan
from planners.arena import Arena
from planners.clearance import Barriers
from planners.maps import geojson
from planners.types import Floats
from planners.vehicle import DRIVES
from sensorgraph.loading import load_arena
from sensorgraph.show.figures.style import (
    ALARM,
    AMBER,
    FINE,
    INK,
    LINE,
    SOLID,
    TEAL,
    TITLE,
    new_figure,
    reduce_frame,
    save_figure,
)

RESOLUTION = 0.05
"""[m] of the raster map."""
FREE, OCCUPIED = 254, 0
FIRST_OFFICE = 1001
"""Seed of the first random office."""
COLUMNS = (
    "place", "planner", "m²", "bins", "covered", "core", "T/Tref", "above the bound", "violations", "clearance [m]",
    "of bare footprint", "s/10k", "cpu",
)  # fmt: skip
REPORTED = (
    "reachable_cells", "coverage", "core_coverage", "ratio", "limit_violations", "min_clearance_m",
    "share_of_bare_footprint", "joins", "lower_bound_s", "drive_time_s", "unreached",
)  # fmt: skip
"""Of the report of a plan, what is kept."""


class Place(NamedTuple):
    """Where is planned."""

    name: str
    arena: Arena
    start: Floats | None = None
    """(3,) [m, m, rad]; None: where the planner likes."""
    area: float | None = None
    """[m2]; None: that of the free space."""


def main() -> None:
    """Print the table, or draw the race."""
    parser = parser_of(__doc__)
    parser.add_argument("--arena", nargs="*", help="default: square and office, without --large and --floors")
    parser.add_argument(
        "--planner", nargs="*", help="default: coverage, and stop_and_spin where it turns in place"
    )
    parser.add_argument("--drive", default="diff", choices=DRIVES)
    parser.add_argument("--random", type=int, default=0, help="count of random offices")
    parser.add_argument(
        "--large", nargs=2, type=int, metavar=("SIDE", "ROOMS"), help="one large random office"
    )
    parser.add_argument("--floors", type=Path, help="folder of floors")
    parser.add_argument("--raster", nargs="*", default=[], help="floors to plan as raster maps of 5 cm, too")
    parser.add_argument("--largest", type=float, default=3000.0, help="[m2] of a floor")
    parser.add_argument("--keep", type=Path, help="file of results, a line each")
    parser.add_argument("--race", nargs="+", help="draw coverage against driving time in these arenas")
    parser.add_argument("-o", "--out", type=Path, default=Path("race.png"))
    options = parser.parse_args()
    plan(load_arena("square"), vehicle(options.drive), cell=0.5, headings=4)  # compiles
    if options.race:
        race({name: load_arena(name) for name in options.race}, options.out)
        return
    is_usual = options.large is None and options.floors is None
    options.arena = ["square", "office"] * is_usual if options.arena is None else options.arena
    planners = options.planner or ["coverage", "stop_and_spin"][: 1 + (is_usual and options.drive == "diff")]
    rows = kept(options.keep)
    known = {(row["place"], row["planner"]) for row in rows}
    print(heads(*COLUMNS, text=2))
    for place in places(options):
        for planner in planners:
            name = place.name if options.drive == "diff" else f"{place.name} ({options.drive})"
            if (name, planner) in known:
                continue
            try:
                found = planned(place, planner, options.drive)
            except PlanError as exc:
                print(f"| {name} | {planner} | {exc} |")
                continue
            rows.append({"place": name, "planner": planner} | found)
            keep(options.keep, rows[-1])
            print(line(rows[-1]))
    for planner in dict.fromkeys(row["planner"] for row in rows):
        summary(planner, [row for row in rows if row["planner"] == planner])
    print(f"most memory {peak_memory(with_children=True) / 1024:.2f} GiB")


def places(options: argparse.Namespace) -> Iterator[Place]:
    """Yield where is planned: arenas, random offices, a large one, and floors, the smallest first."""
    for name in options.arena:
        yield Place(name, load_arena(name))
    for seed in range(FIRST_OFFICE, FIRST_OFFICE + options.random):
        yield Place(f"office {seed}", arena_named(str(seed)))
    if options.large:
        side, rooms = options.large
        text = office(0, width=side, depth=side, rooms=rooms)
        yield Place(f"{side} x {side} m, {rooms} rooms", geojson.loads(text))
    if options.floors is None:
        return
    with (options.floors / "index.csv").open() as file:
        index = sorted(csv.DictReader(file), key=lambda row: float(row["area_m2"]))
    for row in index:
        if float(row["area_m2"]) <= options.largest:
            name, area = row["floor"], float(row["area_m2"])
            start = np.array([float(row["start_x"]), float(row["start_y"]), 0.0])
            arena = read_floor(options.floors, name)
            yield Place(name, arena, start, area)
            if name in options.raster:
                yield Place(f"{name} (raster)", rasterised(arena), start, area)


def read_floor(folder: Path, floor: str) -> Arena:
    """Return the arena of a floor, from its GeoJSON, zipped or not."""
    path = folder / f"{floor}.geojson"
    if path.exists():
        return geojson.loads(path.read_text())
    return geojson.loads(gzip.decompress(Path(f"{path}.gz").read_bytes()).decode())


def rasterised(arena: Arena) -> Arena:
    """Return an arena as a map_server map of it would be read: free where the middle of a cell is, and walls on their cells."""
    x0, y0, x1, y1 = arena.bounds
    nx, ny = int(np.ceil((x1 - x0) / RESOLUTION)), int(np.ceil((y1 - y0) / RESOLUTION))
    i, k = np.indices((nx, ny)).reshape(2, -1)
    middles = np.column_stack([x0 + (i + 0.5) * RESOLUTION, y0 + (k + 0.5) * RESOLUTION])
    is_wall = ~arena.contains(middles) | (Barriers(arena).distances(middles) < RESOLUTION / 2)
    image = np.where(is_wall, OCCUPIED, FREE).astype(np.uint8).reshape(nx, ny).T[::-1]
    with tempfile.TemporaryDirectory() as folder:
        return load_arena(write_map(Path(folder), image, (float(x0), float(y0)), RESOLUTION))


def planned(place: Place, planner: str, drive: str) -> dict[str, Any]:
    """Plan, and return what the table needs of it."""
    with timed() as took:
        report = plan(place.arena, vehicle(drive), planner=planner, start=place.start).report
    found = {key: report.get(key) for key in REPORTED}
    return found | {"area_m2": place.area or place.arena.free.area, "wall_s": took.wall, "cpu_s": took.cpu}


def line(row: dict[str, Any]) -> str:
    """Return a row of the table."""
    per, bound, bare = 1e4 / row["reachable_cells"], row["lower_bound_s"], row["share_of_bare_footprint"]
    is_car = row["place"].endswith(("dubins)", "reeds_shepp)"))  # whose bound says nothing
    above = f"{100 * (row['drive_time_s'] / bound - 1):.0f} %" if bound and not is_car else "-"
    return (
        f"| {row['place']} | {row['planner']} | {row['area_m2']:,.0f} | {row['reachable_cells']:,} | "
        f"{100 * row['coverage']:.3f} % | {row['core_coverage']:.3f} | {row['ratio']:.3f} | {above} | "
        f"{row['limit_violations']} | {row['min_clearance_m']:.3f} | {'-' if bare is None else f'{100 * bare:.1f} %'} | "
        f"{per * row['wall_s']:.1f} | {per * row['cpu_s']:.1f} |"
    )


def summary(planner: str, rows: list[dict[str, Any]]) -> None:
    """Print the means of plans, and the worst of them."""
    cover, core, ratio, violations, wall, cpu = (
        np.array([row[key] for row in rows])
        for key in ("coverage", "core_coverage", "ratio", "limit_violations", "wall_s", "cpu_s")
    )
    wall, cpu = (1e4 * seconds / [row["reachable_cells"] for row in rows] for seconds in (wall, cpu))
    joins = [row["joins"] for row in rows if row["joins"]]
    print(
        f"{len(rows)} places, {planner}: covered {100 * cover.min():.3f} % at least; T/Tref {ratio.mean():.3f} mean, "
        f"{ratio.max():.3f} worst; core {core.mean():.3f} mean, {core.min():.3f} least; {violations.sum()} violations; "
        f"joins {', '.join(f'{sum(j[key] for j in joins)} {key}' for key in ('direct', 'planned', 'failed'))}; "
        f"s/10k {wall.mean():.1f} mean, {wall.max():.1f} worst, cpu {cpu.mean():.1f} mean"
    )


def _growth_picture(races: Mapping[str, Mapping[str, tuple[Floats, Floats]]], path: Path) -> None:
    """Draw coverage over driving time, one panel per arena and one line per drive.

    Parameters
    ----------
    races : Arena -> label -> (seconds (n,), share of the reachable bins (n,) visited by then).
    """
    figure = new_figure(5.2 * len(races), 3.9)
    for number, (arena, lines) in enumerate(races.items()):
        axes = figure.add_subplot(1, len(races), number + 1)
        longest = max(float(stamps[-1]) for stamps, _ in lines.values())
        unit, seconds = ("h", 3600.0) if longest > 2 * 3600 else ("min", 60.0)
        for (label, (stamps, share)), colour in zip(
            lines.items(), (TEAL, "#7ad151", AMBER, ALARM), strict=False
        ):
            name = f"{label.replace('_', ' ')}: {100 * share[-1]:.0f} %"
            axes.plot(stamps / seconds, 100 * share, color=colour, lw=LINE, label=name)
        axes.set(xlim=(0, None), ylim=(0, 103))
        axes.set_title(arena, loc="left", fontsize=TITLE, color=INK)
        axes.set_xlabel(f"driving time [{unit}]", color=INK)
        axes.grid(color=SOLID, lw=FINE)
        axes.legend(loc="upper left", frameon=False, fontsize=8.5, labelcolor=INK)
        reduce_frame(axes)
        if number == 0:
            axes.set_ylabel("reachable (x, y, φ) bins visited [%]", color=INK)
    save_figure(figure, path)


def race(arenas: dict[str, Arena], path: Path) -> None:
    """Draw coverage against driving time: the search, stops and spins, random bounces, wall following."""
    lines: dict[str, dict[str, tuple[Floats, Floats]]] = {}
    for name, arena in arenas.items():
        made = {
            planner: plan(arena, vehicle("diff"), planner=planner)
            for planner in ("coverage", "stop_and_spin")
        }
        longest = max(one.trajectory.duration for one in made.values())
        for planner in ("random_bounce", "wall_following"):
            made[planner] = plan(arena, vehicle("diff"), planner=planner, duration=longest)
        lines[name] = {planner: one.growth() for planner, one in made.items()}
        done = made["coverage"].trajectory.duration
        print(
            f"{name}: bins visited after a quarter, half, three quarters and all of the {done / 60:.0f} min of the search"
        )
        for planner, (stamps, share) in lines[name].items():
            marks = np.interp(np.array([0.25, 0.5, 0.75, 1.0]) * done, stamps, share)
            print(f"  {planner:16} " + " ".join(f"{100 * mark:6.1f} %" for mark in marks))
    _growth_picture(lines, path)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
