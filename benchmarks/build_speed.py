"""How long `build` takes for 50,000 scans x 181 rays of the office, on one core, and how much memory.

    python -m benchmarks.build_speed [--scans 50000]

Compilation is done before (on 300 scans).
"""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

import numpy as np

from benchmarks.arguments import parser_of
from benchmarks.measures import peak_memory, timed
from logs.run import RangeSensor, Run
from planners.maps import geojson
from sensorgraph.building.build import build
from sensorgraph.demo import check_run
from sensorgraph.world.robot import default_robot


def recording(n: int) -> Run:
    """Return scans from n poses spread evenly over the office, with a sensor of 30 m."""
    arena = geojson.loads(files("sensorgraph.data").joinpath("office.geojson").read_text())
    robot = default_robot()
    sensor = RangeSensor(bearings=robot.sensor.bearings, range_max=30.0, sigma=0.01, rate=10.0)
    return check_run(arena, replace(robot, sensor=sensor), np.random.default_rng(0), n)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--scans", type=int, default=50_000)
    options = parser.parse_args()
    build([recording(300)])
    run = recording(options.scans)
    with timed() as took:
        graph = build([run])
    size = f"{options.scans:,} scans x {graph.sensor.n_rays} rays"
    print(f"{size}: {took.cpu:.2f} s of one core, {took.wall:.2f} s by the clock")
    print("; ".join(f"{label}: {text}" for label, text in graph.model.summary().items()))
    print(f"memory at its highest: {peak_memory():,.0f} MiB")


if __name__ == "__main__":
    main()
