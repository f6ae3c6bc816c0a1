"""effects.yaml: round trip, what a hand may write, and every mistake in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from effects_samples import arena, neutral, strong

from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.effects_file import check_places, dumps, loads, read, write
from sensorgraph.errors import SensorgraphError

ROOM = arena()
SCAN = [name for name, effect in EFFECTS.items() if effect.channel == "scan"]


def facts(a: Amendment) -> tuple[object, ...]:
    return a.effect, dict(a.parameters), dict(a.stderr), a.location, a.probability, a.evidence


def full(name: str) -> Amendment:
    """Return an amendment with all that a diagnosis says."""
    a = (
        strong(name)
        if name in SCAN
        else neutral(name).moved_to({p.name: 0.125 for p in EFFECTS[name].parameters})
    )
    return Amendment(
        effect=a.effect,
        parameters={k: np.float64(v) / 3 for k, v in a.parameters.items()},
        stderr={k: np.float64(v) / 300 for k, v in a.parameters.items()},
        location=a.at(a.place, np.array([1 / 3, 2.0])).location,
        probability=0.999,
        evidence=1234.5,
    )


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    amendments = [full(name) for name in EFFECTS]
    write(amendments, tmp_path / "effects.yaml")
    again = read(tmp_path / "effects.yaml", ROOM)
    assert [facts(a) for a in again] == [facts(a) for a in amendments]
    assert dumps(again) == dumps(amendments)
    assert [path.name for path in tmp_path.iterdir()] == ["effects.yaml"]


def test_the_file_is_readable() -> None:
    a = EFFECTS["glass"](a=0.5, b=2.0, alpha_ret=0.3, depth=np.float64(1.0)).at("room/edge_0")
    assert dumps([a]) == (
        "- name: glass\n"
        "  parameters: {a: 0.5, b: 2.0, alpha_ret: 0.3, depth: 1.0}\n"
        "  location: {name: room/edge_0}\n"
    )


@pytest.mark.parametrize("text", ["", "[]", "# nothing yet\n"])
def test_an_empty_file_is_no_effect(text: str) -> None:
    assert loads(text) == ()


def test_a_file_without_an_effect_is_said_in_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "effects.yaml").write_text("[]\n")
    assert read(tmp_path / "effects.yaml", ROOM) == ()
    (line,) = caplog.messages
    assert line == f"{tmp_path / 'effects.yaml'} contains no effect; the model is unchanged"


def test_places_are_checked_later_against_the_arena_of_a_run() -> None:
    (pane,) = loads(
        f"- {{name: glass, parameters: {{a: 90, b: 91, {PANE}}}, location: {{name: room/edge_0}}}}"
    )
    with pytest.raises(
        SensorgraphError, match=r"mine.yaml: effect 1 \(glass\): the part .* is outside `room/edge_0`"
    ):
        check_places([pane], ROOM, name="mine.yaml")


def test_a_hand_may_leave_out_what_has_a_default() -> None:
    warm, scale = loads(
        "- {name: range_drift, parameters: {b1: 1e-2}}\n- {name: map_scale, parameters: {s: 0.01}}\n"
    )
    assert warm["b1"] == 0.01
    assert dict(scale.parameters) == {"s": 0.01}


BIAS = "name: range_bias, parameters: {b: 0.1}"
PANE = "alpha_ret: 0.3, depth: 1.0"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- {name: [", "not YAML"),
        ("name: glass", "expected a list of effects"),
        ("- glass", "effect 1 is 'glass', expected keys name"),
        ("- {parameters: {b: 1}}", "expected keys name"),
        (f"- {{{BIAS}}}\n- {{name: glas}}", "effect 2: unknown effect `glas`; did you mean `glass`?"),
        ("- {name: range_bias, params: {b: 1}}", "unknown key `params`; did you mean `parameters`?"),
        ("- {name: range_bias, parameters: {q: 1}}", "unknown parameter `q`; expected `b`"),
        ("- {name: range_bias}", "parameter `b` is missing (m, offset of each return)"),
        ("- {name: range_bias, parameters: [1]}", "parameter is [1], expected NAME: NUMBER for b"),
        ("- {name: range_bias, parameters: {b: much}}", "parameter `b` is 'much', expected a number"),
        ("- {name: range_bias, parameters: {b: true}}", "is True, expected a number"),
        ("- {name: range_bias, parameters: {b: .nan}}", "expected a number"),
        ("- {name: range_bias, parameters: {b: .inf}}", "expected a number"),
        ("- {name: people, parameters: {p: 1.5}}", "`p` is 1.5, expected 0 to 1"),
        (f"- {{{BIAS}, stderr: {{c: 1}}}}", "unknown stderr `c`"),
        (f"- {{{BIAS}, evidence: strong}}", "evidence is 'strong'"),
        (f"- {{{BIAS}, location: here}}", "location is 'here'"),
        (f"- {{{BIAS}, location: {{xyz: 1}}}}", "unknown key of location `xyz`; did you mean `xy`?"),
        (f"- {{{BIAS}, location: {{xy: [1]}}}}", "expected [x, y] in m"),
        (f"- {{{BIAS}, location: {{name: 3}}}}", "location.name is 3"),
        ("- {name: missing_obstacle, parameters: {x: 1}}", "none is expected"),
        ("- {name: missing_obstacle}", "the name of its obstacle is missing"),
        (
            "- {name: mirror, parameters: {a: 0, b: 1}}",
            "the name of its wall is missing; add location: {name: ...}",
        ),
        (
            "- {name: moved_wall, parameters: {d: 0.1}, location: {name: room}}",
            "no wall `room`; room has `room/edge_0` to `room/edge_",
        ),
        (
            "- {name: moved_wall, parameters: {d: 0.1}, location: {name: room/edge_99}}",
            "no wall `room/edge_99`; room has `room/edge_0` to `room/edge_",
        ),
        ("- {name: missing_obstacle, location: {name: piano}}", "no obstacle `piano`; it has `"),
        ("- {name: missing_obstacle, location: {name: bx}}", "no obstacle `bx`; did you mean `box`?"),
        (
            f"- {{name: glass, parameters: {{a: 2.0, b: 0.5, {PANE}}}, location: {{name: room/edge_0}}}}",
            "expected a < b",
        ),
        ("- {name: mirror, parameters: {a: 1, b: 1}, location: {name: room/edge_0}}", "expected a < b"),
        (
            f"- {{name: glass, parameters: {{a: 90, b: 91, {PANE}}}, location: {{name: room/edge_0}}}}",
            "is outside `room/edge_0`",
        ),
    ],
)
def test_a_mistake_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "effects.yaml"
    path.write_text(text)
    with pytest.raises(SensorgraphError) as caught:
        read(path, ROOM)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    for path, said in (
        (tmp_path, "is a directory"),
        (tmp_path / "none.yaml", "does not exist"),
        (tmp_path / "binary.yaml", "not a text file"),
    ):
        with pytest.raises(SensorgraphError, match=said):
            read(path)
