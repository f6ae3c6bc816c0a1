"""robot.yaml: defaults, every mistake in one line with what to do."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from sensorgraph.errors import SensorgraphError
from sensorgraph.world.robot import Robot, bearings, load_robot, parse_robot


def plain(robot: Robot) -> dict[str, object]:
    parts = (robot.limits, robot.pose, robot.wheels, robot.actuators, robot.tolerances)
    facts: dict[str, object] = robot.to_dict()
    for part in parts:
        facts |= {f"{type(part).__name__}.{k}": v for k, v in vars(part).items() if k != "limits"}
    sensor = {k: np.asarray(v).tolist() for k, v in vars(robot.sensor).items()}
    return facts | sensor


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
        ("sensor: {fov: 180}", "write an angle in degrees as `180 deg`"),
        ("sensors: [{n_rays: 5, fov: 180}]", "sensors[0].fov is 180.0 rad, expected at most 2 pi"),
        (
            "sensor: {fov: 360 grad}",
            "expected a number of radians, or an angle with its unit such as `180 deg`",
        ),
        ("sensor: {range_max: .inf}", "`sensor.range_max` is inf, expected a number such as 8.0"),
        ("sensor: {range_max: 8 deg}", "`sensor.range_max` is '8 deg', expected a number such as 8.0"),
        ("sensor: {mount: [1, 2]}", "expected 3 numbers"),
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
