"""Calibration: how a laser differs from what was stated, with errors; what a graph of faces keeps of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sensorgraph.models.calibration.gauge import Gauge
from sensorgraph.models.calibration.ray_terms import RayTerms
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.types import Floats

ADJUSTMENT = CALIBRATION.adjustment


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """How the laser differs from what was stated."""

    terms: RayTerms
    offset: Floats
    """(3,) [m, m, rad] found mount less the stated one."""
    offset_se: Floats
    """(3,) its standard errors; nan where the mount was not identified."""
    can_mount: bool
    """The poses are those of a base that carries the laser, so the mount can be told."""
    n_own: int
    """Rays that have a term of their own."""
    gauge: Gauge | None
    """What the edges say; None where no incidence term is there to trade with."""
    sigma_xy: float
    """[m] noise of the training poses that was taken out; 0: they were left as they are."""
    sigma_yaw: float
    """[rad]"""

    @classmethod
    def none(cls, n_rays: int, *, can_mount: bool = True) -> Self:
        """Take the laser as stated."""
        return cls(
            terms=RayTerms.none(n_rays),
            offset=np.zeros(3),
            offset_se=np.full(3, np.nan),
            can_mount=can_mount,
            n_own=0,
            gauge=None,
            sigma_xy=0.0,
            sigma_yaw=0.0,
        )

    @property
    def is_as_stated(self) -> bool:
        """Tell whether neither the laser nor a pose was changed."""
        return self.terms.is_none and not self.offset.any() and self.sigma_xy == 0 == self.sigma_yaw

    @property
    def is_plausible(self) -> bool:
        """Tell whether the calibration is plausible; poses and scans that do not belong together give one that is not."""
        return bool(
            np.hypot(*self.offset[:2]) < ADJUSTMENT.max_mount_offset
            and abs(self.offset[2]) < ADJUSTMENT.max_mount_turn
            and np.abs(self.terms.constant).max() < CALIBRATION.matches.max_ray_bias
            and np.abs(self.terms.slope).max() < ADJUSTMENT.max_slope
        )

    def summary(self) -> dict[str, str]:
        """Return what a reader wants to know first."""
        out = {"mount": self._mount()}
        if not self.terms.is_none:
            shared = "with" if self.terms.has_incidence else "without"
            out["ray terms"] = (
                f"{self.n_own} of {len(self.terms.constant)} rays have their own, {shared} incidence terms"
            )
        else:
            out["ray terms"] = "none needed"
        if self.gauge is not None:
            g = self.gauge
            out["walls against a common bias"] = (
                f"moved by {1e3 * g.shift:+.2f} ± {1e3 * g.stderr:.2f} mm to where occlusion edges are sharpest"
                if g.is_observed
                else "not observable in this room: no occlusion edges; walls may all sit some mm too near or far"
            )
        if self.sigma_xy > 0 or self.sigma_yaw > 0:
            out["training poses"] = (
                f"refined; their noise was {1e3 * self.sigma_xy:.1f} mm and {math.degrees(self.sigma_yaw):.3f}°"
            )
        return out

    def _mount(self) -> str:
        if not self.can_mount:
            return "cannot be told: the poses are the laser's own"
        if not np.isfinite(self.offset_se).all():
            return "as stated"
        (x, y, yaw), (sx, sy, s_yaw) = self.offset, self.offset_se
        return (
            f"off by {1e3 * x:+.2f} ± {1e3 * sx:.2f} mm, {1e3 * y:+.2f} ± {1e3 * sy:.2f} mm, "
            f"{math.degrees(yaw):+.4f} ± {math.degrees(s_yaw):.4f}° from what was stated"
        )

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that hold all."""
        gauge = None
        if self.gauge is not None:
            gauge = [self.gauge.shift, self.gauge.stderr if self.gauge.is_observed else None]
        header = {
            "can_mount": self.can_mount,
            "n_own": self.n_own,
            "gauge": gauge,
            "sigma_xy": self.sigma_xy,
            "sigma_yaw": self.sigma_yaw,
        }
        arrays: dict[str, NDArray[Any]] = {
            "constant": self.terms.constant,
            "slope": self.terms.slope,
            "incidence": self.terms.incidence,
            "offset": self.offset,
            "offset_se": self.offset_se,
        }
        return header, arrays

    @classmethod
    def restore(cls, n_rays: int, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Build it from what `state` gave.

        Raises
        ------
        ValueError : an array has a wrong shape
        """
        empty = cls.none(n_rays)
        right = {name: array.shape for name, array in empty.state()[1].items()}
        found = {name: np.asarray(arrays[name], dtype=np.float64) for name in right}
        shapes = {name: array.shape for name, array in found.items()}
        if shapes != right:
            raise ValueError(f"calibration has shapes {shapes}, expected {right}")
        gauge = None
        if header["gauge"] is not None:
            shift, width = header["gauge"]
            gauge = Gauge(shift=float(shift), stderr=np.inf if width is None else float(width))
        return cls(
            terms=RayTerms(**{name: found[name] for name in ("constant", "slope", "incidence")}),
            offset=found["offset"],
            offset_se=found["offset_se"],
            can_mount=bool(header["can_mount"]),
            n_own=int(header["n_own"]),
            gauge=gauge,
            sigma_xy=float(header["sigma_xy"]),
            sigma_yaw=float(header["sigma_yaw"]),
        )
