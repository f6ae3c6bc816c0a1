"""File formats, one module each: detect a format and read it as a `Run`; registry FORMATS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from logs.errors import MAX_LISTED, LogError
from logs.formats import carmen, mcap_file, rosbag, table, wean
from logs.formats.foreign import described
from logs.formats.text import first_bytes
from logs.inflation import BZIP2_MAGIC, GZIP_MAGIC
from logs.no_return import check_no_return
from logs.run import OccupancyMap, Run
from logs.types import Mounts, Progress, ReadOptions

BAG_METADATA = "metadata.yaml"


class Format(NamedTuple):
    """A file format that `read` supports."""

    matches: Callable[[Path, bytes], bool]
    """Return whether a file has this format, from its path and its first bytes (decompressed, if gzip)."""
    read: Callable[[Path, ReadOptions], Run]


FORMATS: dict[str, Format] = {
    "mcap": Format(mcap_file.matches, mcap_file.read),
    "rosbag": Format(rosbag.matches, rosbag.read),
    "wean": Format(wean.matches, wean.read),
    "carmen": Format(carmen.matches, carmen.read),
    "table": Format(table.matches, table.read),
}
"""Name -> format; the first match is used."""


def read(
    path: Path | str,
    *,
    topics: Mapping[str, str] | None = None,
    no_return: str | None = None,
    mounts: Mounts | None = None,
    slice: tuple[float, float] | None = None,
    progress: Progress | None = None,
) -> Run:
    """Read a run from a file; the format is detected from its content.

    Parameters
    ----------
    topics : Role (scan, pose, odom, cmd) -> topic, for files with non-standard topic names.
    no_return : Encoding of a missing return: `range_max` (exactly that range), `zero`, `inf` or `nan`.
        None: Detected from the frequency of readings, and reported in the notes.
    mounts : Topic or frame of a sensor -> (3,) [m, m, rad] mount in base_link, used if the log has no transform.
    slice : [m] Lowest and highest point of a PointCloud2 that is read as a laser, above base_footprint or base_link.
        None: The ring nearest the horizontal.

    Raises
    ------
    LogError
        If the format is unknown, the file is damaged, or it holds no scans.
    OSError
        If the file cannot be opened.
    """
    path = Path(path)
    check_no_return(no_return)
    kind = format_of(path)
    check_slice(path, kind, slice)
    how = ReadOptions(topics, progress, no_return, mounts, slice)
    with np.errstate(all="ignore"):  # overflow gives inf or nan, which are dropped and counted
        return FORMATS[kind].read(path, how)


def check_slice(path: Path, kind: str, slice: Sequence[float] | None) -> None:
    """Reject heights that are not two numbers in order, and those for a format without point clouds."""
    if slice is None:
        return
    if len(slice) != 2 or not np.isfinite(slice).all() or not slice[0] < slice[1]:
        raise LogError(
            f"`slice` is {slice}, expected two heights in metres, the lower first, such as 0.1, 0.5"
        )
    if kind not in ("mcap", "rosbag"):
        raise LogError(f"`slice` selects heights of a PointCloud2, but {path} is a {kind} log; leave it out")


def format_of(path: Path) -> str:
    """Return the key of `FORMATS` for a file.

    Raises
    ------
    LogError
        If no format matches; the message describes the content of the file.
    """
    if path.is_fifo():
        raise LogError(f"{path} is a pipe, and a log is read more than once; save it to a file and give that")
    if path.name == BAG_METADATA and path.is_file():
        raise LogError(f"{path} describes a rosbag2 folder; give the folder: {path.parent}")
    head = first_bytes(path)
    for name, known in FORMATS.items():
        if known.matches(path, head):
            _check_plain(path, name)
            return name
    expected = (
        "expected MCAP, a rosbag2 folder or .db3, a ROS 1 .bag, a CARMEN log or a CSV table with t and r0 ..."
    )
    if path.is_dir():
        raise LogError(f"{path} is a folder {_inside(path)}; {expected}")
    what = described(head, str(path))
    if what:
        raise LogError(f"{path} is {what}")
    if not head:
        raise LogError(f"{path} is empty; {expected}")
    raise LogError(f"{path} is not a known log (it starts with {head[:8]!r}); {expected}")


def _inside(folder: Path) -> str:
    """Describe a folder that is no log: the logs in it, or else its files."""
    children = sorted(folder.iterdir())
    logs = [child for child in children if _is_log(child)]
    if logs:
        return f"with the logs {_listed(logs)}; give one of them, or all of them to `sensorgraph fleet`"
    return f"without a log (it holds {_listed(children) or 'nothing'})"


def _listed(paths: Sequence[Path]) -> str:
    more = f" and {len(paths) - MAX_LISTED} more" if len(paths) > MAX_LISTED else ""
    return ", ".join(path.name for path in paths[:MAX_LISTED]) + more


def _is_log(path: Path) -> bool:
    """Tell whether a file or a folder is a log."""
    try:
        head = first_bytes(path)
        return any(known.matches(path, head) for known in FORMATS.values())
    except (LogError, OSError):  # damaged, or private
        return False


def _check_plain(path: Path, kind: str) -> None:
    """Reject a binary log that is compressed as a whole; only text logs are decompressed while reading."""
    if kind not in ("mcap", "rosbag") or not path.is_file():
        return
    with path.open("rb") as file:
        start = file.read(4)
    for magic, tool in ((GZIP_MAGIC, "gunzip -k"), (BZIP2_MAGIC, "bunzip2 -k")):
        if start.startswith(magic):
            raise LogError(
                f"{path} is a {kind} log that is compressed as a whole; decompress it: {tool} {path}"
            )


def write(
    run: Run,
    path: Path | str,
    *,
    occupancy: OccupancyMap | None = None,
    progress: Progress | None = None,
) -> None:
    """Write a run as MCAP (profile ros2), or as a table if the name ends in `.csv`.

    Raises
    ------
    LogError
        If a stamp is not finite or outside the range of ROS time.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        table.write(run, path)
    else:
        mcap_file.write(run, path, occupancy=occupancy, progress=progress)
