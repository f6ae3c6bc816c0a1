"""Small whole files of every kind, to be damaged; written by the packages themselves where they can write them."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import logs
from benchmarks.fuzz.structure.draft import EPOCH, Draft, Item, vec7
from benchmarks.fuzz.structure.writers import write_bag, write_file
from logs.run import RangeSensor, Run
from robotmodic_ident import Moments, Terms, fit, polynomial
from sensorgraph.building.build import build
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.effect import Parameter

GEOJSON = json.dumps({"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"name": "room", "kind": "arena", "surfaces": {"1": "glass"}},
     "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]]}},
    {"type": "Feature", "properties": {"name": "box", "kind": "obstacle"},
     "geometry": {"type": "Polygon", "coordinates": [[[1, 2], [2, 2], [2, 2.5], [1, 2.5], [1, 2]]]}}]}).encode()  # fmt: skip
NO_GO = json.dumps({"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"name": "rug", "kind": "no_go"},
     "geometry": {"type": "Polygon", "coordinates": [[[3, 0.5], [3.5, 0.5], [3.5, 1], [3, 1], [3, 0.5]]]}}]}).encode()  # fmt: skip
MAP = b"image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n"
PGM = b"P5\n8 6\n255\n" + bytes([254] * 40 + [0] * 8)
ROBOT = b"""name: a
drive: diff
footprint_radius: 0.2
limits: {v: 0.4, omega: 1.0, a: 0.5, alpha: 2.0, turning_radius: 0.0}
sensor: {mount: [0.1, 0.0, 0.0], n_rays: 7, fov: 3.0, range_min: 0.05, range_max: 8.0, sigma: 0.01, rate: 10.0, sweep_time: 0.01}
pose: {rate: 30.0, sigma_xy: 0.002}
actuators: {tau: 0.1, delay: 0.0}
"""
CAR = b"""drive: reeds_shepp
limits: {v: 0.3, omega: 1.0, a: 0.5, alpha: 2.0, turning_radius: 0.4}
sensor: {n_rays: 9, fov: 180 deg, resolution: 0.001, rate: 5.0, sweep_time: 0.1, height: 0.2}
wheels: {radius: 0.1, base: 0.4, sigma_v: 0.01, sigma_omega: 0.01, rate: 20.0}
tolerances: {map: 0.01, mount_xy: 0.002, mount_yaw: 0.001, pose_xy: 0.002, pose_yaw: 0.001, stamp: 0.003,
  control_period: 0.05, transport_jitter: 0.005}
"""
SONARS = b"""sensors:
  - {ring: 6, radius: 0.2, first: 10 deg, cone: 0.06}
  - {name: /front, mount: [0.25, 0.0, 0.0], n_rays: 5, fov: 1.57}
sensor: {range_min: 0.05, range_max: 4.0, sigma: 0.01, rate: 10.0}
"""
CLOCKWISE = b"""footprint_radius: 20 cm
limits: {v: 40 cm/s, omega: 60 deg/s, a: 500 mm/s^2, alpha: 2 rad/s2}
sensor: {mount: [120 mm, 0, 1.5 deg], angle_min: 179 deg, angle_max: -179 deg, angle_increment: -0.25 deg, n_rays: 1433,
  sweep_time: 33 ms, rate: 600 rpm}
"""
ROBOTS = (ROBOT, CAR, SONARS, CLOCKWISE)
EFFECTS_FILE = b"""- name: mount_yaw
  parameters: {delta: 0.02}
  stderr: {delta: 0.001}
  probability: 0.9
  evidence: 12.0
"""
TRAJECTORY = (
    b"t,x,y,phi,v,omega,primitive\n0,1,1,0,0,0,move\n0.02,1,1,0,0.1,0,move\n0.04,1.1,1,0,0.1,0,move\n"
)
PLAN = b'{"planner": "coverage", "planning_s": 1.0, "coverage": 0.9, "duration": 2.0, "n_waypoints": 3}\n'
POSES = b"x,y,phi\n1,1,0\n1.5,1,0.2\n"
SIGNALS = b"t,record,u,y\n" + b"".join(b"%d,0,%d,0.%d\n" % (i, i % 3, i % 7) for i in range(40))
METADATA = b"""rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths: [a.db3]
  message_count: 12
  compression_format: ""
  compression_mode: ""
"""


def some_run() -> Run:
    """Return a run of 60 scans of 7 rays in the room of GEOJSON, with every signal."""
    n = 60
    t = np.arange(n) / 10
    poses = np.column_stack([1 + 0.05 * t, 1 + 0 * t, 0.1 * t + 0.0123])
    bearings = np.linspace(-1.5, 1.5, 7)
    around = np.add.outer(poses[:, 2], bearings)
    cos, sin = np.cos(around), np.sin(around)
    along_x = (np.where(cos > 0, 4.0, 0.0) - poses[:, :1] - 0.1 * np.cos(poses[:, 2:])) / cos
    along_y = (np.where(sin > 0, 3.0, 0.0) - poses[:, 1:2] - 0.1 * np.sin(poses[:, 2:])) / sin
    ranges = np.minimum(along_x, along_y) + 0.01 * np.sin(np.add.outer(3 * t, np.arange(7)))
    ranges[3, 2], ranges[4, 1], ranges[5, 0] = np.inf, -np.inf, np.nan
    return Run(
        sensor=RangeSensor(bearings=bearings, mount=np.array([0.1, 0.0, 0.0]), range_min=0.05, range_max=8.0, sweep_time=0.01),
        stamps=t, ranges=ranges, pose_stamps=t, poses=poses, odom_stamps=t, odometry=poses,
        odom_twists=np.column_stack([0.05 + 0 * t, 0.1 + 0 * t]), cmd_stamps=t, commands=np.zeros((n, 2)),
        meta={"source": "fuzz"}, attachments={"arena.geojson": GEOJSON, "robot.yaml": ROBOT},
    )  # fmt: skip


def sonar_run() -> Run:
    """Return the same with rays that start in places of their own, and are cones."""
    run = some_run()
    around = run.sensor.bearings
    origins = 0.2 * np.column_stack([np.cos(around), np.sin(around)])
    return replace(run, sensor=replace(run.sensor, origins=origins, cones=np.full(7, 0.05), sweep_time=0.0))


def bytes_of(suffix: str, write: Callable[[Path], object]) -> bytes:
    """Return what `write` writes to a file of this suffix."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        write(path)
        return path.read_bytes()


def of_runs(suffix: str) -> tuple[bytes, ...]:
    """Return both runs as files."""
    return tuple(
        bytes_of(suffix, lambda path, run=run: logs.write(run, path)) for run in (some_run(), sonar_run())
    )  # type: ignore[misc]


LASER = {
    "angle_min": -1.0, "angle_max": 1.0, "angle_increment": 1.0, "time_increment": 0.0, "scan_time": 0.1,
    "range_min": 0.0, "range_max": 8.0, "ranges": [1.0, 2.0, 3.0], "intensities": [],
}  # fmt: skip


Contents = Mapping[str, Callable[[int], Mapping[str, Any]]]
"""Kind of a message -> its content by its number."""


def items_of(contents: Contents, n: int = 12) -> list[Item]:
    """Return n messages of each kind, one a second, in the frame of the laser."""
    at = [k - EPOCH for k in range(n)]
    return [
        Item(f"/{kind[-4:]}", kind, at[k], at[k], "laser", dict(content(k)))
        for k in range(n)
        for kind, content in contents.items()
    ]


@cache
def small_bag() -> bytes:
    """Return a rosbag2 sqlite3 file of twelve small scans."""
    draft = Draft(items=items_of({"LaserScan": lambda _: LASER}))
    return bytes_of(".db3", lambda path: write_file(path, draft))


def ros1_bag(contents: Contents, n: int = 12, packing: str = "") -> bytes:
    """Return a ROS 1 bag of n messages of each kind."""
    draft = Draft(items=items_of(contents, n))
    return bytes_of(".bag", lambda path: write_bag(path, draft, compression=packing))


def ros1_bags() -> tuple[bytes, ...]:
    """Return ROS 1 bags of scans and poses, plain and packed."""
    contents = {"LaserScan": lambda _: LASER, "PoseStamped": lambda i: {"pose": vec7(0.1 * i, 0.0, 0.0)}}
    return tuple(ros1_bag(contents, packing=packing) for packing in ("", "bz2", "lz4"))


def interrupted_bags() -> tuple[bytes, ...]:
    """Return ROS 1 bags that were not closed: cut in their index, and inside their last chunk."""
    return tuple(bag[: len(bag) - cut] for bag in ros1_bags() for cut in (700, 2000))


def other_lasers() -> tuple[bytes, ...]:
    """Return ROS 1 bags of laser scans with several echoes, and of point clouds."""
    rays = [np.ones(n) for n in (1, 0, 2, 1, 3)]
    echoes = LASER | {"angle_increment": 0.5, "ranges": rays, "intensities": rays}
    points = np.zeros(120, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("t", "<u4")])
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    for ring in range(2):
        rows = points[ring::2]
        rows["x"], rows["y"], rows["z"] = 2 * np.cos(turn), 2 * np.sin(turn), 0.1 * ring
        rows["ring"], rows["t"] = ring, turn / (2 * np.pi) * 1e9
    cloud = {"points": points, "height": 1}
    return ros1_bag({"MultiEchoLaserScan": lambda _: echoes}, 5), ros1_bag(
        {"PointCloud2": lambda _: cloud}, 5
    )


def carmen() -> bytes:
    """Return a CARMEN log with each kind of line."""
    lines = ["# CARMEN", "PARAM robot_frontlaser_offset 0.1"]
    for i in range(12):
        ranges = " ".join(["1.00"] * 9)
        lines.append(f"ODOM {i / 10} 0 0 0.1 0 0 {i}.0 host {i}.0")
        lines.append(f"FLASER 9 {ranges} {i / 10} 0 0 {i / 10} 0 0 {i}.0 host {i}.0")
        lines.append(
            f"ROBOTLASER1 0 -1.5 3.0 0.4 8.0 0.01 0 9 {ranges} 0 {i / 10} 0 0 0 0 0 0 0 0 0 0 {i}.0 host {i}.0"
        )
    return ("\n".join(lines) + "\n").encode()


def wean() -> bytes:
    """Return a log in the format of Wean Hall."""
    ranges = " ".join(["100"] * 180)
    lines = [f"O {10 * i} 0 0 {i}.0\nL {10 * i} 0 0 {10 * i} 0 0 {ranges} {i}.0" for i in range(12)]
    return ("\n".join(lines) + "\n").encode()


def every_effect() -> tuple[bytes, ...]:
    """Return effects.yaml of the example, and of each effect with values at which it should show."""

    def value(parameter: Parameter) -> float:
        given = (parameter.typical, parameter.materiality, parameter.neutral, 0.1)
        chosen = next(number for number in given if number is not None)
        return float(np.clip(chosen, parameter.low, parameter.high))

    places: dict[str | None, dict[str, Any]] = {
        "wall": {"name": "room/edge_0"},
        "obstacle": {"name": "box"},
        "spot": {"xy": [1.0, 1.0]},
    }
    entries: list[dict[str, Any]] = []
    for effect in EFFECTS.values():
        entry: dict[str, Any] = {
            "name": effect.name,
            "parameters": {p.name: value(p) for p in effect.parameters},
        }
        if effect.place in places:
            entry["location"] = places[effect.place]
        entries.append(entry)
    return (EFFECTS_FILE, *(yaml.safe_dump([entry], sort_keys=False).encode() for entry in entries))


@cache
def graphs() -> tuple[bytes, ...]:
    """Return a small sensorgraph of each kind."""
    plain, sonars = some_run(), sonar_run()
    kinds: tuple[tuple[Run, str, dict[str, Any]], ...] = (
        (plain, "faces", {"calibrate": False}),
        (plain, "polynomial", {"degree": 2, "harmonics": 1, "n_terms": 4}),
        (plain, "cells", {}),
        (sonars, "faces", {"calibrate": False}),
    )
    return tuple(
        bytes_of(".sensorgraph", build([run], model=model, **given).save) for run, model, given in kinds
    )


def models() -> tuple[bytes, ...]:
    """Return identified models: a plain one, one with shapes and noise terms, and one that steers by a ray."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=200)
    y = np.zeros(200)
    for k in range(1, 200):
        y[k] = 0.5 * y[k - 1] + u[k - 1] + 0.1 * np.sin(u[k - 1])
    record = {"y": y, "u": u}
    plain = fit(record, "y", Terms.parse("1", "y(k-1)", "u(k-1)", "u(k-1)^2"), n_terms=3)
    noisy = fit(record, "y", Terms.parse("1", "y(k-1)", "sin(u(k-1))", "u(k-1)"), n_terms=3, noise=1)
    steer = fit({"cmd_omega": y, "L0": u}, "cmd_omega", Terms.parse("1", "L0(k)", "L0(k-1)"), n_terms=2)
    controller = steer.to_dict() | {"period_s": 0.1, "held": {"cmd_v": 0.2}}
    return tuple(json.dumps(data).encode() for data in (plain.to_dict(), noisy.to_dict(), controller))


def moments() -> bytes:
    """Return saved moments."""
    rng = np.random.default_rng(0)
    columns = {"x": rng.normal(size=30), "y": rng.normal(size=30)}
    sums = Moments(polynomial(["x", "y"], 2), 1).add(columns, columns["x"][:, None])
    return bytes_of(".npz", sums.save)
