"""What a driver logged for "nothing seen": found from the ranges themselves, or named by the user."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.errors import LogError
from logs.types import Floats

NO_RETURNS = ("range_max", "zero", "inf", "nan")
"""How a missing return may be logged: exactly as range_max, as 0, as REP-117 says, or as nan (urg_node), an invalid reading there."""
SICK_CODES = (81.83, 81.87, 81.91, 32.767, 8.191, 8.183, 327.67)
"""[m] codes of SICK scanners (8183 and up in cm or mm) and of a full 15 or 16 bit word; one alone is believed."""


@dataclass(frozen=True, kw_only=True)
class CodeSearch:
    """When a value counts as a code; set on the public CARMEN logs (`pytest tests/test_logs_formats_carmen.py`)."""

    spread: float = 0.101
    """[m] several codes can lie this close together: 51.05 and 51.10, 81.83 to 81.91."""
    empty: float = 1.0
    """[m] below the codes, where real returns are rare."""
    ratio: float = 5.0
    """Codes outnumber the returns in the empty zone by this factor."""
    min_count: int = 5
    """Times that the commonest code is met."""
    min_share: int = 50
    """A value that is this many times as rare as the commonest code is a stray return."""
    known_tolerance: float = 5e-4
    """[m] from a code of `SICK_CODES`."""
    stated_tolerance: float = 1e-4
    """[m] from a range_max that the driver states; float32 at 100 m."""
    neighbours: float = 0.1
    """[m] below range_max, where returns are counted for comparison ..."""
    bin: float = 0.01
    """[m] ... per so much of a range."""
    frequent: float = 0.01
    """A code of 0, or of exactly range_max, is at least this share of all readings."""
    beside: float = 0.5
    """Zeros beside returns shorter than this share of the median are surfaces too close, not missing returns."""


CODE_SEARCH = CodeSearch()


def check_no_return(no_return: str | None) -> None:
    """Refuse a name that is not in `NO_RETURNS`.

    Raises
    ------
    LogError : it is not
    """
    if no_return is not None and no_return not in NO_RETURNS:
        raise LogError(f"`no_return` is {no_return!r}, expected one of {', '.join(NO_RETURNS)}")


def notice(parts: Sequence[Floats], range_max: float) -> str:
    """Tell from the frequency of readings how a driver logged a missing return.

    Exactly `range_max` where that is met far more often than the ranges just below; else 0 where that is frequent,
    not beside short ranges, and no reading is infinite; else +inf. Rays that always read 0 do not count.

    Parameters
    ----------
    parts : arrays (n_scans, n_rays) [m] of readings
    range_max : [m] as the driver states it

    Returns
    -------
    one of `NO_RETURNS`
    """
    n = sum(part.size for part in parts)
    at_max = below = infinite = 0
    for part in parts:
        top = range_max - CODE_SEARCH.stated_tolerance
        at_max += int(((part >= top) & (part <= range_max + CODE_SEARCH.stated_tolerance)).sum())
        below += int(((part >= range_max - CODE_SEARCH.neighbours) & (part < top)).sum())
        infinite += int(np.isposinf(part).sum())
    usual = below * CODE_SEARCH.bin / CODE_SEARCH.neighbours
    if at_max > max(CODE_SEARCH.frequent * n, CODE_SEARCH.ratio * usual, CODE_SEARCH.min_count):
        return "range_max"
    if infinite == 0 and _are_zeros_missing(parts, n):
        return "zero"
    return "inf"


def _are_zeros_missing(parts: Sequence[Floats], n: int) -> bool:
    """Tell whether zeros are frequent, and lie beside returns that are not short."""
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
    """Turn the code that a user named into +inf, in place, in ranges [m] that otherwise follow REP-117."""
    if no_return == "range_max":
        ranges[np.isfinite(ranges) & (ranges >= range_max - CODE_SEARCH.stated_tolerance)] = np.inf
    if no_return == "zero":
        ranges[ranges == 0] = np.inf
    if no_return == "nan":
        ranges[np.isnan(ranges)] = np.inf


def frequent_nans(parts: Sequence[Floats]) -> str:
    """Say that nan is frequent, which may be how the driver logs a missing return; empty where it is not.

    Rays that are nan in every scan do not count: something masks them.
    """
    total = sum(part.size for part in parts)
    n = sum(int((nan & ~nan.all(axis=0)).sum()) for nan in map(np.isnan, parts))
    if n <= max(CODE_SEARCH.frequent * total, CODE_SEARCH.min_count):
        return ""
    return (
        f"{n} ranges ({n / total:.1%}) are nan, an invalid reading: not judged "
        "(if the driver means nothing seen, set `no_return` nan)"
    )


def find_code(ranges: Floats, range_max: float | None = None) -> float | None:
    """Return the smallest range [m] that means "nothing seen", or None where no number does.

    It is the largest value (or a few next to it), repeated exactly, with hardly anything below.
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
    # a stray return next to the codes is no code: it does not repeat
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
    """Bring readings of a log without conventions to REP-117, in place.

    Codes become +inf, and 0 or less nan, unless 0 is the code.

    Parameters
    ----------
    parts : arrays (n_scans, n_rays) [m]
    stated : [m] range_max, where the log says it
    no_return : one of `NO_RETURNS`; None: as their frequency says

    Returns
    -------
    the smallest range [m] that meant "nothing seen", and what was done
    """
    code = None
    if no_return in (None, "range_max"):
        values = np.concatenate([part.ravel() for part in parts])
        code = find_code(values, stated)
        if no_return == "range_max" and code is None:
            code = float(values[np.isfinite(values)].max(initial=0.0)) or None
    is_zero = no_return == "zero" or (no_return is None and code is None and notice(parts, np.inf) == "zero")
    return code, mask(parts, code, is_zero=is_zero)


def mask(parts: Sequence[Floats], code: float | None, *, is_zero: bool = False) -> list[str]:
    """Turn codes into +inf and 0 or less into nan, in place; say how many. With `is_zero`, 0 is a code."""
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
        notes.append(f"{code:g} m and above means nothing seen: {n_code} rays are +inf")
    if is_zero:
        notes.append(zero_text(n_zero, sum(part.size for part in parts)))
    if n_broken:
        what = "less than 0" if is_zero else "0 or less"
        notes.append(f"{n_broken} ranges are {what}, which tells nothing: nan")
    return notes


def zero_text(count: int, total: int) -> str:
    """Say that 0 was taken as nothing seen."""
    return f"0 means nothing seen: {_share(count, total)} +inf (if not so, set `no_return` inf)"


def nan_text(count: int, total: int) -> str:
    """Say that nan was taken as nothing seen."""
    return f"nan means nothing seen: {_share(count, total)} +inf"


def range_max_text(range_max: float, count: int, total: int) -> str:
    """Say that exactly range_max was taken as nothing seen."""
    return f"exactly range_max {range_max:g} m means nothing seen: {_share(count, total)} +inf (if not so, set `no_return` inf)"


def _share(count: int, total: int) -> str:
    return f"{count} rays ({count / max(total, 1):.1%}) are"
