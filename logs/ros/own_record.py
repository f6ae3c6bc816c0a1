"""The metadata record of our own MCAP files, with which a Run is restored exactly as written.

The metadata record `sensorgraph` holds plain text. It contains the sensor as float64 (LaserScan has float32 and no
sigma), the frame of /pose, the time of stamp 0, and the meta of the run as `meta.NAME`.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from logs.errors import LogError
from logs.no_return import apply_no_return
from logs.ros.messages import planar_covariances
from logs.ros.recording import (
    COVARIANCE_TOPIC,
    ODOMETRY_TYPE,
    POSE_COVARIANCE_TYPE,
    POSE_TYPE,
    SCAN_TYPE,
    TWIST_STAMPED_TYPE,
    Recording,
    Track,
    sort_stamps,
    track,
)
from logs.run import RangeSensor, Run, rare_times, with_rare_times
from logs.transforms import Stamps, to_planar
from logs.types import Floats

METADATA_NAME = "sensorgraph"
RECORD_VERSION = "1"
TOPIC_OF_ROLE = {"scan": "/scan", "pose": "/pose", "odom": "/odom", "cmd": "/cmd_vel"}
SENSOR_SCALARS = ("range_min", "range_max", "sigma", "resolution", "rate", "sweep_time", "height")


def sensor_facts(
    sensor: RangeSensor, *, pose_frame: str, epoch_ns: int, zero_ns: int, meta: Mapping[str, str]
) -> dict[str, str]:
    """Return the metadata record of a run; `zero_ns` [ns] is the time of stamp 0 in the file."""
    record = {
        "version": RECORD_VERSION,
        "bearings": _bearings_text(sensor.bearings),
        "mount": _numbers_text(sensor.mount),
        **{name: repr(float(getattr(sensor, name))) for name in SENSOR_SCALARS},
        **({"origins": _numbers_text(sensor.origins)} if sensor.is_composite else {}),
        **({"cones": _numbers_text(sensor.cones)} if sensor.cones.any() else {}),
        **({"delays": _numbers_text(sensor.delays)} if sensor.delays.any() else {}),
        **{name: repr(value) for name, value in rare_times(sensor).items()},
        "pose_frame": pose_frame,
        "epoch_ns": str(int(epoch_ns)),
        "zero_ns": str(int(zero_ns)),
        **{f"meta.{name}": str(value) for name, value in meta.items()},
    }
    return record | {"crc32": _checksum(record)}


def is_intact(record: Mapping[str, str]) -> bool:
    """Return whether a record is unchanged; MCAP has no checksum for metadata."""
    return record.get("crc32") == _checksum(record)


def _checksum(record: Mapping[str, str]) -> str:
    lines = [f"{name}={value}" for name, value in sorted(record.items()) if name != "crc32"]
    return f"{zlib.crc32(chr(10).join(lines).encode()):08x}"


def is_own(recording: Recording, topics: Mapping[str, str] | None) -> bool:
    """Return whether the file is ours and the caller selects no other topics."""
    selected = {role: "/" + name.lstrip("/") for role, name in (topics or {}).items()}
    return METADATA_NAME in recording.metadata and all(
        TOPIC_OF_ROLE[role] == name for role, name in selected.items()
    )


def sensor_of(sensor_facts: Mapping[str, str]) -> RangeSensor:
    """Restore the sensor from the metadata record."""
    scalars: dict[str, Any] = {name: float(sensor_facts[name]) for name in SENSOR_SCALARS}
    sensor = RangeSensor(
        bearings=parse_bearings(sensor_facts["bearings"]),
        mount=parse_numbers(sensor_facts["mount"]),
        origins=parse_numbers(sensor_facts.get("origins", "")).reshape(-1, 2),
        cones=parse_numbers(sensor_facts.get("cones", "")),
        delays=parse_numbers(sensor_facts.get("delays", "")),
        **scalars,
    )
    return with_rare_times(sensor, sensor_facts)


def to_run(recording: Recording, source: str, no_return: str | None = None) -> Run:
    """Restore the run as written; a missing return is +inf unless `no_return` selects another encoding."""
    record = recording.metadata[METADATA_NAME]
    if record.get("version") != RECORD_VERSION:
        raise LogError(
            f"{source} has record version {record.get('version')}, expected {RECORD_VERSION}; update sensorgraph"
        )
    if not is_intact(record):
        raise LogError(
            f"{source}: its `{METADATA_NAME}` record does not match its checksum; "
            f"save the messages without it: sensorgraph recover {source} -o OUT.mcap"
        )
    try:
        sensor, zero = sensor_of(record), int(record["zero_ns"])
        epoch = int(record["epoch_ns"])
    except (KeyError, ValueError) as exc:
        raise LogError(
            f"{source}: its `{METADATA_NAME}` record is incomplete ({exc}); "
            f"save the messages without it: sensorgraph recover {source} -o OUT.mcap"
        ) from exc
    stamps, ranges, intensities, notes = _scans(recording, sensor.n_rays, source)
    apply_no_return(ranges, sensor.range_max, no_return)
    pose = _track(recording, "pose", POSE_TYPE, "pose", 7)
    odom = _track(recording, "odom", ODOMETRY_TYPE, "pose", 7)
    twist = _track(recording, "odom", ODOMETRY_TYPE, "twist", 6)
    command = _track(recording, "cmd", TWIST_STAMPED_TYPE, "twist", 6)
    meta = {k.removeprefix("meta."): v for k, v in record.items() if k.startswith("meta.")}
    all_notes = _with_sorted([*notes, *pose.notes, *odom.notes, *command.notes], meta.get("notes", ""))
    all_notes = "; ".join(filter(None, [*recording.notes, all_notes]))
    return Run(
        sensor=sensor,
        stamps=(stamps - zero) / 1e9,
        ranges=ranges,
        intensities=intensities,
        pose_stamps=(pose.stamps - zero) / 1e9,
        poses=to_planar(pose.values),
        pose_covariances=_covariances(recording, pose.stamps),
        odom_stamps=(odom.stamps - zero) / 1e9,
        odometry=to_planar(odom.values),
        odom_twists=twist.values[:, [0, 5]],
        cmd_stamps=(command.stamps - zero) / 1e9,
        commands=command.values[:, [0, 5]],
        pose_frame="laser" if record.get("pose_frame") == "laser" else "base_link",
        epoch_ns=epoch,
        meta={**meta, **({"notes": all_notes} if all_notes else {})},
        attachments=dict(recording.attachments),
    )


def _with_sorted(found: list[str], written: str) -> str:
    """Return the stored notes of the run, and notes on stamps of the file that go back.

    Notes on duplicate stamps are omitted, because the run may contain duplicates itself.
    """
    back = [note for note in found if "stamps go back" in note]
    return "; ".join(dict.fromkeys(filter(None, [*written.split("; "), *back])))


def _track(recording: Recording, role: str, msgtype: str, column: str, width: int) -> Track:
    topic = recording.topics.get(TOPIC_OF_ROLE[role])
    if topic is None or topic.type != msgtype or not topic.payloads:
        return Track(np.zeros(0, dtype=np.int64), np.zeros((0, width)))
    return track(topic, column, width, absolute=True)


def _covariances(recording: Recording, stamps: Stamps) -> Floats:
    """Return the covariance (n, 3, 3) of each pose, or an empty array if the stamps do not match."""
    topic = recording.topics.get(COVARIANCE_TOPIC)
    if topic is None or topic.type != POSE_COVARIANCE_TYPE or not topic.payloads:
        return np.zeros((0, 3, 3))
    found = track(topic, "covariance", 36, absolute=True)
    return planar_covariances(found.values) if np.array_equal(found.stamps, stamps) else np.zeros((0, 3, 3))


def _scans(recording: Recording, n_rays: int, source: str) -> tuple[Stamps, Floats, Floats, list[str]]:
    """Return stamps, ranges, and intensities (n_scans, n_rays) or (0, n_rays) of the scans, and notes."""
    topic = recording.topics.get(TOPIC_OF_ROLE["scan"])
    if topic is None or topic.type != SCAN_TYPE or not topic.payloads:
        return np.zeros(0, dtype=np.int64), np.zeros((0, n_rays)), np.zeros((0, n_rays)), []
    stamps = np.zeros(len(topic.payloads), dtype=np.int64)
    ranges = np.empty((len(stamps), n_rays))
    intensities = np.zeros((0, n_rays))
    for block in topic.blocks():
        if block.places["ranges"].count != n_rays:
            raise LogError(
                f"{source}: a scan has {block.places['ranges'].count} ranges, but its `{METADATA_NAME}` record states "
                f"{n_rays}; remove that record to read the file as a foreign log"
            )
        stamps[block.index], ranges[block.index] = block.stamps_ns, block["ranges"]
        if block.places["intensities"].count == n_rays:
            intensities = intensities if len(intensities) else np.full(ranges.shape, np.nan)
            intensities[block.index] = block["intensities"]
    stamps, order, notes = sort_stamps(topic.name, stamps, stamps)
    if not (np.diff(order) == 1).all():
        ranges, intensities = ranges[order], intensities[order] if len(intensities) else intensities
    return stamps, ranges, intensities, notes


def _numbers_text(values: Floats) -> str:
    return " ".join(map(repr, values.ravel().tolist()))


def parse_numbers(text: str) -> Floats:
    """Parse numbers separated by white space."""
    return np.array([float(word) for word in text.split()], dtype=np.float64)


def _bearings_text(bearings: Floats) -> str:
    first, last, n = float(bearings[0]), float(bearings[-1]), len(bearings)
    if n > 3 and np.array_equal(bearings, np.linspace(first, last, n)):
        return f"{first!r} to {last!r} in {n}"
    return _numbers_text(bearings)


def parse_bearings(text: str) -> Floats:
    """Parse bearings [rad], given as `FIRST to LAST in N` or one by one."""
    if " to " in text:
        first, _, last, _, n = text.split()
        return np.linspace(float(first), float(last), int(n))
    return parse_numbers(text)
