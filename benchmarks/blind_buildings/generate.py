"""Make cases: what may be seen in DIR/cases, the truth in DIR/truth.

    python -m benchmarks.blind_buildings.generate --suite foreign --first 40 --n 20 -o DIR

Without --background every other case is dirty. A case depends on suite, its number in the suite and its background
only, and is written under that number: `--first 40 --n 20` makes 0040 to 0059.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, cast

from benchmarks.blind_buildings.cases import BACKGROUNDS, STREAM, Case, is_dirty_in_turn, make
from benchmarks.blind_buildings.floors import FOLDER, floor_files
from benchmarks.blind_buildings.robots import yaml_text
from benchmarks.blind_buildings.rooms import write_geojson, write_raster
from benchmarks.blind_buildings.setups import SEED, SUITES
from benchmarks.blind_world.files import Log, write_log

MAPS = ("polygon", "raster")
FIRST_EPOCH = 1_760_000_000
"""[s] of case 0; each other begins 1000 s after the one before."""


def save(case: Case, folder: Path, index: int, *, is_raster: bool = False) -> None:
    """Write a case under its number."""
    scene, runs = case.scene, case.runs
    seen = folder / "cases" / f"{index:04d}"
    seen.mkdir(parents=True, exist_ok=True)
    (folder / "truth").mkdir(exist_ok=True)
    for old in seen.iterdir():
        old.unlink()
    if is_raster:
        write_raster(scene.plan, seen)
    else:
        write_geojson(scene.plan, seen / "arena.geojson")
    (seen / "robot.yaml").write_text(yaml_text(scene.robot))
    log = Log(
        robot=cast(Any, scene.robot),  # the writer asks for what this world's robots have, too
        epoch_ns=(FIRST_EPOCH + 1000 * index) * 10**9,
        scan_stamps=runs.scans.stamps[runs.scans.kept],
        bearings=scene.robot.bearings,
        ranges=runs.scans.ranges[runs.scans.kept],
        pose_stamps=runs.pose_stamps,
        poses=runs.poses,
        odometry=cast(Any, runs.odometry),
        command_stamps=runs.commands[:, 0],
        commands=runs.commands[:, 1:],
        arrival_seed=(SEED, index),
    )
    write_log(log, seen / "run.mcap", library=STREAM)
    truth = json.dumps(case.truth, indent=1, default=float)
    (folder / "truth" / f"{index:04d}.json").write_text(truth)


def summary(case: Case, index: int) -> str:
    """Return one line about a case."""
    truth, made = case.truth, case.truth["made"]
    hidden = truth["foreign_effect"] or next(iter(truth["effects"]), None)
    what = f"{hidden['name']} {hidden['mark']}" if hidden else "nothing"
    return (
        f"{index:04d} {truth['suite']} {truth['background']} {what}, {made['robot']} in {made['room']}, "
        f"{made['style']}, {made['scans']} scans, try {made['attempt']}"
    )


def main() -> None:
    """Read the command line and make the cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", choices=SUITES, required=True)
    parser.add_argument("--background", choices=BACKGROUNDS, help="default: in turn")
    parser.add_argument("--map", choices=MAPS, default=MAPS[0], help="of the arena")
    parser.add_argument("--floors", type=Path, default=FOLDER, help="folder of the floors of KTH")
    parser.add_argument("--first", type=int, default=0, help="skip this many cases of the suite")
    parser.add_argument("--n", type=int, default=10, help="count of cases")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    options = parser.parse_args()
    try:
        floors = floor_files(options.floors)
    except FileNotFoundError as error:
        parser.error(str(error))
    for index in range(options.first, options.first + options.n):
        is_dirty = is_dirty_in_turn(options.suite, index)
        if options.background:
            is_dirty = options.background == "dirty"
        case = make(options.suite, index, is_dirty, floors)
        save(case, options.output, index, is_raster=options.map == "raster")
        print(summary(case, index), flush=True)


if __name__ == "__main__":
    main()
