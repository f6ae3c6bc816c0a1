"""What `watch` gains by the drift with the floor as an unknown of its own, in the two halves of a raw log.

    python -m benchmarks.floor_drift LOG --work FOLDER

Prints for each half, with and without the drift: the log-likelihood of the tracked poses, the drift, and how much wheel scale and
mount angle scatter between windows of 500 scans, in their standard errors.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.arguments import log_of_halves, parser_of
from benchmarks.localize_in_map import halves
from benchmarks.particle_filter import driven
from benchmarks.watch import Watched, clean_scans, good_run
from planners.types import Floats
from sensorgraph.graph import Sensorgraph
from sensorgraph.watching.evidence import Baseline, Pair
from sensorgraph.watching.odometry_errors import UNKNOWN_FLOOR, OdometryErrors
from sensorgraph.watching.settings import DISTANCE_FAULTS
from sensorgraph.watching.watcher import Watcher

Step = tuple[Floats, Floats, Floats, float]
WINDOW = 500
"""Number of used scans in a window; windows overlap by half."""
NO_DRIFT = Baseline(tolerance=0.0)
COMPARED = {
    fault.name: k for k, fault in enumerate(DISTANCE_FAULTS) if fault.name in ("wheel_radius", "mount_yaw")
}


class Recorder(OdometryErrors):
    """Keeps what it is given; None where the pose is forgotten."""

    def __init__(self) -> None:
        super().__init__()
        self.kept: list[Step | None] = []

    def add(self, step: Floats, twist: Floats, tracked: Floats, weight: float = 1.0) -> float:
        self.kept.append((step, twist, tracked, weight))
        return super().add(step, twist, tracked, weight)

    def forget_pose(self) -> None:
        self.kept.append(None)
        super().forget_pose()


def steps_of(graph: Sensorgraph, watched: Watched) -> list[Step | None]:
    """Return the steps of the odometry with the tracked poses at their ends."""
    watcher, motion = Watcher(graph), Pair(Recorder, math.inf)
    watcher.robot.motion = motion
    for one in watched.observations():
        watcher.add(one)
    return motion.older.kept


def filtered(steps: list[Step | None], floor: Baseline) -> OdometryErrors:
    """Return the filter after all steps."""
    found = OdometryErrors((floor, floor))
    for step in steps:
        if step is None:
            found.forget_pose()
        else:
            found.add(*step)
    return found


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    log_of_halves(parser)
    options = parser.parse_args()
    data = halves(options.log, options.work)
    second = clean_scans(data, driven(data.second), np.flatnonzero(np.isfinite(data.truth[:, 0])))
    for half, watched in (("first", good_run(data)), ("second", second)):
        steps = steps_of(data.graph, watched)
        for name, floor in (("without", NO_DRIFT), ("with", UNKNOWN_FLOOR)):
            whole = filtered(steps, floor)
            drift, error = 1e3 * np.array(whole.floor())
            parts = np.array(
                [
                    filtered(steps[first : first + WINDOW], floor).estimates()
                    for first in range(0, len(steps) - WINDOW + 1, WINDOW // 2)
                ]
            )
            values, errors = parts[:, 0], parts[:, 1]
            mean = (values / errors**2).sum(axis=0) / (1 / errors**2).sum(axis=0)
            scatter = np.sqrt((((values - mean) / errors) ** 2).mean(axis=0))
            shown = ", ".join(f"{fault} {scatter[k]:.1f}" for fault, k in COMPARED.items())
            print(
                f"{half} half, {name} drift: {whole.log_likelihood.max():.0f} nats, drift {drift.round(1)} ± {error.round(1)} mm/m; "
                f"scatter of {len(parts)} windows in standard errors: {shown}",
                flush=True,
            )


if __name__ == "__main__":
    main()
