"""Notes of readers: what is worth a warning, and what is as usual."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from logs_samples import some_run

import logs
from logs.formats import mcap_file
from logs.notes import assumptions_of, notes_of
from logs.ros import own_record
from logs.ros.cdr import Messages
from sensorgraph.intake import log_notes

MENDED = (
    "/scan: 9 messages have stamp 0, their log time was taken",
    "/scan: stamps go back 3 times, sorted",
    "range_min 10 makes no sense, 0 was taken",
    "no transform base_link -> laser: the mount is robot.yaml's where one is given, else 0",
    "exactly range_max 8 m means nothing seen: 80 rays (10.0%) are +inf (if not so, set `no_return` inf)",
    "2 broken lines left out, the first is line 9",
)
USUAL = (
    "3 ranges are above range_max 8 m: +inf",
    "/sonar: 7 ranges are exactly 0, which tells nothing: nan",
    "2 ranges are 0 or less, which tells nothing: nan",
    "the laser sweeps clockwise: rays were reversed",
    "the laser hangs upside down: rays were mirrored",
    "1 rays repeat others after a full turn, dropped",
    "/scan: 180 to 181 rays: 10 of 30 were resampled to the 180 rays of most, none dropped",
    "2 sensors are read as one, each with its own mount: /front, /rear",
    "other scans in the log (`topics` scan=NAME takes them): 5 RLASER",
)


def test_a_note_is_a_warning_where_something_was_assumed_or_mended() -> None:
    run = replace(some_run(), meta={"source": "a.mcap", "notes": "; ".join((*MENDED, *USUAL))})
    assert notes_of(run) == [*MENDED, *USUAL]
    assert assumptions_of(run) == list(MENDED)
    assert log_notes(run, run) == [f"a.mcap: {note}" for note in MENDED]


@pytest.mark.parametrize("written", ["", "2 broken lines left out, the first is line 9"])
def test_stamps_that_go_back_in_a_file_of_ours_are_noted(written: str, tmp_path: Path) -> None:
    logs.write(replace(some_run(), meta={"notes": written} if written else {}), tmp_path / "run.mcap")
    recording = mcap_file.load(tmp_path / "run.mcap", None)
    topic = recording.topics["/scan"]
    topic.payloads = Messages(list(topic.payloads)[::-1])
    run = own_record.to_run(recording, "run.mcap")
    assert notes_of(run) == [*filter(None, [written]), "/scan: stamps go back 39 times, sorted"]
    np.testing.assert_allclose(run.stamps, some_run().stamps, atol=1e-9)  # whole nanoseconds
