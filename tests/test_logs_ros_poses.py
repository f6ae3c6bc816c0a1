"""Reference poses of ROS logs: without an orientation, or in a frame that no transform connects to map."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbag_samples import (
    HUMBLE,
    Message,
    read,
    trip,
)


def unturned(one: Message) -> Message:
    """Return a message of a pose whose quaternion is left at zeros, as a node leaves it that fills in x and y alone."""
    topic, kind, at, data = one
    whole = HUMBLE.deserialize_cdr(data, kind)
    whole.pose.orientation.z = whole.pose.orientation.w = 0.0
    return topic, kind, at, bytes(HUMBLE.serialize_cdr(whole, kind))


@pytest.mark.parametrize("n", [3, 10])
def test_poses_without_orientation_are_left_out_and_said(n: int, tmp_path: Path) -> None:
    bag = trip()
    chosen = [i for i, one in enumerate(bag) if one[0] == "/pose"][:n]
    bag = [unturned(one) if i in chosen else one for i, one in enumerate(bag)]
    run = read(tmp_path, bag)
    assert f"/pose: {n} of 10 poses have no orientation (quaternion 0 0 0 0): left out" in run.meta["notes"]
    assert len(run.pose_stamps) == len(run.poses) == 10 - n
    assert run.meta["pose_source"] == ("/pose" if n < 10 else "none")


@pytest.mark.parametrize(
    ("frame", "is_known"),
    [("map", True), ("/amr7/world", True), ("odom_combined", True), ("", True), ("mars", False)],
)
def test_poses_in_an_unknown_frame_are_said_to_be_taken_as_the_maps(
    frame: str, is_known: bool, tmp_path: Path
) -> None:
    bag = trip()
    for i, (topic, kind, at, data) in enumerate(bag):
        if topic == "/pose":
            whole = HUMBLE.deserialize_cdr(data, kind)
            whole.header.frame_id = frame
            bag[i] = (topic, kind, at, bytes(HUMBLE.serialize_cdr(whole, kind)))
    said = read(tmp_path, bag).meta.get("notes", "")
    assert said == (
        "" if is_known else f"/pose is in the unknown frame {frame}, which is assumed to be the map"
    )
