"""Read and write recordings of a robot: `Run` in memory, MCAP and other formats on disk.

`read(path)` reads any format in `FORMATS`. `write(run, path)` writes MCAP. `Recorder` writes during the drive.
The package depends on no planner and no model. Heavy libraries are imported when a name is first used.

* `run`: `Run` and `RangeSensor`, the data model of a recording.
* `recorder`, `plan_file`: Write a run during the drive, and write a plan.
* `inspection`, `recovery`, `stream`: Inspect a file, recover a damaged one, read one that is larger than memory.
* `usability`: What a run can be used for.
* `recorded_map`: The map that a log holds.
* `formats/`: One module per file format.
* `mcap/`: MCAP records, each one validated.
* `ros/`: ROS messages, that is byte layout, topics and their roles, and transforms.
* `signals`, `clocks`, `no_return`, `resampling`, `jumps`, `publishers`, `odometry_faults`, `repeated_scans`: Correct or detect the quirks of drivers and clocks.
* `notes`, `run_warnings`: The assumptions and corrections of a reader, and values that look wrong.
* `motion`: The pose of the robot at any time, and the pose at which each ray of a sweep is taken.
* `transforms`: Planar poses.
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

_MODULES = {
    "errors": "LogError",
    "formats": "FORMATS read write",
    "recorder": "Recorder",
    "ros.recording": "parse_topics",
    "run": "OccupancyMap Pairing RangeSensor Run pair",
}
"""Module -> its public names."""


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use."""
    module = next((module for module, names in _MODULES.items() if name in names.split()), None)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{module}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
