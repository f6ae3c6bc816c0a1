"""Messages of the library for the command line: a parameter in backticks becomes the option that sets it."""

from __future__ import annotations

import re
from collections.abc import Iterable

import typer

FLAGS = {
    "bearing": "--bearing",
    "battery": "--battery",
    "budget": "--budget",
    "degree": "--degree",
    "dock": "--dock",
    "domain": "--domain",
    "end": "--end",
    "every": "--all",
    "force": "--force",
    "graph": "--graph",
    "inputs": "--inputs",
    "lags": "--lags",
    "margin": "--margin",
    "model": "--model",
    "n_terms": "--terms",
    "no_return": "--no-return",
    "no_go": "--no-go",
    "order": "--order",
    "output_lags": "--output-lags",
    "planner": "--planner",
    "priority": "--priority",
    "resume": "--resume",
    "ray": "--ray",
    "robot": "--robot",
    "router": "--router",
    "slice": "--slice",
    "start": "--start",
    "topics": "--topic",
    "update": "--update",
    "views": "--views",
}
"""Parameter in backticks in a message of the library -> option of the command line."""


def with_flags(message: str) -> str:
    """Replace each parameter in backticks by its option."""
    return re.sub(r"`(\w+)`", lambda match: FLAGS.get(match[1], match[0]), message)


class _Printed:
    """Warnings that the running command has printed."""

    warnings: frozenset[str] = frozenset()


def reset_warnings() -> None:
    """Forget the printed warnings at the start of a command."""
    _Printed.warnings = frozenset()


def print_warnings(notes: Iterable[str]) -> None:
    """Print each note as a warning on stderr, once in a command."""
    for line in dict.fromkeys(f"warning: {with_flags(note)}" for note in notes):
        if line not in _Printed.warnings:
            _Printed.warnings |= {line}
            typer.echo(line, err=True)
