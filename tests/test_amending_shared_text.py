"""Amending texts that several parts share: macros, default classes, nested models, anchors; and other encodings."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

import sensorgraph as sg
from sensorgraph.amending.expressions import evaluate
from sensorgraph.cli import run as cli
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.world.robot import load_robot

COMMENT = re.compile(r" ?<!-- sensorgraph amend: .*?-->|  # sensorgraph amend: [^\n]*")
WHEELS = """<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:property name="width" value="0.36"/>
  <xacro:property name="separation" value="0.4"/>
  <link name="base_link"/>
  <xacro:macro name="wheel" params="side reflect">
    <link name="${side}_wheel"><visual><geometry><cylinder radius="0.1" length="0.04"/></geometry></visual></link>
    <joint name="${side}_wheel_joint" type="continuous">
      <parent link="base_link"/><child link="${side}_wheel"/><origin xyz="0 Y 0" rpy="${reflect*pi/2} 0 0"/>
    </joint>
  </xacro:macro>
  <xacro:wheel side="left" reflect="1"/>
  <xacro:wheel side="right" reflect="-1"/>
</robot>
"""
LASERS = """<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">
  <link name="base_link"/>
  <xacro:macro name="lidar" params="name far">
    <link name="${name}"/>
    <gazebo reference="${name}"><sensor name="${name}" type="ray"><ray>
      <range><min>0.1</min><max>${far}</max></range>
    </ray></sensor></gazebo>
  </xacro:macro>
  <xacro:lidar name="front" far="10"/>
  <xacro:lidar name="rear" far="10"/>
</robot>
"""
DRIVE = """<sdf version="1.6"><model name="m">
  <link name="base_link"/>
  WHEELS
  <plugin name="drive" filename="libgazebo_ros_diff_drive.so">
    <num_wheel_pairs>2</num_wheel_pairs>
    <left_joint>left0</left_joint><right_joint>right0</right_joint>
    <left_joint>left1</left_joint><right_joint>right1</right_joint>
    <wheel_separation>0.4</wheel_separation>
    <wheel_separation>0.42</wheel_separation>
  </plugin>
</model></sdf>
"""
SDF_LASER = """<sensor name="l" type="gpu_lidar"><pose>0 0 0.05 0 0 0</pose>
  <lidar><range><min>0.1</min><max>9</max></range>NOISE</lidar></sensor>"""
MJCF = """<mujoco><compiler angle="radian" eulerseq="SEQUENCE"/>
  <default>
    <general dyntype="filterexact" dynprm="0.1"/>
    <default class="wheel"><geom size="0.05"/></default>
  </default>
  <worldbody><body name="base_link"><freejoint/><geom size="0.1"/>
    <body name="left" pos="0 0.2 0"><joint name="jl" axis="0 1 0"/><geom class="wheel"/></body>
    <body name="right" pos="0 -0.2 0"><joint name="jr" axis="0 1 0"/><geom class="wheel"/></body>
    LASER
  </body>OTHER</worldbody>
  <actuator><general joint="jl"/><general joint="jr"/></actuator>
  <sensor><rangefinder site="ray"/></sensor>
</mujoco>"""


def effect(name: str, /, **values: float) -> Amendment:
    return Amendment(effect=EFFECTS[name], parameters=values, stderr={})


@pytest.fixture
def amended(tmp_path: Path) -> Callable[..., str]:
    """Return the function that amends a text and returns the new one without comments."""

    def run(name: str, text: str, *effects: Amendment, laser: str | None = None) -> str:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        found = sg.amend(path, effects, laser=laser)
        return COMMENT.sub("", found.files[0].text.decode())

    return run


@pytest.mark.parametrize(
    "y, changed",
    [
        ("${reflect*0.2}", 'xyz="0 ${(reflect*0.2) * 0.970874} 0" rpy="${reflect*pi/2} 0 0"'),
        ("${reflect*separation/2}", 'name="separation" value="0.38835"'),
        ("${reflect*(width/2 + 0.02)}", 'xyz="0 ${(reflect*(width/2 + 0.02)) * 0.970874} 0"'),
    ],
)
def test_a_text_of_both_wheels_is_scaled_once(y: str, changed: str, amended: Callable[..., str]) -> None:
    """A macro states both sides by a parameter of 1 and -1, which is no size."""
    text = WHEELS.replace("Y", y)
    new = amended("r.xacro", text, effect("wheel_radius", s=0.02), effect("wheel_base", s=0.03))
    assert changed in new and 'cylinder radius="0.0980392"' in new
    assert 'side="left" reflect="1"' in new and 'side="right" reflect="-1"' in new


def test_a_macro_with_other_calls_is_left_alone(amended: Callable[..., str]) -> None:
    caster = '<xacro:wheel side="caster" reflect="0"/></robot>'
    text = WHEELS.replace("Y", "${reflect*0.2}").replace("</robot>", caster)
    with pytest.raises(SensorgraphError, match="in a macro with calls for other parts"):
        amended("r.xacro", text, effect("wheel_radius", s=0.02))


def test_one_of_two_lasers_of_a_macro_is_amended_where_it_differs(amended: Callable[..., str]) -> None:
    new = amended("r.xacro", LASERS, effect("max_range", R=8.0), laser="rear")
    assert '"front" far="10"' in new and '"rear" far="8"' in new
    with pytest.raises(
        SensorgraphError, match=r"`0\.1` is in a macro with several calls; make it a parameter"
    ):
        amended("r.xacro", LASERS, effect("min_range", r_min=0.2), laser="rear")


@pytest.mark.parametrize(
    "expression, value",
    [
        ("'classic' == 'ignition'", False),
        ("1.0 if 'a' + 'b' == 'ab' else 2.0", 1.0),
        ("math.radians(180) - math.pi", 0.0),
    ],
)
def test_expressions_of_xacro(expression: str, value: float, amended: Callable[..., str]) -> None:
    assert evaluate(expression, {}.__getitem__) == value
    text = LASERS.replace("</robot>", '<xacro:arg name="sim" default="gz"/></robot>')
    # an argument inside an expression is substituted before the expression is evaluated
    rear = '<xacro:lidar name="rear" far="10"/>'
    chosen = f"<xacro:if value=\"${{'$(arg sim)' == 'gz'}}\">{rear}</xacro:if>"
    text = text.replace(rear, chosen).replace('<xacro:lidar name="front" far="10"/>', "")
    assert 'far="8"' in amended("r.xacro", text, effect("max_range", R=8.0))


def test_a_change_applies_to_both_branches_of_an_expression(amended: Callable[..., str]) -> None:
    text = (
        '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:property name="high" value="1"/><link name="base_link"/>'
        '<link name="laser"/><joint name="j" type="fixed"><parent link="base_link"/><child link="laser"/>'
        '<origin xyz="${0.3 if high else 0.1} 0 0"/></joint></robot>'
    )
    new = amended("r.xacro", text, effect("mount_xy", dx=0.01, dy=0.0))
    assert 'xyz="${(0.3 if high else 0.1) + 0.01} 0 0"' in new


def test_every_pair_of_wheels_of_a_plugin_is_amended(amended: Callable[..., str]) -> None:
    wheels = "".join(
        f'<link name="{n}"><collision name="c"><geometry><cylinder><radius>0.1</radius></cylinder></geometry></collision></link>'
        f'<joint name="{n[1:]}" type="revolute"><parent>base_link</parent><child>{n}</child></joint>'
        for n in ("wleft0", "wleft1", "wright0", "wright1")
    )
    text = DRIVE.replace("WHEELS", wheels)
    new = amended("m.sdf", text, effect("wheel_base", s=0.05), effect("wheel_radius_diff", s=0.02))
    assert re.findall(r"<wheel_separation>([\d.]+)", new) == ["0.42", "0.441"]
    assert re.findall(r"<radius>([\d.]+)", new) == ["0.101", "0.101", "0.099", "0.099"]
    skid = text.replace("diff_drive", "skid_steer_drive")
    assert "0.441" in amended("m.sdf", skid, effect("wheel_base", s=0.05))


def test_the_plugin_of_a_world_is_that_of_the_robot_with_the_laser(amended: Callable[..., str]) -> None:
    plugin = '<plugin name="d" filename="gz-sim-diff-drive-system"><wheel_radius>0.1</wheel_radius></plugin>'
    models = "".join(
        f'<model name="{name}"><link name="base_link">{SDF_LASER}</link>{plugin}</model>'.replace(
            '"l"', f'"{name}_laser"'
        )
        for name in ("a", "b")
    )
    text = f'<sdf version="1.8"><world name="w">{models}</world></sdf>'.replace("NOISE", "")
    new = amended("w.sdf", text, effect("wheel_radius", s=0.2), laser="a_laser")
    assert re.findall(r"<wheel_radius>([\d.]+)", new) == ["0.12", "0.1"]


@pytest.mark.parametrize(
    "noise", ['<noise type="none"><stddev>0.3</stddev></noise>', "<noise><type>none</type></noise>"]
)
def test_noise_of_type_none_is_switched_on(noise: str, amended: Callable[..., str]) -> None:
    sensor = SDF_LASER.replace("NOISE", noise)
    text = f'<sdf version="1.8"><model name="m"><link name="base_link">{sensor}</link></model></sdf>'
    new = amended("m.sdf", text, effect("range_bias", b=0.02))
    assert "gaussian" in new and "none" not in new
    assert "<mean>0.02</mean>" in new and "<stddev>0</stddev>" in new


def test_a_nested_model_turns_its_laser(amended: Callable[..., str]) -> None:
    """Forward of the robot is to the right of a model that is turned to the left; the world's pose does not count."""
    text = (
        '<sdf version="1.8"><world name="w"><model name="box"><link name="base_link"><pose>0 0 0 0 0 1</pose></link></model>'
        '<model name="robot"><pose>1 2 0 0 0 0.5</pose><link name="base_link"/><model name="top">'
        f'<pose degrees="true">0 0 0 0 0 90</pose><link name="laser">{SDF_LASER}</link></model></model></world></sdf>'
    )
    new = amended("m.sdf", text.replace("NOISE", ""), effect("mount_xy", dx=0.01, dy=0.0))
    assert "<pose>0 -0.01 0.05 0 0 0</pose>" in new
    text = text.replace(
        'degrees="true">0 0 0 0 0 90', 'rotation_format="quat_xyzw">0 0 0 0 0 0.70710678 0.70710678'
    )
    new = amended("m.sdf", text.replace("NOISE", ""), effect("mount_xy", dx=0.01, dy=0.0))
    assert "<pose>0 -0.01 0.05 0 0 0</pose>" in new


def test_a_pose_that_a_file_lacks_is_added_once(amended: Callable[..., str]) -> None:
    """The laser hangs upside down: a turn to the left is one about -z there, and left is -y."""
    effects = effect("mount_xy", dx=0.01, dy=0.002), effect("mount_yaw", delta=0.02)
    urdf = (
        '<robot name="r"><link name="base_link"/><link name="plate"/><link name="laser"/>'
        '<joint name="a" type="fixed"><parent link="base_link"/><child link="plate"/><origin rpy="3.1415926535898 0 0"/></joint>'
        '<joint name="b" type="fixed"><parent link="plate"/><child link="laser"/></joint></robot>'
    )
    new = amended("r.urdf", urdf, *effects)
    assert new.count("<origin") == 2 and '<origin xyz="0.01 -0.002 0" rpy="0 0 -0.02"/>' in new
    sensor = SDF_LASER.replace("<pose>0 0 0.05 0 0 0</pose>", "<topic>scan</topic>").replace("NOISE", "")
    sdf = (
        '<sdf version="1.8"><model name="m"><link name="base_link"/><link name="laser"><pose>0 0 0 3.1415926535898 0 0</pose>'
        f"{sensor}{sensor.replace('gpu_lidar', 'camera')}</link></model></sdf>"
    )
    new = amended("m.sdf", sdf, *effects)
    assert new.count("<pose>") == 2 and "<pose>0.01 -0.002 0 0 0 -0.02</pose>" in new


@pytest.mark.parametrize("sequence", ["xyz", "zyx", "XYZ"])
@pytest.mark.parametrize("mast", ["", 'xyaxes="0 1 0 -1 0 0"', 'zaxis="1 0 0"', 'axisangle="1 0 0 3.1415926"', 'euler="0.5 0.2 0.3"'])  # fmt: skip
def test_mounts_on_any_mast_and_with_any_angles(
    mast: str, sequence: str, amended: Callable[..., str]
) -> None:
    mujoco = pytest.importorskip("mujoco")
    laser = f'<body name="mast" {mast}><body name="laser" pos="0.1 0 0.1" euler="0.3 0.2 0.5"><site name="ray" zaxis="1 0 0"/></body></body>'
    text = MJCF.replace("SEQUENCE", sequence).replace("LASER", laser).replace("OTHER", "")
    new = amended("m.xml", text, effect("mount_yaw", delta=0.02), effect("mount_xy", dx=0.01, dy=-0.02))
    found = []
    for one in (text, new):
        model = mujoco.MjModel.from_xml_string(one)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        x, y, z = data.site("ray").xmat.reshape(3, 3)[:, 2]
        found.append((math.atan2(y, x), z, *data.site("ray").xpos))
    change = [after - before for before, after in zip(*found, strict=True)]
    assert change == pytest.approx([0.02, 0.0, 0.01, -0.02, 0.0], abs=3e-6)


def test_defaults_are_inherited_and_changed_once(amended: Callable[..., str]) -> None:
    laser = '<site name="ray" zaxis="1 0 0"/>'
    text = MJCF.replace("SEQUENCE", "xyz").replace("LASER", laser).replace("OTHER", "")
    new = amended("m.xml", text, effect("actuator_lag", tau=0.05), effect("wheel_radius", s=0.25))
    assert 'dynprm="0.15"' in new and new.count("dynprm") == 1
    assert 'class="wheel"><geom size="0.04"' in new
    sites = text.replace(laser, '<site name="ray"/>').replace(
        "<default>", '<default><site zaxis="1 0 0"/>', 1
    )
    with pytest.raises(SensorgraphError, match="a default class sets `zaxis` of the site `ray`"):
        amended("m.xml", sites, effect("mount_yaw", delta=0.02))


def test_only_the_robot_of_the_laser_is_amended(amended: Callable[..., str]) -> None:
    other = (
        '<body name="second"><freejoint/><geom size="0.1"/>'
        '<body name="l2" pos="0 0.2 0"><joint name="jl2"/><geom size="0.07"/></body></body>'
    )
    text = MJCF.replace("SEQUENCE", "xyz").replace("OTHER", other)
    text = text.replace("</actuator>", '<general joint="jl2"/></actuator>')
    new = amended("m.xml", text.replace("LASER", '<site name="ray"/>'), effect("wheel_radius", s=0.25))
    assert '"0.04"' in new and '"0.07"' in new
    with pytest.raises(SensorgraphError, match="2 robots, `base_link`, `second`; choose"):
        amended("m.xml", text.replace("LASER", ""), effect("wheel_radius", s=0.25))


def test_units_anchors_and_empty_sections_of_yaml(amended: Callable[..., str], tmp_path: Path) -> None:
    robot = "name: bot\nsensor:  # laser\nwheels: {radius: &r 10 cm}\n"
    (tmp_path / "robot.yaml").write_text(
        amended("robot.yaml", robot, effect("latency", tau=0.02), effect("wheel_radius", s=0.25)),
        encoding="utf-8",
    )
    machine = load_robot(tmp_path / "robot.yaml")
    assert machine.sensor.first_ray_delay == -0.02 and machine.wheels.radius == pytest.approx(0.08)
    for sweep, expected in (("20 ms", 0.07), ("-20 ms", -0.07)):
        new = amended(
            "robot.yaml", f"name: bot\nsensor: {{sweep_time: {sweep}}}\n", effect("scan_skew", T=0.05)
        )
        assert yaml.safe_load(new)["sensor"]["sweep_time"] == pytest.approx(expected)


AMCL = "amcl:\n  ros__parameters:\n    laser_max_range: {}\n"


@pytest.mark.parametrize(
    "text, result",
    [
        (AMCL.format("&far 100.0"), AMCL.format("&far 8.0")),
        (AMCL.format("*far").replace("amcl", "b: &far 100.0\namcl"), AMCL.format("8.0").replace("amcl", "b: &far 100.0\namcl")),
        ("/robot1/" + AMCL.format("100.0"), "/robot1/" + AMCL.format("8.0")),
        ("/**:\n  ros__parameters: {laser_max_range: 100.0}\n", "/**:\n  ros__parameters: {laser_max_range: 8.0}\n"),
        ("amcl: {ros__parameters: {}}\n", "amcl: {ros__parameters: {laser_max_range: 8.0}}\n"),
        ("amcl:\n  ros__parameters:\nb: 1\n", "amcl:\n  ros__parameters:\n    laser_max_range: 8.0\nb: 1\n"),
        (AMCL.format("&far 100.0") + "    b: *far\n", "uses the number elsewhere"),
        (AMCL.format('"{{ far }}"'), "`laser_max_range` is not a number"),
        ("a:\n  amcl: {ros__parameters: {}}\nb:\n  amcl: {ros__parameters: {}}\n", "2 nodes amcl"),
    ],
)  # fmt: skip
def test_places_of_amcl_in_parameter_files(text: str, result: str, amended: Callable[..., str]) -> None:
    if "ros__parameters" in result:
        assert amended("nav2_params.yaml", text, effect("max_range", R=8.0)) == result
        return
    with pytest.raises(SensorgraphError, match=re.escape(result)):
        amended("nav2_params.yaml", text, effect("max_range", R=8.0))


def test_a_declared_encoding_stays(tmp_path: Path) -> None:
    body = '<robot name="Größe"><link name="base_link"/><link name="laser"/><joint name="j" type="fixed">\r\n\t<parent link="base_link"/><child link="laser"/><origin xyz="0 0 0" rpy=\'0 0\t0.1\'/></joint></robot>'
    data = f"<?xml version='1.0' encoding='ISO-8859-1'?>\r\n<!DOCTYPE robot>\r\n{body}".encode("latin-1")
    path = tmp_path / "r.urdf"
    path.write_bytes(data)
    new = sg.amend(path, [effect("mount_yaw", delta=0.02)]).files[0].text
    assert COMMENT.sub("", new.decode("latin-1")).encode("latin-1") == data.replace(b"0.1'", b"0.12'")
    path.write_bytes(data.replace(b"ISO-8859-1", b"UTF-8"))
    with pytest.raises(SensorgraphError, match="is not UTF-8 text"):
        sg.amend(path, [effect("mount_yaw", delta=0.02)])


def test_a_similar_effect_is_not_the_same_one(tmp_path: Path) -> None:
    path = tmp_path / "bot.yaml"
    path.write_text("name: bot\n", encoding="utf-8")
    sg.amend(path, [effect("mount_yaw", delta=0.021), effect("wheel_base", s=0.03)]).write()
    sg.amend(path, [effect("mount_yaw", delta=0.02)])
    with pytest.raises(SensorgraphError, match=r"already amended with wheel_base s = 0\.03"):
        sg.amend(path, [effect("wheel_base", s=0.03)])


def test_an_input_is_not_the_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, effects = tmp_path / "bot.yaml", tmp_path / "effects.yaml"
    model.write_text("name: bot\n", encoding="utf-8")
    effects.write_text("- {name: mount_yaw, parameters: {delta: 0.02}}\n", encoding="utf-8")
    for out in (model, effects, tmp_path):
        assert cli(["amend", str(model), "--effects", str(effects), "-o", str(out)]) == 2
        assert "is also the input and would be overwritten" in capsys.readouterr().err
    assert cli(["amend", str(model), "--effects", str(effects), "-o", str(tmp_path / "none" / "x.yaml")]) == 2
    assert "the folder" in capsys.readouterr().err
    assert model.read_text(encoding="utf-8") == "name: bot\n"


def test_files_of_one_name_or_without_permission_are_not_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / one / "bot.yaml" for one in "ab"]
    for path in paths:
        path.parent.mkdir()
        path.write_text("name: bot\n", encoding="utf-8")
    found = sg.amend(paths, [effect("mount_yaw", delta=0.02)])
    with pytest.raises(SensorgraphError, match=r"two files are named bot\.yaml"):
        found.write(tmp_path / "out")
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(SensorgraphError, match="is read-only"):
        found.write()
    assert all(path.read_text(encoding="utf-8") == "name: bot\n" for path in paths)
