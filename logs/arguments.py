"""Check the arguments of methods that users call; each error is one line."""

from __future__ import annotations

from typing import SupportsIndex

import numpy as np
from numpy.typing import ArrayLike

from logs.types import Floats


def numbers_of(values: ArrayLike, what: str) -> Floats:
    """Return values as numbers; masked ones are nan.

    Raises
    ------
    ValueError : A value is not a real number.
    """
    try:
        if isinstance(values, np.ma.MaskedArray):
            return np.asarray(np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan))
        given = np.asarray(values)
        is_object = given.ndim == 0 and given.dtype == object  # such as None
        if given.dtype.kind not in "cmM" and not is_object:  # neither complex nor times
            return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        pass
    raise ValueError(
        f"{what} of type {type(values).__name__} holds no real numbers; expected an array of them"
    )


def convert_lists(owner: object, *names: str) -> None:
    """Replace fields of a frozen dataclass that are lists or tuples by arrays of float64.

    Raises
    ------
    ValueError : A field holds no real numbers.
    """
    for name in names:
        value = getattr(owner, name)
        if not isinstance(value, np.ndarray):
            object.__setattr__(owner, name, numbers_of(value, name))


def check_scan(scan: SupportsIndex, n_scans: int) -> None:
    """Check the index of a scan; negative ones count from the end.

    Raises
    ------
    ValueError : It is not a whole number.
    IndexError : There is no such scan.
    """
    if isinstance(scan, bool) or not isinstance(scan, int | np.integer):
        kind = type(scan).__name__
        raise ValueError(f"scan is of type {kind}, expected a whole number, the index of one scan")
    if not -n_scans <= scan < n_scans:
        raise IndexError(f"scan {scan} does not exist; this run has scans 0 to {n_scans - 1}")
