"""`sensorgraph locate` and `sg.locate`: files as promised, one line for each mistake."""

from __future__ import annotations

import csv
import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from localization_samples import ROOM, loop_poses, room_run

import logs
import sensorgraph as sg
from logs.run import pair
from sensorgraph.cli import run as command
from sensorgraph.localization.kept import located, needs_locating
from sensorgraph.types import ProgressBars

TRUTH = loop_poses(39, laps=0.43)
"""Poses of a scan each: fewer than the 40 key frames from which the times of the rays are estimated, for seconds."""
PLACE = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "room", "kind": "arena"},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[*[list(wall[:2]) for wall in ROOM[:10]], list(ROOM[0][:2])]],
            },
        },
        {
            "type": "Feature",
            "properties": {"name": "box", "kind": "obstacle"},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[*[list(wall[:2]) for wall in ROOM[10:]], list(ROOM[10][:2])]],
            },
        },
    ],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("locate")
    logs.write(room_run(TRUTH, way_scale=0.97, heading_bias=0.05), path / "raw.mcap")
    (path / "room.geojson").write_text(json.dumps(PLACE))
    return path


def test_what_was_taken_for_granted_of_a_log_is_said_beside_the_result(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = logs.read(folder / "raw.mcap").take_scans(slice(0, 30))
    meta = {**run.meta, "source": "raw.mcap", "notes": "/scan: stamps go back 3 times, sorted"}
    logs.write(replace(run, meta=meta), tmp_path / "raw.mcap")
    arguments = ["--arena", str(folder / "room.geojson"), "--csv", str(tmp_path / "p.csv")]
    assert command(["locate", str(tmp_path / "raw.mcap"), *arguments]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said.count("warning: raw.mcap: /scan: stamps go back 3 times, sorted") == 1


@pytest.mark.parametrize(("is_checked", "n_lines"), [(True, 2), (False, 1)])
def test_what_was_taken_for_granted_is_said_before_the_work_and_after_the_checks(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    is_checked: bool,
    n_lines: int,
) -> None:
    run = logs.read(folder / "raw.mcap").take_scans(slice(0, 30))
    note = "/scan: stamps go back 3 times, sorted"
    logs.write(replace(run, meta={**run.meta, "source": "raw.mcap", "notes": note}), tmp_path / "raw.mcap")

    def stop(*given: object, progress: ProgressBars, **options: object) -> None:
        with progress("tracking", "scans") if is_checked else nullcontext():
            raise logs.LogError("expected more scans")

    monkeypatch.setattr("sensorgraph.localization.locate.locate", stop)
    assert command(["locate", str(tmp_path / "raw.mcap")]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said == [f"warning: raw.mcap: {note}", "error: expected more scans"][-n_lines:]


def test_runs_that_would_get_separate_maps_are_refused_before_they_are_located(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("monday.mcap", "tuesday.mcap"):
        (tmp_path / name).write_bytes((folder / "raw.mcap").read_bytes())
    runs = [str(tmp_path / name) for name in ("monday.mcap", "tuesday.mcap")]
    assert command(["build", *runs, "-o", str(tmp_path / "g.sensorgraph")]) == 2
    said = capsys.readouterr()
    assert "each run would get a separate map" in said.err and "locating" not in said.out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["monday.mcap", "tuesday.mcap"]


def test_locate_in_a_map_writes_run_csv_json_and_picture(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = [
        str(folder / name) for name in ("raw.mcap", "room.geojson", "out.mcap", "p.csv", "l.json", "l.png")
    ]
    arguments = ["--arena", out[1], "-o", out[2], "--csv", out[3], "--json", out[4], "--picture", out[5]]
    assert command(["locate", out[0], *arguments]) == 0
    said = capsys.readouterr().out
    assert "39 of 39 scans located" in said and "wheels: distance scale 1.0" in said
    rows = list(csv.DictReader((folder / "p.csv").read_text().splitlines()))
    assert list(rows[0]) == ["t", "x", "y", "phi", "sigma_x", "sigma_y", "sigma_phi", "status", "map"]
    assert len(rows) == 39 and {(row["status"], row["map"]) for row in rows} == {("ok", "1")}
    raw, located = logs.read(folder / "raw.mcap"), logs.read(folder / "out.mcap")
    np.testing.assert_allclose([float(row["t"]) for row in rows], raw.stamps, atol=1e-6)
    table = np.array([[float(row[name]) for name in ("x", "y", "phi")] for row in rows])
    np.testing.assert_allclose(table, located.poses, atol=1e-6)
    assert np.hypot(*(located.poses - TRUTH)[:, :2].T).max() < 0.02
    assert located.pose_covariances.shape == (39, 3, 3)
    sigma = np.sqrt(np.diagonal(located.pose_covariances, axis1=1, axis2=2))
    np.testing.assert_allclose([float(row["sigma_x"]) for row in rows], sigma[:, 0], atol=1e-6)
    assert json.loads((folder / "l.json").read_text())["ok"] == 39
    assert (folder / "l.png").stat().st_size > 10_000
    np.testing.assert_array_equal(located.ranges, raw.ranges)
    np.testing.assert_allclose(located.odometry, raw.odometry, atol=1e-9)
    assert pair(located).paired.all() and located.meta["pose_source"] == "locate"


def test_tf_of_a_located_run_leads_from_map_to_the_base(folder: Path) -> None:
    found = sg.locate(folder / "raw.mcap", folder / "room.geojson", path=folder / "api.mcap")
    by_tf = logs.read(folder / "api.mcap", topics={"pose": "/tf"})
    np.testing.assert_allclose(by_tf.poses[:, :2], found.poses[:, :2], atol=1e-6)
    assert "39 of 39 scans located" in repr(found) and found.to_dict()["lost"] == 0
    assert found.run.meta["pose_source"] == "locate"


def test_run_in_a_new_place_is_located_from_where_its_odometry_began(folder: Path) -> None:
    found = sg.locate(folder / "raw.mcap")
    moved = TRUTH - TRUTH[0]
    cos, sin = np.cos(-TRUTH[0, 2]), np.sin(-TRUTH[0, 2])
    x, y = cos * moved[:, 0] - sin * moved[:, 1], sin * moved[:, 0] + cos * moved[:, 1]
    assert np.hypot(found.poses[:, 0] - x, found.poses[:, 1] - y).max() < 0.03


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["raw.mcap", "-o", "out.bag"], "written as *.mcap"),
        (["raw.mcap", "--picture", "p.pdf"], "written as *.png"),
        (["raw.mcap", "-o", "raw.mcap"], "is also the input"),
        (["raw.mcap", "--arena", "nowhere.geojson"], "does not exist"),
        (["one.mcap"], "the run has 1 scan, expected a drive of 10 or more"),
        (["blind.mcap"], "no ray of the run ever returned"),
        (["raw.mcap", "--arena", "square"], "fit nowhere in square"),
    ],
)
def test_mistake_is_one_line_and_exit_code_2(
    folder: Path,
    arguments: list[str],
    says: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = room_run(TRUTH[:12])
    logs.write(replace(run, stamps=run.stamps[:1], ranges=run.ranges[:1]), folder / "one.mcap")
    logs.write(replace(run, ranges=np.full_like(run.ranges, np.inf)), folder / "blind.mcap")
    monkeypatch.chdir(folder)
    assert command(["locate", *arguments]) == 2
    assert says in capsys.readouterr().err.splitlines()[-1]


def test_commands_locate_a_run_without_reference_once_and_keep_it(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert command(["build", "raw.mcap", "--no-calibrate", "-o", "g.sensorgraph"]) == 0
    said = capsys.readouterr().out
    assert "raw.mcap: no reference poses: locating in a new map" in said
    assert "39 of 39 scans located" in said and "saved to raw.mcap.located.mcap" in said
    assert "39 of 39 scans paired" in said
    kept = (folder / "raw.mcap.located.mcap").read_bytes()
    assert command(["evaluate", "g.sensorgraph", "raw.mcap", "--json", "e.json"]) == 0
    said = capsys.readouterr().out
    assert "raw.mcap: using the poses from which g.sensorgraph was built" in said
    assert json.loads((folder / "e.json").read_text())["all"]["median_m"] < 0.03
    assert command(["review", "raw.mcap", "--graph", "g.sensorgraph", "-o", "r.rrd"]) == 0
    assert (folder / "raw.mcap.located.mcap").read_bytes() == kept


def test_another_run_is_located_in_the_graph_that_judges_it(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    if not (folder / "g.sensorgraph").exists():  # the test above has built it
        assert command(["build", "raw.mcap", "--no-calibrate", "-o", "g.sensorgraph"]) == 0
    logs.write(room_run(TRUTH[9:], seed=4), folder / "second.mcap")
    capsys.readouterr()
    assert command(["evaluate", "g.sensorgraph", "second.mcap", "--json", "e2.json"]) == 0
    assert "second.mcap: no reference poses: locating in g.sensorgraph" in capsys.readouterr().out
    assert json.loads((folder / "e2.json").read_text())["all"]["median_m"] < 0.05


def test_kept_poses_are_not_taken_when_the_run_has_changed(folder: Path) -> None:
    path = folder / "changing.mcap"
    logs.write(room_run(TRUTH[:30]), path)
    place = sg.load_arena(folder / "room.geojson")
    first = located(path, logs.read(path), place, name="room")
    assert first.lines and not located(path, logs.read(path), place, name="room").lines
    logs.write(room_run(TRUTH[:30], seed=9), path)
    assert located(path, logs.read(path), place, name="room").lines
    assert located(path, logs.read(path), place, name="room", options={"no_return": "inf"}).lines


def test_runs_are_located_unasked_only_without_reference() -> None:
    raw = replace(room_run(TRUTH[:30]), meta={"pose_source": "odometry /odom"})
    known = replace(raw, pose_stamps=raw.stamps, poses=TRUTH[:30], meta={"pose_source": "/pose"})
    assert needs_locating(raw, 30, None) and not needs_locating(raw, 30, "log")
    assert needs_locating(known, 30, "locate") and not needs_locating(known, 30, None)
    assert not needs_locating(raw, 5, None)  # no drive
    cones = replace(raw, sensor=replace(raw.sensor, cones=np.full(raw.sensor.n_rays, 0.5)))
    assert not needs_locating(cones, 30, None)


def test_two_raw_runs_are_not_put_into_one_graph_from_two_maps(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert command(["build", "raw.mcap", "changing.mcap", "-o", "two.sensorgraph"]) == 2
    assert "build the runs one by one" in capsys.readouterr().err.splitlines()[-1]
    assert command(["build", "raw.mcap", "--poses", "gps", "-o", "two.sensorgraph"]) == 2
    assert "--poses is 'gps', expected log" in capsys.readouterr().err
