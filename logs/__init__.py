"""What happened: runs in memory and the files that keep them; knows no planner and no model.

`read(path)` takes any format in `FORMATS`; `write(run, path)` writes MCAP; `Recorder` writes while it happens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from logs import carmen, mcap_file, rosbag, table, wean
from logs.errors import LogError
from logs.recorder import Recorder
from logs.recording import check_roles
from logs.run import OccupancyMap, Pairing, RangeSensor, Run, pair
from logs.types import Progress

__all__ = [
    "FORMATS",
    "LogError",
    "OccupancyMap",
    "Pairing",
    "RangeSensor",
    "Recorder",
    "Run",
    "pair",
    "parse_topics",
    "read",
    "write",
]


class Format(NamedTuple):
    """A kind of file that `read` understands."""

    matches: Callable[[Path, bytes], bool]
    """Tell from the path and its first bytes (unpacked, if gzip) whether a file is of this kind."""
    read: Callable[[Path, Mapping[str, str] | None, Progress | None], Run]
    """Read (path, topics, progress)."""


FORMATS: dict[str, Format] = {
    "mcap": Format(mcap_file.matches, mcap_file.read),
    "rosbag": Format(rosbag.matches, rosbag.read),
    "wean": Format(wean.matches, wean.read),
    "carmen": Format(carmen.matches, carmen.read),
    "table": Format(table.matches, table.read),
}


def read(
    path: Path | str, *, topics: Mapping[str, str] | None = None, progress: Progress | None = None
) -> Run:
    """Read a run from a file of any known format, told by its content.

    Parameters
    ----------
    topics : role -> topic, for files with other names than ours: roles scan, pose, odom, cmd
    """
    path = Path(path)
    return FORMATS[format_of(path)].read(path, topics, progress)


def parse_topics(texts: Iterable[str]) -> dict[str, str]:
    """Return role -> topic of texts like `scan=/front/scan`, as the command line takes them."""
    topics = {}
    for text in texts:
        role, equals, name = text.partition("=")
        if not equals or not name:
            raise LogError(f"--topic {text} is no ROLE=NAME; expected for example scan=/front/scan")
        topics[role.strip()] = name.strip()
    check_roles(topics)
    return topics


def format_of(path: Path) -> str:
    """Return the key of `FORMATS` for a file, or say what it looks like instead."""
    from logs.text import first_bytes

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
    """Write a run as MCAP (profile ros2), or as a table where the name ends in `.csv`."""
    path = Path(path)
    if path.suffix.lower() == ".csv":
        table.write(run, path)
    else:
        mcap_file.write(run, path, occupancy=occupancy, progress=progress)
