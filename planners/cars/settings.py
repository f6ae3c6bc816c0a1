"""Tuned parameters of cars, with the command that set each.

All were set with `python -m benchmarks.coverage_planners --drive reeds_shepp` and `--drive dubins`, for the
arenas `square office` and for random offices (`--arena --random 10 --first 1`): driving time, coverage and
processor time.

Some are constants of compiled code. `planners.kernel` compiles again after a change of their values.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class EntrySettings:
    """Entry of a car to a heading of the primitives."""

    max_steps: int = 3
    """Maximum number of headings of the primitives within the arc."""
    same_heading: float = 1e-5
    """[rad] Headings closer than this are equal."""
    clearance_step: float = 0.005
    """[m] between the places on the arc at which the clearance is tested."""


@dataclass(frozen=True, kw_only=True)
class ArcPathSettings:
    """Sampling of the chain of arcs of a drive."""

    bin_step: float = 0.005
    """[m] between the poses whose bin is evaluated."""
    clearance_step: float = 0.02
    """[m] between the poses whose clearance is tested."""
    max_piece_forward: float = 0.16
    """[m] Longer arcs are cut, since shortcuts begin and end at arc ends: for cars without a reverse gear ..."""
    max_piece_reversing: float = 0.12
    """... and for cars with one."""
    max_bins: int = 4096
    """Maximum number of bins that a shortcut or a detour covers."""


@dataclass(frozen=True, kw_only=True)
class ShortcutSettings:
    """Shortening of a drive."""

    max_saving: float = 60.0
    """[s] maximum time that dropping a part of the drive would save; longer parts are not evaluated."""
    max_critical_first: int = 2
    """Maximum number of bins covered only by the replaced part, in the first pass. A shortcut rarely covers
more of them."""
    max_critical_later: int = 4
    """The same in later passes."""
    min_saving: float = 0.1
    """[s] minimum saving of a shortcut."""
    min_pass_saving: float = 0.006
    """Minimum saving of a pass for another to follow, as a share of the driving time."""
    max_passes: int = 6
    """Maximum number of passes over the whole drive."""
    reach_over: int = 20
    """Number of arcs before a replaced part whose shortcuts are evaluated again, since they may span it."""
    arcs_per_job: int = 1000
    """Number of arcs per thread job."""


@dataclass(frozen=True, kw_only=True)
class DetourSettings:
    """Detours to missing bins near a drive."""

    max_distance: float = 1.0
    """[m] maximum distance between the drive and the bin."""
    max_duration: float = 20.0
    """[s] maximum duration of a detour."""


@dataclass(frozen=True, kw_only=True)
class ReachabilitySettings:
    """The wavefront of a Dubins car over the whole floor, and the choice of its start."""

    lattice: float = 0.02
    """[m] side of a lattice cell; a path is found through any gap that this resolves."""
    goal_dwell: float = 1.3
    """Minimum stay in the bin at the end of a path [log periods], so that a log of any phase records it."""
    exhaustive_share: float = 0.25
    """Share of the returnable states; a wavefront that reached more, and no wanted bin, is not repeated for
these bins."""
    start_tries: int = 6
    """Number of random poses among which a start is chosen."""
    good_start_share: float = 0.5
    """Share of all bins at which a start is good enough."""


ENTRY = EntrySettings()
ARC_PATH = ArcPathSettings()
SHORTCUTS = ShortcutSettings()
DETOURS = DetourSettings()
REACHABILITY = ReachabilitySettings()
