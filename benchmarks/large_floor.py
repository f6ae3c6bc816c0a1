"""One large floor: how long a plan takes, and the most memory it needs.

    python -m benchmarks.large_floor                      # 50 x 50 m, 36 rooms, about 575,000 bins: some minutes
    python -m benchmarks.large_floor --side 42 --rooms 30 # about 400,000 bins
    python -m benchmarks.large_floor --side 20 --rooms 9  # a smaller one

The floor is `benchmarks/offices.py`'s: random rooms with doors and furniture, no code shared with the planner.
"""

from __future__ import annotations

import sys

from benchmarks.arguments import parser_of
from benchmarks.measures import peak_memory, timed
from benchmarks.offices import office
from benchmarks.places import vehicle
from planners import plan
from planners.maps import geojson


def main() -> None:
    """Plan the floor and print one line."""
    parser = parser_of(__doc__)
    parser.add_argument("--side", type=float, default=50.0, help="[m]")
    parser.add_argument("--rooms", type=int, default=36)
    options = parser.parse_args()
    arena = geojson.loads(office(0, width=options.side, depth=options.side, rooms=options.rooms))
    robot = vehicle("diff")
    plan(geojson.loads(office(0, width=4.0, depth=4.0, rooms=1)), robot, cell=0.5, headings=4)  # compiles
    with timed() as took:
        report = plan(arena, robot, cell=0.25, headings=16, progress=said).report
    if sys.stderr.isatty():
        sys.stderr.write("\n")
    bins = report["reachable_cells"]
    joins = report["joins"]
    print(
        f"{bins:,} bins in {report['reachable_positions']:,} cells: cover {100 * report['coverage']:.3f} %, "
        f"T/Tref {report['ratio']:.3f}, {report['drive_time_s'] / 3600:.1f} h, {report['path_m'] / 1000:.1f} km, "
        f"{report['limit_violations']} violations, clearance {report['min_clearance_m']:.3f} m; "
        f"joins {joins['direct']} direct, {joins['planned']} planned, {joins['failed']} failed; "
        f"planned in {took.wall:.0f} s ({took.cpu:.0f} s of processor, "
        f"{1e4 * report['planning_s'] / bins:.1f} s per 10,000 bins); "
        f"most memory {peak_memory(with_children=True) / 1024:.2f} GiB"
    )


def said(done: int, total: int) -> None:
    """Write how far it is, if someone looks."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r{done:,} of {total:,} bins")
    sys.stderr.flush()


if __name__ == "__main__":
    main()
