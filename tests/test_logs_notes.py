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
    "/scan: 9 messages have stamp 0, their log time was used",
    "/scan: stamps go back 3 times, sorted",
    "range_min 10 is invalid, 0 was used",
    "no transform base_link -> laser: the mount of robot.yaml is used if given, otherwise 0",
    "ranges of exactly range_max 8 m are missing returns: 80 rays (10.0 %) are +inf (if this is wrong, set `no_return` inf)",
    "2 invalid lines left out, the first is line 9",
)
USUAL = (
    "3 ranges are above range_max 8 m: +inf",
    "/sonar: 7 ranges are exactly 0, an invalid reading: nan",
    "2 ranges are 0 or less, an invalid reading: nan",
    "the laser sweeps clockwise: rays were reversed",
    "the laser is mounted upside down: rays were mirrored",
    "1 rays repeat others after a full turn and were dropped",
    "/scan: 180 to 181 rays: 10 of 30 were resampled to the bearings of most scans (180 rays), none was dropped",
    "2 sensors are read as one, each with its own mount: /front, /rear",
    "other scans in the log (select them with `topics` scan=NAME): 5 RLASER",
)


def test_a_note_is_a_warning_where_something_was_assumed_or_mended() -> None:
    run = replace(some_run(), meta={"source": "a.mcap", "notes": "; ".join((*MENDED, *USUAL))})
    assert notes_of(run) == [*MENDED, *USUAL]
    assert assumptions_of(run) == list(MENDED)
    assert log_notes(run, run) == [f"a.mcap: {note}" for note in MENDED]


@pytest.mark.parametrize("written", ["", "2 invalid lines left out, the first is line 9"])
def test_stamps_that_go_back_in_a_file_of_ours_are_noted(written: str, tmp_path: Path) -> None:
    logs.write(replace(some_run(), meta={"notes": written} if written else {}), tmp_path / "run.mcap")
    recording = mcap_file.load(tmp_path / "run.mcap", None)
    topic = recording.topics["/scan"]
    topic.payloads = Messages(list(topic.payloads)[::-1])
    run = own_record.to_run(recording, "run.mcap")
    assert notes_of(run) == [*filter(None, [written]), "/scan: stamps go back 39 times, sorted"]
    np.testing.assert_allclose(run.stamps, some_run().stamps, atol=1e-9)  # whole nanoseconds
