"""Finding: all that a diagnosis says, channel by channel, and what its pictures need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding
from sensorgraph.diagnosis.next_run.design import NextRun
from sensorgraph.diagnosis.result import ChannelResult, Gap, Unknown
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.model_selection import Explained
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.tolerance_scale import tolerance_scale
from sensorgraph.diagnosis.simulation import SimulationComparison
from sensorgraph.effects import Amendment


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """What a diagnosis says of one run."""

    channels: dict[str, ChannelResult]
    """`scan`, `odometry`, `drive`."""
    intake: dict[str, Any]
    """What came in, what was used, what was dropped, what this run excites; plain data."""
    data: ScanData
    explained: Explained | None = None
    """The accepted model of the scan channel; None where the arena does not fit the run."""
    goodness_of_fit: GoodnessOfFit | None = None
    """Of that model."""
    second_gap: Gap | None = None
    """On a further run that no fit has seen, where one was given."""
    shared: tuple[Amendment, ...] = ()
    """Effects that a simulation shows, too, with the same size and as it has them: part of the simulator."""
    driving: DrivingFinding | None = None
    """Wheels and mount from driving alone, where the run has no reference but its own scans; in place of the odometry
    channel, which such poses would flatter."""
    next_run: NextRun | None = None
    """A drive that would tell more; None where none was asked for, or none can be made."""
    simulation: SimulationComparison | None = None
    """How the run differs from one of the user's own simulator, where one was given."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """[s] of CPU time per stage."""

    @property
    def effects(self) -> tuple[Amendment, ...]:
        """Named effects of all channels, strongest evidence first."""
        named = [a for channel in self.channels.values() for a in channel.effects]
        return tuple(sorted(named, key=lambda a: -(a.evidence or 0.0)))

    @property
    def undecided(self) -> tuple[Amendment, ...]:
        """Effects of all channels that a rival explains as well."""
        return tuple(a for channel in self.channels.values() for a in channel.undecided)

    @property
    def pose_tolerance_factor(self) -> float | None:
        """By how much the reference is worse than its tolerances, as the accepted model fits it; 1 is as stated."""
        return None if self.explained is None else self.explained.final.state.pose_scale

    @property
    def map_tolerance_factor(self) -> float | None:
        """The same of the map."""
        return None if self.explained is None else self.explained.final.state.map_scale

    @cached_property
    def stamp_tolerance_factor(self) -> float | None:
        """The same of the stamps of the scans; 1 also where the run does not tell."""
        return None if self.explained is None else tolerance_scale(self.explained.final, "stamp")

    @cached_property
    def heading_tolerance_factor(self) -> float | None:
        """The same of the reference's heading alone, where stamps are as stated."""
        if self.explained is None or self.data.from_scans or (self.stamp_tolerance_factor or 1.0) > 1.0:
            return None if self.explained is None else 1.0
        return tolerance_scale(self.explained.final, "pose_yaw")

    @property
    def unknown(self) -> Unknown | None:
        """What no effect of the library explains."""
        return next((channel.unknown for channel in self.channels.values() if channel.unknown), None)


def misaligned(
    data: ScanData, intake: dict[str, Any], problem: Unknown, seconds: Mapping[str, float]
) -> Finding:
    """Return the finding of a run that the arena does not fit: nothing is named before that is mended."""
    skipped = "the arena does not fit the run; move it first"
    return Finding(
        channels={
            "scan": ChannelResult(channel="scan", unknown=problem),
            "odometry": ChannelResult(channel="odometry", skipped=skipped),
            "drive": ChannelResult(channel="drive", skipped=skipped),
        },
        intake=intake,
        data=data,
        seconds=seconds,
    )
