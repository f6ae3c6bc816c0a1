"""Detect how a driver encodes a missing return, or apply the encoding that the user selects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.errors import LogError
from logs.types import Floats

NO_RETURNS = ("range_max", "zero", "inf", "nan")
"""Encodings of a missing return: exactly range_max; 0; inf (REP-117); nan (urg_node), an invalid reading in REP-117."""
SICK_CODES = (81.83, 81.87, 81.91, 32.767, 8.191, 8.183, 327.67)
"""[m] codes of SICK scanners (8183 and above in cm or mm), and full 15-bit or 16-bit words.

A single occurrence of one of these is accepted as a code."""


@dataclass(frozen=True, kw_only=True)
class CodeSearch:
    """Criteria for a code; set on the public CARMEN logs (`pytest tests/test_logs_formats_carmen.py`)."""

    spread: float = 0.101
    """[m] maximum spread of several codes, such as 51.05 and 51.10, or 81.83 to 81.91."""
    empty: float = 1.0
    """[m] width of the zone below the codes in which real returns are rare."""
    ratio: float = 5.0
    """Factor by which codes outnumber the returns in that zone."""
    min_count: int = 5
    """Minimum count of the most frequent code."""
    min_share: int = 50
    """A value that is rarer than the most frequent code by this factor is an outlier, not a code."""
    known_tolerance: float = 5e-4
    """[m] tolerance around a code of `SICK_CODES`."""
    stated_tolerance: float = 1e-4
    """[m] tolerance around the range_max of the driver; float32 at 100 m."""
    neighbours: float = 0.1
    """[m] width of the zone below range_max in which returns are counted for comparison."""
    bin: float = 0.01
    """[m] width of the interval to which that count is scaled."""
    frequent: float = 0.01
    """Minimum share of all readings for a code of 0 or of exactly range_max."""
    beside: float = 0.5
    """Zeros next to returns shorter than this share of the median range are surfaces too close, not missing returns."""


CODE_SEARCH = CodeSearch()


def check_no_return(no_return: str | None) -> None:
    """Reject a name that is not in `NO_RETURNS`.

    Raises
    ------
    LogError : If the name is not None and not in `NO_RETURNS`.
    """
    if no_return is not None and no_return not in NO_RETURNS:
        raise LogError(f"`no_return` is {no_return!r}, expected one of {', '.join(NO_RETURNS)}")


def detect_no_return(parts: Sequence[Floats], range_max: float) -> str:
    """Detect how a driver encodes a missing return from the frequency of its readings.

    1. Exactly `range_max`, if it is far more frequent than the ranges just below it.
    2. Otherwise 0, if 0 is frequent, not next to short ranges, and no reading is infinite.
    3. Otherwise +inf.

    Rays that always read 0 are ignored.

    Parameters
    ----------
    parts : arrays (n_scans, n_rays) [m] of readings
    range_max : [m] as stated by the driver

    Returns
    -------
    one of `NO_RETURNS`
    """
    n = sum(part.size for part in parts)
    if _is_code(parts, range_max):
        return "range_max"
    if not any(np.isposinf(part).any() for part in parts) and _are_zeros_missing(parts, n):
        return "zero"
    return "inf"


def _is_code(parts: Sequence[Floats], code: float) -> bool:
    """Return whether readings of exactly `code` [m] are frequent, and far more so than the ranges just below it."""
    at_code = below = 0
    for part in parts:
        top = code - CODE_SEARCH.stated_tolerance
        at_code += int(((part >= top) & (part <= code + CODE_SEARCH.stated_tolerance)).sum())
        below += int(((part >= code - CODE_SEARCH.neighbours) & (part < top)).sum())
    n, usual = sum(part.size for part in parts), below * CODE_SEARCH.bin / CODE_SEARCH.neighbours
    return at_code > max(CODE_SEARCH.frequent * n, CODE_SEARCH.ratio * usual, CODE_SEARCH.min_count)


def code_below(parts: Sequence[Floats], range_max: float) -> float | None:
    """Return the reading [m] just below `range_max` that encodes a missing return, such as 29.99 below 30; None: none."""
    low, top = (
        range_max - min(CODE_SEARCH.neighbours, range_max / 2),
        range_max - CODE_SEARCH.stated_tolerance,
    )
    near = np.concatenate([part[(part > low) & (part < top)] for part in parts])
    if not len(near):
        return None
    values, counts = np.unique(near, return_counts=True)
    code = float(values[np.argmax(counts)])
    return code if _is_code(parts, code) else None


def _are_zeros_missing(parts: Sequence[Floats], n: int) -> bool:
    """Return whether zeros are frequent and next to returns that are not short."""
    zeros, beside, middles = 0, [], []
    for part in parts:
        zero = (part == 0) & ~(part == 0).all(axis=0)
        zeros += int(zero.sum())
        last = part[:, :-1][zero[:, 1:]]  # the reading before each zero
        beside.append(last[last > 0])
        middles.append(part[np.isfinite(part) & (part > 0)])
    if zeros <= max(CODE_SEARCH.frequent * n, CODE_SEARCH.min_count):
        return False
    neighbours, returns = np.concatenate(beside), np.concatenate(middles)
    if not len(neighbours) or not len(returns):
        return False
    return bool(np.median(neighbours) >= CODE_SEARCH.beside * np.median(returns))


def apply_no_return(ranges: Floats, range_max: float, no_return: str | None) -> None:
    """Convert the encoding that the user selects to +inf, in place, in ranges [m] that otherwise follow REP-117."""
    if no_return == "range_max":
        ranges[np.isfinite(ranges) & (ranges >= range_max - CODE_SEARCH.stated_tolerance)] = np.inf
    if no_return == "zero":
        ranges[ranges == 0] = np.inf
    if no_return == "nan":
        ranges[np.isnan(ranges)] = np.inf


def frequent_nans(parts: Sequence[Floats]) -> str:
    """Return a note that nan is frequent and may encode a missing return; an empty text if it is rare.

    Rays that are nan in every scan are masked and do not count.
    """
    total = sum(part.size for part in parts)
    n = sum(int((nan & ~nan.all(axis=0)).sum()) for nan in map(np.isnan, parts))
    if n <= max(CODE_SEARCH.frequent * total, CODE_SEARCH.min_count):
        return ""
    return (
        f"{n} ranges ({100 * n / total:.1f} %) are nan and count as invalid readings "
        "(if nan encodes a missing return, set `no_return` nan)"
    )


def find_code(ranges: Floats, range_max: float | None = None) -> float | None:
    """Return the smallest range [m] that encodes a missing return, or None if there is no such code.

    A code is the largest value, or a few values next to it, that repeats exactly with few returns just below.
    """
    values = ranges[np.isfinite(ranges)]
    if range_max is not None and (values >= range_max).any():
        return range_max
    if len(values) == 0:
        return None
    levels, counts = np.unique(values, return_counts=True)
    top = levels[-1]
    near = levels >= top - CODE_SEARCH.spread
    below = counts[(levels > top - CODE_SEARCH.spread - CODE_SEARCH.empty) & ~near].sum()
    # an outlier next to the codes does not repeat
    codes = levels[near & (counts >= max(2, counts[near].max() // CODE_SEARCH.min_share))]
    known = np.abs(np.array(SICK_CODES) - top).min() < CODE_SEARCH.known_tolerance
    if known and below == 0 and len(levels) > 1:
        return float(codes.min(initial=top))
    if (
        counts[near].max() >= CODE_SEARCH.min_count
        and counts[near].sum() > CODE_SEARCH.ratio * below
        and len(levels) > near.sum()
    ):
        return float(codes.min(initial=top))
    return None


def decode(
    parts: Sequence[Floats], stated: float | None, no_return: str | None
) -> tuple[float | None, list[str]]:
    """Convert readings of a log without conventions to REP-117, in place.

    Codes become +inf. Values of 0 or less become nan, unless 0 is the code.

    Parameters
    ----------
    parts : arrays (n_scans, n_rays) [m]
    stated : [m] range_max, if the log states it
    no_return : one of `NO_RETURNS`; None: detected from the frequency of readings

    Returns
    -------
    the smallest range [m] that encodes a missing return or None, and notes on the changes
    """
    code = None
    if no_return in (None, "range_max"):
        values = np.concatenate([part.ravel() for part in parts])
        code = find_code(values, stated)
        if no_return == "range_max" and code is None:
            code = float(values[np.isfinite(values)].max(initial=0.0)) or None
    is_zero = no_return == "zero" or (
        no_return is None and code is None and detect_no_return(parts, np.inf) == "zero"
    )
    if no_return == "nan":
        invalid = nan_text(sum(int(np.isnan(part).sum()) for part in parts), sum(part.size for part in parts))
        for part in parts:
            part[np.isnan(part)] = np.inf
    else:
        invalid = frequent_nans(parts)
    return code, [*mask(parts, code, is_zero=is_zero), *filter(None, [invalid])]


def mask(parts: Sequence[Floats], code: float | None, *, is_zero: bool = False) -> list[str]:
    """Convert codes to +inf and values of 0 or less to nan, in place; return notes with the counts.

    With `is_zero`, 0 is a code.
    """
    n_code = n_zero = n_broken = 0
    for part in parts:
        above = np.isfinite(part) & (part >= (np.inf if code is None else code))
        zero = (part == 0) & is_zero
        broken = np.isfinite(part) & (part <= 0) & ~zero
        part[above | zero], part[broken] = np.inf, np.nan
        n_code, n_zero, n_broken = (
            n_code + int(above.sum()), n_zero + int(zero.sum()), n_broken + int(broken.sum())
        )  # fmt: skip
    notes = []
    if code is not None:
        notes.append(f"ranges of {code:g} m and above are missing returns: {n_code} rays are +inf")
    if is_zero:
        notes.append(zero_text(n_zero, sum(part.size for part in parts)))
    if n_broken:
        what = "less than 0" if is_zero else "0 or less"
        notes.append(f"{n_broken} ranges are {what}, an invalid reading: nan")
    return notes


def zero_text(count: int, total: int) -> str:
    """Return the note that 0 is interpreted as a missing return."""
    return f"ranges of 0 are missing returns: {_share(count, total)} +inf (if this is wrong, set `no_return` inf)"


def nan_text(count: int, total: int) -> str:
    """Return the note that nan is interpreted as a missing return."""
    return f"ranges of nan are missing returns: {_share(count, total)} +inf"


def range_max_text(range_max: float, count: int, total: int) -> str:
    """Return the note that exactly range_max is interpreted as a missing return."""
    return (
        f"ranges of exactly range_max {range_max:g} m are missing returns: {_share(count, total)} +inf "
        "(if this is wrong, set `no_return` inf)"
    )


def _share(count: int, total: int) -> str:
    return f"{count} rays ({100 * count / max(total, 1):.1f} %) are"
