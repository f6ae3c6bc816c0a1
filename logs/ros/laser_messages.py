"""Convert the messages of all lasers to LaserScan messages of one beginning, so that what follows knows one type."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from logs.errors import LogError
from logs.ros.multi_echo import first_echoes
from logs.ros.point_cloud import scans_of_clouds
from logs.ros.ray_stream import full_turns
from logs.ros.recording import CLOUD_TYPE, MULTI_ECHO_TYPE, SCAN_TYPE, Recording, ScanSource


def as_laser_scans(
    recording: Recording, sources: Sequence[ScanSource], heights: tuple[float, float] | None = None
) -> Recording:
    """Return the recording with LaserScan messages on the topics that are read.

    Parameters
    ----------
    sources : topics that are read
    heights : [m] lowest and highest point of a point cloud that is used; None: its ring nearest the horizontal

    Raises
    ------
    LogError : If `heights` is given but no point cloud is read, or a message is damaged.
    """
    names = dict.fromkeys(source.topic for source in sources)
    kinds = {name: recording.topics[name].type for name in names}
    if heights is not None and CLOUD_TYPE not in kinds.values():
        raise LogError(
            f"`slice` selects heights of a PointCloud2, but {', '.join(f'{n} is {k}' for n, k in kinds.items())}; "
            "leave it out, or select a point cloud with `topics` scan=NAME"
        )
    topics, notes = dict(recording.topics), list(recording.notes)
    for name, kind in kinds.items():
        if kind == MULTI_ECHO_TYPE:
            topics[name], more = first_echoes(topics[name])
            notes += more
        elif kind == CLOUD_TYPE:
            found, more = scans_of_clouds(recording, name, heights)
            topics |= found
            notes += more
        if topics[name].type == SCAN_TYPE:
            topics[name], more = full_turns(topics[name])
            notes += more
    return replace(recording, topics=topics, notes=notes)
