"""Diagnosis of several sensors read as one: what one of them has for itself, and what all of them share."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import polygon_arena

from logs.run import Run
from planners.arena import Arena, wrap
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.world.robot import Robot, parse_robot
from sensorgraph.world.scene import Scene, draw_readings
from sensorgraph.world.sensor_parts import part_names, sensor_of_rays

RING = parse_robot("sensors: [{ring: 16, radius: 0.2, cone: 0.26}]\nsensor: {sigma: 0.01, range_max: 6.0}")
FRONT_AND_REAR = parse_robot(
    "sensors: [{mount: [0.35, 0.1, 0.3], n_rays: 20, fov: 3.0}, {mount: [-0.35, -0.1, 3.3], n_rays: 20, fov: 3.0}]"
)
T = np.arange(0, 60, 0.05)


@pytest.fixture(scope="module")
def hall() -> Arena:
    pillar = [(2.5, 1.0), (3.0, 1.0), (3.0, 1.5), (2.5, 1.5)]
    return polygon_arena([(0, 0), (4, 0), (4, 3), (0, 3)], pillar)


def drive(robot: Robot, arena: Arena, *effects: Amendment, n: int = 200) -> Run:
    """Circle on the left of the pillar, looking about; the reference has the noise of a careful set-up."""
    rng = np.random.default_rng(0)
    phase = 0.35 * T
    track = np.column_stack([1.3 + 0.7 * np.cos(phase), 1.5 + 0.8 * np.sin(phase), phase + np.sin(0.2 * T)])
    stamps = np.linspace(0, T[-1], n)
    scene = Scene(
        arena=arena,
        sensor=robot.sensor,
        stamps=stamps,
        motion=lambda times: np.stack([np.interp(times, T, column) for column in track.T], axis=-1),
        span=float(T[-1]),
    )
    scene.run(effects)
    poses = track + rng.normal(size=track.shape) * [0.002, 0.002, 0.0015]
    return Run(
        sensor=robot.sensor,
        stamps=stamps,
        ranges=draw_readings(scene, rng),
        pose_stamps=T,
        poses=np.column_stack([poses[:, :2], wrap(poses[:, 2])]),
    )


def found(robot: Robot, arena: Arena, *effects: Amendment) -> Finding:
    return diagnose(drive(robot, arena, *effects), arena, robot, plan_next=False)


@pytest.mark.parametrize("robot", [RING, FRONT_AND_REAR], ids=["ring of sonars", "front and rear laser"])
def test_nothing_is_found_where_nothing_was_planted(robot: Robot, hall: Arena) -> None:
    finding = found(robot, hall)
    gap = finding.channels["scan"].gap
    assert not finding.effects and finding.channels["scan"].unknown is None
    assert gap is not None and gap.before.normalised < 1.1


@pytest.mark.parametrize(
    ("robot", "planted"),
    [
        pytest.param(RING, EFFECTS["mount_xy"](dx=0.03, dy=0.02).at("sensor 5"), marks=pytest.mark.slow),
        pytest.param(RING, EFFECTS["mount_yaw"](delta=0.1).at("sensor 5"), marks=pytest.mark.slow),
        pytest.param(RING, EFFECTS["range_scale"](s=0.03).at("sensor 2"), marks=pytest.mark.slow),
        pytest.param(RING, EFFECTS["range_noise"](k=0.03).at("sensor 4"), marks=pytest.mark.slow),
        pytest.param(
            RING, EFFECTS["incidence_dropout"](alpha_max=0.9).at("sensor 4"), marks=pytest.mark.slow
        ),
        pytest.param(RING, EFFECTS["range_bias"](b=0.03), marks=pytest.mark.slow),
        pytest.param(RING, EFFECTS["range_noise"](k=0.01), marks=pytest.mark.slow),
        (FRONT_AND_REAR, EFFECTS["mount_yaw"](delta=0.02).at("sensor 1")),
        pytest.param(FRONT_AND_REAR, EFFECTS["range_bias"](b=0.03).at("sensor 0"), marks=pytest.mark.slow),
    ],
    ids=lambda value: value.name + value.place if isinstance(value, Amendment) else "",
)
def test_what_was_planted_is_found_at_its_sensor(robot: Robot, planted: Amendment, hall: Arena) -> None:
    finding = found(robot, hall, planted)
    assert [(a.name, a.place) for a in finding.effects] == [(planted.name, planted.place)]
    for name, value in planted.parameters.items():
        assert finding.effects[0][name] == pytest.approx(value, abs=4 * finding.effects[0].stderr[name])


def test_an_effect_of_one_sensor_changes_its_rays_alone(hall: Arena) -> None:
    sensor = FRONT_AND_REAR.sensor
    owner = sensor_of_rays(sensor)
    assert part_names(sensor) == ["sensor 0", "sensor 1"] and np.bincount(owner).tolist() == [20, 20]
    scenes = [
        Scene(
            arena=hall,
            sensor=sensor,
            stamps=np.zeros(1),
            motion=lambda t: np.zeros((*t.shape, 3)) + [1, 1, 0.5],
            span=1.0,
        )
        for _ in range(3)
    ]
    plain = scenes[0].run().reading
    turned = scenes[1].run([EFFECTS["mount_yaw"](delta=0.2).at("sensor 1")]).reading
    np.testing.assert_allclose(turned[:, owner == 0], plain[:, owner == 0], rtol=1e-12)
    assert (np.abs(turned - plain)[:, owner == 1] > 1e-3).all()
    with pytest.raises(
        SensorgraphError, match="applies to `sensor 2`, but the robot has sensor 0 to sensor 1"
    ):
        scenes[2].run([EFFECTS["range_bias"](b=0.1).at("sensor 2")])
