"""What happened: runs in memory and the files that keep them; knows no planner and no model.

`read(path)` takes any format in `FORMATS`; `write(run, path)` writes MCAP; `Recorder` writes while it happens.
Nothing heavy is imported until a name is used.

| room | what happens there |
|---|---|
| `run` | `Run` and `RangeSensor`: the one data contract of a recording |
| `recorder`, `plan_file` | write a run while it is driven; write a plan |
| `inspection`, `recovery`, `stream` | look into a file, save a damaged one, read one larger than memory |
| `formats/` | one module for each kind of file |
| `mcap/` | MCAP records, checked one by one |
| `ros/` | what ROS messages mean: byte layout, topics and their roles, transforms |
| `no_return`, `resampling`, `jumps` | what drivers and clocks get wrong |
| `notes` | what a reader took for granted |
| `motion` | where the robot was at any time, and so where each ray of a sweep was taken |
| `transforms` | planar poses |
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from logs.errors import LogError
    from logs.formats import FORMATS, read, write
    from logs.recorder import Recorder
    from logs.ros.recording import parse_topics
    from logs.run import OccupancyMap, Pairing, RangeSensor, Run, pair

__all__ = [
    "FORMATS",
    "LogError",
    "OccupancyMap",
    "Pairing",
    "RangeSensor",
    "Recorder",
    "Run",
    "pair",
    "parse_topics",
    "read",
    "write",
]

_HOMES = {
    "LogError": "logs.errors",
    "FORMATS": "logs.formats",
    "read": "logs.formats",
    "write": "logs.formats",
    "Recorder": "logs.recorder",
    "parse_topics": "logs.ros.recording",
    "OccupancyMap": "logs.run",
    "Pairing": "logs.run",
    "RangeSensor": "logs.run",
    "Run": "logs.run",
    "pair": "logs.run",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its home when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
