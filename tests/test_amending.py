"""Amending model files: only the intended numbers change, where they are set, and what a format cannot hold is listed.

The models are small and follow the structure of turtlebot3 (SDF of gz), turtlebot4 (xacro with a laser's macro in
another file), husky (defaults of a macro, environment variables) and jackal (properties shared by four wheels).
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from amending_samples import CLASSIC, LASER, MJCF, SDF, XACRO

import sensorgraph as sg
from logs.run import RangeSensor, Run
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.world.robot import load_robot

NAV2 = """# parameters
amcl:
  ros__parameters:
    alpha1: 0.2   # rotation
    laser_max_range: 100.0
velocity_smoother:
  ros__parameters:
    max_velocity: [0.26, 0.0, 1.0]
"""


def effect(name: str, /, stderr: float | None = None, **values: float) -> Amendment:
    errors = {} if stderr is None else dict.fromkeys(values, stderr)
    return Amendment(effect=EFFECTS[name], parameters=values, stderr=errors)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def written(name: str, text: str) -> Path:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return written


def new_lines(before: str, after: bytes) -> list[str]:
    """Return the lines that differ, as the file has them after the amendment."""
    lines = difflib.ndiff(before.splitlines(), after.decode().splitlines())
    return [line[2:].strip() for line in lines if line.startswith("+ ")]


def without_comments(text: str) -> str:
    return re.sub(r" ?<!-- sensorgraph amend: .*?-->|  # sensorgraph amend: [^\n]*", "", text)


def test_sdf_changes_only_the_lines_of_its_effects(write: Callable[..., Path]) -> None:
    path = write("model.sdf", SDF)
    effects = [
        effect("mount_xy", 0.0004, dx=0.012, dy=-0.02),
        effect("mount_yaw", delta=0.015),
        effect("range_bias", b=0.02),
        effect("max_range", R=3.2),
        effect("wheel_base", 0.002, s=0.03),
        effect("speed_saturation", v_max=0.2),
    ]
    found = sg.amend(path, effects)
    text = without_comments(found.files[0].text.decode())
    assert "<pose>-0.02 -0.02 0.171 0 0 0.015</pose>" in text
    assert "<mean>0.02</mean><stddev>0</stddev></noise>" in text
    assert "<max>3.2</max> <resolution>" in text
    assert "<wheel_separation>0.1648</wheel_separation>" in text
    assert "<max_linear_velocity>0.2</max_linear_velocity>" in text
    lines = new_lines(SDF, found.files[0].text)
    assert len(lines) == 6
    assert "was 0.160, ± 0.00032: wheel_base s = 0.03, assumed by the driver" in "\n".join(lines)
    assert found.left_out == ()
    assert path.read_text(encoding="utf-8") == SDF  # nothing is written before `write`
    found.write()
    assert path.read_bytes() == found.files[0].text


def test_an_included_laser_is_placed_by_the_include(write: Callable[..., Path]) -> None:
    """A laser of another file, turned by 90 degrees where the robot includes it: ahead is -y there."""
    laser = """<sdf version="1.9"><model name="lidar"><link name="head">
  <sensor name="lds" type="gpu_lidar"><pose>0.1 0 0.2 0 0 0</pose><lidar><range><max>10</max></range></lidar></sensor>
</link></model></sdf>
"""
    robot = """<sdf version="1.9"><model name="bot"><link name="base_link"/>
  <include><uri>model://lidar</uri><name>front</name><pose>0 0 0 0 0 1.5707963</pose></include>
</model></sdf>
"""
    paths = [write("bot.sdf", robot), write("lidar.sdf", laser)]
    found = sg.amend(paths, [effect("mount_xy", dx=0.012, dy=-0.02)])
    assert "<pose>0.08 -0.012 0.2 0 0 0</pose>" in without_comments(found.files[1].text.decode())
    assert found.files[0].text == robot.encode()
    alone = sg.amend(paths[1], [effect("mount_xy", dx=0.012, dy=-0.02)])
    assert "<pose>0.112 -0.02 0.2 0 0 0</pose>" in without_comments(alone.files[0].text.decode())


def test_a_driver_that_assumes_large_wheels_overstates_the_distance(write: Callable[..., Path]) -> None:
    """The plugin's number over the geometry's is the ratio of reported to true distance: 1 + s."""
    found = sg.amend(
        write("model.sdf", SDF), [effect("wheel_radius", s=0.02), effect("wheel_radius_diff", s=0.01)]
    )
    text = found.files[0].text.decode()
    assumed = float(re.search(r"<wheel_radius>([\d.]+)", text)[1])  # type: ignore[index]
    left, right = (float(one) for one in re.findall(r"<radius>([\d.]+)", text))
    assert assumed / ((left + right) / 2) == pytest.approx(1.02)
    # wheels of equal speed then turn by -s v / base, and the odometry by 0 (effect `wheel_radius_diff`)
    assert (right - left) / 0.033 == pytest.approx(-0.01)


def test_classic_plugin_and_the_chosen_laser_are_amended(write: Callable[..., Path]) -> None:
    path = write("old.sdf", CLASSIC)
    with pytest.raises(SensorgraphError, match="2 lasers, `front`, `rear`; choose one with `laser`"):
        sg.amend(path, [effect("range_bias", b=0.02)])
    with pytest.raises(SensorgraphError, match="no laser `side`; give one of `front`, `rear`"):
        sg.amend(path, [effect("range_bias", b=0.02)], laser="side")
    found = sg.amend(
        path,
        [
            effect("mount_xy", dx=0.01, dy=0.0),
            effect("wheel_radius", s=0.02),
            effect("speed_saturation", v_max=0.3),
        ],
        laser="rear",
    )
    text = without_comments(found.files[0].text.decode())
    assert "<pose>-0.09 0 0.2 0 0 3.14159</pose>" in text and "<pose>0.1 0 0.2 0 0 0</pose>" in text
    assert "<wheel_diameter>0.204</wheel_diameter>" in text
    assert found.left_out == (
        "old.sdf: speed saturation (speed_saturation): the plugin of Gazebo classic has no limit of speed; "
        "`sensorgraph record --effects` simulates it, and `diagnose --effects` accounts for it",
    )


def test_xacro_is_changed_where_a_number_is_set(write: Callable[..., Path]) -> None:
    paths = [write("tower.urdf.xacro", XACRO), write("laser.urdf.xacro", LASER)]
    effects = [
        effect("mount_xy", dx=0.012, dy=-0.02),
        effect("mount_yaw", delta=0.015),
        effect("max_range", R=9.0),
        effect("wheel_base", s=0.03),
    ]
    found = sg.amend(paths, effects)
    main, laser = (without_comments(file.text.decode()) for file in found.files)
    # the shell is turned by 90 degrees: forward in base_link is -y there, and left is x
    assert '<xacro:property name="laser_x" value="${-4*cm2m - 0.02}"/>' in main
    assert '<xacro:property name="laser_y" value="-0.012"/>' in main
    assert 'rpy="0 0 ${pi/2 + 0.015}"' in main
    assert f'<xacro:property name="track" value="{0.38 / 1.03:.6g}"/>' in main
    assert "r_max:=9 *origin" in laser
    assert len(new_lines(XACRO, found.files[0].text)) == 4 and len(new_lines(LASER, found.files[1].text)) == 1


def test_a_laser_of_two_gets_its_own_argument(write: Callable[..., Path]) -> None:
    """The macro is called twice: its default stays, and one call gains the argument."""
    second = XACRO.replace(
        "</robot>",
        '  <xacro:planar_laser name="rear" parent="base_link"><origin xyz="-0.2 0 0"/></xacro:planar_laser>\n</robot>',
    )
    paths = [write("tower.urdf.xacro", second), write("laser.urdf.xacro", LASER)]
    found = sg.amend(paths, [effect("max_range", R=9.0), effect("mount_yaw", delta=0.02)], laser="rear")
    main, laser = (without_comments(file.text.decode()) for file in found.files)
    assert (
        '<xacro:planar_laser name="rear" parent="base_link" r_max="9"><origin xyz="-0.2 0 0" rpy="0 0 0.02"/>'
        in main
    )
    assert laser == LASER


def test_mjcf_holds_geometry_lag_and_delay(write: Callable[..., Path]) -> None:
    effects = [
        effect("mount_xy", dx=0.012, dy=-0.02),
        effect("mount_yaw", delta=0.015),
        effect("wheel_radius", s=0.02),
        effect("wheel_base", s=0.03),
        effect("actuator_lag", tau=0.08),
        effect("dead_time", L=0.06),
        effect("range_bias", b=0.02),
    ]
    found = sg.amend(write("bot.xml", MJCF), effects)
    assert len(found.left_out) == 1 and "range bias" in found.left_out[0] and "twin" in found.left_out[0]
    mujoco = pytest.importorskip("mujoco")
    old, new = (mujoco.MjModel.from_xml_string(one) for one in (MJCF, found.files[0].text.decode()))
    for side, y in (("left", 1), ("right", -1)):
        wheel = new.body(f"{side}_wheel")
        assert wheel.pos[1] == pytest.approx(y * 0.15 / 1.03, rel=1e-5)
        radius = new.geom(wheel.geomadr[0]).size[0]
        assert radius == pytest.approx(0.05 / 1.02, rel=1e-5)
        floor = wheel.pos[2] - radius - (old.body(f"{side}_wheel").pos[2] - 0.05)
        assert floor == pytest.approx(0.0, abs=1e-6)  # the wheels touch the same floor
    laser = new.body("laser")
    assert laser.pos == pytest.approx([0.112, -0.02, 0.1])
    assert 2 * math.atan2(laser.quat[3], laser.quat[0]) == pytest.approx(0.015)
    assert new.actuator_dynprm[:, 0] == pytest.approx([0.18, 0.08])
    assert new.actuator_delay == pytest.approx([0.06, 0.06])


def test_unequal_wheels_stay_round(write: Callable[..., Path]) -> None:
    """Several effects change each of the two radii of an ellipsoid."""
    text = MJCF.replace(
        'type="cylinder" size="0.05 0.01" euler="1.5708 0 0"', 'type="ellipsoid" size="0.05 0.01 0.05"'
    )
    effects = [effect("wheel_radius_diff", s=0.01), effect("wheel_radius", s=0.02)]
    found = sg.amend(write("bot.xml", text), effects)
    sizes = re.findall(r'size="(0.0[45]\d*) 0.01 (\S+)"', found.files[0].text.decode())
    assert [float(x) for x, _ in sizes] == pytest.approx([0.05 * 1.005 / 1.02, 0.05 * 0.995 / 1.02], rel=1e-5)
    assert all(x == z for x, z in sizes)


@pytest.mark.parametrize(
    "frame, text",
    [
        ('<site name="ray" pos="0 0 0.1" zaxis="1 0 0"/>', "zaxis"),
        ('<body name="l" pos="0 0 0.1" quat="1 0 0 0"><site name="ray" zaxis="1 0 0"/></body>', "quat"),
        (
            '<body name="l" pos="0 0 0.1" axisangle="0 0 1 10"><site name="ray" zaxis="1 0 0"/></body>',
            "axisangle",
        ),
        ('<body name="l" pos="0 0 0.1" euler="180 0 10"><site name="ray" zaxis="1 0 0"/></body>', "euler"),
    ],
)
def test_mount_yaw_turns_the_rays_of_any_mjcf_orientation(
    frame: str, text: str, write: Callable[..., Path]
) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = (
        '<mujoco><worldbody><body name="base_link"><freejoint/><geom size="0.1"/>'
        f'{frame}</body></worldbody><sensor><rangefinder site="ray"/></sensor></mujoco>'
    )
    found = sg.amend(write("bot.xml", model), [effect("mount_yaw", delta=0.2)])
    yaws = []
    for one in (model, found.files[0].text.decode()):
        compiled = mujoco.MjModel.from_xml_string(one)
        data = mujoco.MjData(compiled)
        mujoco.mj_forward(compiled, data)
        x, y, _ = data.site("ray").xmat.reshape(3, 3)[:, 2]
        yaws.append(math.atan2(y, x))
    assert math.remainder(yaws[1] - yaws[0] - 0.2, 2 * math.pi) == pytest.approx(0.0, abs=1e-5)


def test_yaml_files_keep_their_comments(write: Callable[..., Path]) -> None:
    found = sg.amend(
        write("nav2_params.yaml", NAV2), [effect("max_range", R=8.0), effect("speed_saturation", v_max=0.2)]
    )
    text = found.files[0].text.decode()
    assert "alpha1: 0.2   # rotation\n" in text
    assert "laser_max_range: 8.0  # sensorgraph amend: was 100.0: max_range R = 8\n" in text
    assert "max_velocity: [0.2, 0.0, 1.0]  # sensorgraph amend: was 0.26" in text
    assert any("AMCL's parameters" in line for line in found.left_out)
    robot = "name: bot\nsensor:\n  mount: [10 cm, 0.0, 0.0]  # by hand\n"
    path = write("robot.yaml", robot)
    sg.amend(
        path,
        [effect("mount_xy", dx=0.01, dy=0.0), effect("actuator_lag", tau=0.05), effect("latency", tau=0.02)],
    ).write()
    machine = load_robot(path)
    assert machine.sensor.mount == pytest.approx([0.11, 0.0, 0.0])
    assert machine.actuators.tau == pytest.approx(0.15)
    assert "# by hand" in path.read_text(encoding="utf-8")


def test_a_run_states_rate_angles_and_ranges(write: Callable[..., Path]) -> None:
    bearings = np.linspace(-2.0, 2.0, 401)
    sensor = RangeSensor(bearings=bearings, range_min=0.12, range_max=6.0, mount=np.zeros(3))
    rng = np.random.default_rng(0)
    run = Run(
        stamps=np.arange(60) / 7.5,
        ranges=rng.uniform(1.0, 3.0, (60, 401)),
        sensor=sensor,
        pose_stamps=np.zeros(0),
        poses=np.zeros((0, 3)),
    )
    effects = [effect("range_noise", k=0.01), effect("max_range", R=5.0)]
    found = sg.amend(write("model.sdf", SDF), effects, run=run)
    text = without_comments(found.files[0].text.decode())
    for one in ("<update_rate>7.5<", "<samples>401<", "<min_angle>-2<", "<max_angle>2<", "<max>5<"):
        assert one in text
    rms = math.sqrt(np.mean(run.ranges**2))
    assert float(re.search(r"<stddev>([\d.]+)", text)[1]) == pytest.approx(0.01 * rms, rel=1e-4)  # type: ignore[index]


@pytest.mark.parametrize(
    "name, text, message",
    [
        ("a.sdf", "<sdf><model>", "a.sdf: not XML: no element found in line 1"),
        ("a.xml", "<html/>", "root element is <html>; expected <robot>"),
        ("a.yaml", "- 1\n", "neither XML nor a YAML mapping"),
        ("a.yaml", "sensr: {}\n", "sensr"),
        ("a.sdf", "", "is empty"),
        ("a.sdf", '<!DOCTYPE a [<!ENTITY b "c">]><sdf/>', "defines the entity b"),
        (
            "a.urdf",
            '<robot name="r"><link name="base_link"/></robot>',
            "nothing to write: a.urdf: mounting yaw",
        ),
    ],
)
def test_bad_files_are_one_line_and_untouched(
    name: str, text: str, message: str, write: Callable[..., Path]
) -> None:
    path = write(name, text)
    with pytest.raises(SensorgraphError) as caught:
        sg.amend(path, [effect("mount_yaw", delta=0.02)])
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert path.read_text(encoding="utf-8") == text


def test_amcl_gets_floats_from_a_run_and_comments_stay_on_their_lines(write: Callable[..., Path]) -> None:
    run = sg.record(sg.plan("square", views=4))
    text = NAV2.replace("100.0\n", '100.0\n    laser_model_type: "likelihood_field"  # default\n')
    found = sg.amend(write("nav2_params.yaml", text), [effect("max_range", R=7.0)], run=run)
    new = yaml.safe_load(found.files[0].text)["amcl"]["ros__parameters"]
    assert new["laser_max_range"] == 7.0 and new["z_hit"] > 0.9 and new["alpha1"] < 0.01
    assert all(isinstance(value, float) for name, value in new.items() if name != "laser_model_type")
    line = next(one for one in found.files[0].text.decode().splitlines() if "laser_model_type" in one)
    assert "# default" in line and "was likelihood_field" in line


def test_an_effect_is_not_written_twice(write: Callable[..., Path]) -> None:
    path = write("bot.xml", MJCF)
    sg.amend(path, [effect("mount_yaw", delta=0.02)]).write()
    with pytest.raises(SensorgraphError, match="already amended with mount_yaw delta"):
        sg.amend(path, [effect("mount_yaw", delta=0.02)])


def test_an_effect_that_does_not_fit_leaves_no_part_behind(write: Callable[..., Path]) -> None:
    """The second actuator has no time constant, so the first one keeps its own."""
    text = MJCF.replace(
        '<general name="r" joint="right" gainprm="5" biastype="affine" biasprm="0 0 -5"/>',
        '<velocity name="r" joint="right" kv="5"/>',
    )
    found = sg.amend(
        write("bot.xml", text), [effect("actuator_lag", tau=0.08), effect("mount_yaw", delta=0.02)]
    )
    assert 'dynprm="0.1"' in found.files[0].text.decode()
    assert "an actuator `velocity` has no time constant" in found.left_out[0]
