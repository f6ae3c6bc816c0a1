"""Reference poses, stamps, a map or a laser that are less accurate than specified.

The scatter of the laser is tested before the effects (`scan.scatter_scale`).
"""

from __future__ import annotations

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.world.robot import Tolerances

POSE_CAUSES = (
    "a reference pose that is less accurate than specified: a poor calibration, a slow filter, lost markers",
    "stamps of scans or poses that are late or jitter",
)
MAP_CAUSES = (
    "a map that is less accurate than specified",
    "objects that have moved since the map was made",
)


def find(checked: Checked) -> list[Doubt]:
    """Return by how much a model needs tolerances far wider than the nominal ones."""
    view, nominal = checked.view, checked.nominal
    state, t = view.fitted.state, view.data.tolerances
    poses = state.pose_scale * t.pose_xy / max(nominal.pose_xy, 1e-9)
    walls = state.map_scale * t.map / max(nominal.map, 1e-9)
    limit = SCAN.goodness_of_fit.max_tolerance_scale
    return beyond_tolerances(poses, walls, nominal, view.data.n_scans, limit)


def beyond_tolerances(
    poses: float, walls: float, nominal: Tolerances, n_scans: int, limit: float
) -> list[Doubt]:
    """Return poses and walls; sure are those at least `limit` times worse than their tolerances."""
    return [
        Doubt(
            family=family,
            is_sure=bool(scale >= limit),
            statement=f"the {name} would have to be {scale:.1f} times worse than its tolerance",
            misfit=(scale - 1) * n_scans,
            statistic=scale,
            threshold=limit,
            size=ScanError(offset=scale * tolerance, affected=1.0),
            causes=causes,
        )
        for family, name, scale, tolerance, causes in (
            ("reference_worse", "reference pose", poses, nominal.pose_xy, POSE_CAUSES),
            ("map_worse", "map", walls, nominal.map, MAP_CAUSES),
        )
    ]


WORSE_THAN_SPECIFIED = Unnamed(
    titles={
        "reference_worse": "reference poses less accurate than specified",
        "map_worse": "a map less accurate than specified",
    },
    find=find,
)

SCATTER = "laser_scatter"
LASER_SCATTER = Unnamed(titles={SCATTER: "a laser that scatters more than specified"})
