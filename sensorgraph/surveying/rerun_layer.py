"""fleet.rrd: each robot's quantities over time, and the paths of the logs in each place; the logs stay as they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from sensorgraph.show.rerun_file import DIM, WALL, recorded
from sensorgraph.types import Floats

TIMELINE = "day"


def write_layer(rows: Sequence[Mapping[str, Any]], walls: Mapping[str, Floats], path: Path) -> None:
    """Write the recording.

    Parameters
    ----------
    rows : Rows of a fleet, by robot and time.
    walls : Place -> (n, 2, 2) [m].
    """
    layout = rrb.Blueprint(
        rrb.Horizontal(
            rrb.TimeSeriesView(origin="robots", name="quantities by robot"),
            *(rrb.Spatial2DView(origin=f"places/{_entity(place)}", name=place) for place in walls),
        ),
        collapse_panels=True,
    )
    with recorded(path, "fleet", layout) as recording:
        for place, lines in walls.items():
            flipped = [line * [1, -1] for line in lines]  # y points down in a view
            recording.log(
                f"places/{_entity(place)}/walls",
                rr.LineStrips2D(flipped, colors=WALL, radii=-0.6),
                static=True,
            )
        series: dict[str, list[tuple[float, float]]] = {}
        for row in rows:
            for name, (value, _) in row["quantities"].items():
                series.setdefault(f"robots/{_entity(row['robot'])}/{name}", []).append(
                    (row["epoch_s"], value)
                )
        for entity, points in series.items():
            t, values = np.array(points).T
            time = [rr.TimeColumn(TIMELINE, timestamp=t)]
            recording.send_columns(entity, time, rr.Scalars.columns(scalars=values))
        for row in rows:
            if row["place"] in walls and row["path"]:
                recording.set_time(TIMELINE, timestamp=row["epoch_s"])
                strip = np.array(row["path"]) * [1, -1]
                recording.log(
                    f"places/{_entity(row['place'])}/{_entity(row['robot'])}",
                    rr.LineStrips2D([strip], colors=DIM, radii=-0.8),
                )


def _entity(name: object) -> str:
    """Return a name as a part of an entity's path."""
    return "".join(one if one.isalnum() or one in "-_" else "_" for one in str(name)) or "_"
