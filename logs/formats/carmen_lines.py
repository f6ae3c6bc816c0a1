"""Parse the lines of a CARMEN log into values, whatever the order of the words after the ranges."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from logs.formats.carmen_clock import LATEST
from logs.types import Floats, Progress

SCAN_KEYWORDS = ("FLASER", "ROBOTLASER1", "RAWLASER1", "RLASER", "ROBOTLASER2", "RAWLASER2")
"""Keywords of scan lines; the first one in the log is read unless `topics` selects another, such as scan=RLASER."""
ALL_WORDS = {"ODOM": 9, "TRUEPOS": 9, "FLASER": 9, "RLASER": 9, "RAW": 3, "ROBOT": 14}
"""Number of words of a complete line, after its ranges: poses, and `time host time`."""


@dataclass
class ParsedLines:
    """The values of a log, grouped by keyword."""

    scans: dict[str, list[ScanLine]] = field(default_factory=dict)
    odom: list[list[float]] = field(default_factory=list)
    """x, y, phi, v, omega, stamp, line number; nan for what a line does not contain."""
    true: list[list[float]] = field(default_factory=list)
    """x, y, phi, stamp, line number."""
    params: dict[str, str] = field(default_factory=dict)
    is_filtered: bool = False
    """Whether the log has NEFF lines of a particle filter."""
    broken: list[int] = field(default_factory=list)
    """Line numbers that could not be parsed."""
    others: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True)
class ScanLine:
    """The values of a scan line."""

    number: int
    ranges: Floats
    remissions: Floats
    """Intensities, one for each ray; nan if the line has none."""
    geometry: tuple[float, float, float, float]
    """First bearing and step [rad], maximum range and accuracy [m]; nan if the line does not state them."""
    laser: tuple[float, ...]
    robot: tuple[float, ...]
    """Poses (x, y, phi), or empty."""
    times: tuple[float, float]
    """[s] time of the sensor and of the logger; nan without a time."""


def parse_lines(text: list[str], progress: Progress | None) -> ParsedLines:
    """Parse all lines; those that cannot be parsed are listed in `broken`."""
    lines = ParsedLines()
    found: dict[str, list[_Words]] = {}
    for number, line in enumerate(text, 1):
        if progress is not None and number % 1000 == 0:
            progress(number, len(text))
        word, _, rest = line.partition(" ")
        if not word or word.startswith("#"):
            continue
        try:
            if word in SCAN_KEYWORDS:
                words = _scan_words(word, rest.split(), number)
                found.setdefault(word, []).append(words)
            elif word in ("ODOM", "TRUEPOS"):
                found.setdefault(word, []).append(_Words(number, rest.split()))
            elif word == "PARAM":
                name, value = rest.split()[:2]
                lines.params[name] = value
            elif word == "NEFF":
                lines.is_filtered = True
            else:
                lines.others[word] += 1
        except (ValueError, IndexError):
            lines.broken.append(number)
    for word, parsed in found.items():
        usual = Counter(len(each.rest) for each in parsed).most_common(1)[0][0]
        for each in parsed:
            # a line with fewer words than a complete one is another dialect if most lines are like it, otherwise cut
            if len(each.rest) != usual and len(each.rest) < ALL_WORDS[_family(word)]:
                lines.broken.append(each.number)
                continue
            try:
                _add(lines, word, each)
            except ValueError:
                lines.broken.append(each.number)
    lines.broken.sort()
    return lines


@dataclass(frozen=True)
class _Words:
    """A line, split into its ranges and the words after them."""

    number: int
    rest: list[str]
    ranges: Floats = field(default_factory=lambda: np.zeros(0))
    remissions: Floats = field(default_factory=lambda: np.zeros(0))
    geometry: tuple[float, float, float, float] = (np.nan,) * 4


def _family(word: str) -> str:
    return word if word in ALL_WORDS else word.partition("LASER")[0]


def _scan_words(word: str, values: list[str], number: int) -> _Words:
    """Split the words after the keyword of a scan line."""
    at, geometry = 0, (np.nan, np.nan, np.nan, np.nan)
    if not word.endswith("LASER"):  # laser_type start_angle fov resolution range_max accuracy remission_mode
        geometry = (float(values[1]), float(values[3]), float(values[4]), float(values[5]))
        at = 7
    n = int(values[at])
    end = at + 1 + n
    if n < 1 or len(values) < end:
        raise ValueError(f"{n} ranges")
    ranges = np.array(list(map(float, values[at + 1 : end])))
    remissions = np.full(n, np.nan)
    if not word.endswith("LASER") and len(values) > end:
        start, end = end + 1, end + 1 + int(values[end])
        if end - start == n:
            remissions = np.array(list(map(float, values[start:end])))
    return _Words(number, values[end:], ranges, remissions, geometry)


def _add(lines: ParsedLines, word: str, words: _Words) -> None:
    """Add a line: poses, then other numbers, then times and the host in any order.

    A line with six numbers or more has the poses of laser and robot; with three to five, one pose; with fewer, none.
    """
    rest, number = words.rest, words.number
    is_number = [_number(text) is not None for text in rest]
    n_leading = is_number.index(False) if False in is_number else len(rest)
    n_poses = 0 if word.startswith("RAW") else 6 if n_leading >= 6 else 3 if n_leading >= 3 else 0
    values = [float(text) for text in rest[:n_poses]]
    n_before = 11 if word.startswith("ROBOT") and n_leading >= 11 else n_poses
    times = [value for text in rest[n_before:] if (value := _number(text)) is not None] or [np.nan]
    if any(abs(time) > LATEST for time in times):
        raise ValueError("a stamp that is out of range")
    if word in ("ODOM", "TRUEPOS"):
        if n_poses == 0:
            raise ValueError("no pose")
        twist = values[3:5] or [np.nan, np.nan]
        (lines.odom if word == "ODOM" else lines.true).append(
            [*values[:3], *(twist if word == "ODOM" else []), times[0], number]
        )
        return
    times_of_line = times[0], times[-1]
    scan = ScanLine(
        number,
        words.ranges,
        words.remissions,
        words.geometry,
        tuple(values[:3]),
        tuple(values[-3:]),
        times_of_line,
    )
    lines.scans.setdefault(word, []).append(scan)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
