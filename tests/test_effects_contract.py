"""Effects own what is known about them: no name of one is quoted elsewhere, and a further one is a single object."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import further, polygon_arena
from diagnosis_samples import make_run
from scan_samples import drive

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive
from sensorgraph.diagnosis.motion.odometry_channel import diagnose_odometry
from sensorgraph.effects import EFFECTS, Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.interfaces import DrivenMotion, Regressor
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot, Tolerances, parse_robot
from sensorgraph.world.scene import Scene, draw_readings

ROOT = Path(__file__).parent.parent / "sensorgraph"
SCAN = [effect for effect in EFFECTS.values() if effect.channel == "scan"]


def quoted(path: Path) -> list[str]:
    """Return the string constants that are names of effects; docstrings hold more than a name."""
    constants = (
        node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)
    )
    return [value for value in constants if isinstance(value, str) and value in EFFECTS]


def test_no_name_of_an_effect_is_quoted_outside_the_library() -> None:
    outside = [p for p in sorted(ROOT.rglob("*.py")) if ROOT / "effects" not in p.parents]
    assert len(outside) > 100
    quotes = re.compile(rf"[\"'](?:{'|'.join(EFFECTS)})[\"']")  # most files need no parsing
    suspects = [p for p in outside if quotes.search(p.read_text())]
    found = {p.relative_to(ROOT).as_posix(): names for p in suspects if (names := quoted(p))}
    assert found == {
        "amending/gazebo.py": ["wheel_radius"],  # an element of the DiffDrive plugin
    }


@pytest.mark.parametrize("effect", SCAN, ids=lambda effect: effect.name)
def test_an_effect_of_the_scan_channel_can_be_found_and_missed(effect: Effect) -> None:
    known = effect.diagnostics
    looked_for = known.propose or known.sweep or known.corner_shifts or effect.nuisances or effect.steps
    assert looked_for
    sectors = {"theta1", "theta2"} if effect.place == "sector" else set()
    fitted = set(effect.steps) | set(effect.search_steps) | sectors
    assert fitted == {p.name for p in effect.parameters} or known.is_lattice
    assert known.unobservable or known.why_unseen or known.corner_shifts
    assert set(known.leftovers) <= set(EFFECTS)
    for p in effect.parameters:
        assert p.nuisance is None or p.step is not None
        assert p.search_step is None or p.search_step > 0
    assert effect.absorber <= (
        len(effect.search_steps) == 1
    )  # its one width or share is searched with the noise


def test_every_nuisance_is_the_copy_of_one_parameter() -> None:
    copies = [nuisance for effect in EFFECTS.values() for nuisance in effect.nuisances]
    assert sorted(copies) == list(range(8))


def test_tolerances_take_along_effects_of_their_own_name() -> None:
    keys = [effect.diagnostics.tolerance for effect in SCAN if effect.diagnostics.tolerance]
    assert len(set(keys)) == len(keys)
    assert set(keys) <= set(vars(Tolerances()))


# a further effect ----------------------------------------------------------------------------------------------------


def bend(scene: Scene, a: Amendment) -> None:
    """Stretch far readings more than near ones."""
    beams = scene.beams
    beams.slope = beams.slope * np.where(np.isfinite(beams.reading), 1 + 2 * a["c"] * beams.reading, 1.0)
    beams.reading = beams.reading + a["c"] * beams.reading**2


CURVATURE = Effect(
    name="range_curvature",
    title="range error that grows with the square of the range",
    channel="scan",
    stage="range",
    physics="The clock of the range finder slows down while it waits: z = r + c r^2.",
    source="a test",
    varies="the square of the range",
    rivals={"range_scale": "compare near, middle and far views of one wall"},
    parameters=(Parameter(name="c", unit="1/m", doc="growth", materiality=0.0008, step=1e-4, jump=300.0),),
    transform=bend,
)
TRUE_C = 0.006
"""[1/m] 10 cm at 4 m."""


@pytest.fixture(scope="module")
def robot() -> Robot:
    return parse_robot("sensor: {n_rays: 61}")


@pytest.fixture(scope="module")
def plain(hall: Arena) -> Run:
    """Return a run without any effect."""
    return drive(hall, seed=4)


@pytest.fixture(scope="module")
def bent(plain: Run) -> Run:
    """Hide the error in the readings themselves, in whole millimetres as the sensor gives them."""
    hit = np.isfinite(plain.ranges)
    r = plain.ranges[hit]
    ranges = plain.ranges.copy()
    ranges[hit] = np.round(r + TRUE_C * r * r, 3)
    return replace(plain, ranges=ranges)


def test_a_further_effect_is_found_once_it_is_in_the_library(
    hall: Arena, robot: Robot, bent: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EFFECTS, CURVATURE.name, CURVATURE)
    finding = diagnose(bent, hall, robot, plan_next=False)
    first = finding.effects[0]
    assert first.name == CURVATURE.name
    assert abs(first["c"] - TRUE_C) < 3 * first.stderr["c"] < 0.2 * TRUE_C
    assert [a.name for a in finding.effects] == [CURVATURE.name]
    assert finding.channels["scan"].unknown is None


@pytest.mark.slow  # a search through all that is known
def test_without_it_the_library_does_not_know_that_name(hall: Arena, robot: Robot, bent: Run) -> None:
    finding = diagnose(bent, hall, robot, plan_next=False)
    assert CURVATURE.name not in EFFECTS
    assert CURVATURE.name not in {a.name for a in finding.effects}
    assert finding.effects or finding.channels["scan"].unknown is not None  # something is said to be wrong


def test_it_is_not_found_where_it_is_not(
    hall: Arena, robot: Robot, plain: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EFFECTS, CURVATURE.name, CURVATURE)
    finding = diagnose(plain, hall, robot, plan_next=False)
    assert finding.effects == ()
    assert CURVATURE.name not in finding.channels["scan"].not_observable


# further effects of wheels and motors -----------------------------------------------------------------------------------


def shorter_in_turns(motion: DrivenMotion) -> tuple[Floats, Floats]:
    """Let the body fall short of the wheels for every radian it turns."""
    return -np.abs(motion.turn), np.zeros_like(motion.turn)


def slower_in_turns(motion: DrivenMotion) -> tuple[Floats, Floats]:
    """Let the motors lose speed while they turn."""
    return -motion.distance * np.abs(motion.turn), np.zeros_like(motion.turn)


SCRUB = Effect(
    name="wheel_scrub",
    title="tyres that scrub in turns",
    channel="odometry",
    stage="wheels",
    physics="The body loses c metres of way for every radian that it turns.",
    source="a test",
    varies="distance against turning, the same for both senses",
    rivals={"wheel_radius": "a straight run"},
    parameters=(Parameter(name="c", unit="m/rad", doc="way lost", materiality=0.003),),
    transform=lambda drivetrain, a: None,
    diagnostics=Diagnostics(
        why_unseen="too little turning",
        regressor=Regressor(column=shorter_in_turns, tolerance=0.0005),
    ),
)
SAG = Effect(
    name="battery_sag",
    title="motors that share one weak battery",
    channel="drive",
    stage="motors",
    physics="The motors lose the share c of their speed per rad/s of turning.",
    source="a test",
    varies="speed against turn rate",
    rivals={"actuator_lag": "a straight run"},
    parameters=(Parameter(name="c", unit="s/rad", doc="share of the speed lost", materiality=0.03),),
    transform=lambda drivetrain, a: None,
    diagnostics=Diagnostics(
        why_unseen="too little turning at speed",
        regressor=Regressor(column=slower_in_turns, tolerance=0.005),
    ),
)
FURTHER_MOTION = [(SCRUB, {"scrub": 0.01}, 0.01), (SAG, {"sag": 0.2}, 0.2)]


def driven_in_a_box(robot: Robot, **effect: float) -> tuple[Run, Arena]:
    """Return a run of the closed-form robot, with what its laser reads in an empty box about its way."""
    run = make_run(3, **effect)
    low, high = run.poses[:, :2].min(axis=0) - 1.0, run.poses[:, :2].max(axis=0) + 1.0
    box = polygon_arena([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])])
    smooth = np.column_stack([run.poses[:, :2], np.unwrap(run.poses[:, 2])])
    stamps = np.arange(1.0, run.pose_stamps[-1] - 1.0, 0.5)
    scene = Scene(
        arena=box,
        sensor=robot.sensor,
        stamps=stamps,
        motion=lambda times: np.stack([np.interp(times, run.pose_stamps, c) for c in smooth.T], axis=-1),
        span=float(stamps[-1]),
    )
    scene.run()
    ranges = draw_readings(scene, np.random.default_rng(7))
    return replace(run, sensor=robot.sensor, stamps=stamps, ranges=ranges), box


@pytest.mark.parametrize(
    ("effect", "planted", "truth"), [FURTHER_MOTION[0], *further(FURTHER_MOTION[1])], ids=["wheels", "motors"]
)
def test_a_further_effect_of_wheels_or_motors_is_found_once_it_is_in_the_library(
    effect: Effect, planted: dict[str, float], truth: float, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, box = driven_in_a_box(robot, **planted)
    monkeypatch.setitem(EFFECTS, effect.name, effect)
    finding = diagnose(run, box, robot, plan_next=False)
    assert [a.name for a in finding.effects] == [effect.name]
    first = finding.effects[0]
    assert abs(first["c"] - truth) < 3 * first.stderr["c"] < 0.3 * truth
    assert finding.channels[effect.channel].unknown is None


@pytest.mark.parametrize("effect", [SCRUB, *further(SAG)], ids=["wheels", "motors"])
def test_a_further_effect_of_wheels_or_motors_is_not_found_where_it_is_not(
    effect: Effect, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EFFECTS, effect.name, effect)
    result = diagnose_odometry if effect.channel == "odometry" else diagnose_drive
    found = result(make_run(1), robot)
    assert found.effects == () and found.unknown is None and effect.name not in found.not_observable
