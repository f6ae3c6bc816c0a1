"""Types of command-line arguments that benchmarks share."""

from __future__ import annotations

import argparse
from pathlib import Path


def existing(text: str) -> Path:
    """Return the path of a file, or of a folder such as a bag, that is there."""
    path = Path(text)
    if not path.exists():
        raise argparse.ArgumentTypeError(f"{text}: there is no such file or folder")
    return path
