"""Messages of the library for the command line: a parameter in backticks becomes the option that sets it."""

from __future__ import annotations

import re

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
    "inputs": "--inputs",
    "lags": "--lags",
    "model": "--model",
    "n_terms": "--terms",
    "no_return": "--no-return",
    "no_go": "--no-go",
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
