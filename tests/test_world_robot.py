"""robot.yaml: defaults, every mistake in one line with what to do."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from sensorgraph.errors import SensorgraphError
from sensorgraph.world.robot import SECTIONS, TOP, Robot, load_robot, parse_robot
from sensorgraph.world.robot_sensor import MOUNTED, RING, bearings
from sensorgraph.world.robot_values import KINDS


def plain(robot: Robot) -> dict[str, object]:
    parts = (robot.limits, robot.pose, robot.wheels, robot.actuators, robot.tolerances)
    facts: dict[str, object] = robot.to_dict()
    for part in parts:
        facts |= {f"{type(part).__name__}.{k}": v for k, v in vars(part).items() if k != "limits"}
    sensor = {k: np.asarray(v).tolist() for k, v in vars(robot.sensor).items()}
    return facts | sensor


def test_an_empty_file_is_said_in_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "robot.yaml").touch()
    load_robot(tmp_path / "robot.yaml")
    assert caplog.messages == [
        f"{tmp_path / 'robot.yaml'} is empty: every value is the default of robot.yaml"
    ]
    (tmp_path / "robot.yaml").write_text("name: rover")
    load_robot(tmp_path / "robot.yaml")
    assert len(caplog.messages) == 1


def test_an_empty_file_is_the_shipped_robot() -> None:
    shipped = parse_robot((files("sensorgraph.data") / "radix.yaml").read_text())
    assert plain(parse_robot("")) == plain(shipped)
    assert shipped.sensor.n_rays == 181
    assert shipped.sensor.sigma == 0.01


def test_a_key_that_is_given_replaces_its_default_only() -> None:
    robot = parse_robot(
        "drive: reeds_shepp\nlimits: {turning_radius: 0.4}\nsensor: {sigma: 2e-2, mount: [0.1, 0, -3.1]}"
    )
    assert robot.drive == "reeds_shepp"
    assert robot.limits.turning_radius == 0.4
    assert robot.limits.v == 0.4
    assert robot.sensor.sigma == 0.02  # YAML 1.1 takes 2e-2 for a word
    assert robot.sensor.mount.tolist() == [0.1, 0.0, -3.1]


def test_bearings_of_a_full_turn_do_not_meet_themselves() -> None:
    full = bearings(360, 2 * np.pi)
    assert len(np.unique(np.round(np.mod(full, 2 * np.pi), 9))) == 360
    half = bearings(181, np.pi)
    np.testing.assert_allclose(np.degrees(half[[0, 90, 180]]), [-90, 0, 90])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sensr: {}", "unknown key `sensr`; did you mean `sensor`?"),
        ("sensor: {range_mx: 3}", "unknown key `sensor.range_mx`; did you mean `sensor.range_max`?"),
        ("limits: {V: 3}", "did you mean `limits.v`?"),
        ("drive: tank", "expected one of diff, reeds_shepp, dubins"),
        ("drive: dubins", "needs limits.turning_radius > 0"),
        ("footprint_radius: wide", "`footprint_radius` is 'wide', expected a number"),
        ("footprint_radius: 0", "expected a value above 0"),
        ("sensor: {n_rays: 1.5}", "expected a whole number"),
        ("sensor: {n_rays: true}", "expected a whole number"),
        ("sensor: {fov: 270}", "`sensor.fov` is 270; radians expected, at most 6.28; write 270 deg"),
        ("sensor: {fov: 400 deg}", "`sensor.fov` is 400 deg; expected at most 360 deg"),
        (
            "sensor: {mount: [0.1, 0, 180]}",
            "`sensor.mount` is 180; radians expected, at most 6.28; write 180 deg",
        ),
        (
            "sensor: {mount: [120, 0, 0]}",
            "metres expected, at most 20; write 120 mm, or 120 m if metres are meant",
        ),
        (
            "sensors: [{n_rays: 5, fov: 180}]",
            "`sensors[0].fov` is 180; radians expected, at most 6.28; write 180 deg",
        ),
        (
            "sensor: {range_max: 12000}",
            "`sensor.range_max` is 12000; metres expected, at most 200; write 12000 mm, or",
        ),
        ("footprint_radius: 25", "metres expected, at most 20; write 25 cm, or 25 m if metres are meant"),
        (
            "sensor: {sweep_time: 33}",
            "`sensor.sweep_time` is 33; seconds expected, at most 10; write 33 ms, or 33 s",
        ),
        (
            "limits: {omega: 90}",
            "`limits.omega` is 90; rad/s expected, at most 20; write 90 deg/s, or 90 rad/s",
        ),
        ("limits: {v: 400}", "m/s expected, at most 30; write 400 mm/s"),
        ("tolerances: {map: 4.5}", "`tolerances.map` is 4.5; metres expected, at most 1; write 4.5 mm"),
        ("tolerances: {pose_yaw: 1.5}", "radians expected, at most 1; write 1.5 deg"),
        ("sensor: {rate: 20 kHz}", "`sensor.rate` is 20 kHz; expected at most 10 kHz"),
        ("sensor: {rate: 10 ms}", "expected a number such as 10.0, in hertz or with a unit (Hz, kHz, rpm)"),
        (
            "sensor: {fov: 360 grad}",
            "expected a number such as 3.14159265, in radians or with a unit (rad, deg, °",
        ),
        ("sensor: {range_max: .inf}", "`sensor.range_max` is inf, expected a number such as 8.0"),
        ("sensor: {range_max: 8 deg}", "`sensor.range_max` is '8 deg', expected a number such as 8.0"),
        ("sensor: {mount: [1, 2]}", "expected 3 numbers"),
        (
            "sensor: {angle_min: -179 deg}",
            "`sensor.angle_min` alone does not determine the rays; expected n_rays and two of",
        ),
        (
            "sensor: {angle_min: -1, fov: 2}",
            "`sensor.fov` does not go with `sensor.angle_min`; remove one of them",
        ),
        (
            "sensor: {angle_min: -180 deg, angle_max: 180 deg, angle_increment: 0.007}",
            "has 897.6 times angle_increment from angle_min to angle_max, expected a whole number, 0 or more; give n_rays",
        ),
        (
            "sensor: {angle_min: 0, angle_max: 270 deg, angle_increment: 0.25 deg, n_rays: 541}",
            "`sensor` has 541 rays, but 1081 with angle_increment from angle_min to angle_max",
        ),
        (
            "sensor: {angle_min: 0, angle_increment: 1 deg, n_rays: 720}",
            "has 720 rays, 1° apart; expected at most a full",
        ),
        ("sensor: {angle_min: 0, angle_max: 0, n_rays: 7}", "has an angle between rays of 0"),
        (
            "sensor: {angle_min: 0, angle_max: 1, angle_increment: -0.1}",
            "`sensor` has -10 times angle_increment",
        ),
        (
            "sensor: {angle_min: 1, angle_max: -1, n_rays: 5, interlaced_sweeps: 2, sweep_period: 0.1}",
            "write a positive angle_increment, and a negative sweep_time",
        ),
        (
            "sensors: [{n_rays: 5, fov: 1}]\nsensor: {angle_min: 1}",
            "`sensor.angle_min` does not go with `sensors`",
        ),
        ("sensor: {sigma: -0.1}", "expected 0 or more"),
        ("sensor: {range_min: 9.0}", "expected 0 <= min < max"),
        ("sensor: {range_max: .nan}", "expected a number"),
        ("sensor: 7", "expected keys"),
        ("- a\n- b", "contains a list"),
        (
            '{"type": "FeatureCollection", "features": []}',
            "contains an arena (keys type, features), expected a robot.yaml",
        ),
        ("image: map.pgm\nresolution: 0.05", "are arena and robot swapped?"),
        ("a: [", "not YAML"),
        ("name: 7", "expected a word"),
    ],
)
def test_a_mistake_is_said_in_one_line(text: str, said: str) -> None:
    with pytest.raises(SensorgraphError) as caught:
        parse_robot(text, name="my.yaml")
    assert said in str(caught.value)
    assert str(caught.value).startswith("my.yaml: ")


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_bytes(bytes(range(256)))
    with pytest.raises(SensorgraphError, match="not a text file"):
        load_robot(tmp_path / "robot.yaml")
    with pytest.raises(SensorgraphError, match="is a directory"):
        load_robot(tmp_path)


def test_angles_may_be_written_in_degrees() -> None:
    said = parse_robot("sensor: {fov: 360 deg, n_rays: 4, mount: [0.1, 0, 90deg]}\npose: {sigma_yaw: 0.1 °}")
    np.testing.assert_allclose(np.degrees(said.sensor.bearings), [-180, -90, 0, 90])
    assert said.sensor.mount[2] == pytest.approx(np.pi / 2)
    assert said.pose.sigma_yaw == pytest.approx(np.radians(0.1))
    ring = parse_robot("sensors: [{ring: 4, first: 45 deg, cone: 15 deg}]").sensor
    np.testing.assert_allclose(np.degrees(ring.bearings), [-135, -45, 45, 135])
    np.testing.assert_allclose(np.degrees(ring.cones), 15)
    assert parse_robot("sensor: {fov: 3.0 rad}").sensor.bearings[-1] == pytest.approx(1.5)


def test_every_number_takes_a_unit() -> None:
    """A new key needs a quantity; whole numbers are counts, a mount has its own."""
    keys = {
        key
        for group in (*SECTIONS.values(), TOP, RING, MOUNTED)
        for key, value in group.items()
        if isinstance(value, float | None)
    }
    assert keys == set(KINDS)


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("5 cm", 0.05), ("120 mm", 0.12), ("120mm", 0.12), ("0.12 m", 0.12), ("250 um", 0.00025), ("1.5e-1 m", 0.15),
    ],
)  # fmt: skip
def test_lengths_have_units(written: str, read: float) -> None:
    assert parse_robot(f"sensor: {{height: {written}}}").sensor.height == pytest.approx(read)
    assert parse_robot(f"sensor: {{mount: [{written}, -{written}, 0]}}").sensor.mount[1] == pytest.approx(
        -read
    )
    assert parse_robot(f"tolerances: {{map: {written}}}").tolerances.map == pytest.approx(read)
    assert parse_robot(f"footprint_radius: {written}").footprint_radius == pytest.approx(read)


def test_all_quantities_have_units() -> None:
    robot = parse_robot(
        "limits: {v: 40 cm/s, omega: 90 deg/s, a: 500 mm/s^2, alpha: 114.6 deg/s2}\n"
        "sensor: {rate: 600 rpm, sweep_time: 33 ms, angle_min: −135 deg, angle_max: 135°, n_rays: 1081}\n"
        "pose: {rate: 2 Hz, sigma_yaw: 0.1 deg}\nwheels: {sigma_v: 4 mm/s, sigma_omega: 0.3 deg/s}\n"
        "actuators: {tau: 120 ms}\ntolerances: {stamp: 3.5 ms, mount_yaw: 0.05 deg, control_period: 20 ms}"
    )
    limits = robot.limits
    assert (limits.v, limits.a) == pytest.approx((0.4, 0.5))
    assert (limits.omega, limits.alpha) == pytest.approx((np.pi / 2, 2.0), rel=1e-3)
    assert (robot.sensor.rate, robot.sensor.sweep_time, robot.pose.rate) == pytest.approx((10.0, 0.033, 2.0))
    np.testing.assert_allclose(np.degrees(robot.sensor.bearings[[0, -1]]), [-135, 135])
    assert (robot.wheels.sigma_v, robot.wheels.sigma_omega) == pytest.approx((0.004, np.radians(0.3)))
    assert (robot.actuators.tau, robot.tolerances.stamp) == pytest.approx((0.12, 0.0035))
    assert (robot.tolerances.mount_yaw, robot.tolerances.control_period) == pytest.approx(
        (np.radians(0.05), 0.02)
    )


def test_a_unit_allows_what_a_bare_number_does_not() -> None:
    """A laser may see 250 m; written without a unit this is more likely in cm."""
    assert parse_robot("sensor: {range_max: 250 m}").sensor.range_max == 250
    with pytest.raises(SensorgraphError, match="250; metres expected, at most 200"):
        parse_robot("sensor: {range_max: 250}")


@pytest.mark.parametrize("fov", ["6.28", "6.2832", "6.283185307", "360 deg", "6.2832 rad"])
def test_a_rounded_full_turn_is_a_full_turn(fov: str) -> None:
    sensor = parse_robot(f"sensor: {{n_rays: 360, fov: {fov}}}").sensor
    np.testing.assert_allclose(np.degrees(sensor.bearings), np.arange(-180, 180))


@pytest.mark.parametrize(
    ("keys", "first", "step", "n_rays"),
    [
        ("angle_min: -179 deg, angle_max: 180 deg, n_rays: 720", -179, 359 / 719, 720),  # RPLIDAR
        ("angle_min: -3.14159, angle_increment: 0.007, n_rays: 897", -180, np.degrees(0.007), 897),  # Velodyne
        ("angle_min: -3.14159, angle_max: 3.14159, angle_increment: 0.007, n_rays: 897", -180, np.degrees(0.007), 897),
        ("angle_min: -135 deg, angle_max: 135 deg, angle_increment: 0.25 deg", -135, 0.25, 1081),
        ("angle_max: 135 deg, angle_increment: 0.25 deg, n_rays: 1081", -135, 0.25, 1081),
        ("angle_min: 0, angle_max: 6.28319, n_rays: 361", 0, 1, 360),  # of a full turn the last ray repeats the first
        ("angle_min: 10 deg, n_rays: 1", 10, 1, 1),
    ],
)  # fmt: skip
def test_rays_are_described_as_in_a_scan_message(keys: str, first: float, step: float, n_rays: int) -> None:
    sensor = parse_robot(f"sensor: {{{keys}}}").sensor
    np.testing.assert_allclose(np.degrees(sensor.bearings), first + step * np.arange(n_rays), atol=1e-3)
    assert not sensor.is_clockwise


@pytest.mark.parametrize(
    ("keys", "is_clockwise"),
    [
        ("angle_min: -90 deg, angle_max: 90 deg, n_rays: 5, sweep_time: 0.1", False),
        ("angle_min: -90 deg, angle_max: 90 deg, n_rays: 5, sweep_time: -0.1", True),
        ("angle_min: 90 deg, angle_increment: -45 deg, n_rays: 5, sweep_time: 0.1", True),
        ("angle_min: 90 deg, angle_max: -90 deg, n_rays: 5, sweep_time: 0.1", True),
        ("angle_min: 90 deg, angle_increment: -45 deg, n_rays: 5, sweep_time: -0.1", False),
        ("angle_min: 90 deg, angle_increment: -45 deg, n_rays: 5", True),
        ("fov: 180 deg, n_rays: 5, sweep_time: -0.1", True),
    ],
)
def test_rays_and_their_times_go_either_way(keys: str, is_clockwise: bool) -> None:
    """Bearings rise in memory; times follow the order of the file, from its last ray if the sweep time is negative."""
    sensor = parse_robot(f"sensor: {{{keys}}}").sensor
    np.testing.assert_allclose(np.degrees(sensor.bearings), [-90, -45, 0, 45, 90], atol=1e-9)
    assert sensor.is_clockwise == is_clockwise
    if "sweep_time" in keys:
        assert (np.diff(sensor.ray_delays) < 0).all() == is_clockwise


def test_several_lasers_have_rays_as_they_are() -> None:
    text = "sensors: [{name: /front, mount: [0.2, 0, 0], angle_min: 40 deg, angle_increment: -20 deg, n_rays: 4}, {mount: [-0.2, 0, 180 deg]}]"
    sensor = parse_robot(text).sensor
    np.testing.assert_allclose(np.degrees(sensor.bearings), [-20, 0, 20, 40, 180])
