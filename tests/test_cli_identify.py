"""`sensorgraph identify`: what is written is what was promised, and bad input costs one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from robotmodic_ident import Narmax
from sensorgraph.cli import run as command


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a CSV of two records of speed = 0.6 speed(k-1) + 0.5 volts(k-1)^2, with a hole."""
    path = tmp_path_factory.mktemp("csv") / "motor.csv"
    rng = np.random.default_rng(1)
    lines = ["record,t,volts,speed,flat"]
    for name in ("a", "b"):
        volts, speed = rng.uniform(0, 2, 200), 0.0
        for k in range(200):
            speed = 0.6 * speed + 0.5 * (volts[k - 1] ** 2 if k else 0.0)
            cell = "" if k == 50 else f"{speed + 0.01 * rng.normal():.6f}"
            lines.append(f"{name},{0.1 * k:.1f},{volts[k]:.6f},{cell},3.0")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_model_file_holds_what_is_promised(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "motor.json"
    options = ["--output", "speed", "--inputs", "volts", "--lags", "1", "--output-lags", "1", "-o", str(out)]
    assert command(["identify", str(table), *options]) == 0
    data = json.loads(out.read_text())
    assert {"output", "inputs", "terms", "noise_terms", "one_step", "free_run", "validation", "split"} <= set(
        data
    )
    assert (data["output"], data["inputs"], data["split"]) == ("speed", ["volts"], "half")
    assert {frozenset(t) for t in data["terms"]} == {frozenset(("name", "theta", "stderr", "err"))}
    assert {"rmse", "rrse", "r", "p_value"} <= set(data["free_run"])
    found = {t["name"]: t["theta"] for t in data["terms"]}
    assert found["speed(k-1)"] == pytest.approx(0.6, abs=0.01)
    assert found["volts(k-1)^2"] == pytest.approx(0.5, abs=0.01)
    assert data["period_s"] == pytest.approx(0.1)
    assert 0 <= data["outside"]["share"] < 0.05
    assert data["unknown"] == {"speed": 0.005, "volts": 0.0}
    assert Narmax.load(out).terms.names == tuple(found)
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    said = capsys.readouterr().out
    assert "speed: 0.5 % of the samples are unknown" in said
    assert "volts(k-1)^2" in said
    assert "the range of the training data" in said


@pytest.mark.slow
def test_noise_lags_auto_finds_how_many_and_the_file_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(8)
    u, e, y = rng.uniform(-1, 1, 1200), 0.2 * rng.normal(size=1200), np.zeros(1200)
    for k in range(2, 1200):
        y[k] = 0.7 * y[k - 1] + u[k - 1] + e[k] + 0.8 * e[k - 1] + 0.4 * e[k - 2]
    path, out = tmp_path / "arma.csv", tmp_path / "m.json"
    path.write_text("u,y\n" + "\n".join(f"{a},{b}" for a, b in zip(u, y, strict=True)))
    form = ["--output", "y", "--inputs", "u", "--lags", "1", "--output-lags", "1", "--degree", "1"]
    assert command(["identify", str(path), *form, "--noise-lags", "auto", "-o", str(out)]) == 0
    data = json.loads(out.read_text())
    assert data["noise_lags"] == "auto"
    assert {t["name"]: t["theta"] for t in data["noise_terms"]} == {
        "e(k-1)": pytest.approx(0.8, abs=0.15),
        "e(k-2)": pytest.approx(0.4, abs=0.15),
    }
    said = capsys.readouterr().out
    assert "note: noise lags: 0 to 2 tried, 2 kept" in said
    assert "standard errors are too small" not in said
    assert command(["identify", str(path), *form, "-o", str(out)]) == 0
    assert "standard errors are too small; try --noise-lags auto" in capsys.readouterr().out
    assert command(["identify", str(path), *form, "--noise-lags", "1", "-o", str(out)]) == 0
    assert [t["name"] for t in json.loads(out.read_text())["noise_terms"]] == ["e(k-1)"]


BAD = {
    "a name that is near": (["--output", "sped", "--inputs", "volts"], "did you mean speed?"),
    "an input that is far": (
        ["--output", "speed", "--inputs", "qqq"],
        "expected one of t, volts, speed, flat",
    ),
    "constant": (["--output", "flat", "--inputs", "volts"], "constant"),
    "lags": (
        ["--output", "speed", "--inputs", "volts", "--lags", "150", "--degree", "1"],
        "longest interval",
    ),
    "terms": (["--output", "speed", "--inputs", "volts", "--lags", "30"], "are too few for"),
    "split": (["--output", "speed", "--inputs", "volts", "--split", "third"], "expected one of half"),
    "criterion": (["--output", "speed", "--inputs", "volts", "--criterion", "luck"], "expected one of"),
    "nothing": (["--output", "speed"], "no explanatory signal"),
    "itself": (["--output", "speed", "--inputs", "speed"], "speed is output and input"),
    "record": (["--output", "speed", "--inputs", "record"], "record separates records"),
    "several": (["--output", "speed,flat", "--inputs", "volts"], "for each of speed and flat"),
    "twice": (["--output", "speed", "--output", "flat", "--inputs", "volts"], "names 2 signals"),
    "none": (["--output", ",", "--inputs", "volts"], "name one"),
    "topic": (["--output", "speed", "--inputs", "volts", "--topic", "scan=/a"], "is a CSV"),
    "noise lags": (["--output", "speed", "--inputs", "volts", "--noise-lags", "many"], "0 to 100, or auto"),
    "too many noise lags": (
        ["--output", "speed", "--inputs", "volts", "--noise-lags", "40"],
        "give at most",
    ),
    "degree": (["--output", "speed", "--inputs", "volts", "--degree", "9"], "--degree"),
    "auto with a degree": (
        ["--output", "speed", "--inputs", "volts", "--auto", "--lags", "3", "--degree", "3"],
        "leave out --lags and --degree",
    ),
}


@pytest.mark.parametrize(("options", "said"), BAD.values(), ids=BAD)
def test_bad_input_costs_one_line_and_leaves_nothing(
    options: list[str], said: str, table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(["identify", str(table), *options, "-o", str(tmp_path / "m.json")]) == 2
    text = capsys.readouterr().err
    assert said in text
    assert text.count("\n") == 1
    assert not list(tmp_path.iterdir())


TABLES = {
    "empty": ("", "is empty"),
    "header alone": ("a,b\n", "no rows"),
    "a word": ("a,b\n1,2\n1,zwei\n", "line 3: b is 'zwei'"),
    "a short row": ("a,b\n1,2\n1\n", "line 3 has 1 cells"),
    "twice": ("a,b,b\n1,2,3\n", "twice"),
    "semicolons": ("a;b\n1;2\n", "replace ';' by commas"),
    "no header": ("1,2\n3,4\n", "the first line has numbers"),
    "no time": ("t,a,b\n0,1,2\n,1,2\n2,1,2\n", "line 3: column t is not a number"),
    "short records": ("record,a,b\n" + "".join(f"{i // 3},{i},{i}\n" for i in range(30)), "1 for testing"),
    "one row": ("a,b\n1,2\n", "longest interval"),
    "not known": ("a,b\n,2\n,3\n", "a has no known sample"),
    "time goes back": ("t,a,b\n0,1,2\n1,1,2\n0.5,1,2\n", "line 3: column t"),
}


@pytest.mark.parametrize(("text", "said"), TABLES.values(), ids=TABLES)
def test_a_broken_table_is_told_by_its_line(
    text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "data.csv"
    path.write_text(text)
    assert (
        command(["identify", str(path), "--output", "a", "--inputs", "b", "-o", str(tmp_path / "m.json")])
        == 2
    )
    assert said in capsys.readouterr().err


@pytest.mark.usefixtures("no_pictures")
def test_as_many_terms_as_samples_have_no_standard_error(tmp_path: Path) -> None:
    path, out = tmp_path / "six.csv", tmp_path / "m.json"
    path.write_text("u,y\n0.3,1.2\n-0.4,0.7\n0.9,-0.2\n0.1,0.5\n0.6,0.1\n-0.2,0.8\n")
    options = ["--output", "y", "--inputs", "u", "--lags", "0", "--terms", "3", "-o", str(out)]
    assert command(["identify", str(path), *options]) == 0
    data = json.loads(out.read_text(), parse_constant=pytest.fail)
    assert [t["stderr"] for t in data["terms"]] == [None] * 3
    assert np.isnan(Narmax.load(out).stderr).all()
    assert isinstance(data["one_step"]["n"], int)
    assert data["outside"]["share"] is None


@pytest.mark.usefixtures("no_pictures")
def test_what_no_term_explains_is_said_with_noise_and_without(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(4)
    path, out = tmp_path / "white.csv", tmp_path / "m.json"
    path.write_text("u,y\n" + "\n".join(f"{a},{b}" for a, b in rng.normal(size=(200, 2))))
    for noise in ("0", "2"):
        options = ["--output", "y", "--inputs", "u", "--noise-lags", noise, "-o", str(out)]
        assert command(["identify", str(path), *options]) == 0
        assert "no term is significant" in capsys.readouterr().out
        assert len(json.loads(out.read_text())["terms"]) == 1


@pytest.mark.usefixtures("no_pictures")
def test_an_output_that_rests_where_it_is_scored_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(4)
    path, out = tmp_path / "rest.csv", tmp_path / "m.json"
    u = rng.normal(size=80)
    path.write_text("u,y\n" + "\n".join(f"{a},{2 * a if i < 40 else 3}" for i, a in enumerate(u)))
    assert command(["identify", str(path), "--output", "y", "--inputs", "u", "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "no r: y is constant in the test data" in said
    assert "nan" not in said
    assert json.loads(out.read_text())["one_step"]["r"] is None


@pytest.mark.slow
def test_what_is_odd_about_the_samples_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(4)
    u = rng.normal(size=200)
    even, uneven = np.arange(200.0), np.arange(200.0) + rng.uniform(-0.24, 0.24, 200)
    gap = even + 10 * (even >= 100)
    cases = {
        "1 gap in t": (gap, u, 2 * u),
        "unevenly spaced": (uneven, u, 2 * u),
        "no score: ": (even, u, np.where(even < 100, 2 * u, np.nan)),
        "more such terms": (even, np.full(200, 3.0), 2 * u),
    }
    for said, columns in cases.items():
        path, out = tmp_path / "odd.csv", tmp_path / "m.json"
        rows = (",".join(map(str, row)) for row in zip(*columns, u, strict=True))
        path.write_text("t,u,y,w\n" + "\n".join(rows))
        assert command(["identify", str(path), "--output", "y", "--inputs", "u,w", "-o", str(out)]) == 0
        assert said in capsys.readouterr().out


@pytest.mark.slow
def test_a_wall_following_run_becomes_a_polynomial_that_drives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = tmp_path / "robot.yaml"
    robot.write_text("sensor: {rate: 4.0, n_rays: 61}\n")
    plan, run = tmp_path / "plan.csv", tmp_path / "run.mcap"
    plan.write_text("t,x,y,phi,v,omega,primitive\n0,3.2,2.3,0,0,0,wait\n60,3.2,2.3,0,0,0,wait\n")
    drive = ["record", str(plan), "--arena", "square", "--robot", str(robot)]
    assert command([*drive, "--controller", "wall_following", "-o", str(run)]) == 0
    models = []
    for name in ("cmd_omega", "cmd_v"):
        models.append(str(tmp_path / f"{name}.json"))
        asked = ["--output", name, "--inputs", "L45-90", "--lags", "1", "-o", models[-1]]
        assert command(["identify", str(run), *asked]) == 0
    copy = [
        *drive,
        "--controller",
        models[0],
        "--controller",
        ",".join(models),
        "-o",
        str(tmp_path / "c.mcap"),
    ]
    assert command(copy) == 0
    assert (tmp_path / "c.cmd_omega+cmd_v.mcap").exists()
    assert "| | cmd_omega | cmd_omega+cmd_v |" in capsys.readouterr().out
    assert command([*drive, "--controller", "sideways", "-o", str(tmp_path / "d.mcap")]) == 2
    assert command(["identify", str(run), "--output", "L67x", "--inputs", "x", "-o", models[0]]) == 2
    assert "did you mean L67?" in capsys.readouterr().err
