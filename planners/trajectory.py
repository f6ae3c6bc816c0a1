"""Trajectory: poses and twists by time; reading and writing of trajectory CSV files."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planners.arena import wrap
from planners.errors import PlanError
from planners.files import atomic_file
from planners.types import Floats

COLUMNS = ("t", "x", "y", "phi", "v", "omega", "primitive")
ROW = "%.6f," * 6 + "%s\n"
SAMPLES_AT_A_TIME = 1 << 16
"""Number of samples processed at a time, so that days of driving fit in memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """A timed path with exact samples.

    Raises
    ------
    ValueError : The shapes do not match, or the stamps do not increase strictly.
    """

    stamps: Floats
    """(n,) [s] from the start, strictly increasing."""
    poses: Floats
    """(n, 3) [m, m, rad] base_link in map, phi in (-pi, pi]."""
    twists: Floats
    """(n, 2) [m/s, rad/s] body velocity (v, omega) at each sample."""
    primitives: NDArray[np.str_]
    """(n,) motion primitive at each sample: `spin`, `lane`, `move`, `turn`, `wait`, ..."""

    def __post_init__(self) -> None:
        n = len(self.stamps)
        shapes = (self.stamps.shape, self.poses.shape, self.twists.shape, self.primitives.shape)
        if shapes != ((n,), (n, 3), (n, 2), (n,)):
            raise ValueError(f"trajectory has shapes {shapes}, expected ({n},), ({n}, 3), ({n}, 2), ({n},)")
        if n < 2 or not (np.diff(self.stamps) > 0).all():
            raise ValueError("a trajectory needs at least two samples with strictly increasing stamps")

    def __repr__(self) -> str:
        """Summarise the trajectory in one line."""
        return f"Trajectory: {len(self.stamps):,} samples, {self.duration:.1f} s, {self.length:.1f} m"

    @property
    def duration(self) -> float:
        """[s] from the first sample to the last."""
        return float(self.stamps[-1] - self.stamps[0])

    @property
    def length(self) -> float:
        """[m] distance driven by base_link, forward and backward."""
        places, total = self.poses[:, :2], 0.0
        for first in range(0, len(places) - 1, SAMPLES_AT_A_TIME):
            total += float(np.hypot(*np.diff(places[first : first + SAMPLES_AT_A_TIME + 1], axis=0).T).sum())
        return total

    def at(self, stamps: Floats) -> tuple[Floats, Floats]:
        """Interpolate poses (m, 3) and twists (m, 2) at stamps (m,) [s]; outside, the end values are held."""
        phi = np.unwrap(self.poses[:, 2])
        columns = [self.poses[:, 0], self.poses[:, 1], phi, self.twists[:, 0], self.twists[:, 1]]
        out = np.stack([np.interp(stamps, self.stamps, c) for c in columns], axis=-1)  # (m, 5)
        return np.concatenate([out[:, :2], wrap(out[:, 2:3])], axis=1), out[:, 3:]

    def write_csv(self, path: Path) -> None:
        """Write columns t,x,y,phi,v,omega,primitive."""
        quoted = {label: _quoted(label) for label in np.unique(self.primitives).tolist()}
        with atomic_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
            file.write(",".join(COLUMNS) + "\n")
            for first in range(0, len(self.stamps), SAMPLES_AT_A_TIME):
                some = slice(first, first + SAMPLES_AT_A_TIME)
                rows = np.column_stack([self.stamps[some], self.poses[some], self.twists[some]]).tolist()
                labels = [quoted[label] for label in self.primitives[some].tolist()]
                file.write("".join(ROW % (*row, label) for row, label in zip(rows, labels, strict=True)))


def _quoted(label: str) -> str:
    """Return a text as a CSV field (RFC 4180)."""
    doubled = label.replace('"', '""')
    return f'"{doubled}"' if any(c in label for c in ',"\r\n') else label


def read_csv(path: Path) -> Trajectory:
    """Read a trajectory CSV; columns are found by name, and `primitive` is optional.

    Raises
    ------
    PlanError : The file is not such a table, or its times do not increase.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            missing = [name for name in COLUMNS[:6] if name not in (reader.fieldnames or [])]
            rows = list(reader)
    except (UnicodeDecodeError, csv.Error) as exc:
        raise PlanError(f"{path}: not a CSV file ({exc}); expected columns {','.join(COLUMNS)}") from exc
    if missing:
        raise PlanError(f"{path}: no column {', '.join(missing)}; expected {','.join(COLUMNS)}")
    try:
        values = np.array([[float(row[name]) for name in COLUMNS[:6]] for row in rows], dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise PlanError(f"{path}: {exc}; expected numbers in {','.join(COLUMNS[:6])}") from exc
    if len(values) < 2:
        raise PlanError(f"{path}: {len(values)} rows, expected at least two")
    if not np.isfinite(values).all() or not (np.diff(values[:, 0]) > 0).all():
        raise PlanError(f"{path}: expected finite numbers and strictly increasing t")
    primitives = np.array([row.get("primitive") or "move" for row in rows], dtype=np.str_)
    values[:, 3] = wrap(values[:, 3])
    return Trajectory(stamps=values[:, 0], poses=values[:, 1:4], twists=values[:, 4:6], primitives=primitives)
