"""Finding: the results of a diagnosis, channel by channel, and the data for its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from sensorgraph.diagnosis.engine.ledger import Ledger
from sensorgraph.diagnosis.engine.why import why
from sensorgraph.diagnosis.ledger import ledger_of
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding
from sensorgraph.diagnosis.next_run.design import NextRun
from sensorgraph.diagnosis.result import ChannelResult, Gap, Unknown
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.model_selection import Explained
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.unnamed.scans_elsewhere import tolerance_scale
from sensorgraph.effects import Amendment


@dataclass(frozen=True, kw_only=True)
class LaserNoise:
    """Noise of a laser, as one log shows it."""

    scatter: float
    """[m] robust standard deviation of the readings about the model."""
    lost: float
    """Share of the rays with a missing return."""
    stray: float
    """Share of the returns that are outliers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationComparison:
    """Differences between the log of a robot and that of a simulator."""

    name: str
    """Of the simulator's log."""
    shared: tuple[Amendment, ...] = ()
    """Effects that both show, with the parameters of the simulation."""
    changed: tuple[tuple[Amendment, Amendment], ...] = ()
    """Effects that both show with different sizes: the robot's, the simulation's."""
    only_in_simulation: tuple[Amendment, ...] = ()
    """Effects that the robot does not show."""
    not_observable: Mapping[str, str] = field(default_factory=dict)
    """Effect of `only_in_simulation` -> reason why the robot's log could not have shown it."""
    unknown: Unknown | None = None
    """Unmodelled structure in the simulation."""
    shares_unknown: bool = False
    """Whether the robot's log shows the same structure, so that it is not a difference."""
    robot_noise: LaserNoise | None = None
    simulated_noise: LaserNoise | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """Results of the diagnosis of one run."""

    channels: dict[str, ChannelResult]
    """`scan`, `odometry`, `drive`."""
    intake: dict[str, Any]
    """Input, used and dropped scans, and excitation of the run; plain data."""
    data: ScanData
    explained: Explained | None = None
    """The accepted model of the scan channel; None if the arena does not fit the run."""
    goodness_of_fit: GoodnessOfFit | None = None
    """Of the accepted model."""
    second_gap: Gap | None = None
    """On a second run, which no fit has used; None without one."""
    shared: tuple[Amendment, ...] = ()
    """Effects that a simulation shows with the same size, with its parameters. They are part of the simulator."""
    driving: DrivingFinding | None = None
    """Calibration of wheels and mount from driving alone, for a run that was located with its own scans. It
    replaces the odometry channel, which such poses would bias towards agreement."""
    next_run: NextRun | None = None
    """A drive that could answer open questions; None if none was requested or is possible."""
    simulation: SimulationComparison | None = None
    """Comparison with a run of the user's own simulator; None without one."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """[s] CPU time per stage."""

    @property
    def effects(self) -> tuple[Amendment, ...]:
        """Named effects of all channels, strongest evidence first."""
        named = [a for channel in self.channels.values() for a in channel.effects]
        return tuple(sorted(named, key=lambda a: -(a.evidence or 0.0)))

    @property
    def undecided(self) -> tuple[Amendment, ...]:
        """Effects of all channels with an equally likely rival."""
        return tuple(a for channel in self.channels.values() for a in channel.undecided)

    @cached_property
    def tolerance_factors(self) -> dict[str, float]:
        """Ratios of the fitted to the specified tolerances of `map`, `pose`, `stamp` and `heading`.

        A ratio is 1 if the run does not determine it: that of the heading if the stamps are worse than specified. Empty
        if nothing was fitted.
        """
        if self.explained is None:
            return {}
        final = self.explained.final
        stamp = tolerance_scale(final, "stamp")
        is_hidden = self.data.from_scans or stamp > 1.0
        return {
            "map": final.state.map_scale,
            "pose": final.state.pose_scale,
            "stamp": stamp,
            "heading": 1.0 if is_hidden else tolerance_scale(final, "pose_yaw"),
        }

    @property
    def unknown(self) -> Unknown | None:
        """Unmodelled structure: a difference that no effect of the library explains."""
        return next((channel.unknown for channel in self.channels.values() if channel.unknown), None)

    @cached_property
    def ledger(self) -> Ledger:
        """Every hypothesis that was considered, with its numbers and the verdict on it."""
        return ledger_of(self.channels)

    def why(self, name: str) -> str:
        """Return why an effect, or a family without a name, was or was not reported.

        Raises
        ------
        SensorgraphError
            No hypothesis has this name.
        """
        return why(self.ledger, name)


def misaligned(
    data: ScanData,
    intake: dict[str, Any],
    problem: Unknown,
    seconds: Mapping[str, float],
    driving: DrivingFinding | None = None,
) -> Finding:
    """Return the finding of a run that the arena does not fit.

    Only effects of wheels and mount are named, from driving alone: this needs no arena.
    """
    skipped = "the arena does not fit the run; correct the arena first"
    wheels = ChannelResult(channel="odometry", skipped=skipped) if driving is None else driving.channel
    return Finding(
        channels={
            "scan": ChannelResult(channel="scan", unknown=problem),
            "odometry": wheels,
            "drive": ChannelResult(channel="drive", skipped=skipped),
        },
        intake=intake,
        data=data,
        driving=driving,
        seconds=seconds,
    )
