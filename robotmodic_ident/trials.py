"""What `auto_fit` looks at, and what it keeps of every dictionary that it tries."""

from __future__ import annotations

from dataclasses import dataclass

from robotmodic_ident.model import Narmax
from robotmodic_ident.selection.free_run_terms import FREE_RUN_SEARCH, FreeRunSearch
from robotmodic_ident.selection.hidden_stretches import WARM_UP, WarmUp


@dataclass(frozen=True, kw_only=True)
class AutoSettings:
    """What `auto_fit` looks at."""

    orders: tuple[int, ...] = (2, 3, 4, 6, 8, 12)
    """[samples] lags of output and inputs; beyond those of the linear dynamics, until `patience` of them in a row do no
    better."""
    patience: int = 2
    min_order_gain: float = 0.2
    """Relative fall of the error that longer lags must bring: the spread over folds of sets of some 1,000 samples ..."""
    min_sure_gain: float = 0.1
    """... or this one, where the error falls on every stretch."""
    min_one_step_gain: float = 0.15
    """Relative fall of a linear model's one-step error that speaks for longer lags."""
    degrees: tuple[int, ...] = (2, 3, 1)
    """All are tried at the order of the linear dynamics, the best one at longer ones."""
    max_product_lag: int = 3
    """[samples] of signals in terms of degree 2 and more; longer lags are linear."""
    n_folds: int = 5
    min_whole_gain: float = 0.2
    """Relative fall of the error over whole records that speaks for another model than the one that pieces chose."""
    min_unexplained: float = 0.01
    """Error of the free run over the output's standard deviation that asks for friction and lost signs."""
    max_friction_rows: int = 25_000
    """Samples at the start of the records on which friction is estimated: a motor drifts for long."""
    max_magnitude_order: int = 4
    """[samples] lags of the signed output behind a magnitude."""
    max_whole_loss: float = 0.1
    """Relative rise of that error that fewer terms are worth."""
    max_rows: int = 3_000
    """Samples among which terms are searched, in pieces spread over the records; all are fitted in the end."""
    n_pieces: int = 4
    warm_up: WarmUp = WARM_UP
    """Never hidden."""
    min_limit_gain: float = 0.02
    """Relative fall of the error that holding the output between limits must bring to be kept."""
    search: FreeRunSearch = FREE_RUN_SEARCH


AUTO = AutoSettings()


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One dictionary, cross-validated."""

    order: int
    """[samples]"""
    degree: int
    limits: tuple[float, float]
    """[units of the output]"""
    n_candidates: int
    n_terms: int
    """Least size that does as well as the best on stretches left out."""
    rmse: float
    """[units of the output] of the free run there; inf where no size ran to the end on all of them."""
    errors: tuple[float, ...] = ()
    """[units of the output, squared] mean square of that size on every stretch."""
    found: tuple[Narmax, ...] = ()
    """The model of that size of every fold."""

    def beats(self, other: Trial, settings: AutoSettings) -> bool:
        """Tell whether a larger dictionary is worth its terms."""
        everywhere = all(mine < its for mine, its in zip(self.errors, other.errors, strict=True))
        gain = settings.min_sure_gain if everywhere else settings.min_order_gain
        return self.rmse < other.rmse * (1.0 - gain)
