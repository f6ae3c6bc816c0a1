"""What is refused of a log before anything is made of it, unless the user insists."""

from __future__ import annotations

from logs.jumps import Jumps, find_jumps
from logs.run import Pairing, Run
from sensorgraph.errors import SensorgraphError


def check_jumps(run: Run, pairing: Pairing, *, force: bool, name: str | None = None) -> None:
    """Refuse a run whose pose jumps between consecutive scans; with `force`, take it as it is.

    Raises
    ------
    SensorgraphError : it jumps farther than a robot drives
    """
    poses = pairing.poses[pairing.paired]
    jumps = find_jumps(run.stamps[pairing.paired], poses, is_timed=run.meta.get("clock") != "assumed")
    refuse_jumps(jumps, name or run.meta.get("source", "the run"), force=force)


def refuse_jumps(jumps: Jumps | None, name: str, *, force: bool) -> None:
    """Raise an error that says how far the poses of a run jump, and what to do; not with `force`."""
    if jumps is not None and not force:
        raise SensorgraphError(
            f"{name}: {jumps}; expected poses along which a robot can drive: check the clocks and where the poses "
            "are from (sensorgraph inspect), or set `force` to use them as they are"
        )
