"""What a reader notes of a log: what it took for granted or mended, and counts and conventions that are as usual."""

from __future__ import annotations

import re

from logs.run import Run

USUAL = re.compile(
    r"\d+ ranges (are|is) |rays were (reversed|mirrored)|rays repeat others after a full turn|were resampled to "
    r"|sensors are read as one|^other scans in the log "
)
"""Notes that change no result: readings that REP-117 counts as no returns, and how rays are numbered."""


def notes_of(run: Run) -> list[str]:
    """Return all notes, as `inspect` lists them."""
    return [note for note in run.meta.get("notes", "").split("; ") if note]


def assumptions_of(run: Run) -> list[str]:
    """Return the notes that whoever computes with the run should know: what was assumed, mended or left out."""
    return [note for note in notes_of(run) if not USUAL.search(note)]
