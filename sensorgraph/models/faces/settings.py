"""Settings of the model `faces`, with unit and meaning; the modules hold the constants of the algorithms.

The modules use the instance `FACES`. Some settings are constants of compiled code: `planners.kernel` recompiles after
a change of their values. The values were set on random offices. The criteria are median error, share of wrong rays, time
and file size, as printed by

    python -m benchmarks.office_graph

Widths and distances suit a laser with a noise of about 1 cm. The selection of lines multiplies them for a noisier one.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class LineLimits:
    """Requirements of a line."""

    min_hits: float
    """Minimum number of hits."""
    gap: float
    """[m] Length without hits that ends a line."""
    min_length: float
    """[m] Minimum length."""


@dataclass(frozen=True, kw_only=True)
class FacesSettings:
    """Surfaces that are resolved, priors and complexity penalties, and the space that is answered."""

    first_sigma: float = 0.01
    """[m] Initial range noise, which hit cells, gaps and lengths suit."""
    hit_cell: float = 0.02
    """[m] Side of the cells in which hits are pooled."""
    first_lines: LineLimits = LineLimits(min_hits=12.0, gap=0.10, min_length=0.03)
    """Limits of lines among all hits."""
    later_lines: LineLimits = LineLimits(min_hits=4.0, gap=0.05, min_length=0.02)
    """Limits of lines among unexplained hits; the leg of a chair has few hits."""
    turn_prior: float = 0.1
    """[rad] Prior standard deviation of a line's turn; it keeps faces with few hits from rotating freely."""
    slope_prior: float = 0.3
    """[m/m] Prior standard deviation of the slope of hits along a face; also of a line's turn in an edge's error."""
    min_face_gain: float = 8.0
    """[nats] Minimum gain in log likelihood of a face."""
    min_split_gain: float = 9.0
    """[nats] Complexity penalty of a second line, in addition to the log of the number of hits."""
    min_edge_gain: float = 4.0
    """[nats] Complexity penalty of an edge, in addition to half the log of the number of crossings of its face."""
    corner_distance: float = 0.03
    """[m] Distance within which two ends may form a corner, and upper limit of the standard error of an edge."""
    observed_cell: float = 0.10
    """[m] Side of the cells of observed space; a ray needs no support in the last one, whose surface was observed."""
    max_p_off: float = 0.05
    """Maximum probability of being off, in addition to that by the noise of the ranges, for a ray to be answered."""
    max_stray: float = 2e-3
    """[1/m] Density of outliers above which cells predict: 1e-4 in rooms without clutter, 7e-3 on logs of real floors.

    The value lies between the two: `python -m benchmarks.office_graph` and `python -m benchmarks.real_logs LOG`.
    """


FACES = FacesSettings()
"""The settings that the modules use."""
