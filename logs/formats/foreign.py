"""Name files that are given for logs and are none, from their first bytes, with what to do instead."""

from __future__ import annotations

import csv
import re

import numpy as np

from logs.errors import MAX_LISTED
from logs.formats.text import parses_as_number
from logs.inflation import LZ4_MAGIC, ZSTD_MAGIC
from logs.types import Floats

GIVE_LOG = "give the log from which it was made, with the scans"
PACKED: tuple[tuple[int, tuple[bytes, ...], str], ...] = (
    (0, (ZSTD_MAGIC,), "compressed with zstd; give the rosbag2 folder that contains it, or decompress it: zstd -d"),
    (0, (b"\xfd7zXZ\x00", b"\x5d\x00\x00"), "compressed with xz; decompress it: xz -dk"),
    (0, (b"7z\xbc\xaf\x27\x1c",), "a 7z archive; unpack it and give the log in it: 7z x"),
    (0, (b"Rar!\x1a\x07",), "a rar archive; unpack it and give the log in it: unrar x"),
    (0, (LZ4_MAGIC,), "compressed with lz4; decompress it: lz4 -dk"),
    (257, (b"ustar",), "a tar archive; unpack it and give the log in it: tar xf"),
    (0, (b"version https://git-lfs",), "a pointer of Git LFS and not the log; fetch it: git lfs pull, for"),
    (0, (b"/annex/objects", b"../.git/annex"), "a pointer of git-annex and not the log; fetch it: git annex get"),
    (0, (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x0a\x0d\x0d\x0a"),
     "a capture of network packets; replay it to the driver of the laser and record its topics, instead of"),
)  # fmt: skip
"""Files that contain or represent a log: (offset, first bytes there, what such a file is and what to do with it)."""
ZIP_MAGIC = b"PK\x03\x04"
GRAPH_HEADER = (30, b"header.json")
"""Offset and name of the first member of a sensorgraph in its zip file."""
OTHER_FILES: tuple[tuple[bytes, str], ...] = (
    (b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b", "a map of Cartographer (pbstream)"),
    (b"\x16\x00\x00\x00\x00\x00\x00\x00serialization::archive", "a pose graph of slam_toolbox"),
    (b"ULog\x01\x12\x35", "a flight log of PX4 (ULog)"),
    (b"# .PCD", "a point cloud (PCD)"),
    (b"ply\n", "a point cloud or mesh (PLY)"),
    (b"\x89PNG\r\n", "an image (PNG)"),
    (b"P5\n", "an image (PGM)"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"\x93NUMPY", "a numpy array"),
    (b"RRF2", "a recording of rerun"),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file"),
    (b"PAR1", "a Parquet table"),
    (b"LASF", "a point cloud (LAS)"),
    (b"\x80\x04\x95", "a pickle of Python"),
    (b"\x80\x05\x95", "a pickle of Python"),
)
"""Files that hold no scans as messages: (first bytes, what such a file is)."""
GRAPH_LINE = re.compile(r"(VERTEX|EDGE)(2|3|_SE2|_SE3:QUAT)\s")
TRAJECTORIES = {8: "TUM: stamp x y z qx qy qz qw", 12: "KITTI: 3 x 4 matrices"}
"""Numbers in a line of a trajectory -> its format."""
RANGES_COLUMN = re.compile(r"\branges(\b|_?\d)")
"""Name of a column with ranges of a topic: `/scan/ranges[0]`, `ranges_0`, `field.ranges0`, or `ranges` with all of them."""
UNIT_TOLERANCE = 0.01
"""Deviation of the norm of a rotation from 1 that rounded numbers have."""


def described(head: bytes, name: str) -> str:
    """Return what a file is and what to do with it, as the end of a sentence; empty if it is not known.

    Parameters
    ----------
    head : First bytes of the file.
    name : Its path, for commands.
    """
    if head.startswith(ZIP_MAGIC):
        at, member = GRAPH_HEADER
        if head[at:].startswith(member):
            return "a sensorgraph; give a log here, and the sensorgraph where --help says GRAPH"
        if head[at : at + int.from_bytes(head[26:28], "little")].endswith(b".npy"):
            return f"a numpy archive (npz); {GIVE_LOG}"
        return f"a zip archive; unpack it and give the log in it: unzip {name}"
    for at, starts, what in PACKED:
        if head[at:].startswith(starts):
            return f"{what} {name}"
    what = next((what for start, what in OTHER_FILES if head.startswith(start)), "")
    return f"{what}; {GIVE_LOG}" if what else _described_text(head.decode("utf-8", errors="replace"))


def _described_text(text: str) -> str:
    """Return what a text is and what to do with it; empty if it is not known."""
    start = text.lstrip().lower()
    if start.startswith(("<!doctype html", "<html")):
        return "a web page and not the log; download the file itself, then check its size"
    if "<gazebo_log>" in start:
        return "a log of Gazebo's states; replay it with the laser, record the topics, and give that bag"
    if start.startswith("<"):
        return f"an XML file; {GIVE_LOG}"
    if start.startswith("{") and '"featurecollection"' in start:
        return "an arena (GeoJSON); give a log here, and the arena with --arena"
    if re.search(r"^image:", text, re.MULTILINE) and re.search(r"^resolution:", text, re.MULTILINE):
        return "a map of map_server; give a log here, and the map with --arena"
    if re.search(r"^angle_min:", text, re.MULTILINE) or start.startswith(("header:", "%time,")):
        return "a text printed by `ros2 topic echo`; record the topics instead: ros2 bag record -a"
    lines = [line for line in text.splitlines()[:-1] if line.strip() and not line.lstrip().startswith("#")]
    if lines and all(GRAPH_LINE.match(line) for line in lines):
        return f"a pose graph (g2o or TORO), without scans; {GIVE_LOG}"
    return _described_table(lines)


def _described_table(lines: list[str]) -> str:
    """Return what a table is; empty if the lines are not one."""
    rows = [line.replace(",", " ").split() for line in lines[:20]]
    try:
        numbers = np.array(rows, dtype=np.float64)
    except ValueError:
        numbers = np.zeros((0, 0))
    if len(numbers) and _are_poses(numbers):
        return f"a trajectory ({TRAJECTORIES[numbers.shape[1]]}), without scans; {GIVE_LOG}"
    names, *cells = [[cell.strip() for cell in row] for row in csv.reader([*lines[:1], *lines[-1:]])] or [[]]
    is_header = len(names) > 2 and all(names) and not any(map(parses_as_number, names))
    if is_header and len(names) == len(cells[0]) and any(map(parses_as_number, cells[0])):
        ranges = [name for name in names if RANGES_COLUMN.search(name)]
        if ranges:
            return (
                f"a table of a LaserScan topic (with the column {ranges[0]}), as PlotJuggler or bagpy export it; give the log from "
                "which it was made, or name the columns t and r0, r1, ... below a line such as `# bearings: -1.57 to 1.57 in 181`"
            )
        more = ", ..." if len(names) > MAX_LISTED else ""
        return (
            f"a table without ranges (its columns are {', '.join(names[:MAX_LISTED])}{more}); give one with the columns "
            "t and r0, r1, ..."
        )
    return ""


def _are_poses(numbers: Floats) -> bool:
    """Tell whether rows (n, 8 or 12) are poses: their quaternions, or the rows of their matrices, have the norm 1."""
    if numbers.shape[1] not in TRAJECTORIES:
        return False
    rotations = numbers[:, 4:] if numbers.shape[1] == 8 else numbers.reshape(-1, 4)[:, :3]
    return bool((np.abs(np.linalg.norm(rotations, axis=1) - 1.0) < UNIT_TOLERANCE).all())
