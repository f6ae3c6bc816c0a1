"""What wide tolerances in robot.yaml take along without a name: nothing is found there, but nothing is shown either."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.diagnose import Finding
from sensorgraph.diagnosis.scan.nuisance import BOX, DENSE, widths
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.world.robot import Tolerances

WIDE = 2.0
"""Times its materiality that an effect may reach unnamed, above which a tolerance is called wide; robot.yaml's defaults
stay below 1.2."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tolerated:
    """One effect that a tolerance takes along."""

    tolerance: str
    """Its key in robot.yaml."""
    most: Amendment
    """The largest that passes without a name."""
    taken: Amendment | None
    """What passed in this run, where that is more than its materiality."""


def tolerated(finding: Finding) -> list[Tolerated]:
    """List what the tolerances of this run are too wide to show."""
    tolerances = finding.data.tolerances
    present = {a.name for a in finding.effects}
    here = _here(finding)
    out = []
    for key, most in _reach(tolerances):
        if most.name in present or most.ratio <= WIDE:
            continue
        taken = here.get(most.name)
        is_material = taken is not None and size_ratio(taken.effect, taken.parameters) >= 1.0
        out.append(Tolerated(tolerance=key, most=most, taken=taken if is_material else None))
    return out


def _reach(tolerances: Tolerances) -> Iterator[tuple[str, Amendment]]:
    """Yield robot.yaml's keys and the largest effect that each box takes."""
    own = dict(zip(DENSE, BOX * widths(tolerances), strict=True))
    yield "map", EFFECTS["moved_wall"](d=BOX * tolerances.map)
    yield "mount_xy", EFFECTS["mount_xy"](dx=own["mount_x"], dy=0.0)
    yield "mount_yaw", EFFECTS["mount_yaw"](delta=own["mount_yaw"])
    yield "stamp", EFFECTS["latency"](tau=own["latency"])


def _here(finding: Finding) -> dict[str, Amendment]:
    """Return what the tolerances took in this run, by the effect it would have been."""
    if finding.explained is None:
        return {}
    g = finding.explained.final.state.g
    own = dict(zip(DENSE, g, strict=False))
    corners = g[len(DENSE) :]
    return {
        "moved_wall": EFFECTS["moved_wall"](d=float(np.abs(corners).max(initial=0.0))),
        "mount_xy": EFFECTS["mount_xy"](dx=float(own["mount_x"]), dy=float(own["mount_y"])),
        "mount_yaw": EFFECTS["mount_yaw"](delta=float(own["mount_yaw"])),
        "latency": EFFECTS["latency"](tau=float(own["latency"])),
    }
