"""Files of models that somebody made to do harm, or that were damaged: one line, little memory."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import peak

from benchmarks.fuzz import samples
from robotmodic_ident import IdentError, Moments, Narmax
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph


def test_a_sensorgraph_that_unpacks_to_gibibytes_is_refused_before_it_does(tmp_path: Path) -> None:
    path = tmp_path / "bomb.sensorgraph"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("header.json", "{}")
        with file.open("a.npy", "w", force_zip64=True) as member:
            for _ in range(128):
                member.write(bytes(1 << 20))

    def load() -> None:
        with pytest.raises(SensorgraphError, match="which no sensorgraph does"):
            Sensorgraph.load(path)

    assert peak(load) < 10_000_000


def test_an_array_that_promises_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    array = io.BytesIO()
    np.lib.format.write_array_header_1_0(array, {"descr": "<f8", "fortran_order": False, "shape": (10**10,)})
    path = tmp_path / "bomb.sensorgraph"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("header.json", "{}")
        file.writestr("a.npy", array.getvalue() + bytes(80))
    with pytest.raises(SensorgraphError, match="holds 80 bytes"):
        Sensorgraph.load(path)


@pytest.fixture(scope="module")
def graphs() -> dict[str, bytes]:
    """Files of small graphs, one of each model."""
    return dict(zip(("faces", "polynomial", "cells"), samples.graphs(), strict=False))


def with_member(data: bytes, name: str, change: Callable[[Any], Any]) -> bytes:
    """Change one array, or what header.json says, in the file of a graph; checksums are right again."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as before, zipfile.ZipFile(out, "w") as after:
        for member in before.namelist():
            content = before.read(member)
            if member == name == "header.json":
                top = json.loads(content)
                content = json.dumps(change(top) or top).encode()
            elif member == name:
                array, file = np.load(io.BytesIO(content)), io.BytesIO()
                changed = change(array)
                np.save(file, array if changed is None else changed)
                content = file.getvalue()
            after.writestr(member, content)
    return out.getvalue()


def to(value: float, where: Any = (..., 0)) -> Callable[[Any], None]:
    """Return what puts a value into an array."""

    def change(array: Any) -> None:
        array[where] = value

    return change


def at(path: str, value: object) -> Callable[[Any], None]:
    """Return what puts a value into a header, by the names on the way to it."""

    def change(top: Any) -> None:
        *way, last = path.split(".")
        for step in way:
            top = top[step]
        top[last] = value

    return change


@pytest.mark.parametrize(
    ("model", "member", "change", "said"),
    [
        ("polynomial", "order.npy", to(99), "order is"),
        ("polynomial", "order.npy", to(0, ...), "order holds a term of a ray twice"),
        ("polynomial", "theta.npy", to(np.nan, ...), "theta holds nan"),
        ("polynomial", "theta.npy", to(np.inf, ...), "theta holds inf"),
        ("polynomial", "theta.npy", lambda a: a.astype(complex), "theta holds complex128"),
        ("polynomial", "root.npy", to(1e200, ...), "root holds 1e[+]200"),
        ("polynomial", "returns.npy", to(-1), "returns is -1"),
        ("polynomial", "visited.npy", lambda a: np.tile(a, 2), "visited is not in increasing order"),
        (
            "polynomial",
            "header.json",
            at("state.scale", {"x": [0, 1e-200], "y": [0, 1]}),
            "a width of 1e-200",
        ),
        ("polynomial", "header.json", at("state.scale", {"x": [0, 1]}), "the scale is of x"),
        ("polynomial", "header.json", at("state.choice.degree", -4), "the form is"),
        ("polynomial", "header.json", at("state.support.cell", 0), "the support's cell is 0"),
        (
            "polynomial",
            "header.json",
            at("state.leverage_limit", float("nan")),
            "state.leverage_limit is nan",
        ),
        ("polynomial", "header.json", at("pose_frame", "hand"), "pose_frame is 'hand'"),
        ("polynomial", "header.json", at("origin.inputs", [1]), "the inputs are"),
        ("polynomial", "header.json", at("sensor.sigma", float("nan")), "the sensor has"),
        ("faces", "levels.npy", to(7.0, 0), "levels is"),
        ("faces", "levels.npy", to(0.5, -1), "at the last edge"),
        ("faces", "edges.npy", lambda a: a[::-1], "edges of a face are not in increasing order"),
        ("faces", "offsets.npy", to(1e20, 0), "offsets is"),
        ("faces", "normals.npy", to(0.0, ...), "not a unit vector"),
        ("faces", "neighbour.npy", lambda a: a.astype(float), "neighbour has shape"),
        ("faces", "mount.npy", to(np.nan, ...), "mount holds nan"),
        ("faces", "hits.npy", lambda a: a[1:], "hits has shape"),
        ("faces", "crossed.counts.npy", lambda a: a[:0], "crossed.counts has shape"),
        ("faces", "memory.face.npy", to(10_000, ...), "memory.face is"),
        ("faces", "header.json", at("state.cell", 0), "cell is 0"),
        ("faces", "header.json", at("state.noise.sigma", 0), "noise.sigma is 0"),
        ("faces", "header.json", at("state.returns", 2), "returns is 2"),
        ("cells", "rate.npy", to(255, ...), "rate is 255"),
        ("cells", "rate.npy", lambda a: a.astype(float), "rate holds float64"),
        ("cells", "header.json", at("state.sigma", -1), "sigma is -1"),
    ],
)
def test_a_number_that_no_model_has_is_refused_when_its_graph_is_loaded(
    model: str, member: str, change: Callable[[Any], Any], said: str, graphs: dict[str, bytes], tmp_path: Path
) -> None:
    path = tmp_path / "odd.sensorgraph"
    path.write_bytes(with_member(graphs[model], member, change))
    with pytest.raises(SensorgraphError, match=rf"odd.sensorgraph: the sensorgraph is damaged .*{said}"):
        Sensorgraph.load(path)


def test_arrays_of_the_other_byte_order_predict_the_same(graphs: dict[str, bytes], tmp_path: Path) -> None:
    path, poses = tmp_path / "a.sensorgraph", np.array([[1.0, 1.0, 0.2], [1.1, 1.0, 2.0]])
    path.write_bytes(graphs["cells"])
    right = Sensorgraph.load(path).predict(poses)
    with zipfile.ZipFile(path) as file:
        names = [name for name in file.namelist() if name.endswith(".npy")]
    data = graphs["cells"]
    for name in names:
        data = with_member(data, name, lambda a: a.astype(a.dtype.newbyteorder(">")))
    path.write_bytes(data)
    np.testing.assert_array_equal(Sensorgraph.load(path).predict(poses).ranges, right.ranges)


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays | {"gram": arrays["gram"][:1]},
        lambda arrays: arrays | {"power": np.array([b"x"])},
        lambda arrays: arrays | {"count": np.array([-1])},
        lambda arrays: arrays | {"missing_outputs": np.array([7]), "missing": np.zeros((1, 6, 6))},
        lambda arrays: {name: array for name, array in arrays.items() if name != "cross"},
    ],
)
def test_moments_whose_arrays_do_not_fit_are_refused(change: Callable[[Any], Any], tmp_path: Path) -> None:
    path = tmp_path / "sums.npz"
    path.write_bytes(samples.moments())
    with np.load(path) as data:
        arrays = dict(data)
    assert Moments.load(path).count.tolist() == [30]
    np.savez(path, **change(arrays))
    with pytest.raises(IdentError, match="not a file of moments"):
        Moments.load(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(IdentError, match="not a file of moments"):
        Moments.load(path)


@pytest.mark.parametrize("key", ["output", "stop", "estimator"])
def test_a_model_whose_texts_are_none_is_refused(key: str, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(json.loads(samples.models()[0]) | {key: None}))
    with pytest.raises(IdentError, match=f"{key} is None"):
        Narmax.load(path)


@pytest.mark.parametrize(("theta", "said"), [(float("inf"), "theta is"), (1e308, "too large")])
def test_a_model_with_numbers_beyond_all_is_refused(theta: float, said: str, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    data = json.loads(samples.models()[0])
    data["scale"] = {"y": [0.0, 1e-9], "u": [0.0, 1e-9]}
    data["terms"][0]["theta"] = data["terms"][1]["theta"] = theta
    path.write_text(json.dumps(data))
    with pytest.raises(IdentError, match=said):
        Narmax.load(path).equation()
