"""Members of the file of a sensorgraph: a header in JSON, and arrays in numpy's format, each checked against its size."""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError
from logs.files import atomic_file
from logs.formats import format_of
from logs.inflation import most_plain
from logs.run import PoseFrame, RangeSensor, rare_times, with_rare_times
from sensorgraph.errors import SensorgraphError
from sensorgraph.models import MODELS
from sensorgraph.models.base import Model
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.models.stored_numbers import check_numbers

FORMAT = "sensorgraph"
VERSION = 1
"""Version of the file format; a reader refuses a newer one."""
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # a fixed date, so that the same graph gives the same bytes
_MAY_BE_NAN = ("calibration.offset_se",)
"""Arrays of a file in which nan marks a quantity that was not identified."""
SENSOR_FIELDS = ("range_min", "range_max", "sigma", "resolution", "rate", "sweep_time", "height")
"""Numbers of a sensor that the file holds."""


def write_members(path: Path, top: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the header and the arrays; the same content gives the same bytes.

    Raises
    ------
    OSError : The file cannot be written.
    """
    members = {"header.json": json.dumps(top, indent=1, sort_keys=True).encode()}
    for name in sorted(arrays):
        buffer = io.BytesIO()
        np.lib.format.write_array(buffer, np.ascontiguousarray(arrays[name]), allow_pickle=False)
        members[f"{name}.npy"] = buffer.getvalue()
    with (
        atomic_file(path) as part,
        zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as file,
    ):
        for name, data in members.items():
            info = zipfile.ZipInfo(name, date_time=_ZIP_DATE)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            file.writestr(info, data)


def write_graph(
    path: Path, *, model: Model, sensor: RangeSensor, pose_frame: PoseFrame, origin: Mapping[str, Any],
    memory: ResidualMemory | None,
) -> None:  # fmt: skip
    """Write the fields of a `Sensorgraph`, which `read_graph` returns.

    Raises
    ------
    OSError : The file cannot be written.
    """
    header, arrays = model.state()
    top = {
        "format": FORMAT,
        "version": VERSION,
        "model": model.name,
        "pose_frame": pose_frame,
        "sensor": {name: getattr(sensor, name) for name in SENSOR_FIELDS} | rare_times(sensor),
        "origin": dict(origin),
        "state": header,
    }
    of_memory = {} if memory is None else memory.arrays()
    write_members(path, top, {**arrays, **sensor_arrays(sensor), **of_memory})


def read_graph(path: Path) -> dict[str, Any]:
    """Read the fields of a `Sensorgraph`.

    Raises
    ------
    SensorgraphError : The file is not a sensorgraph, is damaged, or has a newer version.
    """
    top, arrays = read_members(path)
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
        check_origin(top)
        scalars: dict[str, Any] = {name: float(top["sensor"][name]) for name in SENSOR_FIELDS}
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
        return {
            "model": model, "sensor": sensor, "pose_frame": top["pose_frame"], "origin": top["origin"], "memory": memory,
        }  # fmt: skip
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


def check_origin(top: Mapping[str, Any]) -> None:
    """Check the frame of the poses and the form of the origin against what `save` writes."""
    if top["pose_frame"] not in get_args(PoseFrame):
        raise ValueError(f"pose_frame is {top['pose_frame']!r}, expected {' or '.join(get_args(PoseFrame))}")
    inputs = top["origin"].get("inputs", [])
    if not isinstance(inputs, list) or not all(isinstance(entry, dict) for entry in inputs):
        raise ValueError(f"the inputs are {inputs!r}, expected a list with one entry for each run")


def sensor_arrays(sensor: RangeSensor) -> dict[str, NDArray[Any]]:
    """Return the arrays of a sensor; origins, cones and delays only where they differ from those of a single laser."""
    arrays = {"sensor.bearings": sensor.bearings, "sensor.mount": sensor.mount}
    if sensor.is_composite:
        arrays["sensor.origins"] = sensor.origins
    arrays |= {"sensor.cones": sensor.cones} if sensor.cones.any() else {}
    return arrays | ({"sensor.delays": sensor.delays} if sensor.delays.any() else {})


def _unreadable_text(path: Path, error: Exception) -> str:
    """Return what a file is that cannot be read as a sensorgraph."""
    try:
        kind = format_of(path)
    except LogError:
        return f"{path}: not a sensorgraph, or damaged ({error}); expected a *.sensorgraph of `sensorgraph build`"
    return f"{path} is a log ({kind}) and no sensorgraph; build one from it: sensorgraph build {path} -o {path.stem}.sensorgraph"


def read_members(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    arrays: dict[str, NDArray[Any]] = {}
    if path.is_dir():
        raise SensorgraphError(f"{path} is a folder, expected a *.sensorgraph of `sensorgraph build`")
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
        raise SensorgraphError(_unreadable_text(path, exc)) from exc
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
