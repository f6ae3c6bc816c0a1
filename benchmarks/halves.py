"""Do parts of one log agree in wheels and mount, as driving alone tells them, and is a planted change found?

    python -m benchmarks.halves LOG... [--plant 0.012]

Each log is located once and cut into halves, thirds, quarters, and at 30 and 60 %; each pair of parts is compared. Then the
turns, and then the ways, of the odometry's second half are made smaller by the planted share, and the halves are compared
again, and searched for the change as one run. Parts that are files of their own: `sensorgraph diagnose FIRST SECOND`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

import logs
from benchmarks.arguments import parser_of
from logs.transforms import compose, invert
from sensorgraph.diagnosis.motion.calibration.comparison import change_within, compare
from sensorgraph.diagnosis.motion.calibration.driving import change_lines
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, calibrate
from sensorgraph.diagnosis.motion.calibration.laser_motion import LaserMotion, laser_motion
from sensorgraph.localization.kept import located

CUTS = ((0, 0.5, 1), (0, 1 / 3, 2 / 3, 1), (0, 0.25, 0.5, 0.75, 1), (0, 0.3, 1), (0, 0.6, 1))


def pairs(motion: LaserMotion) -> list[tuple[float, ...]]:
    """Return the differences of all pairs of parts, in standard errors, in the order of PARAMETERS."""
    n, out = len(motion.first), []
    for cuts in CUTS:
        parts = [calibrate(motion.part(slice(int(a * n), int(b * n)))) for a, b in pairwise(cuts)]
        out += [
            tuple(d.value / d.stderr for d in compare(parts[i], parts[j]))
            for j in range(len(parts))
            for i in range(j)
        ]
    return out


def planted(motion: LaserMotion, column: int, share: float) -> LaserMotion:
    """Make ways (column 0) or turns (column 2) of the odometry smaller from the middle on."""
    steps = compose(invert(motion.odometry[:-1]), motion.odometry[1:])
    steps[:, 2] = np.diff(motion.odometry[:, 2])
    steps[motion.second[len(motion.first) // 2] :, slice(0, 2) if column == 0 else 2] /= 1 + share
    track = [motion.odometry[0]]
    for step in steps:
        after = compose(track[-1], step)
        after[2] = track[-1][2] + step[2]
        track.append(after)
    return replace(motion, odometry=np.array(track))


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG")
    parser.add_argument("--plant", type=float, default=0.012, help="share of ways and turns")
    args = parser.parse_args()
    all_of = []
    for path in args.logs:
        run = logs.read(path)
        motion = laser_motion(run, located(path, run).run)
        off = np.array(pairs(motion))
        all_of.append(off)
        print(f"{path.name}: halves differ by", ", ".join(
            f"{name} {z:+.1f}" for name, z in zip(PARAMETERS, off[0], strict=True)), "standard errors")  # fmt: skip
        print("  untouched:", change_lines(change_within(calibrate(motion)))[0])
        half, middle = len(motion.first) // 2, motion.second[len(motion.first) // 2]
        for column, name in ((2, "turn_scale"), (0, "way_scale")):
            changed = planted(motion, column, args.plant)
            parts = [calibrate(changed.part(chosen)) for chosen in (slice(0, half), slice(half, None))]
            one = next(d for d in compare(*parts) if d.name == name)
            print(
                f"  planted {name} {100 * args.plant:+.1f} % at {motion.stamps[middle] - motion.stamps[0]:.0f} s: "
                f"{100 * one.value:+.2f} ± {100 * one.stderr:.2f} %, told: {one.differs and one.is_material}"
            )
            print("    as one run:", change_lines(change_within(calibrate(changed)))[0])
    off = np.abs(np.concatenate(all_of))
    told = compare(*parts)[0].threshold
    print(f"{len(off)} pairs of parts: {100 * (off < 2).mean():.1f} % of {off.size} parameters within 2 standard errors, "
          f"{int((off.max(axis=1) > told).sum())} pairs beyond {told:.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
