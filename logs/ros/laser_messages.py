"""Convert the messages of all lasers to LaserScan messages of one beginning, so that what follows knows one type.

Of a MultiEchoLaserScan, the first echo of each ray is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError
from logs.ros import cdr
from logs.ros.point_cloud import scans_of_clouds
from logs.ros.ray_stream import full_turns
from logs.ros.recording import CLOUD_TYPE, MULTI_ECHO_TYPE, SCAN_TYPE, Recording, ScanSource, Topic
from logs.types import SCANS_AT_A_TIME, Floats


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


def first_echoes(topic: Topic) -> tuple[Topic, list[str]]:
    """Return the topic with LaserScan messages, and notes on what was chosen.

    A ray without an echo has no return: +inf.

    Raises
    ------
    LogError : If a message is too short for the echoes that it states.
    """
    heads: dict[str, list[cdr.MessageColumns]] = {}
    for block in topic.blocks():
        heads.setdefault(block.strings["frame_id"], []).append(block)
    messages: list[bytes] = [b""] * len(topic.payloads)
    n_more = n_none = 0
    for frame, blocks in heads.items():
        words, index = _words(blocks)
        columns = {
            name: np.concatenate([block[name] for block in blocks]) for name in ("sec", "nanosec", "limits")
        }
        n_rays = np.array([part[0] for part in words])
        for n in np.unique(n_rays).tolist():
            for some in _blocks(np.flatnonzero(n_rays == n)):
                (ranges, counts), (intensities, _) = _decode([words[i] for i in some], n, topic)
                n_more, n_none = n_more + int((counts > 1).sum()), n_none + int((counts == 0).sum())
                ranges[counts == 0] = np.inf
                taken = {name: values[some] for name, values in columns.items()}
                known = {} if intensities is None else {"intensities": intensities}
                rows = cdr.pack(
                    SCAN_TYPE,
                    len(some),
                    strings={"frame_id": frame},
                    columns={**taken, "ranges": ranges, **known},
                )
                for i, row in zip(index[some].tolist(), rows, strict=True):
                    messages[i] = row.tobytes()
    notes = [f"{topic.name}: the first echo of each ray was used ({n_more or 'no'} rays have further echoes)"]
    if n_none:
        notes.append(f"{topic.name}: {n_none} rays without an echo are missing returns, +inf")
    return replace(topic, type=SCAN_TYPE, encoding="cdr", payloads=cdr.Messages(messages)), notes


def _words(blocks: list[cdr.MessageColumns]) -> tuple[list[NDArray[np.uint32]], NDArray[np.intp]]:
    """Return the 32-bit words after the limits of each message, and the indices of the messages."""
    words = []
    for block in blocks:
        place = block.places["limits"]
        start = place.offset + place.dtype.itemsize * place.count
        rest = block.rows[:, start : start + (block.rows.shape[1] - start) // 4 * 4]
        words += list(np.ascontiguousarray(rest).view("<u4"))
    return words, np.concatenate([block.index for block in blocks])


def _blocks(index: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    return [index[i : i + SCANS_AT_A_TIME] for i in range(0, len(index), SCANS_AT_A_TIME)]


def _decode(
    words: list[NDArray[np.uint32]], n_rays: int, topic: Topic
) -> tuple[tuple[Floats, NDArray[np.uint32]], tuple[Floats | None, NDArray[np.uint32]]]:
    """Return first values and numbers of echoes (m, n_rays) of ranges and intensities; the latter may be absent.

    Parameters
    ----------
    words : for each of m messages, the words of both arrays: n_rays, then count and values of each ray
    """
    flat = np.concatenate([*words, np.zeros(2, dtype=np.uint32)])
    ends = np.cumsum([len(part) for part in words])
    at = np.concatenate([[0], ends[:-1]])
    ranges, counts, at = _walk(flat, at + 1, ends, n_rays, topic)
    has_strengths = (at < ends) & (flat[np.minimum(at, ends - 1)] == n_rays)
    if not has_strengths.all():
        return (ranges, counts), (None, counts)
    strengths, strength_counts, _ = _walk(flat, at + 1, ends, n_rays, topic)
    return (ranges, counts), (strengths, strength_counts)


def _walk(
    flat: NDArray[np.uint32], at: NDArray[np.intp], ends: NDArray[np.intp], n_rays: int, topic: Topic
) -> tuple[Floats, NDArray[np.uint32], NDArray[np.intp]]:
    """Read one array of echoes of all messages, ray by ray; also return the positions after it."""
    values = flat.view("<f4")
    first = np.full((len(at), n_rays), np.nan)
    counts = np.zeros((len(at), n_rays), dtype=np.uint32)
    for ray in range(n_rays):
        if (at >= ends).any():
            break
        n = flat[at]
        if (n > ends - at - 1).any():
            break
        counts[:, ray] = n
        first[:, ray] = np.where(n > 0, values[at + 1], np.nan)
        at = at + 1 + n.astype(np.intp)
    else:
        return first, counts, at
    raise LogError(
        f"{topic.name}: a MultiEchoLaserScan states more echoes than it holds; the file is damaged or states a wrong type"
    )
