"""What a model of faces holds, and its form in a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from sensorgraph.models.calibration.laser_calibration import Calibration
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.sufficient_statistics import SufficientStatistics
from sensorgraph.models.faces.visibility import ReturnNoise
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class FacesData:
    """The fields of `Faces`."""

    sensor: RangeSensor
    faces: FaceSet
    noise: ReturnNoise
    hits: Floats
    """(n_faces,) training returns that each face explains."""
    observed: ObservedSpace
    returns: float
    """Share of the training rays that returned."""
    mount: Floats
    """(3,) [m, m, rad] laser in the frame of the poses, as identified."""
    calibration: Calibration
    """How the laser differs from what was stated; identity for a perfect one."""
    n_rays: int = 0
    """Training rays."""
    statistics: SufficientStatistics | None = None
    """What new runs are added to."""
    cells: CellModel | None = None
    """What predicts where long faces do not explain enough."""


def stored(model: FacesData) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return plain data and arrays that hold the whole model."""
    noise = {name: getattr(model.noise, name) for name in ReturnNoise.__dataclass_fields__}
    calibration, terms = model.calibration.state()
    header: dict[str, Any] = {
        "noise": noise,
        "returns": model.returns,
        "cell": model.observed.cell,
        "calibration": calibration,
        "n_rays": model.n_rays,
    }
    arrays: dict[str, NDArray[Any]] = {name: getattr(model.faces, name) for name in FaceSet._fields}
    arrays |= {"hits": model.hits, "mount": model.mount}
    arrays |= {f"calibration.{name}": array for name, array in terms.items()}
    if model.statistics is not None:
        arrays |= {f"memory.{name}": array for name, array in model.statistics.arrays().items()}
    arrays |= {"crossed.origin": model.observed.origin, "crossed.counts": model.observed.counts}
    if model.cells is not None:
        header["cells"], own = model.cells.state()
        arrays |= {f"cells.{name}": array for name, array in own.items()}
    return header, arrays


def restored_fields(
    sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> dict[str, Any]:
    """Return the fields of the model whose plain data and arrays `stored` gave.

    Raises
    ------
    ValueError : an array has a wrong shape, or points outside another one
    """
    faces = FaceSet(
        **{name: np.asarray(arrays[name], _INTEGER_FIELDS.get(name, float)) for name in FaceSet._fields}
    )
    _check_face_set(faces)
    statistics = _with_prefix("memory.", arrays)
    return {
        "sensor": sensor,
        "faces": faces,
        "noise": ReturnNoise(**{name: float(value) for name, value in header["noise"].items()}),
        "hits": np.asarray(arrays["hits"], dtype=np.float64),
        "observed": ObservedSpace(
            origin=np.asarray(arrays["crossed.origin"], dtype=np.float64),
            cell=float(header["cell"]),
            counts=np.asarray(arrays["crossed.counts"], dtype=np.uint8),
        ),
        "returns": float(header["returns"]),
        "n_rays": int(header.get("n_rays", 0)),
        "statistics": SufficientStatistics.from_arrays(statistics, faces) if statistics else None,
        "mount": np.asarray(arrays["mount"], dtype=np.float64),
        "calibration": Calibration.restore(
            sensor.n_rays, header["calibration"], _with_prefix("calibration.", arrays)
        ),
        "cells": CellModel.restore(sensor, header["cells"], _with_prefix("cells.", arrays))
        if "cells" in header
        else None,
    }


def _with_prefix(prefix: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


_INTEGER_FIELDS: dict[str, type] = {"first": np.intp, "neighbour": np.intp}


def _check_face_set(faces: FaceSet) -> None:
    """Refuse arrays that kernels would read beyond their ends."""
    k, e = faces.n_faces, len(faces.edges)
    shapes = {name: np.shape(getattr(faces, name)) for name in FaceSet._fields}
    right = {"normals": (k, 2), "offsets": (k,), "first": (k + 1,)} | dict.fromkeys(
        ("edges", "levels", "blur", "neighbour"), (e,)
    )
    if shapes != right:
        raise ValueError(f"faces have shapes {shapes}, expected {right}")
    if faces.first[0] != 0 or faces.first[-1] != e or (np.diff(faces.first) < 1).any():
        raise ValueError(
            f"faces' edges start at {faces.first.tolist()[:8]} ..., expected 0 to {e}, increasing"
        )
    if len(faces.neighbour) and not (faces.neighbour.min() >= -1 and faces.neighbour.max() < k):
        raise ValueError(f"neighbours reach {faces.neighbour.max()}, expected less than {k} faces")
