"""What the command lines of the benchmarks share."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any


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


def kept(path: Path | None) -> list[dict[str, Any]]:
    """Return the results in a file of JSON lines; none of a file that is not there."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path and path.exists() else []


def keep(path: Path | None, result: dict[str, Any]) -> None:
    """Add a result to a file of JSON lines, if there is to be one."""
    if path:
        with path.open("a") as file:
            file.write(json.dumps(result) + "\n")


def log_of_halves(parser: argparse.ArgumentParser) -> None:
    """Take a raw log, and a folder for what `localize_in_map.halves` makes of it."""
    parser.add_argument("log", type=Path)
    parser.add_argument(
        "--work", type=Path, default=Path("runs/in_map"), help="folder of located run and graph"
    )
