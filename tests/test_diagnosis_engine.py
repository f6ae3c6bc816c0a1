"""The engine knows no robot: it chooses among the columns of a plain regression, and its ledger says why."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from planners.types import Floats
from sensorgraph.diagnosis.engine.ledger import Entry, Ledger
from sensorgraph.diagnosis.engine.selection import occam_factor, remove_superfluous, select
from sensorgraph.diagnosis.engine.verdict import Facts, Verdict
from sensorgraph.diagnosis.engine.why import why

PRICE, THRESHOLD = 3.0, 6.0
"""[nats]"""


class Regression:
    """Rows with unit noise that named columns may explain."""

    def __init__(self, y: Floats, columns: dict[str, Floats]) -> None:
        self.y, self.columns = y, columns
        self.models: list[tuple[str, ...]] = []

    def log_likelihood(self, model: Sequence[str]) -> float:
        if not model:
            return -0.5 * float(self.y @ self.y)
        A = np.column_stack([self.columns[name] for name in model])
        left = self.y - A @ np.linalg.lstsq(A, self.y, rcond=None)[0]
        return -0.5 * float(left @ left)

    def best(self, model: Sequence[str]) -> tuple[str, float] | None:
        rest = [name for name in self.columns if name not in model]
        return max(
            ((name, self.evidence([*model, name], name)) for name in rest),
            key=lambda one: one[1],
            default=None,
        )

    def added(self, model: Sequence[str]) -> None:
        self.models.append(tuple(model))

    removed = added

    def evidence(self, model: Sequence[str], hypothesis: str) -> float:
        rest = [name for name in model if name != hypothesis]
        return self.log_likelihood(model) - self.log_likelihood(rest) - PRICE


@pytest.fixture(scope="module")
def two() -> dict[str, Floats]:
    t = np.linspace(0.0, 1.0, 400)
    return {"offset": np.ones_like(t), "slope": t - 0.5}


@pytest.mark.parametrize(("offset", "slope"), [(0.0, 0.0), (0.5, 0.0), (0.0, 1.5), (0.5, 1.5)])
def test_of_two_columns_those_that_are_planted_are_chosen(
    two: dict[str, Floats], offset: float, slope: float
) -> None:
    y = offset * two["offset"] + slope * two["slope"] + np.random.default_rng(1).normal(size=400)
    found = select(Regression(y, two), threshold=THRESHOLD, most=4)
    assert set(found) == {name for name, value in (("offset", offset), ("slope", slope)) if value}


def test_a_column_that_two_others_make_superfluous_is_taken_back(two: dict[str, Floats]) -> None:
    """The sum of both is likeliest at first, and says nothing once both are in the model."""
    y = 1.0 * two["offset"] + 5.0 * two["slope"] + np.random.default_rng(2).normal(size=400)
    columns = {"both": two["offset"] + 2.5 * two["slope"], **two}
    channel = Regression(y, columns)
    assert channel.best([])[0] == "both"  # type: ignore[index]
    assert len(select(channel, threshold=THRESHOLD, most=4)) == 2
    model = ["both", "offset", "slope"]
    remove_superfluous(channel, model, threshold=THRESHOLD)
    assert len(model) == 2


def test_no_more_than_the_most_are_chosen_and_each_change_is_refitted(two: dict[str, Floats]) -> None:
    y = 2.0 * two["offset"] + 6.0 * two["slope"]
    channel = Regression(y, two)
    assert len(select(channel, threshold=THRESHOLD, most=1)) == 1
    assert [len(model) for model in channel.models] == [1]


def test_the_ledger_of_a_channel_without_a_robot_explains_itself(two: dict[str, Floats]) -> None:
    y = 0.5 * two["offset"] + np.random.default_rng(3).normal(size=400)
    channel = Regression(y, two)
    found = select(channel, threshold=THRESHOLD, most=4)
    entries = tuple(
        Entry(
            name=name,
            channel="toy",
            title=f"an {name}",
            facts=Facts(
                has_name=True,
                accepted=name in found,
                evidence=channel.evidence([*[one for one in found if one != name], name], name),
                threshold=THRESHOLD,
            ),
            price=PRICE,
        )
        for name in two
    )
    ledger = Ledger(entries=entries)
    assert {one.name: one.verdict for one in ledger} == {"offset": Verdict.NAMED, "slope": Verdict.SILENT}
    assert "was named" in why(ledger, "offset") and "it needs 6 nats" in why(ledger, "slope")
    assert Ledger.from_list(ledger.to_list()).to_list() == ledger.to_list()


@pytest.mark.parametrize("k", [1, 3])
def test_the_price_of_parameters_is_the_occam_factor_of_a_prior_worth_one_measurement(
    k: int,
) -> None:
    rng, n = np.random.default_rng(5), 3000
    A, y = rng.normal(size=(n, k)), rng.normal(size=n)
    y += A @ np.full(k, 0.1)
    H, b = A.T @ A, A.T @ y
    gain = 0.5 * float(b @ np.linalg.solve(H, b))  # maximised log-likelihood ratio
    prior = H / n  # precision
    marginal = 0.5 * float(b @ np.linalg.solve(H + prior, b)) - 0.5 * float(
        np.linalg.slogdet(H + prior)[1] - np.linalg.slogdet(prior)[1]
    )
    assert gain - occam_factor(k, n) == pytest.approx(marginal, abs=0.05)
