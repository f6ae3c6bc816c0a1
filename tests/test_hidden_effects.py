"""A seeded part of benchmarks/hidden_effects: effects hidden by a generator that shares no code with the diagnosis."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import further

from benchmarks.hidden_effects.case import Spec, save
from benchmarks.hidden_effects.entrants import least_squares
from benchmarks.hidden_effects.entrants.product import run_of
from benchmarks.hidden_effects.worlds.own.cases import make
from planners.maps import geojson
from sensorgraph.diagnosis.diagnose import diagnose, diagnose_motion
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.world.robot import parse_robot


def found(**spec: object) -> tuple[Finding, dict[str, object]]:
    """Diagnose one case; return the finding and the truth."""
    case = make(Spec(**spec))  # type: ignore[arg-type]
    arena = geojson.loads(case.map["arena.geojson"])
    return diagnose(run_of(case), arena, parse_robot(case.robot), plan_next=False), case.truth


@pytest.mark.parametrize("background", ["dirty", *further("clean")])
def test_nothing_is_named_where_nothing_is_hidden(background: str) -> None:
    finding, _ = found(suite="none", index=2, background=background)
    assert not finding.effects
    assert finding.unknown is None


@pytest.mark.slow
def test_ticks_of_a_slow_loop_that_beat_with_the_commands_are_no_changing_delay() -> None:
    """A base at 10 Hz, commands at 20 Hz: delays of stretches differ by 36 ms, which 96 nats had made unknown."""
    case = make(Spec(suite="none", kinds="report", index=10276, background="dirty"))
    for channel in diagnose_motion(run_of(case), parse_robot(case.robot), ()):
        assert channel.effects == () and channel.unknown is None


@pytest.mark.slow
def test_a_baseline_names_what_is_continuous_and_knows_no_unknown(tmp_path: Path) -> None:
    """Least squares finds a mount turned by a degree; a lens that bends the view it calls by names of the library."""
    for name, is_known in (("mount_yaw", True), ("bearing_scale", False)):
        suite = "singles" if is_known else "foreign"
        spec = Spec(suite=suite, index=5, background="clean", effect=name, strength=0.9)
        save(make(spec), tmp_path, int(is_known))
        report = least_squares.answer(tmp_path / "cases" / f"{int(is_known):04d}")
        assert report["unknown"] is None and report["effects"]
        assert not is_known or report["effects"][0]["name"] == name


QUICK = ["dead_time"]
"""Others stand in the tests of the channels and in test_diagnosis_report.py."""
LONG = [
    "moved_wall", "wheel_base", "latency", "range_bias", "mount_yaw", "max_range", "quantisation",
    "range_scale", "sector_bias", "mount_xy", "scan_skew", "glass", "mirror", "black_surface", "incidence_dropout",
    "min_range", "unmapped_obstacle", "moved_obstacle", "missing_obstacle", "map_scale", "people", "range_drift",
    "wheel_radius", "actuator_lag", "self_occlusion", "tilt", "random_outliers", "pose_clock_offset", "mixed_pixels",
]  # fmt: skip


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in LONG)])
def test_a_hidden_effect_is_named_first_on_a_dirty_background(name: str) -> None:
    finding, truth = found(suite="singles", index=5, background="dirty", effect=name, strength=0.7)
    assert [a.name for a in finding.effects][:1] == [name], truth
    assert finding.unknown is None
    gap = finding.channels["scan"].gap
    assert gap is not None
    effect = finding.effects[0].effect
    if effect.channel == "scan" and not effect.absorber:  # the seconds held out may hold hardly anybody
        assert gap.after.nats_per_ray <= gap.before.nats_per_ray


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 3, 6])
def test_what_the_library_lacks_gets_no_name(index: int) -> None:
    finding, _ = found(suite="foreign", index=index + 1, background="dirty")
    assert finding.unknown is not None
    assert not finding.effects
