"""The compiled runs equal a plain Python loop over the terms."""

from __future__ import annotations

import numpy as np
import pytest

from robotmodic_ident import IdentError, Narmax, Record, Scale, Terms

SCALE = Scale(("y", "u"), (0.1, -0.2), (1.5, 2.0))


def model() -> Narmax:
    terms = Terms.parse("1", "y(k-1)", "u(k)*y(k-2)^2", "P2(u(k-1))", "B3_1of6(y(k-1))", "sin(2*y(k-2))")
    below, noise = Terms.parse("u(k-1)^2"), Terms.parse("e(k-1)", "y(k-1)*e(k-2)")
    rng = np.random.default_rng(0)
    return Narmax(
        output="y",
        terms=terms,
        theta=rng.uniform(-0.4, 0.4, 6),
        err=np.zeros(6),
        covariance=np.eye(9),
        sigma=1.0,
        n_samples=1,
        scale=SCALE,
        denominator=below,
        denominator_theta=np.array([0.3]),
        noise_terms=noise,
        noise_theta=np.array([0.5, -0.3]),
    )


def plain(m: Narmax, y: np.ndarray, u: np.ndarray, *, known_until: int | None = None) -> np.ndarray:
    """Run the model sample by sample with numpy; past outputs are predictions after `known_until`."""
    n, past, e, out = len(y), y.copy(), np.zeros(len(y)), np.full(len(y), np.nan)
    for k in range(2, n):
        columns = {
            f"{name}(k-{lag})" if lag else f"{name}(k)": np.array([s[k - lag]])
            for name, s in (("y", past), ("u", u), ("e", e))
            for lag in range(3)
            if lag or name == "u"
        }
        parts = [t.matrix(columns, SCALE, n=1)[0] for t in (m.terms, m.denominator, m.noise_terms)]
        out[k] = parts[0] @ m.theta / (1 + parts[1] @ m.denominator_theta) + parts[2] @ m.noise_theta
        if known_until is None or k <= known_until:
            e[k] = y[k] - out[k]
        else:
            past[k], e[k] = out[k], 0.0
    return out


@pytest.fixture
def record() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {"y": rng.uniform(-1, 1, 30), "u": rng.uniform(-1, 1, 30)}


def test_one_step_prediction_keeps_the_noise_it_finds(record) -> None:
    np.testing.assert_allclose(model().predict_osa(record), plain(model(), **record), atol=1e-13)


def test_free_run_knows_the_start_only(record) -> None:
    np.testing.assert_allclose(
        model().predict_mpo(record), plain(model(), **record, known_until=1), atol=1e-13
    )


@pytest.mark.parametrize("steps", [2, 7])
def test_k_steps_ahead_know_nothing_of_the_last_k_minus_1_outputs(record, steps: int) -> None:
    ahead = model().predict_k(record, steps)
    assert np.isnan(ahead[: 2 + steps - 1]).all()
    for k in range(2 + steps - 1, 30):
        assert ahead[k] == pytest.approx(plain(model(), **record, known_until=k - steps)[k], abs=1e-13)


def test_unknown_output_stops_what_needs_it_and_nothing_else(record) -> None:
    record["y"][10] = np.nan
    osa = model().predict_osa(record)
    assert np.flatnonzero(np.isnan(osa)).tolist() == [0, 1, 11, 12]
    free = model().predict_mpo(record)
    assert np.isfinite(free[2:]).all()  # a free run needs no outputs


def test_file_keeps_noise_and_denominator(record, tmp_path) -> None:
    model().save(tmp_path / "m.json")
    again = Narmax.load(tmp_path / "m.json")
    np.testing.assert_array_equal(again.predict_osa(record), model().predict_osa(record))
    assert again.equation(scaled=True) == model().equation(scaled=True)


def test_widths_taken_out_of_the_coefficients_leave_the_function(record) -> None:
    plain_model = model().without_widths()
    assert plain_model.scale.widths == (1.0, 1.0) and plain_model.scale.centres == SCALE.centres
    np.testing.assert_allclose(plain_model.predict_osa(record), model().predict_osa(record), atol=1e-13)


def test_gap_in_the_stamps_restarts_both_runs(record) -> None:
    stamps = np.arange(30.0) + np.where(np.arange(30) >= 15, 100.0, 0.0)
    parted = Record(signals=record, stamps=stamps)
    second = {name: values[15:] for name, values in record.items()}
    for run in (Narmax.predict_osa, Narmax.predict_mpo):
        np.testing.assert_array_equal(run(model(), parted)[15:], run(model(), second))


RUNS = {
    "one step": lambda m, r: m.predict_osa(r),
    "3 steps": lambda m, r: m.predict_k(r, 3),
    "free": lambda m, r: m.predict_mpo(r),
}


@pytest.mark.parametrize("run", RUNS.values(), ids=RUNS)
def test_every_stretch_runs_as_if_it_were_alone(run) -> None:
    rng = np.random.default_rng(3)
    y, u = rng.uniform(-1, 1, (2, 40))
    u[33] = np.nan
    stamps = np.arange(40.0)
    for start in (12, 13, 15, 25):  # segments of 12, 1, 2, 10 and 15 samples
        stamps[start:] += 10.0
    whole = run(model(), Record(signals={"y": y, "u": u}, stamps=stamps))
    for a, b in ((0, 12), (12, 13), (13, 15), (15, 25), (25, 40)):
        np.testing.assert_array_equal(whole[a:b], run(model(), {"y": y[a:b], "u": u[a:b]}))
    assert np.isnan(whole[12:15]).all()
    assert np.isfinite(whole[20:25]).all()


@pytest.mark.parametrize("run", RUNS.values(), ids=RUNS)
def test_without_feedback_all_runs_are_the_same_equation(run) -> None:
    u = np.linspace(-1, 1, 20)
    u[9] = np.nan
    still = Narmax(
        output="y", terms=Terms.parse("1", "u(k)^2"), theta=np.array([0.5, -2.0]), err=np.zeros(2),
        covariance=np.eye(2), sigma=1.0, n_samples=20,
    )  # fmt: skip
    told = run(still, {"u": u})
    known = np.isfinite(told)
    np.testing.assert_allclose(told[known], 0.5 - 2.0 * u[known] ** 2, atol=1e-15)
    assert known.sum() >= 17  # all but the sample without input and, 3 steps ahead, the first two


def test_measured_output_stands_in_where_an_input_is_not_known() -> None:
    y, u = np.random.default_rng(5).uniform(-1, 1, (2, 20))
    u[10] = np.nan
    line = Narmax(
        output="y", terms=Terms.parse("y(k-1)", "y(k-2)", "u(k)"), theta=np.array([0.5, -0.3, 1.0]),
        err=np.zeros(3), covariance=np.eye(3), sigma=1.0, n_samples=20,
    )  # fmt: skip
    past, out = y.copy(), np.full(20, np.nan)
    for k in range(2, 20):
        out[k] = 0.5 * past[k - 1] - 0.3 * past[k - 2] + u[k]
        past[k] = y[k] if k == 10 else out[k]
    np.testing.assert_allclose(line.predict_mpo({"y": y, "u": u}), out, atol=1e-14)


def test_missing_signal_is_named(record) -> None:
    with pytest.raises(IdentError, match="no signal u"):
        model().predict_osa({"y": record["y"]})
