"""Effects own what is known about them: no name of one is quoted elsewhere, and a further one is a single object."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import polygon_arena

from logs.run import Run
from planners.arena import Arena, wrap
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.effects import EFFECTS, Amendment, Effect, Parameter
from sensorgraph.world.robot import Robot, Tolerances, parse_robot
from sensorgraph.world.scene import Scene, draw_readings

ROOT = Path(__file__).parent.parent / "sensorgraph"
SCAN = [effect for effect in EFFECTS.values() if effect.channel == "scan"]


def quoted(path: Path) -> list[tuple[int, str]]:
    """Return lines and values of string constants that are names of effects; docstrings hold more than a name."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in EFFECTS:
            found.append((node.lineno, node.value))
    return found


def test_no_name_of_an_effect_is_quoted_outside_the_library() -> None:
    outside = [p for p in sorted(ROOT.rglob("*.py")) if ROOT / "effects" not in p.parents]
    assert len(outside) > 100
    assert {p.name: names for p in outside if (names := quoted(p))} == {}


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
def hall() -> Arena:
    return polygon_arena(
        [(0, 0), (6, 0), (6, 5), (0, 5)],
        [(2.0, 3.0), (2.6, 3.0), (2.6, 3.5), (2.0, 3.5)],
        [(4.0, 1.0), (4.5, 1.2), (4.3, 1.7)],
    )


@pytest.fixture(scope="module")
def robot() -> Robot:
    return parse_robot("sensor: {n_rays: 61}")


@pytest.fixture(scope="module")
def plain(hall: Arena, robot: Robot) -> Run:
    """Return a run without any effect: a circle that breathes, with turns of both senses."""
    rng = np.random.default_rng(4)
    t = 0.2 * np.arange(160)
    fine = np.linspace(0, t[-1], 3200)
    phase = 0.35 * fine
    x, y = 3.0 + 1.5 * np.cos(phase), 2.3 + 1.0 * np.sin(phase) + 0.2 * np.sin(3 * phase)
    path = np.column_stack([x, y, phase + 1.5 * np.sin(0.9 * fine)])
    scene = Scene(
        arena=hall,
        sensor=robot.sensor,
        stamps=t,
        motion=lambda times: np.stack([np.interp(times, fine, c) for c in path.T], axis=-1),
        span=float(t[-1]),
    )
    scene.run()
    reference = path + rng.normal(size=path.shape) * [0.002, 0.002, 0.0015]
    return Run(
        sensor=robot.sensor,
        stamps=t,
        ranges=draw_readings(scene, rng),
        pose_stamps=fine,
        poses=np.column_stack([reference[:, :2], wrap(reference[:, 2])]),
    )


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
    finding = diagnose(bent, hall, robot)
    first = finding.effects[0]
    assert first.name == CURVATURE.name
    assert abs(first["c"] - TRUE_C) < 3 * first.stderr["c"] < 0.2 * TRUE_C
    assert [a.name for a in finding.effects] == [CURVATURE.name]
    assert finding.channels["scan"].unknown is None


def test_without_it_the_library_does_not_know_that_name(hall: Arena, robot: Robot, bent: Run) -> None:
    finding = diagnose(bent, hall, robot)
    assert CURVATURE.name not in EFFECTS
    assert CURVATURE.name not in {a.name for a in finding.effects}
    assert finding.effects or finding.channels["scan"].unknown is not None  # something is said to be wrong


def test_it_is_not_found_where_it_is_not(
    hall: Arena, robot: Robot, plain: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EFFECTS, CURVATURE.name, CURVATURE)
    finding = diagnose(plain, hall, robot)
    assert finding.effects == ()
    assert CURVATURE.name not in finding.channels["scan"].not_observable
