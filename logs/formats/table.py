"""Read and write tables: CSV with one row per scan, for spreadsheets and for sensors with a custom logger.

Example:

    # bearings: -1.5707963267948966 to 1.5707963267948966 in 181
    # range_max: 8.0
    t,x,y,phi,v,omega,r0,r1,...,r180

Required are `t` [s], `r0` ... (or `ray_0` ...) [m], and the bearings [rad] in a comment above the header. The bearings
are given as above or one by one. Optional columns are the reference pose `x,y,phi`, the odometry
`odom_x,odom_y,odom_phi` and `v,omega`, and the command `cmd_v,cmd_omega`. `inf`, `-inf` and `nan` (or an empty cell)
follow REP-117. Cells may also be separated by semicolons or tabs, then with decimal commas. Further comments
`# NAME: VALUE` are optional; they are the fields of the metadata record in our MCAP files (`own_record`).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from logs.errors import LogError
from logs.files import atomic_file
from logs.formats.text import read_lines
from logs.no_return import apply_no_return, find_code
from logs.ros.own_record import SENSOR_SCALARS, parse_bearings, parse_numbers, sensor_facts
from logs.run import RangeSensor, Run, pair, with_rare_times
from logs.transforms import dead_reckoning, interpolate, twists_of
from logs.types import Floats, Progress, ReadOptions

POSE_COLUMNS, ODOMETRY_COLUMNS, TWIST_COLUMNS, COMMAND_COLUMNS = (
    ("x", "y", "phi"),
    ("odom_x", "odom_y", "odom_phi"),
    ("v", "omega"),
    ("cmd_v", "cmd_omega"),
)
_RAY = re.compile(r"r(?:ay_)?(\d+)")
SEPARATORS = (",", ";", "\t")
"""Separators of cells; a spreadsheet of a country with decimal commas writes semicolons."""
_COMMENT = re.compile(r"#\s*([\w.]+)\s*:\s*(.*)")


def matches(path: Path, head: bytes) -> bool:
    """Return whether the first line that is not a comment contains t and r0."""
    for line in head.decode("utf-8", errors="replace").splitlines():
        if line.strip() and not _is_comment(line):
            names, _ = _header(line)
            return "t" in names and ("r0" in names or "ray_0" in names)
    return False


def _is_comment(line: str) -> bool:
    return line.lstrip(' "').startswith("#")


def _header(line: str) -> tuple[list[str], str]:
    """Return the names of the columns and the separator of the cells, which is the most frequent one of the header."""
    separator = max(SEPARATORS, key=line.count)
    return _cells(line, separator), separator


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line; a spreadsheet may have quoted them."""
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def read(path: Path, how: ReadOptions) -> Run:
    """Read a run from a table.

    Raises
    ------
    LogError
        If a row cannot be read, a ray column or the bearings are missing, or the number of rows is not as stated.
    """
    lines = read_lines(path)
    # a spreadsheet fills the rest of a row with separators
    comments = [line.strip(' ",;\t') for line in lines if _is_comment(line)]
    stated = {found[1]: found[2].strip() for line in comments if (found := _COMMENT.match(line))}
    rows = [line for line in lines if line.strip() and not _is_comment(line)]
    names, separator = _header(rows[0])
    values = _values(path, rows[1:], len(names), separator, how.progress)
    claimed = stated.get("rows")
    if claimed is not None and claimed != str(len(values)):
        raise LogError(
            f"{path} has {len(values)} rows, but its header states {claimed}; check that the copy is complete"
        )
    if len(values) == 0 and claimed is None:
        raise LogError(f"{path} has a header but no rows; expected one row for each scan")
    values = values[np.argsort(values[:, names.index("t")], kind="stable")]
    rays = sorted((int(found[1]), i) for i, name in enumerate(names) if (found := _RAY.fullmatch(name)))
    if [number for number, _ in rays] != list(range(len(rays))):
        raise LogError(f"{path}: ray columns are missing; expected r0 to r{len(rays) - 1} without a gap")
    ranges, stamps = values[:, [i for _, i in rays]], values[:, names.index("t")]
    if not np.isfinite(stamps).all():
        raise LogError(f"{path}: column t has a value that is not finite; remove those rows")
    try:
        sensor = _sensor(path, stated, ranges, how.no_return)
        epoch = int(stated.get("epoch_ns", "0"))
    except ValueError as exc:
        raise LogError(f"{path}: {exc}; see the comments above its header") from exc
    parts = {
        key: _part(names, values, key)
        for key in (POSE_COLUMNS, ODOMETRY_COLUMNS, TWIST_COLUMNS, COMMAND_COLUMNS)
    }
    odometry, twists = parts[ODOMETRY_COLUMNS], parts[TWIST_COLUMNS]
    if odometry is None and twists is not None:
        odometry = dead_reckoning(stamps, np.insert(twists, 1, 0.0, axis=1))
    if odometry is not None:
        odometry = np.column_stack([odometry, twists_of(stamps, odometry) if twists is None else twists])
    pose_stamps, poses = _whole(stamps, parts[POSE_COLUMNS], 3)
    odom_stamps, driven = _whole(stamps, odometry, 5)
    cmd_stamps, commands = _whole(stamps, parts[COMMAND_COLUMNS], 2)
    meta = {k.removeprefix("meta."): v for k, v in stated.items() if k.startswith("meta.")}
    source = {"source": path.name, "format": "table", "pose_source": "table" if len(poses) else "none"}
    return Run(
        sensor=sensor,
        stamps=stamps,
        ranges=ranges,
        pose_stamps=pose_stamps,
        poses=poses,
        odom_stamps=odom_stamps,
        odometry=driven[:, :3],
        odom_twists=driven[:, 3:],
        cmd_stamps=cmd_stamps,
        commands=commands,
        pose_frame="laser" if stated.get("pose_frame") == "laser" else "base_link",
        epoch_ns=epoch,
        meta=meta if "version" in stated else source,
    )


def write(run: Run, path: Path) -> None:
    """Write a run as a table: poses, odometry and commands are interpolated at the scans; attachments are omitted."""
    stated = sensor_facts(
        run.sensor, pose_frame=run.pose_frame, epoch_ns=run.epoch_ns, zero_ns=0, meta=run.meta
    )
    names, columns = ["t"], [run.stamps[:, None]]
    if len(run.pose_stamps):
        names += POSE_COLUMNS
        columns.append(pair(run, whole_sweep=False).poses)
    if len(run.odom_stamps):
        names += (*ODOMETRY_COLUMNS, *TWIST_COLUMNS)
        columns.append(interpolate(run.stamps, run.odom_stamps, run.odometry))
        columns.append(_linear(run.stamps, run.odom_stamps, run.odom_twists))
    if len(run.cmd_stamps):
        names += COMMAND_COLUMNS
        columns.append(_linear(run.stamps, run.cmd_stamps, run.commands))
    names += [f"r{i}" for i in range(run.sensor.n_rays)]
    table = np.column_stack([*columns, run.ranges])
    with atomic_file(path) as part:
        _write_rows(part, {**stated, "rows": str(run.n_scans)}, names, table)


def _write_rows(path: Path, facts: Mapping[str, str], names: list[str], table: Floats) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        for key, value in facts.items():
            if key == "crc32":  # a table may be edited by hand
                continue
            file.write(f"# {key}: {' '.join(value.split())}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(table.tolist())


def _values(path: Path, rows: Sequence[str], width: int, separator: str, progress: Progress | None) -> Floats:
    """Return the numbers (n_rows, width); a comma that separates no cells is a decimal comma."""
    out = np.empty((len(rows), width))
    for i, line in enumerate(rows):
        cells = _cells(line if separator == "," else line.replace(",", "."), separator)
        try:
            if len(cells) != width:
                raise ValueError(f"it has {len(cells)} cells, expected {width}")
            out[i] = [float(cell) if cell else np.nan for cell in cells]
        except ValueError as exc:
            raise LogError(
                f"{path}: row {i + 1} cannot be read: {exc}; check that the copy is complete"
            ) from exc
        if progress is not None and i % 500 == 0:
            progress(i, len(rows))
    return out


def _sensor(path: Path, stated: Mapping[str, str], ranges: Floats, no_return: str | None) -> RangeSensor:
    if "bearings" not in stated:
        n = ranges.shape[1]
        raise LogError(
            f"{path} does not state the bearings; add a first line `# bearings: -1.5708 to 1.5708 in {n}`"
        )
    bearings = parse_bearings(stated["bearings"])
    if len(bearings) != ranges.shape[1]:
        raise LogError(
            f"{path} has {ranges.shape[1]} ray columns and {len(bearings)} bearings; expected equal numbers"
        )
    scalars: dict[str, Any] = {name: float(stated[name]) for name in SENSOR_SCALARS if name in stated}
    finite = ranges[np.isfinite(ranges)]
    if "range_max" not in scalars and len(finite):
        code = find_code(ranges) if no_return in (None, "range_max") else None
        scalars["range_max"] = code if code is not None else float(finite.max())
        if code is not None:
            ranges[np.isfinite(ranges) & (ranges >= code)] = np.inf
    apply_no_return(ranges, scalars.get("range_max", np.inf), no_return)
    scalars.setdefault("range_min", 0.0)
    sensor = RangeSensor(
        bearings=bearings,
        mount=parse_numbers(stated.get("mount", "0 0 0")),
        origins=parse_numbers(stated.get("origins", "")).reshape(-1, 2),
        cones=parse_numbers(stated.get("cones", "")),
        delays=parse_numbers(stated.get("delays", "")),
        **scalars,
    )
    return with_rare_times(sensor, stated)


def _part(names: Sequence[str], values: Floats, wanted: Sequence[str]) -> Floats | None:
    if not all(name in names for name in wanted):
        return None
    return values[:, [names.index(name) for name in wanted]]


def _whole(stamps: Floats, part: Floats | None, width: int) -> tuple[Floats, Floats]:
    """Omit rows whose cells are all empty."""
    if part is None:
        return np.zeros(0), np.zeros((0, width))
    there = ~np.isnan(part).all(axis=1)
    return stamps[there], part[there]


def _linear(at: Floats, stamps: Floats, values: Floats) -> Floats:
    return np.stack([np.interp(at, stamps, column) for column in values.T], axis=-1)
