"""Fields of the model `faces`, and their form in a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from logs.types import ROUNDING
from planners.types import MAX_COORDINATE
from sensorgraph.models.calibration.laser_calibration import Calibration
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.hit_moments import N_MOMENTS
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.sufficient_statistics import SufficientStatistics
from sensorgraph.models.faces.visibility import ReturnNoise
from sensorgraph.models.stored_numbers import check_positive, check_range, check_shape, with_prefix
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class FacesData:
    """The fields of `Faces`."""

    sensor: RangeSensor
    faces: FaceSet
    noise: ReturnNoise
    hits: Floats
    """(n_faces,) number of training returns that each face explains."""
    observed: ObservedSpace
    returns: float
    """Share of the training rays that returned."""
    mount: Floats
    """(3,) [m, m, rad] identified pose of the laser in the frame of the poses."""
    calibration: Calibration
    """Identified deviation of the laser from its specification; none for a perfect laser."""
    n_rays: int = 0
    """Number of training rays."""
    statistics: SufficientStatistics | None = None
    """Statistics to which new runs are added."""
    cells: CellModel | None = None
    """Model that predicts in place of the faces if these leave too much unexplained."""


def stored(model: FacesData) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return plain data and arrays that describe the whole model."""
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
    observed = model.observed
    arrays |= {
        "crossed.origin": observed.origin,
        "crossed.counts": observed.counts,
        "crossed.free": observed.free,
    }
    if model.cells is not None:
        header["cells"], own = model.cells.state()
        arrays |= {f"cells.{name}": array for name, array in own.items()}
    return header, arrays


def restored_fields(
    sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> dict[str, Any]:
    """Return the fields of the model from the output of `stored`.

    Raises
    ------
    ValueError : An array has a wrong shape or invalid indices, or a number is out of range.
    """
    for name in ("first", "neighbour"):
        check_shape(name, arrays[name], (arrays[name].size,), "iu")
    faces = FaceSet(
        **{name: np.asarray(arrays[name], _INTEGER_FIELDS.get(name, float)) for name in FaceSet._fields}
    )
    _check_face_set(faces)
    _check_other_fields(faces, header, arrays)
    statistics = with_prefix("memory.", arrays)
    return {
        "sensor": sensor,
        "faces": faces,
        "noise": ReturnNoise(**{name: float(value) for name, value in header["noise"].items()}),
        "hits": np.asarray(arrays["hits"], dtype=np.float64),
        "observed": ObservedSpace(
            origin=np.asarray(arrays["crossed.origin"], dtype=np.float64),
            cell=float(header["cell"]),
            counts=np.asarray(arrays["crossed.counts"], dtype=np.uint8),
            free=np.asarray(arrays["crossed.free"], dtype=np.bool_),
        ),
        "returns": float(header["returns"]),
        "n_rays": int(header["n_rays"]),
        "statistics": SufficientStatistics.from_arrays(statistics, faces) if statistics else None,
        "mount": np.asarray(arrays["mount"], dtype=np.float64),
        "calibration": Calibration.restore(
            sensor.n_rays, header["calibration"], with_prefix("calibration.", arrays)
        ),
        "cells": CellModel.restore(sensor, header["cells"], with_prefix("cells.", arrays))
        if "cells" in header
        else None,
    }


_INTEGER_FIELDS: dict[str, type] = {"first": np.intp, "neighbour": np.intp}


def _check_other_fields(
    faces: FaceSet, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Check everything but the faces themselves."""
    check_shape("hits", arrays["hits"], (faces.n_faces,), "f")
    check_shape("mount", arrays["mount"], (3,), "f")
    check_shape("crossed.origin", arrays["crossed.origin"], (2,), "f")
    counts = arrays["crossed.counts"]
    if counts.ndim != 2 or counts.size == 0 or counts.dtype != np.uint8:
        raise ValueError(
            f"crossed.counts has shape {counts.shape} of {counts.dtype}, expected (nx, ny) of uint8"
        )
    check_shape("crossed.free", arrays["crossed.free"], counts.shape, "b")
    check_positive("cell", header["cell"])
    check_range("returns", header["returns"], 0, 1 + ROUNDING)
    check_range("n_rays", header["n_rays"], 0)
    check_positive("noise.sigma", header["noise"]["sigma"])
    check_range("noise", list(header["noise"].values()), 0)
    if statistics := with_prefix("memory.", arrays):
        face, cells = statistics["face"], statistics["left.cells"]
        check_shape("memory.face", face, statistics["t"].shape, "iu")
        check_range("memory.face", face, 0, faces.n_faces - 1)
        check_shape("memory.left.cells", cells, (len(cells), 2), "iu")
        check_shape("memory.left.moments", statistics["left.moments"], (len(cells), N_MOMENTS), "f")


def _check_face_set(faces: FaceSet) -> None:
    """Check arrays that kernels would otherwise read beyond their ends."""
    k, e = faces.n_faces, len(faces.edges)
    shapes = {name: np.shape(getattr(faces, name)) for name in FaceSet._fields}
    expected = {"normals": (k, 2), "offsets": (k,), "first": (k + 1,)} | dict.fromkeys(
        ("edges", "levels", "blur", "neighbour"), (e,)
    )
    if shapes != expected:
        raise ValueError(f"faces have shapes {shapes}, expected {expected}")
    if faces.first[0] != 0 or faces.first[-1] != e or (np.diff(faces.first) < 1).any():
        raise ValueError(
            f"faces' edges start at {faces.first.tolist()[:8]} ..., expected 0 to {e}, increasing"
        )
    check_range("levels", faces.levels, 0, 1 + ROUNDING)
    check_range("blur", faces.blur, 0)
    ends = faces.first[1:] - 1
    if faces.levels[ends].any():
        raise ValueError("levels is positive at the last edge of a face, expected 0")
    inside = np.ones(e, dtype=np.bool_)
    inside[ends] = False
    if (np.diff(faces.edges)[inside[:-1]] < 0).any():
        raise ValueError("the edges of a face are not in increasing order")
    if (np.abs(np.hypot(*faces.normals.T) - 1) > ROUNDING).any():
        raise ValueError("a normal of a face is not a unit vector")
    check_range("offsets", faces.offsets, -MAX_COORDINATE, MAX_COORDINATE)
    check_range("edges", faces.edges, -MAX_COORDINATE, MAX_COORDINATE)
    if len(faces.neighbour) and not (faces.neighbour.min() >= -1 and faces.neighbour.max() < k):
        raise ValueError(
            f"neighbour reaches {faces.neighbour.max()}, expected less than {k}, the number of faces"
        )
