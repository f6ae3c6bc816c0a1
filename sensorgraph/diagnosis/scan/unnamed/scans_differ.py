"""Scans that differ from each other more than the rays within a scan explain."""

from __future__ import annotations

from sensorgraph.diagnosis.scan.consequence import SCATTER_CAUSES, ScanError, excess_noise
from sensorgraph.diagnosis.scan.deviations import dispersion
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed

NAME = "scans_differ"
OF_SCANS = ("time", "omega", "speed", "acceleration", "robot place")
"""Partitions whose bins consist of whole scans."""


def find(checked: Checked) -> list[Doubt]:
    """Return how much more scans differ from each other than the rays within a scan explain."""
    view, found = checked.view, checked.deviations
    scatter, limit = dispersion(view), SCAN.goodness_of_fit.max_dispersion
    noise = excess_noise(scatter.excess, view.data.sensor.sigma)
    is_of_walls = noise < view.data.grain  # scans at different places see walls with different errors
    where = next((d for d in found if d.family == "spread" and d.partition in OF_SCANS), None)
    place = "" if where is None else f", most at {where.partition} {where.label}"
    return [
        Doubt(
            family=NAME,
            is_sure=bool(scatter.ratio > limit and not is_of_walls),
            statement=f"scans differ from each other {scatter.ratio:.1f} times more than the rays within a scan explain"
            + place,
            misfit=(scatter.ratio - 1) / 2 * view.data.n_scans,
            statistic=scatter.ratio,
            threshold=limit,
            size=ScanError(noise=noise, affected=1.0),
            causes=SCATTER_CAUSES,
        )
    ]


SCANS_DIFFER = Unnamed(titles={NAME: "scans that differ from each other"}, find=find)
