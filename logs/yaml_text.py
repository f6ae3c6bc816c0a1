"""YAML that somebody else wrote: plain data, of a size that can be printed, or one ValueError of one line."""

from __future__ import annotations

from typing import Any

import yaml

MAX_NODES = 100_000
"""Values that a file may hold, those repeated by aliases counted each time: nine lines can say a billion."""


def parse_yaml(text: str) -> Any:
    """Read YAML as plain data.

    Raises
    ------
    ValueError
        if it is no YAML, nested too deeply, or larger than MAX_NODES once its aliases are followed
    """
    try:
        data = yaml.safe_load(text)
        n_nodes = _count(data, {})
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except (yaml.YAMLError, ValueError, TypeError, OverflowError) as exc:
        raise ValueError(" ".join(str(exc).split())[:300]) from exc
    if n_nodes > MAX_NODES:
        raise ValueError(f"holds more than {MAX_NODES:,} values once its aliases are followed")
    return data


def _count(node: Any, known: dict[int, int]) -> int:
    """Count the values in a node; a node that holds itself is nested without end."""
    if not isinstance(node, dict | list):
        return 1
    if id(node) not in known:
        known[id(node)] = MAX_NODES + 1
        parts = [*node.keys(), *node.values()] if isinstance(node, dict) else node
        known[id(node)] = 1 + sum(_count(part, known) for part in parts)
    return known[id(node)]
