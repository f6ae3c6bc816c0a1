"""Kinds of scans that differ from the others, with their sizes, words and possible causes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sensorgraph.diagnosis.scan.consequence import length

LATE_CAUSES = (
    "scans that sometimes wait in a queue, and are stamped when they leave it",
    "two clocks that stamp the scans in turn",
)
STRETCH_CAUSES = (
    "two clocks that drift apart and are synchronised at times",
    "a queue that fills during the run",
)
OFFSET_CAUSES = (
    "mirror facets or receivers that alternate and differ",
    "a laser that calibrates its zero again in every scan",
)
ELSEWHERE_CAUSES = (
    "a reference that sometimes loses track: hidden or swapped markers, extrapolated or outdated poses",
    "a laser that sways, or a robot that pitches or is lifted",
)


@dataclass(frozen=True, kw_only=True)
class OddScans(ABC):
    """Scans that differ from the others."""

    share: float
    """Share of the scans."""
    gain: float
    """[nats] Log-likelihood ratio of two kinds of scan to one."""
    offset: float
    """[m] RMS change of the readings of these scans."""
    family: ClassVar[str]
    """Name of the kind."""
    causes: ClassVar[tuple[str, ...]] = ()
    """Possible causes, most likely first."""

    @abstractmethod
    def sentence(self) -> str:
        """Return a statement for the report."""


@dataclass(frozen=True, kw_only=True)
class LateScans(OddScans):
    """Two delays; each scan has one of them."""

    family, causes = "late_scans", LATE_CAUSES
    delay: float
    """[s] Delay of the rarer kind of scan relative to the others; positive if its stamps are late."""

    @property
    def words(self) -> str:
        """Description of the wrong stamps."""
        late = "late" if self.delay > 0 else "early"
        return f"stamped {1e3 * abs(self.delay):.0f} ms too {late}"

    def sentence(self) -> str:
        """Return a statement for the report."""
        return f"{100 * self.share:.0f} % of the scans are {self.words}, relative to the others"


@dataclass(frozen=True, kw_only=True)
class LateStretches(LateScans):
    """Two delays, each in separate stretches of the run: the delay changes."""

    causes = STRETCH_CAUSES

    def sentence(self) -> str:
        """Return a statement for the report."""
        return (
            f"the delay of the scans changes during the run: in {100 * self.share:.0f} % of it they are {self.words}, "
            "relative to the rest"
        )


@dataclass(frozen=True, kw_only=True)
class ScansElsewhere(OddScans):
    """Scans that were not taken at their reference pose."""

    family, causes = "scans_elsewhere", ELSEWHERE_CAUSES
    distance: float
    """[m] RMS position error."""
    turn: float
    """[rad] RMS heading error."""

    def sentence(self) -> str:
        """Return a statement for the report."""
        return (
            f"{100 * self.share:.0f} % of the scans were taken away from their reference pose, by {length(self.distance)} "
            f"and {np.degrees(self.turn):.2g}° (rms)"
        )


@dataclass(frozen=True, kw_only=True)
class ScansWithOffsets(OddScans):
    """Scans with a common offset of all their readings, which differs between scans."""

    family, causes = "scan_offsets", OFFSET_CAUSES

    def sentence(self) -> str:
        """Return a statement for the report."""
        return f"each scan has a different range offset, {length(self.offset)} (rms)"
