"""Test residuals for structure that no effect of the library explains.

    evidence = c' H⁻¹ c / 2 - log det H / 2 - choice_price,   H = I + Z'Z,   c = Z'y

Z are the whitened columns of a family, in units of their prior standard deviation and orthogonal to the
columns of the model. A family describes how structure may depend on time, speed, direction or place. This
marginal likelihood contains the Occam factor (MacKay 1992, "Bayesian interpolation"), so that families with
few and many columns need the same evidence. Noise and columns are fitted in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.engine.ledger import Competitor, Entry
from sensorgraph.diagnosis.engine.verdict import Facts
from sensorgraph.diagnosis.motion.consequence import ReferenceError, SimulationError
from sensorgraph.diagnosis.motion.increments import MIN_MOTION
from sensorgraph.diagnosis.motion.reference_noise import robust_log_likelihood
from sensorgraph.diagnosis.motion.regression import RIDGE
from sensorgraph.diagnosis.motion.whitening import HUBER_LIMIT, Whitener, WhiteningFilter, by_kind
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools, Floats

SCALE_SIGMA = 0.1
"""Prior standard deviation of a coefficient of structure, unless its family says otherwise: of a scale, a gain, an angle [rad], a
speed [m/s], a turn rate [rad/s], a clock offset [s], or a jump [m, rad]."""
N_PIECES = 6
"""Number of pieces of the run in which scales, gains or delays may differ."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StructureFamily:
    """Family of differences that no effect of the library explains."""

    kind: str
    """Variable that they depend on: `time`, `jump`, `speed`, ...; several families may have one kind."""
    columns: Floats
    """(n_kinds n, k)"""
    statement: str
    """Noun phrase that completes the sentence "the readings differ by ..."."""
    sigma: float = SCALE_SIGMA
    """Prior standard deviation of each coefficient."""
    is_of_reference: bool = False
    """Whether it describes an error of the reference poses, not of the robot."""
    choice_price: float = 0.0
    """[nats] penalty for the choice among several families of its kind."""
    least_change: float = 0.0
    """Change of its coefficients, as twice their standard deviation, that matters; 0: the error of a simulation without it
    decides."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TestedFamily:
    """A family in addition to a model: a hypothesis without a name."""

    family: StructureFamily
    evidence: float
    """[nats] less the price."""
    price: float | None
    """[nats] Occam factor of its columns, and the penalty for the choice of the family; None: not screened."""
    threshold: float = SCAN.selection.threshold
    """[nats] required evidence."""
    size: SimulationError | ReferenceError | None = None
    """Error of a simulation without it, or of the reference poses; None: the evidence does not suffice."""
    is_material: bool = True
    """Whether it matters to a user."""
    rivals: Sequence[str] = ()
    """Statements of the next best families."""
    beaten_by: TestedFamily | None = None
    """Family with sufficient evidence that explains the data better."""

    def entry(self, channel: str, name: str, title: str) -> Entry:
        """Return its entry of the ledger, under the name and the title of its kind."""
        rival, size = self.beaten_by, self.size
        return Entry(
            name=name,
            channel=channel,
            title=title,
            facts=Facts(
                has_name=False,
                accepted=size is not None,
                evidence=self.evidence,
                threshold=self.threshold,
                is_material=self.is_material,
            ),
            price=self.price,
            estimate=self.family.statement,
            rival=None
            if rival is None
            else Competitor(title=rival.family.statement, evidence=rival.evidence),
            size={} if size is None else size.to_dict(),
            consequence="" if size is None else size.sentence(),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """Columns fitted under one noise."""

    whitener: Whitener
    residual: Floats
    """(n_kinds n,)"""
    evidence: float
    """[nats]"""


QUARTERS = (0.25, 0.5, 0.75)
"""Shares of the highest speed or turn rate, above which a scale or a gain may differ."""
Noise = tuple[WhiteningFilter, ...]
"""One filter for each kind of rows, for instance translation and rotation."""
MAX_ROUNDS, N_REWEIGHTED = 4, 2
"""Maximum number of alternations between columns and noise, and number of reweightings of the rows."""
MIN_GAIN = 0.5
"""[nats] gain below which the iteration stops, and below which a family explains nothing."""
NoiseFitter = Callable[[int, Floats, Bools], WhiteningFilter]
"""Fits the noise of a residual (n,) of one kind of rows, counted from 0, to its valid part."""


class StructureTest:
    """Compares families of structure with noise and with each other."""

    def __init__(
        self, valid: Bools, y: Floats, fit_noise: NoiseFitter, nuisances: Floats | None = None
    ) -> None:
        """Prepare the comparison on rows y of one or several kinds (n_kinds n,), valid where `valid` (n,) is.

        Parameters
        ----------
        nuisances : (n_kinds n, m) Columns of every model, in units of their prior standard deviation.
        """
        self.nuisances = np.zeros((len(y), 0)) if nuisances is None else nuisances
        self.valid, self.y, self.fit_noise, self.n = valid, y, fit_noise, len(valid)
        self._noise_of_rows = self._noise(y)
        self._noises: list[Noise] = []
        self.tested: dict[str, TestedFamily] = {}
        """Kind -> its most likely family of all comparisons."""
        white = WhiteningFilter.white(0, 1.0)
        self.whitener = Whitener.plain((white,) * (len(y) // len(valid)), valid)
        self.residual = y

    def best(self, own: Floats, candidates: Sequence[StructureFamily]) -> tuple[StructureFamily, float]:
        """Return the best family in addition to the model's own columns (n_kinds n, k), and its evidence [nats].

        All are screened with fixed noise. The noise is fitted again with the best one, and with the best one of another kind.
        """
        here = self.evidence(own)
        screened = self._screened(own, candidates)
        for one in screened:
            kind = one.family.kind
            if kind not in self.tested or one.evidence > self.tested[kind].evidence:
                self.tested[kind] = one
        best = max(screened, key=lambda one: one.evidence)
        others = [one for one in screened if one.family.kind != best.family.kind and one.evidence > MIN_GAIN]
        tried = [best, *([max(others, key=lambda one: one.evidence)] if others else [])]
        found = [self.evidence(own, one.family) for one in tried]
        here = max(here, self.evidence(own))  # under the noise that was fitted with the families
        gains = [max(all_of - here, one.evidence) for all_of, one in zip(found, tried, strict=True)]
        k = int(np.argmax(gains))
        return tried[k].family, gains[k]

    def rivals(self, family: StructureFamily) -> list[str]:
        """Return the statements of the two most likely families of other kinds, of all comparisons."""
        others = [one for kind, one in self.tested.items() if kind != family.kind and one.evidence > MIN_GAIN]
        return [one.family.statement for one in sorted(others, key=lambda one: -one.evidence)][:2]

    def explained(self, own: Floats, family: StructureFamily) -> Floats:
        """Return the difference of the fitted rows (n_kinds n,) between the models with and without a family.

        All rows have the same weight. A large difference in a few rows is an outlier for the evidence, but it
        matters to a user. A nuisance would absorb a part of it.
        """
        self.evidence(own, family)
        whitener = Whitener.plain(self.whitener.filters, self.valid)
        plain = copy(self)
        plain.nuisances = self.nuisances[:, :0]
        with_it, without = (plain._fit_columns(whitener, own, one)[0] for one in (family, None))
        return np.asarray(without - with_it)

    def dispersion(self, span: float, period: float) -> float:
        """Return the dispersion of the last residual over blocks of `span` [s]; at least 1.

            dispersion = sum over blocks of (sum of white)² / sum of white²

        It is 1 for uncorrelated whitened rows, which are `period` [s] apart, and larger for correlated ones.
        """
        block = np.arange(self.n) // max(round(span / period), 1)
        sums, squares = 0.0, 0.0
        for noise, part in zip(self.whitener.filters, by_kind(self.residual, self.n), strict=True):
            white = np.where(self.valid, noise(part), 0.0)
            limited = np.clip(white, -HUBER_LIMIT, HUBER_LIMIT)
            sums += float(np.square(np.bincount(block, limited)).sum())
            squares += float(np.square(limited).sum())
        return max(1.0, sums / max(squares, 1e-12))

    def lead(self, own: Floats, family: StructureFamily, more: Floats) -> float:
        """Return the evidence [nats] for columns `own` with a family, against `more` columns."""
        self.evidence(own, family)  # first, so that both are evaluated under all noise fits
        other = self.evidence(more)
        return self.evidence(own, family) - other

    def evidence(self, own: Floats, family: StructureFamily | None = None) -> float:
        """Fit columns and noise in turn; return the evidence, without constants [nats].

        The result depends on the start, because noise that has absorbed structure hides it. The fit therefore
        starts from the earlier noise fit under which these columns are most likely.
        """
        noises = [self._noise_of_rows, *self._noises]
        fits = [self._fit_under(noise, own, family) for noise in noises]
        best = max(reversed(fits), key=lambda fit: fit.evidence)
        latest = best
        for _ in range(MAX_ROUNDS):
            before, latest = best, self._fit_under(self._noise(latest.residual), own, family)
            best = max(best, latest, key=lambda fit: fit.evidence)
            if latest.evidence - before.evidence < MIN_GAIN:
                break
        self.whitener, self.residual = best.whitener, best.residual
        self._noises.insert(0, best.whitener.filters)
        return best.evidence

    def _noise(self, residual: Floats) -> Noise:
        parts = enumerate(by_kind(residual, self.n))
        return tuple(self.fit_noise(kind, part, self.valid) for kind, part in parts)

    def _fit_under(self, noise: Noise, own: Floats, family: StructureFamily | None) -> _Fit:
        """Fit columns to rows whitened by `noise`."""
        whitener = Whitener.plain(noise, self.valid)
        for _ in range(N_REWEIGHTED):
            residual, price = self._fit_columns(whitener, own, family)
            whitener = Whitener.robust(noise, self.valid, residual)
        residual, price = self._fit_columns(whitener, own, family)
        parts = zip(noise, by_kind(residual, self.n), strict=True)
        evidence = sum(robust_log_likelihood(one, part, self.valid) for one, part in parts) - price
        return _Fit(whitener=whitener, residual=residual, evidence=evidence)

    def _parts(self, own: Floats, family: StructureFamily | None) -> list[tuple[Floats, Floats]]:
        """Return columns (n_kinds n, .) and their scales (.), which normalise them to unit norm or unit prior."""
        parts = [
            (own, 1 / np.maximum(np.linalg.norm(own, axis=0), 1e-12)),
            (self.nuisances, np.ones(self.nuisances.shape[1])),
        ]
        if family is not None:
            parts.append((family.columns, np.full(family.columns.shape[1], family.sigma)))
        return parts

    def _fit_columns(
        self, whitener: Whitener, own: Floats, family: StructureFamily | None
    ) -> tuple[Floats, float]:
        """Return the residual (n_kinds n,) and the complexity penalty of the family [nats].

            price = theta'theta / 2 + log det(I + information) / 2 + choice_price

        theta excludes the coefficients of the model's own columns, which have no prior.
        """
        parts, k = self._parts(own, family), own.shape[1]
        scale = np.concatenate([scale for _, scale in parts])
        G, b = whitener.normal_equations([columns for columns, _ in parts], self.y)
        G, b = G * np.outer(scale, scale), b * scale
        prior = np.concatenate([_ridge(G, k), np.ones(len(G) - k)])
        theta = np.linalg.solve(G + np.diag(prior), b)
        price = 0.5 * float(theta[k:] @ theta[k:])
        information = _information_beside(G, k)
        price += 0.5 * float(np.linalg.slogdet(np.eye(len(G) - k) + information)[1])
        price += 0.0 if family is None else family.choice_price
        by_part = np.split(scale * theta, np.cumsum([columns.shape[1] for columns, _ in parts])[:-1])
        fitted = sum(columns @ some for (columns, _), some in zip(parts, by_part, strict=True))
        return self.y - fitted, price

    def _screened(self, own: Floats, families: Sequence[StructureFamily]) -> list[TestedFamily]:
        """Return each family with its evidence in addition to columns (n_kinds n, k), with fixed noise."""
        parts = self._parts(own, None)
        parts += [(family.columns, np.full(family.columns.shape[1], family.sigma)) for family in families]
        scale = np.concatenate([scale for _, scale in parts])
        G, b = self.whitener.normal_equations([columns for columns, _ in parts], self.y)
        G, b = G * np.outer(scale, scale), b * scale
        k, m, out = own.shape[1], self.nuisances.shape[1], []
        c = b[k:] - G[k:, :k] @ np.linalg.solve(G[:k, :k] + np.diag(_ridge(G, k)), b[:k])
        H = np.eye(len(G) - k) + _information_beside(G, k)
        (alone, paid), first = _gain(H[:m, :m], c[:m]), m
        for family in families:
            mine = np.r_[:m, first : first + family.columns.shape[1]]
            first += family.columns.shape[1]
            gain, occam = _gain(H[np.ix_(mine, mine)], c[mine])
            evidence = (gain - occam) - (alone - paid) - family.choice_price
            price = occam - paid + family.choice_price
            out.append(TestedFamily(family=family, evidence=evidence, price=price))
        return out


def pieces(passed: Floats, span: float = 1.0) -> list[Bools]:
    """Return which rows are in each piece of the run: one mask (n,) per piece.

    Parameters
    ----------
    passed : (n,) Time since the start of the run, as a share of it or in the unit of `span`.
    """
    piece = np.clip((N_PIECES * passed / span).astype(np.intp), 0, N_PIECES - 1)
    return [piece == k for k in range(N_PIECES)]


def above_quarters(rates: Floats) -> list[Bools]:
    """Return where rates (n,) exceed each quarter of the highest one: one mask (n,) per quarter.

    The highest 2 % may be errors, and do not count as the highest one.
    """
    size = np.abs(rates)
    top = max(float(np.quantile(size, 0.98)), MIN_MOTION)
    return [size > share * top for share in QUARTERS]


def _gain(H: Floats, c: Floats) -> tuple[float, float]:
    """Return the gain and the Occam factor of columns with unit priors [nats]; their difference is the evidence.

        c' H⁻¹ c / 2,   log det H / 2

    Parameters
    ----------
    H, c : (k, k), (k,) Normal equations of the columns, including the prior.
    """
    return float(0.5 * c @ np.linalg.solve(H, c)), float(0.5 * np.linalg.slogdet(H)[1])


def _ridge(G: Floats, k: int) -> Floats:
    return np.full(k, RIDGE * np.trace(G[:k, :k]) / k)


def _information_beside(G: Floats, k: int) -> Floats:
    """Return the information on column k and all later ones, with the first k free (Schur complement)."""
    H = G[:k, :k] + np.diag(_ridge(G, k))
    return np.asarray(G[k:, k:] - G[k:, :k] @ np.linalg.solve(H, G[:k, k:]))
