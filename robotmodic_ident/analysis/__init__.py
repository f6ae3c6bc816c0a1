"""Analyse a model: derivatives, Sobol indices, frequency responses and chaos; the last also from a series alone."""

from __future__ import annotations

from robotmodic_ident.analysis.calculus import (
    antiderivative_model,
    derivative,
    integral,
    jacobian,
    partial_model,
    sensitivity,
    surface,
)
from robotmodic_ident.analysis.dimension import CorrelationDimension, correlation_dimension
from robotmodic_ident.analysis.gfrf import gfrf, rest_point
from robotmodic_ident.analysis.lyapunov import (
    LyapunovExponents,
    NeighbourDivergence,
    lyapunov,
    lyapunov_along,
    lyapunov_of_series,
    states_of,
)
from robotmodic_ident.analysis.noise_reduction import DenoisedOrbit, without_noise
from robotmodic_ident.analysis.sobol import Distribution, SobolIndices, sobol

__all__ = [
    "CorrelationDimension",
    "DenoisedOrbit",
    "Distribution",
    "LyapunovExponents",
    "NeighbourDivergence",
    "SobolIndices",
    "antiderivative_model",
    "correlation_dimension",
    "derivative",
    "gfrf",
    "integral",
    "jacobian",
    "lyapunov",
    "lyapunov_along",
    "lyapunov_of_series",
    "partial_model",
    "rest_point",
    "sensitivity",
    "sobol",
    "states_of",
    "surface",
    "without_noise",
]
