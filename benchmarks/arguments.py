"""What the command lines of the benchmarks share."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help is the docstring of its module, as it stands; from here on each line is printed at once."""
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def existing(text: str) -> Path:
    """Return the path of a file, or of a folder such as a bag, that is there."""
    path = Path(text)
    if not path.exists():
        raise argparse.ArgumentTypeError(f"{text}: there is no such file or folder")
    return path
