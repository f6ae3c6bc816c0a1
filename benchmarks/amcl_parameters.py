"""AMCL's parameters from data: a particle filter on the second half of a raw log, with Nav2's defaults and with those found.

The map is what `sensorgraph export --to nav2` writes for a graph of the first half; the parameters are estimated from the
first half. Truth is the whole log, located together. The filter is ours (`particle_filter.filtered`), with AMCL's models;
both are told where to start.

    python -m benchmarks.amcl_parameters ../shared/data/raw-carmen/intel.clf.bz2 --work /tmp/in_map
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import sensorgraph as sg
from benchmarks.localize_in_map import halves, said
from benchmarks.particle_filter import DistanceField, filtered
from sensorgraph.exporting.amcl import DEFAULTS, estimate_amcl
from sensorgraph.exporting.nav2 import chosen
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.simulate import occupancy_map


def main() -> None:
    """Print the parameters, and the errors with each set."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument(
        "--work", type=Path, default=Path("runs/in_map"), help="folder of located run and graph"
    )
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    data = halves(given.log, given.work)
    arena = arena_of(sg.Sensorgraph.load(given.work / f"{given.log.name}.first.sensorgraph"))
    grid = occupancy_map(arena)
    estimates = estimate_amcl(data.first, arena, grid)
    for name, found in estimates.items():
        print(f"{name}: {found}")
    field = DistanceField.of(grid.data != 100, np.asarray(grid.origin[:2]), grid.resolution)
    for label, parameters in (("Nav2's defaults", DEFAULTS), ("from the first half", chosen(estimates))):
        for seed in range(given.seeds):
            poses = filtered(data.second, data.truth, field, parameters, np.random.default_rng(seed))
            done = np.isfinite(poses[:, 0]) & data.covered
            print(
                f"{given.log.name}, {label}, seed {seed}, covered: {said(poses[done], data.truth[done])}",
                flush=True,
            )


if __name__ == "__main__":
    main()
