"""Parse untrusted YAML to plain data of limited size; every error is a ValueError with a one-line message."""

from __future__ import annotations

from typing import Any

import yaml

MAX_NODES = 100_000
"""Maximum number of values in a file; aliases count every time, because nine lines can expand to a billion values."""


def parse_yaml(text: str) -> Any:
    """Parse YAML to plain data.

    Raises
    ------
    ValueError
        If the text is not YAML, is nested too deeply, or exceeds MAX_NODES with its aliases expanded.
    """
    try:
        data = yaml.safe_load(text)
        n_nodes = _count(data, {})
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except (yaml.YAMLError, ValueError, TypeError, OverflowError) as exc:
        raise ValueError(" ".join(str(exc).split())[:300]) from exc
    if n_nodes > MAX_NODES:
        raise ValueError(f"holds more than {MAX_NODES:,} values with its aliases expanded")
    return data


def _count(node: Any, known: dict[int, int]) -> int:
    """Count the values in a node; a node that contains itself counts as too large."""
    if not isinstance(node, dict | list):
        return 1
    if id(node) not in known:
        known[id(node)] = MAX_NODES + 1
        parts = [*node.keys(), *node.values()] if isinstance(node, dict) else node
        known[id(node)] = 1 + sum(_count(part, known) for part in parts)
    return known[id(node)]
