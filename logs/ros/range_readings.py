"""Decode Range messages of sonars and infrared sensors: each sensor is a scan of one ray with a cone."""

from __future__ import annotations

import numpy as np

from logs.ros.laser_scan import LaserScans, clean_ranges
from logs.ros.recording import Topic, logged_times, sort_stamps


def read_ranges(topic: Topic, no_return: str | None = None) -> list[LaserScans]:
    """Decode the Range messages of a topic, one result per sensor frame.

    Parameters
    ----------
    no_return : one of `NO_RETURNS`; None: detected from the frequency of readings
    """
    stamps = logged_times(topic)
    limits = np.full((len(topic.payloads), 4), np.nan)  # field_of_view, min_range, max_range, range
    frames: dict[str, list[np.ndarray]] = {}
    for block in topic.blocks():
        stamps[block.index], limits[block.index] = block.stamps_ns, block["limits"]
        frames.setdefault(block.strings["frame_id"].strip("/"), []).append(block.index)
    logged = logged_times(topic)
    if topic.stamps is not None:
        stamps = logged = topic.stamps
    out = []
    for frame, parts in frames.items():
        mine = np.sort(np.concatenate(parts))
        at, order, notes = sort_stamps(topic.name, stamps[mine], logged[mine])
        readings = limits[mine, 3:]
        range_notes: list[str] = []
        stated = (float(limits[mine[0], 1]), float(limits[mine[0], 2]))
        range_min, range_max, code = clean_ranges([readings], stated, no_return, range_notes)
        out.append(
            LaserScans(
                at, readings[order], np.zeros(1), 0.0, 0.0, range_min, range_max, frame,
                notes + [f"{topic.name}: {text}" for text in range_notes], code, float(limits[mine[0], 0]),
            )
        )  # fmt: skip
    return out
