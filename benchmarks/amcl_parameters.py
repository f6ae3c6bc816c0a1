"""AMCL's parameters from data: a particle filter on the second half of a raw log, with Nav2's defaults and with those found.

The map is what `sensorgraph export --to nav2` writes for a graph of the first half; the parameters are estimated from the
first half. Truth is the whole log, located together. The filter is ours (`sensorgraph.exporting.amcl_filter`), with AMCL's
models; all are told where to start.

    python -m benchmarks.amcl_parameters ../shared/data/raw-carmen/intel.clf.bz2 --work /tmp/in_map
"""

from __future__ import annotations

import numpy as np

from benchmarks.arguments import log_of_halves, parser_of
from benchmarks.localize_in_map import halves, said
from benchmarks.particle_filter import followed
from sensorgraph.exporting.amcl import DEFAULTS, compare_laser_models, estimate_amcl
from sensorgraph.exporting.amcl_filter import LASER_MODELS, CellDistances
from sensorgraph.exporting.nav2 import chosen, map_of
from sensorgraph.world.identified_arena import arena_of


def main() -> None:
    """Print the parameters, and the errors with each set."""
    parser = parser_of(__doc__)
    log_of_halves(parser)
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    data = halves(given.log, given.work)
    arena = arena_of(data.graph)
    grid = map_of(arena)
    estimates = estimate_amcl(data.first, arena, grid)
    for name, found in estimates.items():
        print(f"{name}: {found}")
    numbers = chosen(estimates)
    model = compare_laser_models(data.first, grid, numbers)
    assert model is not None, "the log has too little odometry"
    print(f"laser_model_type: {model.name}, {model}")
    field = CellDistances.of(grid)
    for label, parameters, laser_model in (
        ("Nav2's defaults", DEFAULTS, LASER_MODELS[0]),
        ("Nav2's defaults, the product", DEFAULTS, LASER_MODELS[1]),
        ("numbers of the first half", numbers, LASER_MODELS[0]),
        ("numbers and laser model of the first half", numbers, model.name),
    ):
        for seed in range(given.seeds):
            poses = followed(
                data.second, data.truth, field, parameters, np.random.default_rng(seed), laser_model
            )
            done = np.isfinite(poses[:, 0]) & data.covered
            print(f"{given.log.name}, {label}, seed {seed}, covered: {said(poses[done], data.truth[done])}")


if __name__ == "__main__":
    main()
