"""A hash of the source of a module and of what it takes from others; cached machine code is valid for one such hash."""

from __future__ import annotations

import hashlib
import sys
from functools import cache
from pathlib import Path

import numpy as np


@cache
def source_stamp(module: str) -> str:
    """Return a hash of a module's source and of what it has imported and defined until now, when first called.

    Constants count by value, named tuples by their fields, and kernels by their names. A kernel's name ends with the
    hash of its module, so the hash changes with every kernel that is called directly or indirectly.
    """
    names = dict(vars(sys.modules[module]))
    file = Path(names.get("__file__") or "-")
    total = hashlib.sha256(file.read_bytes() if file.is_file() else b"")
    for name, value in names.items():
        if name.startswith("__"):  # `__file__`: equal code in another folder has the same hash
            continue
        if callable(value):
            total.update(
                f"{name} {getattr(value, '__qualname__', '')} {getattr(value, '_fields', '')}\n".encode()
            )
        elif isinstance(value, (int, float, str, tuple, np.ndarray, np.generic)):
            total.update(f"{name} {value.tolist() if hasattr(value, 'tolist') else value!r}\n".encode())
    return total.hexdigest()[:12]
