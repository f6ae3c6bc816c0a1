"""What the tests of reports share: findings that are changed a little, and what a recording holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import rerun as rr

from sensorgraph.diagnosis.finding import Finding


def with_scan(finding: Finding, **changes: object) -> Finding:
    """Return a finding with changes of its scan channel."""
    channels = {**finding.channels, "scan": replace(finding.channels["scan"], **changes)}  # type: ignore[arg-type]
    return replace(finding, channels=channels)


def columns_of(recording: Path) -> str:
    """Return the names of what a recording holds, a line each."""
    columns = rr.chunk.RrdReader(str(recording)).store().schema().component_columns()
    return "\n".join(map(str, columns))
