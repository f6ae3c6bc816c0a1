"""Kinds of files, one module each: how to tell them, how to read them as a `Run`; registry FORMATS."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from logs.errors import LogError
from logs.formats import carmen, mcap_file, rosbag, table, wean
from logs.formats.text import first_bytes
from logs.no_return import check_no_return
from logs.run import OccupancyMap, Run
from logs.types import Mounts, Progress

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class Format(NamedTuple):
    """A kind of file that `read` understands."""

    matches: Callable[[Path, bytes], bool]
    """Tell from the path and its first bytes (unpacked, if gzip) whether a file is of this kind."""
    read: Callable[[Path, Mapping[str, str] | None, Progress | None, str | None, Mounts | None], Run]
    """Read (path, topics, progress, no_return, mounts)."""


FORMATS: dict[str, Format] = {
    "mcap": Format(mcap_file.matches, mcap_file.read),
    "rosbag": Format(rosbag.matches, rosbag.read),
    "wean": Format(wean.matches, wean.read),
    "carmen": Format(carmen.matches, carmen.read),
    "table": Format(table.matches, table.read),
}
"""Name -> format; the first that matches is taken."""


def read(
    path: Path | str,
    *,
    topics: Mapping[str, str] | None = None,
    no_return: str | None = None,
    mounts: Mounts | None = None,
    progress: Progress | None = None,
) -> Run:
    """Read a run from a file of any known format, told by its content.

    Parameters
    ----------
    topics : role -> topic, for files with other names than ours: roles scan, pose, odom, cmd
    no_return : how a missing return was logged: `range_max` (exactly that range), `zero`, `inf` or `nan`; None: noticed from
        its frequency, and said in the notes
    mounts : topic or frame of a sensor -> (3,) [m, m, rad] where it sits in base_link, where no transform says it

    Raises
    ------
    LogError
        if the file is of no known format, is damaged, or holds no scans
    OSError
        if the file cannot be opened
    """
    path = Path(path)
    check_no_return(no_return)
    with np.errstate(all="ignore"):  # numbers that overflow become inf or nan, which is dropped and counted
        return FORMATS[format_of(path)].read(path, topics, progress, no_return, mounts)


def format_of(path: Path) -> str:
    """Return the key of `FORMATS` for a file.

    Raises
    ------
    LogError
        if no format matches; it says what the file looks like instead
    """
    head = first_bytes(path)
    for name, known in FORMATS.items():
        if known.matches(path, head):
            return name
    expected = (
        "expected MCAP, a rosbag2 folder or .db3, a ROS 1 .bag, a CARMEN log or a CSV table with t and r0 ..."
    )
    if path.is_dir():
        inside = ", ".join(sorted(child.name for child in path.iterdir())[:5]) or "nothing"
        raise LogError(f"{path} is a folder without metadata.yaml (it holds {inside}); {expected}")
    if head.startswith(ZSTD_MAGIC):
        raise LogError(
            f"{path} is packed by zstd; give the rosbag2 folder that it is a part of (it has a metadata.yaml), or "
            f"unpack it: zstd -d {path}"
        )
    if not head:
        raise LogError(f"{path} is empty; {expected}")
    raise LogError(f"{path} is no log (it starts with {head[:8]!r}); {expected}")


def write(
    run: Run,
    path: Path | str,
    *,
    occupancy: OccupancyMap | None = None,
    progress: Progress | None = None,
) -> None:
    """Write a run as MCAP (profile ros2), or as a table where the name ends in `.csv`.

    Raises
    ------
    LogError
        if a stamp is not finite or beyond what ROS time can hold
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        table.write(run, path)
    else:
        mcap_file.write(run, path, occupancy=occupancy, progress=progress)
