"""Read the logs of CMU's Wean Hall: `O x y theta t` and `L x y theta xl yl thetal r1 .. r180 t` lines in cm and rad."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.formats.carmen_clock import ASSUMED_PERIOD
from logs.formats.text import read_lines
from logs.no_return import mask
from logs.run import RangeSensor, Run
from logs.sensor import usual_step
from logs.transforms import compose, invert, twists_of, wrap
from logs.types import ReadOptions

N_WEAN_RAYS = 180
NO_RETURN_RANGE = 81.83
"""[m] ranges of 8183 cm and above are codes of the SICK scanner."""
N_ODOMETRY_WORDS, N_LASER_WORDS = 5, 8 + N_WEAN_RAYS


def matches(path: Path, head: bytes) -> bool:
    """Return whether the first line has the format of an O or an L line."""
    words = next((line.split() for line in head.splitlines() if line.strip()), [b""])
    return (words[0], len(words)) in ((b"O", N_ODOMETRY_WORDS), (b"L", N_LASER_WORDS))


def read(path: Path, how: ReadOptions) -> Run:
    """Read a run; its poses are wheel odometry.

    Raises
    ------
    LogError
        If the file has no valid scan line, or more invalid lines than scans.
    """
    odom, scans, broken = [], [], []
    lines = read_lines(path)
    for number, line in enumerate(lines, 1):
        words = line.split()
        try:
            if words[:1] == ["O"] and len(words) == N_ODOMETRY_WORDS:
                odom.append([float(word) for word in words[1:]])
            elif words[:1] == ["L"] and len(words) == N_LASER_WORDS:
                scans.append(np.array(words[1:], dtype=np.float64))
            elif words:
                broken.append(number)
        except ValueError:
            broken.append(number)
        if how.progress is not None and number % 1000 == 0:
            how.progress(number, len(lines))
    if not scans or len(broken) > len(scans):
        raise LogError(
            f"{path} has {len(scans)} valid L lines and {len(broken)} invalid lines; check that the copy is complete"
        )
    table = np.stack(scans)
    table = table[np.argsort(table[:, -1], kind="stable")]
    robot, laser = table[:, :3].copy(), table[:, 3:6].copy()
    robot[:, :2] /= 100.0
    laser[:, :2] /= 100.0
    robot[:, 2] = wrap(robot[:, 2])
    ranges, stamps = table[:, 6:-1] / 100.0, table[:, -1]
    code = NO_RETURN_RANGE if how.no_return in (None, "range_max") else None
    notes = mask([ranges], code, is_zero=how.no_return == "zero")
    if broken:
        notes.append(f"{len(broken)} invalid lines left out, the first is line {broken[0]}")
    # an L line repeats the pose of the previous O line with a later stamp; combined with O lines it would zigzag
    own = np.column_stack([table[:, :3], stamps])
    wheel = np.array(odom, dtype=np.float64) if len(odom) > 1 else own
    wheel = wheel[np.argsort(wheel[:, 3], kind="stable")]
    wheel[:, :2] /= 100.0
    return Run(
        sensor=RangeSensor(
            bearings=np.radians(-90.0 + np.arange(N_WEAN_RAYS)),
            range_min=0.0,
            range_max=NO_RETURN_RANGE if code is not None else float(np.nanmax(ranges[np.isfinite(ranges)])),
            mount=np.asarray(np.median(compose(invert(robot), laser), axis=0)),
            resolution=0.01,
            rate=1.0 / usual_step(stamps, ASSUMED_PERIOD),
        ),
        stamps=stamps,
        ranges=ranges,
        pose_stamps=stamps,
        poses=robot,
        odom_stamps=wheel[:, 3],
        odometry=np.column_stack([wheel[:, :2], wrap(wheel[:, 2])]),
        odom_twists=twists_of(wheel[:, 3], wheel[:, :3]),
        meta={
            "source": path.name,
            "format": "wean",
            "pose_source": "odometry",
            "notes": "; ".join(notes),
        },
    )
