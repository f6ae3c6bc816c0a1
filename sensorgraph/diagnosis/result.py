"""Result of one channel of a diagnosis: named effects, deviations, rivals, gap and unmodelled structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sensorgraph.diagnosis.engine.ledger import Entry
from sensorgraph.diagnosis.engine.verdict import Objection
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.types import Floats

BOTH_SIDES = {"odometry": "odometry and reference pose", "drive": "commands and odometry"}
"""Motion channel -> the two signals that it compares."""
MAX_STDERRS = 3.0
"""Minimum difference between two sizes of an effect, in standard errors, to be called different."""
MAX_SHARE = 0.1
"""Minimum relative difference of a parameter without materiality, to be called different."""


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """A place, bearing, range, time, ... at which measurement and simulation differ by more than chance."""

    family: str
    """`bias`, `spread`, `outliers` or `misses`."""
    partition: str
    """`wall`, `bearing`, `range`, `incidence`, `time`, `omega`, `speed`, `hit place`, `robot place`, …"""
    label: str
    """Readable part of the partition: `arena/edge_3`, `30 to 40 degrees`."""
    z: float
    """Difference in standard errors, clustered by scan."""
    size: float
    """Of the difference: [m] for bias, ratio for spread, share for outliers and misses; in the other
    channels, the coefficient of the column."""
    n_rays: int
    xy: tuple[float, float] | None = None
    """[m, map] None if it has no place."""

    channel: str = "scan"
    """Channel whose readings differ."""
    evidence_nats: float | None = None
    """Log Bayes factor [nats] where two models were compared; None where a mean was compared with zero."""

    def sentence(self) -> str:
        """Return the deviation in words."""
        if self.channel != "scan":
            who = BOTH_SIDES[self.channel]
            how = (
                f"in the test by {self.partition}: {self.label}" if self.evidence_nats is None else self.label
            )
            return f"{who} differ {how} ({self.strength()})"
        what = {
            "bias": f"readings are {abs(self.size) * 100:.1f} cm too {'long' if self.size > 0 else 'short'}",
            "spread": f"readings scatter {100 * self.size:.0f} % more than the noise",
            "outliers": f"{100 * self.size:.1f} % more outliers than expected",
            "misses": f"{100 * self.size:.1f} % more rays without a return than expected",
        }[self.family]
        return (
            f"{what} at {self.partition} {self.label}{self.about()} ({self.strength()}, {self.n_rays:,} rays)"
        )

    def about(self) -> str:
        """Return the position of a wall, whose name does not contain it; empty for other partitions."""
        if self.xy is None or not self.partition.startswith("wall"):
            return ""
        return f" about ({self.xy[0]:.1f}, {self.xy[1]:.1f}) m"

    def strength(self) -> str:
        """Return the significance of the difference, in the unit of its test."""
        if self.evidence_nats is not None:
            return f"log Bayes factor {self.evidence_nats:.0f}"
        return f"{abs(self.z):.1f} standard errors"


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Error of the laser as a function of bearing or range."""

    of: str
    """"bearing" [rad], positive to the left, or "reading" [m]: the quantity with the error."""
    over: str
    """"bearing" [rad] or "range" [m]: the quantity that the error depends on."""
    at: tuple[float, ...]
    """Values of `over` at which the error is given, ascending."""
    error: tuple[float, ...]
    """Error at these values, less its mean over all rays."""
    stderr: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """Unmodelled structure: a difference that no effect of the library explains."""

    statement: str
    """One sentence: what differs, where, by how much."""
    deviation: Deviation | None = None
    statistic: float = 0.0
    threshold: float = 0.0
    size: Mapping[str, float] = field(default_factory=dict)
    """Error of a simulation without it; each key contains its unit."""
    consequence: str = ""
    """The same in words."""
    families: tuple[str, ...] = ()
    """Possible causes, in the words of a robotics engineer, most likely first."""
    family: str = ""
    """Name of its family in the ledger; empty if it belongs to none."""
    profile: Profile | None = None
    """Its shape, if it is an error over bearing or range."""


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """Difference between simulation and measurement."""

    rmse_m: float
    """[m] over returns; in the odometry and drive channels [m/s]."""
    normalised: float
    """RMS of the gap, divided by its nominal noise."""
    nats_per_ray: float
    """[nats] mean negative log-likelihood of a reading."""


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Gap on rays that no fit and no selection has used."""

    before: FitQuality
    after: FitQuality
    noise_floor: FitQuality
    n_rays: int


@dataclass(frozen=True, kw_only=True)
class Rival:
    """An effect that explains the same data almost as well."""

    name: str
    instead_of: str
    evidence_nats: float
    separates: str
    """What would distinguish the two."""
    required_nats: float = SCAN.naming.rival_margin
    """[nats] Minimum difference of evidence; below it, the two are undecided."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Withdrawn:
    """An effect that lost its name."""

    amendment: Amendment
    objection: Objection


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionDifference:
    """Motion of the body that the wheels do not report, as a slippery patch or structure explains it."""

    stamps: Floats
    """(n,) [s] on the clock of the reference poses."""
    rates: Floats
    """(n, 2) [m/s, rad/s]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelResult:
    """Result of one channel."""

    channel: str
    effects: tuple[Amendment, ...] = ()
    """Named, strongest evidence first."""
    undecided: tuple[Amendment, ...] = ()
    """Material effects with an equally likely rival; they are not named."""
    within_tolerance: tuple[Amendment, ...] = ()
    """Effects with sufficient evidence, but too small to matter."""
    withdrawn: tuple[Withdrawn, ...] = ()
    """Effects with sufficient evidence that are not named for another reason."""
    considered: tuple[Entry, ...] = ()
    """Hypotheses of the channel, for the ledger (`sensorgraph.diagnosis.ledger`)."""
    unknown: Unknown | None = None
    rivals: tuple[Rival, ...] = ()
    deviations: tuple[Deviation, ...] = ()
    """Differences from the simulator without effects."""
    gap: Gap | None = None
    not_observable: Mapping[str, str] = field(default_factory=dict)
    """Effect -> reason why this run could not have shown it."""
    at_materiality: Mapping[str, float] = field(default_factory=dict)
    """Effect -> evidence [nats] that it would have in this run at its materiality, after its price."""
    skipped: str = ""
    """Reason why the channel was not evaluated; empty if it was."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """Further results, as plain data."""
    motion: MotionDifference | None = None
    """From the odometry channel, for the other channels."""

    def without(self, why: Mapping[int, Objection]) -> ChannelResult:
        """Return the result without some named effects.

        Parameters
        ----------
        why : Index in `effects` -> the rule that takes its name.
        """
        gone = tuple(Withdrawn(amendment=self.effects[i], objection=rule) for i, rule in why.items())
        kept = tuple(a for i, a in enumerate(self.effects) if i not in why)
        return replace(self, effects=kept, withdrawn=(*self.withdrawn, *gone))


def without_close_calls(result: ChannelResult) -> ChannelResult:
    """Move effects with an equally likely rival to the undecided ones, unless the rival is named itself."""
    names = {a.name for a in result.effects}
    rivals = [rival for rival in result.rivals if rival.name not in names]
    close = [a for a in result.effects if any(_is_close(a, rival) for rival in rivals)]
    named = tuple(a for a in result.effects if a not in close)
    return replace(result, effects=named, undecided=(*result.undecided, *close))


def _is_close(a: Amendment, rival: Rival) -> bool:
    """Tell whether the evidence does not decide between an effect and its rival.

    A rival that is far ahead was rejected for another reason, and is not close.
    """
    return rival.instead_of == a.name and abs((a.evidence or 0.0) - rival.evidence_nats) < rival.required_nats


def counterpart(a: Amendment, others: Sequence[Amendment]) -> Amendment | None:
    """Return the effect with the same name and place, if it is among the others."""
    return next((b for b in others if b.name == a.name and _is_same_place(a, b)), None)


def _is_same_place(a: Amendment, b: Amendment) -> bool:
    if a.effect.place == "spot":
        return bool(np.hypot(a["x"] - b["x"], a["y"] - b["y"]) <= a["r"] + b["r"])
    if a.effect.place == "sector":
        return max(a["theta1"], b["theta1"]) <= min(a["theta2"], b["theta2"])
    return a.place == b.place


def is_same_size(a: Amendment, b: Amendment) -> bool:
    """Tell whether two sizes of one effect differ by less than their materiality or their standard errors."""
    off = {k: a[k] - b[k] for k in a.parameters if k in b.parameters}
    error = {k: float(np.hypot(a.stderr.get(k, 0.0), b.stderr.get(k, 0.0))) for k in off}
    clear = {k: d for k, d in off.items() if abs(d) > MAX_STDERRS * error[k]}
    sizes = {k: d for k, d in clear.items() if k in a.effect.sizes}
    if sizes and size_ratio(a.effect, sizes) >= 1.0:
        return False
    places = {"x", "y", "a", "b", "theta1", "theta2"}  # compared as the place
    rest = {k: d for k, d in clear.items() if k not in a.effect.sizes and k not in places}
    return all(abs(d) <= MAX_SHARE * max(abs(a[k]), abs(b[k])) for k, d in rest.items())


def shared_with(result: ChannelResult, simulated: Sequence[Amendment]) -> tuple[Amendment, ...]:
    """Return the effects of a simulation that a channel of the robot names with the same size."""
    pairs = [(a, counterpart(a, simulated)) for a in result.effects]
    return tuple(b for a, b in pairs if b is not None and is_same_size(a, b))


def without_shared(result: ChannelResult, simulated: Sequence[Amendment]) -> ChannelResult:
    """Remove the effects that robot and simulation share."""
    shared = shared_with(result, simulated)
    why = Objection("in_the_simulation", "the simulation shows it with the same size")
    return result.without(
        {i: why for i, a in enumerate(result.effects) if counterpart(a, shared) is not None}
    )
