"""Reference poses, stamps or a map that are less accurate than specified."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.tolerance_scale import tolerance_scale
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.world.robot import Tolerances

POSE_CAUSES = (
    "a reference pose that is less accurate than specified: a poor calibration, a slow filter, lost markers",
    "stamps of scans or poses that are late or jitter",
)
STAMP_CAUSES = (
    "stamps of scans or poses that are late or jitter",
    "a laser that moves relative to the robot: a bracket with play, a swaying mast",
)
HEADING_CAUSES = (
    "a reference whose heading is less accurate than specified: a slow filter, a course over ground",
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


def one_part_of_the_poses(fitted: Fitted) -> list[Doubt]:
    """Return stamps or a heading that are far less accurate than specified, while the positions are not."""
    data, limit = fitted.solver.data, SCAN.goodness_of_fit.max_tolerance_scale
    speed, turn = np.hypot(*data.twists[:, :2].T), np.abs(data.twists[:, 2])
    far = float(np.median(data.ranges[data.returned])) if data.returned.any() else 0.0
    told = data.tolerances
    off = float(np.sqrt(np.mean(speed**2 + (far * turn) ** 2))) * told.stamp
    parts = (
        ("stamps of the scans", tolerance_scale(fitted, "stamp"), off, STAMP_CAUSES),
        (
            "heading of the reference",
            tolerance_scale(fitted, "pose_yaw"),
            far * told.pose_yaw,
            HEADING_CAUSES,
        ),
    )
    # where the robot turns, jitter of the stamps is equivalent to an error of the heading
    worse = sorted((part for part in parts if part[1] >= limit), key=lambda part: -part[1])
    if not worse:
        return []
    scale, one = worse[0][1:3]
    names = " or the ".join(name for name, *_ in worse)
    return [
        Doubt(
            family="stamps_or_heading_worse",
            statement=f"the {names} would have to be {scale:.1f} times worse than specified",
            misfit=(scale - 1) * data.n_scans,
            statistic=scale,
            threshold=limit,
            size=ScanError(offset=scale * one, affected=1.0),
            causes=tuple(cause for *_, causes in worse for cause in causes),
        )
    ]


WORSE_THAN_SPECIFIED = Unnamed(
    titles={
        "reference_worse": "reference poses less accurate than specified",
        "map_worse": "a map less accurate than specified",
        "stamps_or_heading_worse": "stamps or headings less accurate than specified",
    },
    find=find,
)
