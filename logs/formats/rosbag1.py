"""Read ROS 1 bags: closed, interrupted (`.bag.active`), and those of 2010."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from logs.errors import LogError
from logs.formats.bag_fields import check_bag
from logs.formats.bag_records import BagWalk
from logs.formats.collecting import collect, damage_text, messages_of, open_bytes
from logs.mcap.records import Loss
from logs.ros.recording import Recording
from logs.types import Progress

MAGICS = (b"#ROSBAG V", b"#ROSRECORD V")

messages = partial(messages_of, walk_of=BagWalk)


def load(path: Path, progress: Progress | None = None) -> Recording:
    """Read the messages of a bag. The index is not used, so a bag without one is read as well.

    Raises
    ------
    LogError
        If the version is unknown, the bag is encrypted, or a message is damaged or incomplete.
    """
    data = open_bytes(path)
    check_bag(path, data)
    losses: list[Loss] = []
    recording, walk = collect(data, BagWalk, losses.append, progress)
    assert isinstance(walk, BagWalk)
    recording.format = "rosbag1"
    recording.again = partial(messages, path)
    in_messages = [loss for loss in losses if not 0 < (walk.index_pos or 0) <= loss.start]
    if in_messages and not walk.has_read_index:
        raise LogError(damage_text(path, in_messages[0]))
    n_messages = f"all {walk.contents.n_messages:,} messages were read"
    if losses and walk.has_read_index:
        n_bytes = sum(loss.end - loss.start for loss in losses)
        recording.notes.append(
            f"{n_bytes:,} bytes that the index of the bag does not list were skipped, and {n_messages}"
        )
    elif losses:
        recording.notes.append(f"the index at the end of the bag is incomplete, but {n_messages}")
    if walk.index_pos == 0:
        recording.notes.append(f"the bag was not closed by its recorder and has no index, but {n_messages}")
    return recording
