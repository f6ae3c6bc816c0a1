"""Notes of a log reader: assumptions and corrections that can change results, and routine counts and conventions."""

from __future__ import annotations

import re
from dataclasses import replace

from logs.run import Run

ROUTINE = re.compile(
    r"\d+ ranges (are|is) |rays were (reversed|mirrored)|rays repeat others after a full turn|were resampled to "
    r"|sensors are read as one|^other scans in the log "
)
"""Notes that do not change a result: readings without a return in REP-117, and the numbering of rays."""
ODOMETRY_LEFT_OUT = "the odometry was left out"
"""End of the note on odometry that the reader does not use."""


def notes_of(run: Run) -> list[str]:
    """Return all notes of a run, as `inspect` lists them."""
    return [note for note in run.meta.get("notes", "").split("; ") if note]


def with_note(run: Run, text: str) -> Run:
    """Return a run with a further note."""
    return replace(run, meta={**run.meta, "notes": "; ".join([*notes_of(run), text])})


def assumptions_of(run: Run) -> list[str]:
    """Return the notes that can change results: assumptions, corrections and omissions of the reader."""
    return [note for note in notes_of(run) if not ROUTINE.search(note)]
