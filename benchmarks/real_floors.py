"""Plans of real floors: what they cover, how long that drives, and how long it takes to plan.

    python -m benchmarks.real_floors ../kth-floors -o floors.jsonl                 # all, the smallest first
    python -m benchmarks.real_floors ../kth-floors -o floors.jsonl --raster FLOOR  # FLOOR as a map_server map, too
    python -m benchmarks.real_floors ../kth-floors -o floors.jsonl --drive dubins --largest 900    # by a car, the smaller ones

A folder of floors holds `index.csv` (floor, start_x, start_y, area_m2) and `FLOOR.geojson` or `FLOOR.geojson.gz`, such as
the 21 floors of the KTH campus in kth_simulation_packages, 331 to 2,999 m². Each floor planned is one line of the output,
and is not planned again: the command goes on where it was stopped. `s/10k` is the time to plan 10,000 bins, `cpu` the
processor time in it, of all processes; compiling is left out.
"""

from __future__ import annotations

import csv
import gzip
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.arguments import keep, kept, parser_of
from benchmarks.coverage_planners import warm_up
from benchmarks.measures import timed
from benchmarks.places import vehicle, write_map
from planners import plan
from planners.arena import Arena
from planners.clearance import Barriers
from planners.maps import geojson
from planners.vehicle import DRIVES
from sensorgraph.loading import load_arena

RESOLUTION = 0.05
"""[m] of the raster map."""
FREE, OCCUPIED = 254, 0


def main() -> None:
    """Plan the floors that the output lacks, and print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=Path("real_floors.jsonl"))
    parser.add_argument("--raster", nargs="*", default=[], help="floors to plan as raster maps of 5 cm, too")
    parser.add_argument("--largest", type=float, default=3000.0, help="[m2] of a floor")
    parser.add_argument("--drive", default="diff", choices=DRIVES)
    options = parser.parse_args()
    known = {row["floor"] for row in kept(options.out)}
    warm_up(options.drive)
    for floor, start, area in floors(options.folder):
        for is_raster in (False, True):
            kind = [*(["raster"] if is_raster else []), *([options.drive] if options.drive != "diff" else [])]
            name = f"{floor} ({', '.join(kind)})" if kind else floor
            if name in known or area > options.largest or (is_raster and floor not in options.raster):
                continue
            arena = read_floor(options.folder, floor)
            arena = rasterised(arena) if is_raster else arena
            row = {"floor": name, "area_m2": area} | planned(arena, start, options.drive)
            keep(options.out, row)
            print(line(row))
    table(kept(options.out))


def floors(folder: Path) -> list[tuple[str, np.ndarray, float]]:
    """Return name, start (3,) [m, m, rad] and area [m2] of each floor, the smallest first."""
    with (folder / "index.csv").open() as file:
        rows = sorted(csv.DictReader(file), key=lambda row: float(row["area_m2"]))
    starts = [np.array([float(row["start_x"]), float(row["start_y"]), 0.0]) for row in rows]
    return [(row["floor"], start, float(row["area_m2"])) for row, start in zip(rows, starts, strict=True)]


def read_floor(folder: Path, floor: str) -> Arena:
    """Return the arena of a floor, from its GeoJSON, zipped or not."""
    path = folder / f"{floor}.geojson"
    return geojson.loads(
        path.read_text() if path.exists() else gzip.decompress(Path(f"{path}.gz").read_bytes()).decode()
    )


def rasterised(arena: Arena) -> Arena:
    """Return an arena as a map_server map of it would be read: free where the middle of a cell is, and walls on their cells."""
    x0, y0, x1, y1 = arena.bounds
    nx, ny = int(np.ceil((x1 - x0) / RESOLUTION)), int(np.ceil((y1 - y0) / RESOLUTION))
    i, k = np.indices((nx, ny)).reshape(2, -1)
    places = np.column_stack([x0 + (i + 0.5) * RESOLUTION, y0 + (k + 0.5) * RESOLUTION])
    is_wall = ~arena.contains(places) | (Barriers(arena).distances(places) < RESOLUTION / 2)
    image = np.where(is_wall, OCCUPIED, FREE).astype(np.uint8).reshape(nx, ny).T[::-1]
    with tempfile.TemporaryDirectory() as folder:
        return load_arena(write_map(Path(folder), image, (float(x0), float(y0)), RESOLUTION))


def planned(arena: Arena, start: np.ndarray, drive: str) -> dict[str, Any]:
    """Plan one floor, and return what the table needs of it."""
    with timed() as took:
        report = plan(arena, vehicle(drive), start=start).report
    keys = (
        "reachable_cells", "coverage", "ratio", "limit_violations", "min_clearance_m", "share_of_bare_footprint", "joins",
        "lower_bound_s", "drive_time_s", "unreached",
    )  # fmt: skip
    return {key: report[key] for key in keys} | {"wall_s": took.wall, "cpu_s": took.cpu}


def line(row: dict[str, Any]) -> str:
    """Return a row of the table."""
    per = 1e4 / row["reachable_cells"]
    bound = row["lower_bound_s"]
    is_car = row["floor"].endswith(("dubins)", "reeds_shepp)"))  # whose bound says nothing
    above = f"{100 * (row['drive_time_s'] / bound - 1):.0f} %" if bound and not is_car else "-"
    return (
        f"| {row['floor']} | {row['area_m2']:,.0f} | {row['reachable_cells']:,} | {100 * row['coverage']:.3f} % | "
        f"{row['ratio']:.3f} | {above} | {row['limit_violations']} | {row['min_clearance_m']:.3f} | "
        f"{100 * row['share_of_bare_footprint']:.1f} % | {per * row['wall_s']:.1f} | {per * row['cpu_s']:.1f} |"
    )


def table(found: list[dict[str, Any]]) -> None:
    """Print all rows, and their means and worst."""
    print(
        "| floor | m² | bins | covered | T/Tref | above the bound | violations | clearance [m] | of bare footprint | s/10k | cpu |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    for row in found:
        print(line(row))
    if not found:
        return
    ratio = np.array([row["ratio"] for row in found])
    share = 1e4 / np.array([row["reachable_cells"] for row in found])
    wall, cpu = (share * np.array([row[key] for row in found]) for key in ("wall_s", "cpu_s"))
    print(
        f"\n{len(found)} floors: covered {100 * min(row['coverage'] for row in found):.3f} % at least, "
        f"T/Tref {ratio.mean():.3f} mean, {ratio.max():.3f} worst, "
        f"{sum(row['limit_violations'] for row in found)} violations, "
        f"s/10k {wall.mean():.1f} mean, {wall.max():.1f} worst, cpu {cpu.mean():.1f} mean, {cpu.max():.1f} worst"
    )


if __name__ == "__main__":
    main()
