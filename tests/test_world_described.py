"""What a robot.yaml states is held against a log; what it does not state is the log's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from conftest import further
from test_building_sweep import N_RAYS, RATE, SWEEP_TIME, run_of
from test_world_ray_order import room

import logs
import sensorgraph as sg
from logs.run import RangeSensor, Run
from logs.stream import McapStream, open_log
from sensorgraph.cli import run as command
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import exported_robot, robot_for
from sensorgraph.world.described import completed, other_rays, rays_text, with_robot
from sensorgraph.world.robot import default_robot, load_robot, parse_robot
from sensorgraph.world.sweep import sweep_warning, with_sweep_of

SHORT = 20.0
"""[s]"""


def silent(run: Run) -> Run:
    """Return the run of a driver that leaves `time_increment` at 0."""
    return replace(run, sensor=replace(run.sensor, sweep_time=0.0))


def reversed_by_driver(run: Run) -> Run:
    """Return the run of a laser that turns clockwise, as a driver that reverses the array and not the times writes it.

    `run` is clockwise: ray 0, of which the stamp is, is taken last.
    """
    sensor = run.sensor
    assert sensor.is_clockwise
    said = replace(sensor, sweep_time=-sensor.sweep_time)
    return replace(run, sensor=said, stamps=run.stamps - sensor.ray_0_after_first)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log whose driver does not state its sweep, a robot.yaml that does, and a graph."""
    place = tmp_path_factory.mktemp("advice")
    logs.write(silent(run_of(0, duration=SHORT)), place / "log.mcap")
    (place / "sweep.yaml").write_text(f"sensor: {{sweep_time: {SWEEP_TIME}}}\n")
    words = ["build", str(place / "log.mcap"), "--robot", str(place / "sweep.yaml")]
    assert command([*words, "--poses", "log", "-o", str(place / "graph.sensorgraph")]) == 0
    return place


@pytest.mark.parametrize(
    "words",
    [
        ["inspect", "log.mcap"],
        ["evaluate", "graph.sensorgraph", "log.mcap", "--poses", "log"],
        *further(
            ["review", "log.mcap", "--poses", "log", "-o", "review.rrd"],
            ["locate", "log.mcap", "--csv", "poses.csv"],
        ),
    ],
    ids=lambda words: words[0],
)
def test_a_robot_file_of_a_sweep_alone_goes_with_every_command(
    folder: Path, words: list[str], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """`inspect` advises to write `sensor.sweep_time` into a robot.yaml; the rays, the mount and the limits are the log's."""
    monkeypatch.chdir(folder)
    assert command([*words, "--robot", "sweep.yaml"]) == 0
    said = "".join(capfd.readouterr())
    assert "set sensor.sweep_time" not in said
    assert (
        said.count(
            "a sweep takes 0 s in the log and 0.2 s in sweep.yaml (`sensor.sweep_time`), which is used"
        )
        == 1
    )


def test_the_python_functions_take_it_as_the_commands_do(folder: Path) -> None:
    run = sg.read(folder / "log.mcap", robot=folder / "sweep.yaml")
    assert run.sensor.sweep_time == SWEEP_TIME
    np.testing.assert_array_equal(run.sensor.mount, [-0.03, 0, 0])
    robot = robot_for(run, folder / "sweep.yaml")
    data, _ = prepare_scans(run, room(), robot)
    for name in ("bearings", "mount", "range_min", "range_max", "sweep_time", "rate"):
        np.testing.assert_array_equal(getattr(data.sensor, name), getattr(run.sensor, name))


def test_each_key_counts_alone() -> None:
    """Of six keys that are stated one by one, each is kept and the others come from the log."""
    logged = run_of(0, duration=3.0).sensor
    values = {
        "range_max": 3.0,
        "range_min": 0.2,
        "sigma": 0.03,
        "height": 0.7,
        "rate": 4.0,
        "resolution": 0.002,
    }
    for name, value in values.items():
        sensor = completed(parse_robot(f"sensor: {{{name}: {value}}}"), logged).sensor
        assert getattr(sensor, name) == value
        for other in values.keys() - {name, "height", "resolution"}:
            assert getattr(sensor, other) == getattr(logged, other)
        assert (sensor.height, sensor.resolution)[name == "height"] == (0.3, 0.001)[
            name == "height"
        ]  # not logged
        np.testing.assert_array_equal(sensor.mount, logged.mount)
        np.testing.assert_array_equal(sensor.bearings, logged.bearings)
    mounted = completed(parse_robot("sensor: {mount: [0.2, 0, 180 deg]}"), logged).sensor
    np.testing.assert_allclose(mounted.mount, [0.2, 0, np.pi])


def test_a_completed_robot_is_written_as_it_is() -> None:
    logged = replace(run_of(0, duration=3.0).sensor, sweep_time=-0.1, first_ray_delay=0.01)
    for text in ("", "sensor: {range_max: 250 cm, n_rays: 90}\nwheels: {base: 30 cm}"):
        robot = completed(parse_robot(text), logged)
        again = parse_robot(robot.text)
        assert again.wheels == robot.wheels
        for name, value in vars(robot.sensor).items():
            np.testing.assert_allclose(getattr(again.sensor, name), value, atol=1e-12)
    stated = parse_robot(f"sensor: {{{rays_text(logged.bearings)}}}")
    assert stated.text == completed(stated, stated.sensor).text  # nothing to add


@pytest.mark.parametrize(
    ("keys", "agrees"),
    [
        ("sigma: 0.01", True),
        ("n_rays: 90", True),
        ("n_rays: 181", False),
        ("fov: 360 deg", True),
        ("fov: 270 deg", False),
        ("n_rays: 90, fov: 360 deg", True),
        ("n_rays: 90, fov: 356 deg", False),
        ("angle_min: 0, angle_increment: 4 deg, n_rays: 90", True),
        ("angle_min: 0, angle_increment: 0.0698, n_rays: 90", True),  # rounded, 0.09° off at the end
        ("angle_min: 176 deg, angle_increment: -4 deg, n_rays: 90", True),
        ("angle_min: 1 deg, angle_increment: 4 deg, n_rays: 90", False),
    ],
)
def test_rays_must_be_as_stated(keys: str, agrees: bool) -> None:
    bearings = run_of(0, duration=3.0).sensor.bearings
    assert (other_rays(parse_robot(f"sensor: {{{keys}}}"), bearings, name="a.mcap") == "") is agrees


def test_the_refusal_of_other_rays_says_which_keys_describe_them() -> None:
    bearings = np.radians(np.linspace(-179, 180, 720))
    text = other_rays(
        parse_robot("sensor: {n_rays: 181, fov: 180 deg}"), bearings, name="a.bag", robot_name="r.yaml"
    )
    assert "the rays of a.bag differ from those of r.yaml (720 rays from -179° to 180°, expected 181" in text
    keys = text.partition("or write ")[2]
    assert keys == "sensor: {angle_min: -179 deg, angle_max: 180 deg, n_rays: 720}"
    assert other_rays(parse_robot(keys), bearings, name="a.bag") == ""


def test_unstated_ray_times_leave_those_of_the_log() -> None:
    run = run_of(0, duration=3.0)
    interlaced = replace(
        run.sensor, sweep_time=0.05, interlaced_sweeps=2, sweep_period=0.1, first_ray_delay=-0.02
    )
    identified = replace(run, sensor=interlaced)
    for text in ("", "sensor: {range_max: 3.5, n_rays: 90, fov: 360 deg}"):
        assert with_sweep_of(identified, parse_robot(text)) is identified
        assert sweep_warning(identified, parse_robot(text)) is None
    later = with_sweep_of(identified, parse_robot("sensor: {first_ray_delay: 10 ms}")).sensor
    assert (later.first_ray_delay, later.sweep_time, later.sweep_period) == (0.01, 0.05, 0.1)
    shorter = with_sweep_of(identified, parse_robot("sensor: {sweep_time: 0.02}")).sensor
    assert (shorter.sweep_time, shorter.interlaced_sweeps, shorter.first_ray_delay) == (0.02, 2, -0.02)
    with pytest.raises(SensorgraphError, match="do not go with those of the log") as caught:
        with_sweep_of(identified, parse_robot("sensor: {sweep_time: 0.2}"))
    assert "\n" not in str(caught.value)


def test_stated_ray_times_are_marked_also_where_the_log_agrees() -> None:
    run = run_of(0, duration=3.0)
    for text in ("sensor: {sweep_time: 0.2}", "sensor: {sweep_time: 0}", "sensor: {first_ray_delay: 0}"):
        assert with_sweep_of(run, parse_robot(text)).meta["ray_times"] == "robot.yaml"
    assert "ray_times" not in with_sweep_of(run, default_robot()).meta


def test_a_negative_sweep_time_gives_each_ray_of_a_clockwise_laser_its_time() -> None:
    """The driver says that the rays are taken from right to left; robot.yaml states the truth in three ways."""
    true = run_of(0, sweep_time=-SWEEP_TIME, duration=SHORT)
    said = reversed_by_driver(true)
    rays = "angle_increment: -4 deg, n_rays: 90, angle_min: 176 deg"
    for text in ("sweep_time: -200 ms", f"{rays}, sweep_time: 200 ms", "sweep_time: -0.2, fov: 360 deg"):
        robot = parse_robot(f"sensor: {{{text}}}")
        assert "counter-clockwise in the log and clockwise in robot.yaml" in (
            sweep_warning(said, robot) or ""
        )
        used = with_sweep_of(said, robot)
        np.testing.assert_allclose(
            used.stamps[:, None] + used.sensor.ray_delays,
            true.stamps[:, None] + true.sensor.ray_delays,
            atol=1e-9,
        )
        assert with_sweep_of(used, robot) is used
    back = with_sweep_of(
        true, parse_robot("sensor: {angle_min: 0, angle_increment: 4 deg, n_rays: 90, sweep_time: 0.2}")
    )
    assert not back.sensor.is_clockwise


def test_a_log_in_pieces_has_the_stamps_of_a_whole_one(tmp_path: Path) -> None:
    """The stamp is that of ray 0, which a clockwise sweep takes last."""
    logs.write(reversed_by_driver(run_of(0, sweep_time=-SWEEP_TIME, duration=SHORT)), tmp_path / "log.mcap")
    robot = parse_robot("sensor: {sweep_time: -0.2}")
    whole = with_sweep_of(logs.read(tmp_path / "log.mcap"), robot)
    log = open_log(tmp_path / "log.mcap")
    assert isinstance(log, McapStream)
    pieces = list(replace(log, head=with_sweep_of(log.head, robot)).pieces())
    epochs = np.repeat([piece.epoch_ns for piece in pieces], [piece.n_scans for piece in pieces])
    stamps = np.concatenate([piece.stamps for piece in pieces]) + (epochs - whole.epoch_ns) / 1e9
    np.testing.assert_allclose(stamps, whole.stamps, atol=1e-6)


def test_a_simulated_clockwise_laser_is_recorded_and_read_as_one(tmp_path: Path) -> None:
    text = "sensor: {n_rays: 36, angle_min: 175 deg, angle_increment: -10 deg, sweep_time: 50 ms, range_max: 20}\n"
    (tmp_path / "robot.yaml").write_text(text)
    path, turn = tmp_path / "run.mcap", tmp_path / "turn.csv"
    stamps = np.arange(0.0, 4.0, 0.02)
    rows = [f"{t:.3f},2.0,2.0,{0.8 * t:.6f},0,0.8,turn" for t in stamps]
    turn.write_text("\n".join(["t,x,y,phi,v,omega,primitive", *rows]) + "\n")
    run = sg.record(turn, "square", tmp_path / "robot.yaml", path=path)
    again = logs.read(path)
    assert again.sensor.sweep_time == pytest.approx(-0.05) and run.sensor.is_clockwise
    np.testing.assert_allclose(again.sensor.bearings, run.sensor.bearings, atol=1e-6)
    assert (run.stamps[:, None] + run.sensor.ray_delays >= -1e-9).all()  # no ray before the drive
    assert with_robot(again, parse_robot(text)).sensor.sweep_time == pytest.approx(-0.05)


def test_the_mount_and_the_base_count_only_if_stated(tmp_path: Path) -> None:
    assert parse_robot("wheels: {radius: 0.05}").stated_base is None
    assert parse_robot("wheels: {base: 30 cm}").stated_base == 0.3
    run = run_of(0, duration=3.0)
    assert with_robot(run, default_robot()) is run
    turned = with_robot(run, parse_robot("sensor: {mount: [0.1, 0, 180 deg]}"))
    assert turned.sensor.mount[2] == pytest.approx(np.pi) and turned.meta["mount"] == "robot.yaml"
    without = robot_for(
        Run(
            sensor=RangeSensor(bearings=np.linspace(-1, 1, N_RAYS), rate=RATE),
            stamps=np.zeros(0),
            ranges=np.zeros((0, N_RAYS)),
        )
    )
    np.testing.assert_array_equal(without.sensor.mount, np.zeros(3))


def test_the_laser_of_a_sensorgraph_and_the_robot_of_a_run_are_exported() -> None:
    sensor = RangeSensor(bearings=np.linspace(-2.0, 2.0, 41), range_max=6.0, sigma=0.02, rate=5.0)
    graph = cast(Sensorgraph, SimpleNamespace(sensor=sensor))
    shipped, found = load_robot(), exported_robot(None, None, graph)
    for laser in (found.sensor, parse_robot(found.text).sensor):
        np.testing.assert_allclose(laser.bearings, sensor.bearings)
        assert (laser.range_max, laser.sigma, laser.rate) == (6.0, 0.02, 5.0)
    assert (found.name, found.wheels, found.limits) == (shipped.name, shipped.wheels, shipped.limits)
    assert exported_robot(found, None, graph) is found
    nothing = np.zeros((1, 41))
    run = Run(sensor=sensor, stamps=np.zeros(1), ranges=nothing, attachments={"robot.yaml": b"name: mover\n"})
    assert exported_robot(None, run, graph).name == "mover"
    uneven = replace(sensor, bearings=sensor.bearings**3)
    with pytest.raises(SensorgraphError, match="not evenly spaced"):
        exported_robot(None, None, cast(Sensorgraph, SimpleNamespace(sensor=uneven)))
