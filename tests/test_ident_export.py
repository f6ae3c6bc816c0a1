"""An exported model is the same model: compiled C agrees, JSON comes back, LaTeX holds every number."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from robotmodic_ident import IdentError, Narmax, Scale, Terms, fit, fourier, polynomial
from robotmodic_ident.export import from_json, to_c, to_json, to_latex

COMPILER = shutil.which("cc")


@pytest.fixture(scope="module")
def fitted() -> tuple[Narmax, dict[str, np.ndarray]]:
    """Return a model with powers, products and harmonics, and its data, far from the origin."""
    rng = np.random.default_rng(1)
    u, phi = rng.uniform(-1, 1, 500), rng.uniform(-3, 3, 500)
    y = np.zeros(500)
    for k in range(2, 500):
        y[k] = 0.5 * y[k - 1] - 0.2 * y[k - 2] * u[k - 1] + 0.3 * u[k] ** 2 + np.cos(2 * phi[k]) / 3 + 0.1
    data = {"y": y + 0.01 * rng.normal(size=500), "u": u, "phi": phi}
    signals = ["y(k-1)", "y(k-2)", "u(k)", "u(k-1)"]
    return fit(data, "y", polynomial(signals, 3) + fourier(["phi(k)"], 2), n_terms=12), data


@pytest.mark.skipif(COMPILER is None, reason="no C compiler `cc` on this machine")
def test_compiled_c_predicts_as_python_does(
    fitted: tuple[Narmax, dict[str, np.ndarray]], tmp_path: Path
) -> None:
    model, data = fitted
    (tmp_path / "model.c").write_text(to_c(model, name="step"))
    subprocess.run(
        [str(COMPILER), "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-Wno-missing-prototypes",
         "-shared", "-fPIC", "-o", "model.so", "model.c", "-lm"],
        cwd=tmp_path, check=True,
    )  # fmt: skip
    step = ctypes.CDLL(str(tmp_path / "model.so")).step
    step.restype = ctypes.c_double
    signals = model.in_user_units().terms.signals
    said = model.predict_osa(data)
    for k in range(2, 500):
        lags = [re.fullmatch(r"(\w+)\(k(?:-(\d+))?\)", s) for s in signals]
        values = [data[m[1]][k - int(m[2] or 0)] for m in lags if m]
        assert step((ctypes.c_double * len(values))(*values)) == pytest.approx(said[k], rel=1e-12, abs=1e-12)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler `cc` on this machine")
def test_c_and_latex_of_variables_a_thousand_km_away_keep_their_digits(tmp_path: Path) -> None:
    x = 1e6 + np.random.default_rng(3).uniform(-1, 1, 300)
    data = {"x": x, "y": 1 + 0.3 * (x - 1e6) - 0.7 * (x - 1e6) ** 3}
    model = fit(data, "y", polynomial(["x"], 3))
    (tmp_path / "model.c").write_text(to_c(model, name="step"))
    subprocess.run(
        [str(COMPILER), "-std=c99", "-shared", "-fPIC", "-o", "model.so", "model.c"], cwd=tmp_path, check=True
    )
    step = ctypes.CDLL(str(tmp_path / "model.so")).step
    step.restype = ctypes.c_double
    said = [step((ctypes.c_double * 1)(v)) for v in x]
    np.testing.assert_allclose(said, model.predict_osa(data), atol=1e-12)
    assert r"\left(x - 1000000\right)^{3}" in to_latex(model)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler `cc` on this machine")
def test_a_constant_compiles_without_warning(tmp_path: Path) -> None:
    constant = Narmax(
        output="y", terms=Terms.parse("1"), theta=np.array([2.5]), covariance=np.eye(1),
        err=np.ones(1), sigma=0.0, n_samples=3,
    )  # fmt: skip
    (tmp_path / "model.c").write_text(to_c(constant))
    subprocess.run(
        [str(COMPILER), "-std=c99", "-Wall", "-Wextra", "-Werror", "-c", "model.c"], cwd=tmp_path, check=True
    )


def test_json_comes_back_as_the_same_model(fitted: tuple[Narmax, dict[str, np.ndarray]]) -> None:
    model, data = fitted
    again = from_json(to_json(model))
    assert again.terms.names == model.terms.names
    np.testing.assert_array_equal(again.theta, model.theta)
    np.testing.assert_array_equal(again.covariance, model.covariance)
    np.testing.assert_array_equal(again.predict_osa(data), model.predict_osa(data))


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"format": "robotmodic-narmax-1"}'])
def test_json_of_something_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(IdentError, match="not a model"):
        from_json(text)


def test_latex_reads_as_the_equation_does() -> None:
    model = Narmax(
        output="omega", terms=Terms.parse("1", "L67(k-1)^2", "cos(2*phi(k))"),
        theta=np.array([-0.5, 1.0, 2.5e-7]), covariance=np.eye(3), err=np.zeros(3), sigma=0.0, n_samples=9,
    )  # fmt: skip
    assert to_latex(model) == (
        r"\omega(k) = - 0.5 + \left[\mathrm{L67}(k-1)\right]^{2} "
        r"+ 2.5 \cdot 10^{-7}\,\cos\left(2\phi(k)\right)"
    )


def test_latex_of_a_long_model_is_aligned_with_every_term(
    fitted: tuple[Narmax, dict[str, np.ndarray]],
) -> None:
    text = to_latex(fitted[0])
    assert text.startswith("\\begin{aligned}")
    assert text.count(" + ") + text.count(" - ") + text.count("- ") >= 12 - 4  # line breaks begin with a sign
    assert text.count("{") == text.count("}")


def test_export_is_in_the_users_units() -> None:
    centred = Narmax(
        output="y", terms=Terms.parse("x"), theta=np.array([2.0]), covariance=np.eye(1), err=np.ones(1),
        sigma=0.0, n_samples=9, scale=Scale.between({"x": (10.0, 14.0)}),
    )  # fmt: skip
    assert "+ x" in to_latex(centred)
    assert "- 12" in to_latex(centred) or to_latex(centred).startswith("y = - 12")


def test_the_page_of_the_analysis_runs_as_shown(capsys: pytest.CaptureFixture[str]) -> None:
    page = Path(__file__).parent.parent / "docs" / "pages" / "how-to" / "analyse.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.S)
    exec(compile(code, str(page), "exec"), {})
    said = capsys.readouterr().out
    assert "v(k) = 0.8" in said
    assert "a(k) = " in said
    assert "double v_step(const double s[])" in said
