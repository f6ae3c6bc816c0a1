"""Settings of the errors that neighbouring returns share."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SurfaceErrorSettings:
    """Errors that neighbouring returns share."""

    lengths: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)
    """[m] Candidates of the correlation length."""
    frames: tuple[float, ...] = (2.0, 4.0, 8.0, 16.0, 32.0)
    """[key frames] Candidates of the correlation time."""
    distances: tuple[float, ...] = (0.3, 0.5, 0.8, 1.2, 2.0, 3.0)
    """[m] Upper limits of the distances at which residuals of a key frame are compared."""
    lags: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16)
    """[key frames] Distances at which residuals of a patch are compared."""
    parallel: float = 0.9
    """Minimum cosine between the normals of compared patches."""
    max_frames: int = 400
    """Maximum number of key frames whose residuals are compared by distance."""
    min_pairs: int = 30
    """Minimum number of pairs of clusters at a distance."""
    simulated: int = 400_000
    """Number of simulated residuals of a candidate."""
    min_draws: int = 3
    """Minimum number of draws of a candidate."""
    max_draws: int = 24
    """Maximum number of draws."""
    tolerance: float = 1e-2
    """Relative residual at which conjugate gradients stop; simulated residuals need little accuracy."""
    max_steps: int = 100
    """Maximum number of conjugate-gradient steps."""
    max_lag: int = 12
    """[steps] Longest lag of the autocorrelation of the wheels."""


SURFACE_ERRORS = SurfaceErrorSettings()
