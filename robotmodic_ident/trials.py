"""Settings of `auto_fit`, and the result for every dictionary that it tries."""

from __future__ import annotations

from dataclasses import dataclass

from robotmodic_ident.model import Narmax

MIN_ORDER_GAIN = 0.2
"""Minimum relative decrease of the RMSE for a larger order, or another model: the spread over folds of about 1,000 samples."""
MIN_SURE_GAIN = 0.1
"""Minimum relative decrease of the RMSE for a larger order if the error decreases in every fold; an increase that is worth
fewer terms over whole records."""


@dataclass(frozen=True, kw_only=True)
class AutoSettings:
    """Settings of `auto_fit`."""

    orders: tuple[int, ...] = (2, 3, 4, 6, 8, 12)
    """[samples] maximum lags of output and inputs to try."""
    degrees: tuple[int, ...] = (2, 3, 1)
    """Degrees to try at the order of the linear dynamics; larger orders use the best one."""
    max_product_lag: int = 3
    """[samples] maximum lag in terms of degree 2 and above; terms with larger lags are linear."""
    n_folds: int = 5
    """Number of blocks of every record, each of which is held out in turn."""
    min_unexplained: float = 0.01
    """Free-run RMSE over the standard deviation of the output above which friction and unsigned outputs are tried."""
    max_magnitude_order: int = 4
    """[samples] maximum lag of the signed output of a magnitude model."""
    max_rows: int = 3_000
    """Number of samples for the search of terms, in pieces spread over the records; the final fit uses all samples."""


AUTO = AutoSettings()


@dataclass(frozen=True, kw_only=True)
class Trial:
    """The cross-validation of one dictionary."""

    order: int
    """[samples] maximum lag."""
    degree: int
    limits: tuple[float, float]
    """[units of the output] saturation limits of the output."""
    n_candidates: int
    n_terms: int
    """Smallest number of terms within one standard error of the best on the held-out blocks."""
    rmse: float
    """[units of the output] free-run RMSE on the held-out blocks; inf if every size diverges in some block."""
    errors: tuple[float, ...] = ()
    """[units of the output, squared] mean squared error of that size on every held-out block."""
    found: tuple[Narmax, ...] = ()
    """The model of that size from every fold."""

    def beats(self, other: Trial) -> bool:
        """Return whether the gain over a smaller dictionary justifies the additional terms."""
        everywhere = all(mine < its for mine, its in zip(self.errors, other.errors, strict=True))
        gain = MIN_SURE_GAIN if everywhere else MIN_ORDER_GAIN
        return self.rmse < other.rmse * (1.0 - gain)
