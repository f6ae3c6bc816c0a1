"""Checks of the numbers of a file before a model is made of them; a damaged or malicious file may hold any number."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST = 1e24
"""Largest number of a model: sums over a year of rays reach 1e20, and products in predictions remain finite."""
LARGEST_INTEGER = 1 << 60
"""Largest integer in an array, so that sums of a few fit into 64 bits."""


def check_numbers(
    header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], *, may_be_nan: Collection[str] = ()
) -> None:
    """Check that all numbers are finite and within `LARGEST`.

    Parameters
    ----------
    may_be_nan : Names of arrays in which nan and inf mark unknown values.

    Raises
    ------
    ValueError : A number is not finite or too large, or an array does not hold numbers.
    """
    _check_plain("state", header)
    for name, array in arrays.items():
        if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
            raise ValueError(f"{name} holds {array.dtype}, expected numbers of 64 bits at most")
        most = LARGEST if array.dtype.kind == "f" else LARGEST_INTEGER
        with np.errstate(invalid="ignore"):
            right = (array <= most) & (array >= -most) if array.dtype.kind != "b" else array | True
        if name in may_be_nan:
            right |= ~np.isfinite(array)
        if not right.all():
            raise ValueError(f"{name} holds {array[~right].flat[0]}, expected finite numbers up to {most:g}")


def _check_plain(name: str, value: object) -> None:
    if isinstance(value, Mapping):
        for key, part in value.items():
            _check_plain(f"{name}.{key}", part)
    elif isinstance(value, list):
        for part in value:
            _check_plain(name, part)
    elif isinstance(value, int | float) and not abs(value) <= LARGEST:
        raise ValueError(f"{name} is {value:.6g}, expected a finite number up to {LARGEST:g}")


def check_shape(name: str, array: NDArray[Any], shape: tuple[int, ...], kinds: str = "iuf") -> None:
    """Check the shape and the kind of an array.

    Parameters
    ----------
    kinds : numpy's letters of the allowed kinds: i and u for integers, f for floating point.

    Raises
    ------
    ValueError : The array has another shape or kind.
    """
    if array.shape != shape or array.dtype.kind not in kinds:
        raise ValueError(f"{name} has shape {array.shape} of {array.dtype}, expected {shape} of {kinds}")


def check_range(name: str, values: object, low: float, high: float = LARGEST) -> None:
    """Check that a number, or every entry of an array, is in [low, high].

    Raises
    ------
    ValueError : An entry is outside.
    """
    array = np.asarray(values)
    if array.size and not (array.min() >= low and array.max() <= high):
        found = f"{array.min()} to {array.max()}" if array.size > 1 else f"{array.min()}"
        raise ValueError(f"{name} is {found}, expected {low:g} to {high:g}")


def check_positive(name: str, value: float) -> None:
    """Check that a number is positive.

    Raises
    ------
    ValueError : The number is not positive.
    """
    if not value > 0:
        raise ValueError(f"{name} is {value}, expected a positive number")


def with_prefix(prefix: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays whose names begin with a prefix, with the prefix removed."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
