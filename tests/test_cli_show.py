"""`show`: what is printed and drawn of a graph, and what is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import logs
from logs.run import RangeSensor, Run
from planners.arena import Arena
from sensorgraph.building.build import build
from sensorgraph.cli import run as cli
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.faces.model import Faces
from sensorgraph.show.figures.face_pieces import residual_pieces, visible_pieces
from sensorgraph.show.figures.sensorgraph import predicted_ends
from sensorgraph.world.raycast import cast

pytestmark = pytest.mark.usefixtures("trusted_scans")


@pytest.fixture(scope="module")
def run(room: Arena, sensor: RangeSensor) -> Run:
    rng = np.random.default_rng(3)
    poses = rng.uniform([0.4, 0.4, -np.pi], [3.6, 2.6, np.pi], (900, 3))
    poses = poses[room.contains(poses[:, :2])][:400]
    stamps = 0.1 * np.arange(400)
    ranges = cast(room, poses, sensor).ranges + 0.01 * rng.normal(size=(400, sensor.n_rays))
    return Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)


@pytest.fixture(scope="module")
def faces(run: Run) -> Sensorgraph:
    return build([run], calibrate=False)


@pytest.fixture(scope="module")
def files(run: Run, faces: Sensorgraph, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("show")
    logs.write(run, folder / "run.mcap")
    faces.save(folder / "faces.sensorgraph")
    build([run], model="polynomial", degree=1, harmonics=1).save(folder / "plain.sensorgraph")
    return folder


@pytest.fixture(scope="module")
def cells(run: Run, files: Path) -> None:
    """Add a graph of cells, which takes seconds."""
    build([run], model="cells").save(files / "cells.sensorgraph")


def test_visible_stretches_lie_on_the_walls(room: Arena, faces: Sensorgraph) -> None:
    assert isinstance(faces.model, Faces)
    pieces = visible_pieces(faces.model)
    a, d = room.walls[:, 0], room.walls[:, 1] - room.walls[:, 0]
    points = pieces.ends[pieces.values > 0.5].reshape(-1, 1, 2)
    share = np.clip(((points - a) * d).sum(-1) / (d * d).sum(-1), 0, 1)
    off = np.linalg.norm(points - a - share[..., None] * d, axis=-1).min(axis=1)
    assert np.median(off) < 0.005
    assert off.max() < 0.05  # an end may overshoot a corner by what the looks there allow
    length = np.linalg.norm(np.diff(pieces.ends, axis=1)[:, 0], axis=-1)
    assert length[pieces.values > 0.5].sum() == pytest.approx(
        14.0 + 2.0, rel=0.08
    )  # room and pillar; a little is doubled


def test_a_wall_that_moved_shows_as_the_residual_along_its_face(
    room: Arena, run: Run, faces: Sensorgraph
) -> None:
    walls = room.walls.copy()
    walls[walls == 4.0] = 4.03  # the wall at x = 4 is 3 cm farther
    moved = replace(room, walls=walls)
    assert isinstance(faces.model, Faces)
    poses = run.poses
    seen = replace(run, ranges=cast(moved, poses, run.sensor).ranges)
    pieces = residual_pieces(faces.model, *predicted_ends(faces, seen))
    east = np.abs(pieces.normals[:, 0] + 1) < 0.01
    east &= pieces.ends[:, 0, 0] > 3.9
    assert np.isfinite(pieces.values[east]).mean() > 0.9
    # 3 cm over the cosine of the incidence, which is 1.15 to 1.6 on average over a half circle of headings
    assert 0.03 < np.nanmedian(pieces.values[east]) < 0.05
    assert np.nanmedian(np.abs(pieces.values[~east])) < 0.002


@pytest.mark.slow
@pytest.mark.usefixtures("cells")
@pytest.mark.parametrize("name", ["faces", "cells"])
@pytest.mark.parametrize("with_run", [True, False])
def test_faces_and_cells_are_drawn(name: str, with_run: bool, files: Path, tmp_path: Path) -> None:
    out = tmp_path / "figure.png"
    words = ["show", str(files / f"{name}.sensorgraph"), "--out", str(out)]
    assert cli([*words, *(["--run", str(files / "run.mcap")] if with_run else [])]) == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    first = out.read_bytes()
    assert cli([*words, *(["--run", str(files / "run.mcap")] if with_run else [])]) == 0
    assert out.read_bytes() == first


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("{d}/plain.sensorgraph --out {out}/a.png", "neither faces nor cells to draw"),
        ("{d}/faces.sensorgraph --run {d}/run.mcap", "--run is for the picture"),
        ("{d}/faces.sensorgraph --out {out}/a.pdf", "name it a.png"),
    ],
)
def test_what_cannot_be_drawn_is_said_in_one_line(
    words: str, says: str, files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli(["show", *words.format(d=files, out=tmp_path).split()]) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert says in said
    assert not list(tmp_path.iterdir())


def test_a_ray_shows_its_main_faces_first_and_the_rest_on_request(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["show", str(files / "faces.sensorgraph"), "--ray", "5"]
    assert cli(words) == 0
    short = capsys.readouterr().out
    assert cli([*words, "--all"]) == 0
    full = capsys.readouterr().out
    shares = [float(one) for one in re.findall(r"stops it at ([\d.]+) % of poses", full)]
    assert shares == sorted(shares, reverse=True)
    shown = re.findall(r"^face \d+", short, re.MULTILINE)
    assert 4 <= len(shown) <= len(shares) == len(re.findall(r"^face \d+", full, re.MULTILINE))
    assert ("--all prints them" in short) == (len(shown) < len(shares))
    assert cli(["show", words[1], "--all"]) == 2
    assert "--all is for the equation of a ray; give --ray INDEX" in capsys.readouterr().err
