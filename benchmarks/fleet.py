"""A fleet of stretches of real logs, with wear planted in some robots: all planted changes found, none invented.

    python -m benchmarks.fleet make ../shared/data/raw-carmen -o DIR [--logs 200] [--seed 0]
    python -m benchmarks.fleet run DIR [--workers 2]
    python -m benchmarks.fleet kill DIR [--workers 2]

`make` cuts stretches of the raw logs of intel and fr079, deals them to robots in shuffled order, one a day, and
plants wear from some day on: a worn wheel, a knocked laser, an offset of the ranges. It also builds a sensorgraph of
each building from the complete log. What was planted is in planted.json, which `fleet` does not get. `run` calls
`sensorgraph fleet` and compares. `kill` kills a second run half-way and starts it again.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import logs
import sensorgraph as sg
from benchmarks.arguments import existing, heads, parser_of, timed
from logs.run import Run
from logs.transforms import wrap

SOURCES = {"intel": ("amr", 0.7), "fr079": ("bot", 0.3)}
"""Log -> first part of the names of its robots, and share of the stretches."""
N_SCANS = 150
BASE = 0.4
"""[m] Wheelbase in the robot.yaml of each log."""
DAY_ONE, DAY = 1_772_355_600, 86_400
"""[s] 2026-03-01, 09:00 UTC; length of a day."""
KINDS = ("left_wheel", "right_wheel", "mount_phi", "range_offset")
SIZES = {
    "left_wheel": (0.02, 0.04),
    "right_wheel": (0.02, 0.04),
    "mount_phi": (2.0, 3.0),
    "range_offset": (0.06, 0.1),
}
"""Sizes: share of the radius lost; degrees; metres."""
FOLLOWS = {
    "mount_phi": {"mount_x", "mount_y"},
    "range_offset": {"mount_x", "mount_y", "left_wheel", "right_wheel"},
}
"""Quantities that a planted change moves as well."""


def make(source: Path, out: Path, n_logs: int, each: int, seed: int, names: list[str]) -> None:
    """Write logs and places."""
    rng = np.random.default_rng([57, seed])
    planted: list[dict[str, Any]] = []
    (out / "bags").mkdir(parents=True, exist_ok=True)
    (out / "places").mkdir(exist_ok=True)
    total = sum(SOURCES[name][1] for name in names)
    for name in names:
        prefix, share = SOURCES[name]
        whole = logs.read(source / f"{name}.clf.bz2")
        place = out / "places" / f"{name}.sensorgraph"
        if not place.exists():
            sg.build(sg.locate(whole).run).save(place)
        n = max(2, round(share / total * n_logs))
        starts = np.linspace(0, whole.n_scans - N_SCANS - 1, n).astype(int)
        rng.shuffle(starts)
        n_robots = max(1, round(n / each))
        for number, own in enumerate(np.array_split(starts, n_robots), start=1):
            robot = f"{prefix}{number}"
            change = _draw(rng, robot, len(own))
            planted += [change] if change else []
            for day, start in enumerate(own.tolist()):
                run = _stretch(whole, start, robot, day)
                if change and day >= change["day"]:
                    run = _worn(run, change["quantity"], change["size"])
                (out / "bags" / robot).mkdir(exist_ok=True)
                logs.write(run, out / "bags" / robot / f"{robot}_day{day:02d}.mcap")
    (out / "planted.json").write_text(json.dumps(planted, indent=1) + "\n")
    print(f"{sum(1 for _ in out.rglob('*.mcap'))} logs, {len(planted)} planted changes")


def _draw(rng: np.random.Generator, robot: str, n: int) -> dict[str, Any] | None:
    """Draw a change for two of three robots, in the middle of their logs."""
    if rng.random() < 1 / 3 or n < 8:
        return None
    quantity = str(rng.choice(KINDS))
    size = float(rng.uniform(*SIZES[quantity]))
    if quantity != "range_offset":
        size *= -1.0 if "wheel" in quantity else float(rng.choice([-1, 1]))
    return {"robot": robot, "quantity": quantity, "size": size, "day": int(rng.integers(n // 3, 2 * n // 3))}


def _stretch(whole: Run, start: int, robot: str, day: int) -> Run:
    """Return a stretch of a log as a log of its own, with odometry and without poses."""
    first, last = whole.stamps[start], whole.stamps[start + N_SCANS - 1]
    near = (whole.odom_stamps >= first - 0.5) & (whole.odom_stamps <= last + 0.5)
    text = f"name: {robot}\nwheels: {{base: {BASE}}}\n"
    cut = whole.take_scans(slice(start, start + N_SCANS))
    return replace(
        cut,
        stamps=cut.stamps - first,
        odom_stamps=whole.odom_stamps[near] - first,
        odometry=whole.odometry[near],
        odom_twists=whole.odom_twists[near],
        pose_stamps=np.zeros(0),
        poses=np.zeros((0, 3)),
        cmd_stamps=np.zeros(0),
        commands=np.zeros((0, 2)),
        epoch_ns=(DAY_ONE + day * DAY) * 10**9,
        meta={},
        attachments={"robot.yaml": text.encode()},
    )


def _worn(run: Run, quantity: str, size: float) -> Run:
    """Return the log as a worn robot records it."""
    if quantity == "range_offset":
        return replace(run, ranges=run.ranges + size)
    if quantity == "mount_phi":  # ray k then looks where another one looked
        step = np.degrees(np.median(np.diff(run.sensor.bearings)))
        shift = round(size / step)
        ranges = np.full_like(run.ranges, np.nan)
        if shift > 0:
            ranges[:, :-shift] = run.ranges[:, shift:]
        else:
            ranges[:, -shift:] = run.ranges[:, :shift]
        return replace(run, ranges=ranges)
    steps = np.diff(run.odometry, axis=0)
    turn = wrap(steps[:, 2])
    middle = run.odometry[:-1, 2] + turn / 2
    way = np.cos(middle) * steps[:, 0] + np.sin(middle) * steps[:, 1]
    across = np.cos(middle) * steps[:, 1] - np.sin(middle) * steps[:, 0]  # wear does not change this
    left, right = way - turn * BASE / 2, way + turn * BASE / 2
    # the driver assumes the old radius, and so reports more than the wheel rolls
    if quantity == "left_wheel":
        left = left / (1 + size)
    else:
        right = right / (1 + size)
    way, turn = (left + right) / 2, (right - left) / BASE
    phi = run.odometry[0, 2] + np.concatenate([[0.0], np.cumsum(turn)])
    c, s = np.cos(phi[:-1] + turn / 2), np.sin(phi[:-1] + turn / 2)
    moved = np.stack([c * way - s * across, s * way + c * across], axis=1)
    xy = run.odometry[0, :2] + np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)])
    return replace(run, odometry=np.column_stack([xy, wrap(phi)]))


def command(folder: Path, out: Path, workers: int) -> list[str]:
    """Return the command."""
    graphs = [
        part for one in sorted((folder / "places").glob("*.sensorgraph")) for part in ("--graph", str(one))
    ]
    return [
        sys.executable, "-m", "sensorgraph", "fleet", str(folder / "bags"), *graphs, "-o", str(out), "--workers",
        str(workers),
    ]  # fmt: skip


def run(folder: Path, workers: int) -> None:
    """Survey the fleet, and compare with what was planted."""
    with timed() as took:
        subprocess.run(command(folder, folder / "fleet", workers), check=True)
    compare(folder)
    print(f"wall {took.wall:.0f} s; CPU of the coordinator and of ended processes {took.cpu:.0f} s")


def compare(folder: Path) -> None:
    """Print the planted and the stated changes, and the costs."""
    found = json.loads((folder / "fleet" / "fleet.json").read_text())
    planted = json.loads((folder / "planted.json").read_text())
    rows, n_invented, n_found = found["rows"], 0, 0
    print(heads("robot", "planted", "since day", "found", "since", "size", text=2))
    for one in planted:
        hits = [c for c in found["changes"] if (c["robot"], c["quantity"]) == (one["robot"], one["quantity"])]
        hit = max(hits, key=lambda c: c["probability"], default=None)
        n_found += hit is not None
        unit = 57.2958 if one["quantity"] == "mount_phi" else 1.0
        day = "" if hit is None else str(int(Path(hit["after"]).stem.rsplit("day", 1)[1]))
        size = "" if hit is None else f"{hit['size'] * unit:+.4f} ± {hit['sigma'] * unit:.4f}"
        print(
            f"| {one['robot']} | {one['quantity']} {one['size']:+.4f} | {one['day']} | "
            f"{'drift' if hit and hit['is_drift'] else hit['quantity'] if hit else 'NO'} | {day} | {size} |"
        )
    kinds = {one["robot"]: one["quantity"] for one in planted}
    for change in found["changes"]:
        own = kinds.get(change["robot"], "")
        if change["quantity"] != own and change["quantity"] not in FOLLOWS.get(own, ()):
            n_invented += 1
            print(
                f"invented: {change['robot']} {change['quantity']} {change['size']:+.4f} ± {change['sigma']:.4f}"
            )
    robots = {row["robot"] for row in rows}
    n_series = sum(
        len({q for row in rows if row["robot"] == r for q in row["quantities"]}) - 2 for r in robots
    )
    print(
        f"found {n_found} of {len(planted)}; invented {n_invented} in {n_series} series; failed {len(found['failures'])}"
    )
    wrong = sum(_building(row["robot"]) not in row["place"] for row in rows)
    seconds = np.array([row["seconds"] for row in rows])
    hours = sum(row["length_s"] for row in rows) / 3600
    print(
        f"wrong places: {wrong} of {len(rows)}; differ from sisters: {[(o['robot'], o['quantity']) for o in found['odd']]}"
    )
    print(
        f"CPU per log: median {np.median(seconds):.1f} s, 95 % {np.quantile(seconds, 0.95):.1f} s; per hour of log "
        f"{seconds.sum() / hours / 3600:.2f} h; 100,000 such logs on 100 workers {np.mean(seconds) * 1000 / 3600:.1f} h"
    )


def _building(robot: str) -> str:
    return next(name for name, (prefix, _) in SOURCES.items() if robot.startswith(prefix))


def kill(folder: Path, workers: int) -> None:
    """Kill the coordinator half-way, start it again, and count how often each log was analysed."""
    out = folder / "killed"
    n = sum(1 for _ in (folder / "bags").rglob("*.mcap"))
    process = subprocess.Popen(command(folder, out, workers))
    results = out / "results"
    while process.poll() is None and len(list(results.glob("*.*.json"))) < n // 2:
        time.sleep(0.2)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    kept = {path: path.stat().st_mtime_ns for path in results.glob("*.*.json")}
    second = subprocess.run(command(folder, out, workers), check=True, capture_output=True, text=True)
    again = sum(path.stat().st_mtime_ns != stamp for path, stamp in kept.items())
    print(
        f"{len(kept)} of {n} logs before the kill; afterwards: {second.stdout.splitlines()[0]}; analysed twice: {again}"
    )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("step", choices=("make", "run", "kill"))
    parser.add_argument("folder", type=existing, help="make: raw-carmen; else the folder that `make` wrote")
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--each", type=int, default=22, help="logs of a robot")
    parser.add_argument("--sources", nargs="+", choices=list(SOURCES), default=list(SOURCES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    if args.step == "make":
        make(args.folder, args.out, args.logs, args.each, args.seed, args.sources)
    elif args.step == "run":
        run(args.folder, args.workers)
    else:
        kill(args.folder, args.workers)


if __name__ == "__main__":
    main()
