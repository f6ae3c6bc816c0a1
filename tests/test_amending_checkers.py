"""Amended files as the programs of their formats read them: libsdformat, xacro, and two parsers of URDF."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from test_amending import CLASSIC, LASER, SDF, XACRO

import sensorgraph as sg
from sensorgraph.effects import EFFECTS, Amendment

CHECKER = """#include <iostream>
#include <sdf/sdf.hh>
int main(int, char **files) {
  sdf::Root root;
  const auto errors = root.Load(files[1]);
  for (const auto &one : errors) std::cout << one.Message() << "\\n";
  return errors.empty() ? 0 : 1;
}
"""
FOUND = [
    Amendment(effect=EFFECTS[name], parameters=values)
    for name, values in (
        ("mount_xy", {"dx": 0.012, "dy": -0.02}),
        ("mount_yaw", {"delta": 0.015}),
        ("wheel_base", {"s": 0.03}),
        ("wheel_radius", {"s": 0.02}),
        ("max_range", {"R": 3.2}),
        ("range_bias", {"b": 0.02}),
    )
]


@pytest.mark.slow
def test_libsdformat_reads_an_amended_sdf_without_a_word(tmp_path: Path) -> None:
    versions = [f"sdformat{one}" for one in range(16, 8, -1)]
    known = shutil.which("pkg-config") and shutil.which("g++")
    library = next(
        (one for one in versions if known and not subprocess.call(["pkg-config", "--exists", one])), None
    )
    if library is None:
        pytest.skip("libsdformat and g++ are not installed (Debian: libsdformat-dev, g++)")
    (tmp_path / "check.cc").write_text(CHECKER)
    flags = subprocess.check_output(["pkg-config", "--cflags", "--libs", library], text=True).split()
    subprocess.check_call(["g++", "-std=c++17", tmp_path / "check.cc", *flags, "-o", tmp_path / "check"])
    for name, text, laser in (("gz.sdf", SDF, None), ("classic.sdf", CLASSIC, "rear")):
        path = tmp_path / name
        path.write_text(text)
        sg.amend(path, FOUND, laser=laser).write()
        done = subprocess.run([tmp_path / "check", path], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """Return the amended xacro, expanded by the program of ROS."""
    xacro = pytest.importorskip("xacro", reason="xacro is not installed")
    paths = [tmp_path / "tower.urdf.xacro", tmp_path / "laser.urdf.xacro"]
    for path, text in zip(paths, (XACRO.replace("$(find tower)/urdf/", ""), LASER), strict=True):
        path.write_text(text)
    sg.amend(paths, FOUND).write()
    (tmp_path / "tower.urdf").write_text(xacro.process_file(str(paths[0])).toxml())
    return tmp_path / "tower.urdf"


def test_the_parser_of_ros_reads_an_amended_urdf(urdf: Path) -> None:
    parser = pytest.importorskip("urdf_parser_py.urdf", reason="urdf_parser_py is not installed")
    joints = parser.URDF.from_xml_string(urdf.read_text()).joint_map
    assert joints["front_joint"].origin.xyz[:2] == pytest.approx(
        [-0.06, -0.012], abs=1e-6
    )  # in the turned shell
    assert joints["front_joint"].origin.rpy[2] == pytest.approx(1.5707963 + 0.015, abs=1e-6)
    left, right = (joints[f"{side}_wheel_joint"].origin.xyz[1] for side in ("left", "right"))
    assert left - right == pytest.approx(0.38 / 1.03, rel=1e-5)


def test_the_laser_of_an_amended_urdf_is_where_the_effects_put_it(urdf: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
    robot = yourdfpy.URDF.load(str(urdf), load_meshes=False, load_collision_meshes=False)
    assert robot.validate()
    assert robot.get_transform("front", "base_link")[:2, 3] == pytest.approx([0.012, -0.06], abs=1e-6)
