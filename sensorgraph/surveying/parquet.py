"""Write the table as Parquet, if pyarrow is installed."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

logger = logging.getLogger(__name__)


def write_parquet(rows: Sequence[Mapping[str, Any]], path: Path) -> bool:
    """Write rows as a Parquet file; return False, with a note, without pyarrow."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        logger.warning("fleet.parquet needs pyarrow; install it with: pip install pyarrow")
        return False
    table = pyarrow.Table.from_pylist([dict(row) for row in rows])
    pyarrow.parquet.write_table(table, path)
    return True
