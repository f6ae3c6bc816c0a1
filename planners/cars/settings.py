"""The tuned numbers of cars: what they mean, and the command that set them.

All were set with `python benchmarks/coverage_planners.py --drive reeds_shepp` and `--drive dubins`, for the arenas
`square office` and for random offices (`--arena --random 10 --first 1`): driving time, coverage and processor time.

Some are constants of compiled code. `planners.kernel` compiles anew after a change of any file that names it, as this one.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class EntrySettings:
    """How a car comes to a heading that the primitives have."""

    max_steps: int = 3
    """Headings of the primitives that the arc may pass before it takes one."""
    same_heading: float = 1e-5
    """[rad] Headings closer than this are the same."""
    clearance_step: float = 0.005
    """[m] between the places on the arc at which the clearance is looked up."""


@dataclass(frozen=True, kw_only=True)
class ArcPathSettings:
    """How finely the chain of arcs of a drive is looked at."""

    bin_step: float = 0.005
    """[m] between the poses whose bin is looked up."""
    clearance_step: float = 0.02
    """[m] between the poses whose clearance is looked up."""
    max_piece_forward: float = 0.16
    """[m] Longer arcs are cut, since a shortcut begins and ends where an arc does: for cars without a reverse gear, ..."""
    max_piece_reversing: float = 0.12
    """... and for cars with one."""
    max_bins: int = 4096
    """Bins that a shortcut or a detour may cover."""


@dataclass(frozen=True, kw_only=True)
class ShortcutSettings:
    """How a drive is shortened."""

    max_saving: float = 60.0
    """[s] Longer parts of a drive are not looked at: a part is left out if dropping it would save more than this."""
    max_alone_first: int = 2
    """Bins that only the replaced part covers, at most, in the first pass. A shortcut rarely covers more of them."""
    max_alone_later: int = 4
    """The same in later passes."""
    min_saving: float = 0.1
    """[s] that one shortcut saves."""
    min_pass_saving: float = 0.006
    """Share of the driving time that a pass must save for another to follow."""
    max_passes: int = 6
    """Passes over the whole drive."""
    reach_over: int = 20
    """Arcs before a replaced part from which shortcuts are looked for again, since they may reach over it."""
    arcs_per_job: int = 1000
    """Arcs that one thread looks at in a row."""


@dataclass(frozen=True, kw_only=True)
class DetourSettings:
    """How a drive is led by bins that it misses."""

    max_distance: float = 1.0
    """[m] between the drive and the bin."""
    max_duration: float = 20.0
    """[s] of a detour."""


@dataclass(frozen=True, kw_only=True)
class ReachabilitySettings:
    """The wavefront of a Dubins car over the whole floor, and the choice of its start."""

    lattice: float = 0.02
    """[m] side of a lattice cell; a path is found through any gap that this resolves."""
    goal_dwell: float = 1.3
    """Log periods to stay in the bin at the end of a path, so that a log of every phase meets it."""
    exhaustive_share: float = 0.25
    """A wavefront that came over this share of the returnable states, and met no wanted bin, is not repeated for them."""
    start_tries: int = 6
    """Random poses among which a start is chosen."""
    good_start_share: float = 0.5
    """Share of all bins from which on a start is good enough."""


ENTRY = EntrySettings()
ARC_PATH = ArcPathSettings()
SHORTCUTS = ShortcutSettings()
DETOURS = DetourSettings()
REACHABILITY = ReachabilitySettings()
