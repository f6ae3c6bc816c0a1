"""The sensorgraph: what the sensor perceives at every (x, y, phi), where this is supported by data, and its file."""

from __future__ import annotations

import io
import json
import math
import textwrap
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from logs.files import atomic_file
from logs.html_table import html_table
from logs.inflation import most_plain
from logs.motion import to_ray_starts
from logs.run import PoseFrame, RangeSensor, rare_times, with_rare_times
from sensorgraph.errors import SensorgraphError
from sensorgraph.models import MODELS
from sensorgraph.models.base import POINTS, Model, Point, Prediction
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.models.stored_numbers import check_numbers
from sensorgraph.types import Floats, Progress

FORMAT = "sensorgraph"
VERSION = 1
"""Version of the file format; a reader refuses a newer one."""
POSES_AT_A_TIME = 2048
"""Number of poses predicted together; it limits memory and sets the interval of progress reports."""
MAX_POSE_DISTANCE = 1e8
"""[m] Largest accepted distance of a pose from the origin of map."""
MAX_HEADING = 100.0
"""[rad] Largest accepted heading: unwrapped ones grow by full turns, and larger ones are probably degrees."""
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # a fixed date, so that the same graph gives the same bytes
_MAY_BE_NAN = ("calibration.offset_se",)
"""Arrays of a file in which nan marks a quantity that was not identified."""
_SENSOR_FIELDS = ("range_min", "range_max", "sigma", "resolution", "rate", "sweep_time", "height")


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensorgraph:
    """A fitted model of perception, its sensor and its origin."""

    model: Model
    sensor: RangeSensor
    pose_frame: PoseFrame
    """Frame of the poses that `predict` takes: that of the training poses."""
    origin: Mapping[str, Any]
    """Origin of the graph as plain data: `version`, `inputs`, `options`, `split` and counts."""
    memory: ResidualMemory | None = None
    """Correlation of the residuals between places and times, used for drawing only; None: not identified."""

    def predict(
        self,
        poses: Floats,
        *,
        rays: Sequence[int] | NDArray[np.integer] | None = None,
        point: Point = "mode",
        progress: Progress | None = None,
    ) -> Prediction:
        """Predict what the sensor perceives.

        Parameters
        ----------
        poses : (n_poses, 3) [m, m, rad] of `pose_frame` in map; or (n_poses, n_rays, 3), one pose for each ray,
            as while a laser sweeps on a moving robot (`logs.motion.ray_poses`).
        rays : Indices of the predicted rays. None: all rays.
        point : Point value of the mixture that `Prediction.ranges` holds.
        progress : Called with the number of poses done and the total.

        Returns
        -------
        Prediction with arrays (n_poses, n_rays)

        Raises
        ------
        ValueError : The poses have another shape.
        SensorgraphError : A pose is not finite or too far from the origin, a ray or point value is unknown, or headings are
            in degrees. Unwrapped headings, of several turns, are accepted up to 100 rad; not if one exceeds a
            turn and all are whole numbers.
        """
        poses = np.asarray(poses, dtype=np.float64)
        index = np.arange(self.sensor.n_rays) if rays is None else np.asarray(rays, dtype=np.intp)
        self._check_rays(index)
        self._check_poses(poses, len(index))
        if point not in POINTS:
            raise SensorgraphError(f"point is {point!r}, expected one of {', '.join(POINTS)}")
        if poses.ndim == 2 and self.sensor.is_composite and self.model.name != "polynomial":
            poses = to_ray_starts(poses[:, None], self.sensor, self.pose_frame)[:, index]
        parts = []
        for first in range(0, max(len(poses), 1), POSES_AT_A_TIME):
            if progress is not None:
                progress(first, len(poses))
            parts.append(self._predict_some(poses[first : first + POSES_AT_A_TIME], index, point))
        return parts[0] if len(parts) == 1 else Prediction.concatenate(parts)

    def _predict_some(self, poses: Floats, index: NDArray[np.intp], point: Point) -> Prediction:
        """Predict the rays `index` at one batch of poses, (n, 3) or (n, n_rays, 3)."""
        if poses.ndim == 2:
            return self.model.predict(poses, index, point)
        of_rays = [
            self.model.predict(np.ascontiguousarray(poses[:, j]), index[j : j + 1], point)
            for j in range(len(index))
        ]
        return Prediction.concatenate(of_rays, axis=1)

    def _check_poses(self, poses: Floats, n_rays: int) -> None:
        if poses.shape[-1:] != (3,) or poses.shape[1:-1] not in ((), (n_rays,)):
            raise ValueError(
                f"poses has shape {poses.shape}, expected (n_poses, 3) for x, y, phi or (n_poses, {n_rays}, 3)"
            )
        flat = poses.reshape(len(poses), -1, 3)
        if not np.isfinite(poses).all():
            row = int(np.flatnonzero(~np.isfinite(flat).all(axis=(1, 2)))[0])
            raise SensorgraphError(f"pose {row} is not finite; remove such poses")
        phi = poses[..., 2]
        if (most := np.abs(phi).max(initial=0.0)) > 2 * math.pi and (
            most > MAX_HEADING or (phi == phi.round()).all()
        ):
            raise SensorgraphError(
                f"a pose has the heading {most:g}; radians expected: use np.radians(degrees)"
            )
        if np.abs(poses[..., :2]).max(initial=0.0) > MAX_POSE_DISTANCE:
            row, ray = divmod(int(np.abs(flat[..., :2]).max(axis=2).argmax()), flat.shape[1])
            raise SensorgraphError(
                f"pose {row} is at {flat[row, ray, :2].tolist()} m; expected at most {MAX_POSE_DISTANCE:g} m from the origin"
            )

    def __repr__(self) -> str:
        """Summarise the contents and the origin in a few lines."""
        facts = "; ".join(f"{label}: {text}" for label, text in self.model.summary().items())
        inputs = ", ".join(str(entry.get("name", "?")) for entry in self.origin.get("inputs", ()))
        lines = [
            f"Sensorgraph of model {self.model.name}: {self.sensor.n_rays} rays, poses of {self.pose_frame}",
            facts,
            f"built from {inputs or 'unknown runs'}",
        ]
        return "\n".join(textwrap.shorten(line, 160, placeholder=" ...") for line in lines)

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows: facts of the model and its training runs."""
        inputs = ", ".join(str(entry.get("name", "?")) for entry in self.origin.get("inputs", ()))
        rows = [
            ("rays", f"{self.sensor.n_rays}, poses of {self.pose_frame}"),
            *self.model.summary().items(),
            ("built from", inputs or "unknown runs"),
        ]
        return html_table(f"Sensorgraph, model {self.model.name}", rows)

    def facts(self) -> dict[str, str]:
        """Return the main facts of the model and of the memory, if there is one, as label -> text."""
        return {
            **self.model.summary(),
            **({} if self.memory is None else {"memory": self.memory.summary()}),
        }

    def equation(self, ray: int) -> str:
        """Return the explicit equation of one ray, given by index."""
        self._check_rays(np.array([ray]))
        return self.model.equation(ray)

    def _check_rays(self, rays: NDArray[np.integer]) -> None:
        n_rays = self.sensor.n_rays
        if rays.ndim != 1 or len(rays) == 0 or rays.min() < 0 or rays.max() >= n_rays:
            raise SensorgraphError(
                f"ray {', '.join(map(str, rays.ravel().tolist()))} does not exist; this sensor has rays 0 to {n_rays - 1}"
            )

    def save(self, path: Path | str) -> None:
        """Write one file; the same graph gives the same bytes.

        Raises
        ------
        OSError : The file cannot be written.
        """
        header, arrays = self.model.state()
        sensor = {name: getattr(self.sensor, name) for name in _SENSOR_FIELDS} | rare_times(self.sensor)
        top = {
            "format": FORMAT,
            "version": VERSION,
            "model": self.model.name,
            "pose_frame": self.pose_frame,
            "sensor": sensor,
            "origin": dict(self.origin),
            "state": header,
        }
        members = {"header.json": json.dumps(top, indent=1, sort_keys=True).encode()}
        arrays = {**arrays, **_sensor_arrays(self.sensor)}
        arrays |= {} if self.memory is None else self.memory.arrays()
        for name in sorted(arrays):
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(arrays[name]), allow_pickle=False)
            members[f"{name}.npy"] = buffer.getvalue()
        with (
            atomic_file(Path(path)) as part,
            zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as file,
        ):
            for name, data in members.items():
                info = zipfile.ZipInfo(name, date_time=_ZIP_DATE)
                info.compress_type = zipfile.ZIP_DEFLATED
                info.external_attr = 0o644 << 16
                file.writestr(info, data)

    @classmethod
    def load(cls, path: Path | str) -> Sensorgraph:
        """Read a file written by `save`; no code of the file is executed.

        Raises
        ------
        SensorgraphError : The file is not a sensorgraph, is damaged, or has a newer version.
        """
        path = Path(path)
        top, arrays = _read(path)
        if top.get("format") != FORMAT or not isinstance(top.get("version"), int):
            raise SensorgraphError(f"{path}: not a sensorgraph; build one with `sensorgraph build`")
        if top["version"] > VERSION:
            raise SensorgraphError(
                f"{path}: the file has version {top['version']}, this software reads up to version {VERSION}; "
                "install a newer sensorgraph"
            )
        if top.get("model") not in MODELS:
            raise SensorgraphError(
                f"{path}: model {top.get('model')!r} is not known; expected {', '.join(MODELS)}"
            )
        try:
            check_numbers(top["state"], arrays, may_be_nan=_MAY_BE_NAN)
            _check_origin(top)
            scalars: dict[str, Any] = {name: float(top["sensor"][name]) for name in _SENSOR_FIELDS}
            sensor = RangeSensor(
                bearings=arrays.pop("sensor.bearings"),
                mount=arrays.pop("sensor.mount"),
                origins=arrays.pop("sensor.origins", np.zeros((0, 2))),
                cones=arrays.pop("sensor.cones", np.zeros(0)),
                delays=arrays.pop("sensor.delays", np.zeros(0)),
                **scalars,
            )
            sensor = with_rare_times(sensor, top["sensor"])
            model = MODELS[top["model"]].restore(sensor, top["state"], arrays)
            memory = ResidualMemory.restore(arrays)
            return cls(
                model=model, sensor=sensor, pose_frame=top["pose_frame"], origin=top["origin"], memory=memory
            )
        except (
            KeyError,
            TypeError,
            ValueError,
            AttributeError,
            IndexError,
            OverflowError,
            MemoryError,
        ) as exc:
            detail = f"{type(exc).__name__}: {exc}"
            raise SensorgraphError(f"{path}: the sensorgraph is damaged ({detail}); build it again") from exc


def _check_origin(top: Mapping[str, Any]) -> None:
    """Check the frame of the poses and the form of the origin against what `save` writes."""
    if top["pose_frame"] not in get_args(PoseFrame):
        raise ValueError(f"pose_frame is {top['pose_frame']!r}, expected {' or '.join(get_args(PoseFrame))}")
    inputs = top["origin"].get("inputs", [])
    if not isinstance(inputs, list) or not all(isinstance(entry, dict) for entry in inputs):
        raise ValueError(f"the inputs are {inputs!r}, expected a list with one entry for each run")


def _sensor_arrays(sensor: RangeSensor) -> dict[str, NDArray[Any]]:
    """Return the arrays of a sensor; origins, cones and delays only where they differ from those of a single laser."""
    arrays = {"sensor.bearings": sensor.bearings, "sensor.mount": sensor.mount}
    if sensor.is_composite:
        arrays["sensor.origins"] = sensor.origins
    arrays |= {"sensor.cones": sensor.cones} if sensor.cones.any() else {}
    return arrays | ({"sensor.delays": sensor.delays} if sensor.delays.any() else {})


def _read(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with zipfile.ZipFile(path) as file:
            if "header.json" not in file.namelist():
                raise SensorgraphError(f"{path}: not a sensorgraph; build one with `sensorgraph build`")
            stored, promised = path.stat().st_size, sum(info.file_size for info in file.infolist())
            if promised > most_plain(stored):
                raise SensorgraphError(
                    f"{path}: {stored:,} bytes claim to unpack to {promised:,}, which no sensorgraph does; "
                    "the file is damaged or malicious: build it again"
                )
            top = json.loads(file.read("header.json"))
            for name in file.namelist():
                if name.endswith(".npy"):
                    arrays[name.removesuffix(".npy")] = _array(file.read(name))
    except SensorgraphError:
        raise
    except Exception as exc:  # zipfile, zlib and numpy raise many kinds of errors for a damaged file
        if isinstance(exc, OSError) and exc.filename is not None:  # the file cannot be opened
            raise
        raise SensorgraphError(
            f"{path}: not a sensorgraph, or damaged ({exc}); build it again with `sensorgraph build`"
        ) from exc
    if not isinstance(top, dict):
        raise SensorgraphError(f"{path}: not a sensorgraph; build one with `sensorgraph build`")
    return top, arrays


def _array(data: bytes) -> NDArray[Any]:
    """Read one array in numpy's format; its header must declare exactly the bytes that follow."""
    file = io.BytesIO(data)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("an array is stored in another version of numpy's format, expected 1.0")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    if (
        dtype.hasobject
        or min(shape, default=0) < 0
        or math.prod(shape) * dtype.itemsize != len(data) - file.tell()
    ):
        raise ValueError(f"an array declares {shape} of {dtype}, but holds {len(data) - file.tell()} bytes")
    flat = np.frombuffer(data, dtype=dtype, offset=file.tell()).astype(dtype.newbyteorder("="))
    return flat.reshape(shape, order="F" if fortran else "C")
