"""Read the map of a log: its attached arena, or the occupancy grid of a topic such as /map."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.formats import format_of
from logs.inspection import LOADERS
from logs.ros import cdr
from logs.ros.messages import GRID_TYPE
from logs.ros.recording import Recording, Topic, listing
from logs.run import OccupancyMap
from logs.transforms import to_planar

ARENA = "arena.geojson"
"""Attachment with the arena of a log."""
ROBOT = "robot.yaml"
"""Attachment with the robot of a log."""
MAP_TOPIC, COSTMAP = "/map", "costmap"


@dataclass(frozen=True, kw_only=True)
class RecordedMap:
    """The map of a log."""

    arena: bytes | None
    """GeoJSON of the attached arena; None if the log has only a grid."""
    grid: OccupancyMap | None
    """The occupancy grid; None if the log has an attached arena."""
    source: str
    """The attachment or topic that holds the map, with the number of its messages."""
    robot: bytes | None = None
    """The attached robot.yaml; None if the log has none."""


def read_map(path: Path | str) -> RecordedMap:
    """Read the map of a log; of several messages of a topic, the last.

    Raises
    ------
    LogError
        If no format matches, the file is damaged, or the log has no map or several.
    """
    path = Path(path)
    kind = format_of(path)
    if kind not in LOADERS:
        raise LogError(
            f"{path} is a log without topics; expected a log with an occupancy grid in {MAP_TOPIC}"
        )
    recording = LOADERS[kind](path, None)
    robot = recording.attachments.get(ROBOT)
    if ARENA in recording.attachments:
        return RecordedMap(
            arena=recording.attachments[ARENA], grid=None, source=f"the attachment {ARENA}", robot=robot
        )
    topic = _grid_topic(recording, path)
    last = deque(recording.again(topic.name) if recording.again is not None else (), maxlen=1)
    if not last:
        raise LogError(
            f"{path}: {topic.name} has no messages; record the map, which is published once at start"
        )
    message = bytes(last[0][1])
    (block,) = cdr.unpack([message], topic.type, topic.name, topic.encoding)
    nx, ny = (int(n) for n in block["size"][0])
    data, resolution = block["data"][0].astype(np.int8), float(block["resolution"][0, 0])
    origin = to_planar(block["origin"].astype(np.float64))[0]
    if (
        len(data) != nx * ny
        or not data.size
        or not (0 < resolution < np.inf)
        or not np.isfinite(origin).all()
    ):
        raise LogError(
            f"{path}: the map in {topic.name} has {len(data)} cells of {resolution:g} m at {origin[0]:g}, {origin[1]:g}; "
            f"expected {nx} x {ny} cells"
        )
    grid = OccupancyMap(
        data=np.where(data > 100, -1, data).reshape(ny, nx).astype(np.int8),
        resolution=resolution,
        origin=origin,
    )
    times = "" if topic.n_messages == 1 else f", the last of {topic.n_messages} messages"
    return RecordedMap(arena=None, grid=grid, source=f"{topic.name}{times}", robot=robot)


def _grid_topic(recording: Recording, path: Path) -> Topic:
    """Return the topic of the map: /map, or else the only grid that is not a costmap."""
    grids = [topic for topic in recording.topics.values() if topic.type == GRID_TYPE]
    maps = [topic for topic in grids if COSTMAP not in topic.name]
    found = [topic for topic in maps if topic.name == MAP_TOPIC] or maps
    if len(found) == 1:
        return found[0]
    if found:
        names = ", ".join(topic.name for topic in found)
        raise LogError(f"{path} has several maps ({names}) and none in {MAP_TOPIC}; save one with map_saver")
    raise LogError(
        f"{path} has no map: no attachment {ARENA} and no occupancy grid; it has {listing(recording) or 'no topics'}"
    )
