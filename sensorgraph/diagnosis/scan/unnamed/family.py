"""A kind of difference that has no name among the effects, and what it is tested on.

A kind is one file of this package and one line in `UNNAMED`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensorgraph.diagnosis.result import Deviation, Profile
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.deviations import Partition, deviations, partitions
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Progress


@dataclass(frozen=True, kw_only=True, eq=False)
class Doubt:
    """A difference that a model may not explain: a hypothesis without a name."""

    family: str
    """Name of the kind, as in the ledger."""
    statement: str
    misfit: float
    """[nats] approximate evidence for the difference."""
    statistic: float
    threshold: float
    """Threshold of the statistic."""
    deviation: Deviation | None = None
    """Deviation that shows it."""
    failed: frozenset[int] = frozenset()
    """Indices of the effects whose assumptions are violated; they are clutter and not named."""
    size: ScanError | None = None
    """Error of a simulation without it; None if it cannot be quantified, which counts as material."""
    causes: tuple[str, ...] = ()
    """Possible causes, most likely first."""
    profile: Profile | None = None
    """Error over bearing or range, if the difference is one."""
    is_of_building: bool = False
    """Whether the building differs from its map; this concerns few rays, unlike an error of the sensor."""
    price: float = 0.0
    """[nats] Complexity penalty, which the misfit contains."""
    is_sure: bool = True
    """Whether the statistic exceeds its threshold; other doubts are only kept for the ledger."""

    @classmethod
    def unsure(cls, family: str, gain: float, price: float) -> Doubt:
        """Return a difference that was considered, for the ledger, with its gain and its complexity penalty [nats]."""
        return cls(
            family=family,
            price=price,
            statement="",
            misfit=gain,
            statistic=gain,
            threshold=SCAN.selection.threshold,
            is_sure=False,
        )


def sure(doubts: Sequence[Doubt]) -> list[Doubt]:
    """Return the doubts whose statistic exceeds its threshold."""
    return [doubt for doubt in doubts if doubt.is_sure]


@dataclass(frozen=True, kw_only=True, eq=False)
class Checked:
    """An accepted model with what a test for differences may need."""

    view: FitResiduals
    gains: Mapping[int, float]
    """[nats] Gain of each effect of the model."""
    gained: float
    """[nats] Gain of all effects together; two effects that absorb the same readings gain little each."""
    null: Fitted | None
    """The fit without effects, which may show a difference more clearly than effects that imitate it."""
    rng: np.random.Generator
    """For replicates."""
    tick: Progress | None = None

    @property
    def fitted(self) -> Fitted:
        """The accepted model."""
        return self.view.fitted

    @cached_property
    def partitions(self) -> list[Partition]:
        """Partitions of the readings."""
        return partitions(self.view)

    @cached_property
    def deviations(self) -> list[Deviation]:
        """Deviations in the bins of the partitions, strongest first."""
        return deviations(self.view, self.partitions)


@dataclass(frozen=True, kw_only=True)
class Unnamed:
    """One or several kinds of difference that share a test."""

    titles: Mapping[str, str]
    """Name of each kind -> noun phrase for readers."""
    find: Callable[[Checked], Sequence[Doubt]] | None = None
    """Returns the differences of these kinds, sure or not. None: they are tested elsewhere in the channel."""
    is_cause: bool = False
    """Whether a difference of this kind is reported before its consequences in a part of the data."""
