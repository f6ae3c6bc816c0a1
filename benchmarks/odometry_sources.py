"""Two odometries of a CARMEN log, in ODOM lines and in scan lines: how well do their steps agree with the located ones.

    python -m benchmarks.odometry_sources LOG...

Each log is located once. A step is from one scan to the next, where the robot moves; the odometry is taken at the stamps of the
scans, moved by the time with the smallest error.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import logs
from benchmarks.arguments import parser_of
from logs.motion import Motion
from logs.transforms import compose, difference, invert, wrap
from planners.types import Floats
from sensorgraph.localization.kept import located
from sensorgraph.localization.odometry import odometry_of

TIMES = np.arange(-0.3, 0.301, 0.02)
"""[s] that are tried."""
MOVES, LARGEST = (0.02, 0.01), 0.2
"""[m, rad] Least step that counts; largest error [m, rad] that counts in full: the odometry jumps."""


def step_errors(motion: Motion, stamps: Floats, steps: Floats) -> tuple[Floats, Floats]:
    """Return the rms errors (2,) [m, rad] of way and turn at the best times (2,) [s], against steps (n - 1, 3) between scans."""
    moves = (np.hypot(*steps[:, :2].T) > MOVES[0]) | (np.abs(wrap(steps[:, 2])) > MOVES[1])
    errors = []
    for time in TIMES:
        poses = motion.at(stamps + time)
        off = difference(compose(invert(poses[:-1]), poses[1:]), steps)[moves][:, [0, 2]]
        errors.append(np.sqrt(np.mean(np.minimum(np.abs(off), LARGEST) ** 2, axis=0)))
    best = np.argmin(errors, axis=0)
    return np.min(errors, axis=0), TIMES[best]


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG")
    for path in parser.parse_args().logs:
        raw = logs.read(path)
        run = located(path, raw).run
        paired = logs.pair(run)
        stamps, poses = run.stamps[paired.paired], paired.poses[paired.paired]
        steps = compose(invert(poses[:-1]), poses[1:])
        used = odometry_of(raw)
        assert used is not None
        for name, times, odometry in (
            ("scan lines", raw.pose_stamps, raw.poses),
            ("ODOM lines", raw.odom_stamps, raw.odometry),
        ):
            motion = Motion(stamps=times, poses=np.column_stack([odometry[:, :2], np.unwrap(odometry[:, 2])]))
            (way, turn), best = step_errors(motion, stamps, steps)
            mark = ", used" if np.array_equal(used.stamps, times) else ""
            print(
                f"{path.name} {name}: {1e3 * way:.1f} mm at {best[0]:+.2f} s, {1e3 * turn:.1f} mrad at {best[1]:+.2f} s{mark}"
            )


if __name__ == "__main__":
    main()
