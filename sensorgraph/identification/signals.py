"""Read signals by name from a run or from the columns of a CSV file, as records for identification.

`L67` is the ray nearest to 67°, counter-clockwise from the robot's right (0° right, 90° ahead, 180° left). `L45-90` is
the mean over the rays from 45° to 90°. Nehmzow's papers number the rays of a forward-looking laser in this way.
"""

from __future__ import annotations

import csv
import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.formats import table
from logs.formats.text import first_bytes, parses_as_number, read_lines
from logs.run import RangeSensor, Run, pair
from logs.sensor import median_step, usual_step
from robotmodic_ident import Record
from sensorgraph.errors import SensorgraphError
from sensorgraph.intake import log_notes
from sensorgraph.types import Floats, Ints

POSE = ("x", "y", "phi", "cos_phi", "sin_phi")
ODOMETRY = ("v", "omega")
COMMANDS = ("cmd_v", "cmd_omega")
RAY_PATTERN = re.compile(r"L(\d+(?:\.\d+)?)(?:-(\d+(?:\.\d+)?))?")
ANGLE_TOLERANCE = 1e-6
"""[deg] Rounding error of a bearing."""
RESERVED_NAMES = ("cos", "sin", "e")
"""Names with a meaning in terms: functions, and the noise."""
STEP_TOLERANCE, MAX_UNEVEN_SHARE = 0.2, 0.1
"""Relative deviation of a time step from the median above which it is uneven, and the allowed share of uneven steps."""
MAX_STEP, MAX_STEPS = 0.2, 1.5
"""[s], and in usual steps: two samples of the odometry further apart than both leave a gap, as poses do in `pair` and
samples in `Record`."""
MAX_COMMAND_AGE = 0.5
"""[s] Time after the last command of the log for which this command stays known."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SignalData:
    """Records of signals under names that are valid in terms."""

    records: list[Record]
    names: Mapping[str, str]
    """Variable in the terms -> name given by the user: `L45_90` -> `L45-90`."""
    period: float | None
    """[s] Time between samples; None if the file does not give it."""
    held: Mapping[str, float] = field(default_factory=dict)
    """Median of the other command, for example the speed that belongs to a turn rate."""
    notes: Sequence[str] = ()
    """Notes for the user, one line each."""
    log_notes: Sequence[str] = ()
    """Notes on assumed and repaired data of the log."""


def variable(name: str) -> str:
    """Return the name of a signal in terms, of letters, digits and _."""
    plain = re.sub(r"\W", "_", name.strip())
    return f"s_{plain}" if not plain or plain[0].isdigit() or plain in RESERVED_NAMES else plain


def variables(names: Iterable[str]) -> dict[str, str]:
    """Return variable -> name; refuse two names with the same variable."""
    out: dict[str, str] = {}
    for name in names:
        key = variable(name)
        if out.setdefault(key, name) != name:
            raise SensorgraphError(f"signals {out[key]!r} and {name!r} both become {key}; rename one of them")
    return out


def rays_of(sensor: RangeSensor, name: str) -> Ints:
    """Return the indices of the rays of a signal such as `L67`, `L45-90` or, across the robot's right, `L330-390`."""
    found = RAY_PATTERN.fullmatch(name)
    assert found is not None
    degrees = np.degrees(sensor.bearings + sensor.mount[2]) + 90.0
    low, high = float(found[1]), float(found[2] or found[1])
    if high < low:
        raise SensorgraphError(f"{name} has its larger angle first; write L{high:g}-{low:g}")
    if high - low > 360.0:
        raise SensorgraphError(
            f"{name} spans {high - low:g}°, expected at most 360°; correct one of its angles"
        )
    if found[2] is None:
        off = np.abs((degrees - low + 180.0) % 360.0 - 180.0)
        within = off.min() <= max(median_step(degrees, 1.0), ANGLE_TOLERANCE)
        chosen = np.array([off.argmin()] if within else [], dtype=np.intp)
    else:
        past = (degrees - low + ANGLE_TOLERANCE) % 360.0
        chosen = np.flatnonzero(past <= high - low + 2 * ANGLE_TOLERANCE).astype(np.intp)
    if not len(chosen):
        first = round(degrees.min()) % 360
        raise SensorgraphError(
            f"no ray for {name}: the sensor looks from {first}° to {first + np.ptp(degrees):.0f}°, "
            "counter-clockwise from the robot's right; choose an angle in this interval"
        )
    return chosen


def perceived(readings: Floats, rays: Ints) -> Floats:
    """Return the mean range (n_scans,) [m] over some rays of scans (n_scans, n_rays); nan without a return."""
    some = np.where(np.isfinite(readings[:, rays]), readings[:, rays], np.nan)
    count = np.isfinite(some).sum(axis=1)
    return np.where(count > 0, np.nansum(some, axis=1) / np.maximum(count, 1), np.nan)


def signals_of_run(run: Run, names: Sequence[str], *, every: int = 1) -> SignalData:
    """Return signals of a run at the stamps of its scans, every `every`-th of them.

    Poses and odometry are interpolated, but not across a gap. The command of a scan is the last one before its stamp plus half a period of
    the commands or of the scans, the shorter one, so that the reaction to this scan counts.
    """
    known = _offered(run)
    for name in names:
        if name not in known and not RAY_PATTERN.fullmatch(name):
            raise SensorgraphError(_unknown(name, [*known, "L67", "L45-90"]))
    stamps = run.stamps[::every]
    new = np.diff(stamps, prepend=-np.inf) > 0  # of scans with equal stamps, use the first
    values = {name: _signal(run, name, every)[new] for name in names}
    stamps = stamps[new]
    period = median_step(stamps, np.nan) if len(stamps) > 1 else None
    names_of = variables(names)
    record = Record(signals={key: values[name] for key, name in names_of.items()}, stamps=stamps)
    held = {
        name: float(np.median(run.commands[:, i]))
        for i, name in enumerate(COMMANDS)
        if len(run.commands) and name not in names
    }
    notes = [] if not run.meta.get("pose_source") else [f"poses from {run.meta['pose_source']}"]
    notes += _spacing([record], "the scans")
    return SignalData(
        records=[record], names=names_of, period=period, held=held, notes=notes, log_notes=log_notes(run)
    )


def _offered(run: Run) -> list[str]:
    groups = ((POSE, run.pose_stamps), (ODOMETRY, run.odom_stamps), (COMMANDS, run.cmd_stamps))
    return [name for group, stamps in groups if len(stamps) for name in group]


def _signal(run: Run, name: str, every: int) -> Floats:
    if RAY_PATTERN.fullmatch(name):
        return perceived(run.ranges[::every], rays_of(run.sensor, name))
    if name in POSE:
        poses = pair(run).poses[::every]
        columns = [*poses.T, np.cos(poses[:, 2]), np.sin(poses[:, 2])]
        return np.asarray(columns[POSE.index(name)], dtype=np.float64)
    stamps = run.stamps[::every]
    if name in ODOMETRY:
        column = run.odom_twists[:, ODOMETRY.index(name)]
        return _interpolated(stamps, run.odom_stamps, column)
    return _command(run, COMMANDS.index(name), stamps)


def _interpolated(stamps: Floats, at: Floats, values: Floats) -> Floats:
    """Return values (n,) at `stamps` (n,), from values (m,) known at the times `at`; nan outside them and in their gaps."""
    gap = max(MAX_STEP, MAX_STEPS * usual_step(at))
    after = np.clip(np.searchsorted(at, stamps), 1, max(len(at) - 1, 1))
    out = np.interp(stamps, at, values, left=np.nan, right=np.nan)
    if len(at) > 1:
        out[(at[after] - at[after - 1] > gap) & (stamps != at[after]) & (stamps != at[after - 1])] = np.nan
    return np.asarray(out, dtype=np.float64)


def _command(run: Run, column: int, stamps: Floats) -> Floats:
    """Return the command valid just after each stamp (n,), before the next scan and the next command."""
    reaction = 0.5 * min(median_step(run.cmd_stamps, 0.0), usual_step(run.stamps, np.inf))
    last = np.searchsorted(run.cmd_stamps, stamps + reaction, side="right") - 1
    out: Floats = run.commands[np.maximum(last, 0), column].astype(np.float64)
    out[(last < 0) | (stamps > run.cmd_stamps[-1] + MAX_COMMAND_AGE)] = np.nan
    return out


def _unknown(name: str, offered: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, offered, n=1, cutoff=0.4)
    hint = f"did you mean {near[0]}?" if near else "choose one of them"
    return f"no signal {name!r}, expected one of {', '.join(offered)}; {hint}"


def is_table(path: Path) -> bool:
    """Return whether a file is a CSV of signals and not a run."""
    if path.is_dir() or not re.search(r"\.(csv|tsv|txt)(\.gz)?$", path.name.lower()):
        return False
    return not table.matches(path, first_bytes(path))


def signals_of_table(path: Path, names: Sequence[str], *, every: int = 1) -> SignalData:
    """Return columns of a CSV file by name; a column `record` separates records, a column `t` [s] shows gaps."""
    header, rows = _rows(path)
    for name in names:
        if name not in header:
            raise SensorgraphError(f"{path}: {_unknown(name, [h for h in header if h != 'record'])}")
    wanted = [*dict.fromkeys([*names, *(["t"] if "t" in header else [])])]
    values = {name: _numbers(path, rows, header.index(name), name) for name in wanted}
    owner = (
        [row[header.index("record")].strip() for _, row in rows] if "record" in header else [""] * len(rows)
    )
    names_of = variables(names)
    records, periods = [], []
    for key in dict.fromkeys(owner):
        mine = np.flatnonzero(np.array([o == key for o in owner]))[::every]
        stamps = values["t"][mine] if "t" in values else None
        if stamps is not None and not np.isfinite(stamps).all():
            line = rows[int(mine[int(np.argmin(np.isfinite(stamps)))])][0]
            raise SensorgraphError(
                f"{path}: line {line}: column t is not a number; fill it, or leave out the row"
            )
        if stamps is not None and not (np.diff(stamps) > 0).all():
            line = rows[int(mine[int(np.argmin(np.diff(stamps, append=np.inf) > 0))])][0]
            raise SensorgraphError(
                f"{path}: line {line}: column t does not increase; sort the rows, or separate records by a column `record`"
            )
        if stamps is not None and len(stamps) > 1:
            periods.append(median_step(stamps, np.nan))
        records.append(Record(signals={v: values[n][mine] for v, n in names_of.items()}, stamps=stamps))
    return SignalData(
        records=records, names=names_of, period=float(np.median(periods)) if periods else None,
        notes=_spacing(records, "t", "; resample to an even step") if "t" in values else ["no column t: samples are assumed to be evenly spaced"],
    )  # fmt: skip


def _spacing(records: Sequence[Record], where: str, remedy: str = "") -> list[str]:
    """Return notes on gaps in the records and on unevenly spaced samples, because lags count samples."""
    gaps = sum(len(record.segments()) - 1 for record in records)
    notes = [f"{gaps} gaps in {where}; no lag crosses one"] if gaps > 1 else []
    notes += [f"1 gap in {where}; no lag crosses it"] if gaps == 1 else []
    steps = np.concatenate([_steps(record) for record in records])
    if len(steps) and float(np.mean(np.abs(steps - 1.0) > STEP_TOLERANCE)) > MAX_UNEVEN_SHARE:
        low, high = np.quantile(steps, [0.05, 0.95])
        notes.append(
            f"samples are unevenly spaced ({low:.2g} to {high:.2g} of the median step): lags count samples, not seconds"
            + remedy
        )
    return notes


def _steps(record: Record) -> Floats:
    """Return the time steps (n,) between samples without a gap, relative to the median step."""
    if record.stamps is None or len(record) < 2:
        return np.empty(0)
    steps = np.concatenate([np.diff(record.stamps[piece]) for piece in record.segments()])
    return steps / median_step(record.stamps, np.nan)


def _rows(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the header, and the line number and cells of each row."""
    try:
        lines = read_lines(path)
    except LogError as exc:
        raise SensorgraphError(str(exc)) from exc
    numbered = [
        (i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")
    ]
    if not numbered:
        raise SensorgraphError(f"{path} is empty; expected a header with the names of the columns")
    header = [cell.strip() for cell in next(csv.reader([numbered[0][1]]))]
    if all(parses_as_number(cell) for cell in header):
        raise SensorgraphError(
            f"{path}: the first line has numbers, {numbered[0][1].strip()[:40]!r}; expected the names of the columns"
        )
    if len(header) == 1 and (sign := re.search(r"[;\t|]", header[0])):
        raise SensorgraphError(
            f"{path}: the header has one column, {header[0]!r}; replace {sign[0]!r} by commas"
        )
    if twice := sorted({h for h in header if header.count(h) > 1}):
        raise SensorgraphError(
            f"{path}: column {', '.join(twice)} occurs twice; give each column a unique name"
        )
    rows = []
    for (number, _), cells in zip(numbered[1:], csv.reader(line for _, line in numbered[1:]), strict=False):
        if len(cells) != len(header):
            raise SensorgraphError(
                f"{path}: line {number} has {len(cells)} cells, expected {len(header)} as in the header"
            )
        rows.append((number, cells))
    if not rows:
        raise SensorgraphError(f"{path} has a header but no rows; expected one row for each sample")
    return header, rows


def _numbers(path: Path, rows: Sequence[tuple[int, list[str]]], column: int, name: str) -> Floats:
    out = np.empty(len(rows))
    for i, (number, cells) in enumerate(rows):
        text = cells[column].strip()
        try:
            out[i] = float(text) if text else np.nan
        except ValueError:
            raise SensorgraphError(
                f"{path}: line {number}: {name} is {text!r}, expected a number, or an empty cell if unknown"
            ) from None
    out[~np.isfinite(out)] = np.nan
    return out
