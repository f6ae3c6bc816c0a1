"""What one channel of a diagnosis shows: names, deviations, rivals, the gap, and what is left unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sensorgraph.effects import Amendment
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """One place, bearing, range, time … at which measured and simulated differ more than chance allows."""

    family: str
    """`bias`, `spread`, `outliers` or `misses`."""
    partition: str
    """`wall`, `bearing`, `range`, `incidence`, `time`, `omega`, `speed`, `hit place`, `robot place`, …"""
    label: str
    """Which part of it, readable: `arena/edge_3`, `30 to 40 degrees`."""
    z: float
    """How many standard errors, clustered by scan."""
    size: float
    """Of the difference: [m] for bias, ratio for spread, share for outliers and misses; in the other channels, of the
    column it is about."""
    n_rays: int
    xy: tuple[float, float] | None = None
    """[m, map] where it has a place."""

    channel: str = "scan"
    """Whose readings differ."""
    evidence_nats: float | None = None
    """Where models were compared, rather than a mean with zero: by how much the one that differs is likelier."""

    def sentence(self) -> str:
        """Say it in words."""
        if self.channel != "scan":
            who = {"odometry": "odometry and reference", "drive": "commands and odometry"}[self.channel]
            how = f"by {self.partition}: {self.label}" if self.evidence_nats is None else self.label
            return f"{who} differ {how} ({self.strength()})"
        what = {
            "bias": f"readings are {abs(self.size) * 100:.1f} cm too {'long' if self.size > 0 else 'short'}",
            "spread": f"readings scatter {100 * self.size:.0f} % more than the noise",
            "outliers": f"{100 * self.size:.1f} % more strays than expected",
            "misses": f"{100 * self.size:.1f} % more rays without a return than expected",
        }[self.family]
        return (
            f"{what} at {self.partition} {self.label}{self.about()} ({self.strength()}, {self.n_rays} rays)"
        )

    def about(self) -> str:
        """Say where a wall is whose name says nothing."""
        if self.xy is None or not self.partition.startswith("wall"):
            return ""
        return f" about ({self.xy[0]:.1f}, {self.xy[1]:.1f}) m"

    def strength(self) -> str:
        """Say how sure the difference is, in the unit of its test."""
        if self.evidence_nats is not None:
            return f"{self.evidence_nats:.0f} nats of evidence"
        return f"{abs(self.z):.1f} standard errors"


@dataclass(frozen=True, kw_only=True)
class Profile:
    """An error of the laser over bearing or range, as a run tells it."""

    of: str
    """"bearing" [rad], to the left, or "reading" [m]."""
    over: str
    """"bearing" [rad] or "range" [m]."""
    at: tuple[float, ...]
    """Where it is told, ascending."""
    error: tuple[float, ...]
    """Less its mean over all rays."""
    stderr: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """Something that no effect of the library explains."""

    statement: str
    """One sentence: what differs, where, by how much."""
    deviation: Deviation | None = None
    statistic: float = 0.0
    threshold: float = 0.0
    size: Mapping[str, float] = field(default_factory=dict)
    """By how much a simulation without it is off, each number named with its unit."""
    consequence: str = ""
    """The same in words."""
    families: tuple[str, ...] = ()
    """What it may be, in the words of a robot engineer, the likeliest first."""
    profile: Profile | None = None
    """Its shape, where it is an error over bearing or range."""


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """How far the simulator is from what was measured."""

    rmse_m: float
    """[m] over returns; in the odometry and drive channels [m/s]."""
    normalised: float
    """RMS of the gap over its nominal noise."""
    nats_per_ray: float
    """Mean negative log-likelihood of a reading."""


@dataclass(frozen=True, kw_only=True)
class Gap:
    """The gap on rays that no fit and no choice has seen."""

    before: FitQuality
    after: FitQuality
    noise_floor: FitQuality
    n_rays: int
    stated_floor: FitQuality | None = None
    """The noise floor if map and reference are as good as robot.yaml states; None where only one floor is known."""


@dataclass(frozen=True, kw_only=True)
class Rival:
    """An effect that explains the same data almost as well."""

    name: str
    instead_of: str
    evidence_nats: float
    separates: str
    """What would tell them apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionDifference:
    """What the body did beyond what the wheels say, where a patch or structure explains it."""

    stamps: Floats
    """(n,) [s] of the reference's clock."""
    rates: Floats
    """(n, 2) [m/s, rad/s]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelResult:
    """What one channel shows."""

    channel: str
    effects: tuple[Amendment, ...] = ()
    """Named, strongest evidence first."""
    undecided: tuple[Amendment, ...] = ()
    """Material, but a rival explains the readings as well: no name."""
    within_tolerance: tuple[Amendment, ...] = ()
    """Evidence, but too small to be called an effect."""
    unknown: Unknown | None = None
    rivals: tuple[Rival, ...] = ()
    deviations: tuple[Deviation, ...] = ()
    """Before any naming."""
    gap: Gap | None = None
    not_observable: Mapping[str, str] = field(default_factory=dict)
    """Effect -> why this run could not have shown it."""
    skipped: str = ""
    """Why the channel was not looked at; empty if it was."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """What else is worth knowing, plain data."""
    motion: MotionDifference | None = None
    """Of the odometry channel: what other channels are to know of its finding."""
