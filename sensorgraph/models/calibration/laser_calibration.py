"""Calibration result: deviation of the laser from its specification, with standard errors, and its stored form."""

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Deviation of the laser from its specification."""

    terms: RayTerms
    offset: Floats
    """(3,) [m, m, rad] identified mount minus specified mount."""
    offset_se: Floats
    """(3,) [m, m, rad] standard errors of the offset; nan where the mount was not identified."""
    can_mount: bool
    """Whether the mount is identifiable: the poses are those of a base that carries the laser."""
    n_own: int
    """Number of rays with individual terms."""
    gauge: Gauge | None
    """Common shift of the walls by occlusion edges; None without incidence terms, which could compensate it."""
    sigma_xy: float
    """[m] noise removed from the training poses; 0: the poses are unchanged."""
    sigma_yaw: float
    """[rad]"""

    @classmethod
    def none(cls, n_rays: int, *, can_mount: bool = True) -> Self:
        """Return the calibration of a laser as specified."""
        return cls(
            terms=RayTerms.none(n_rays), offset=np.zeros(3), offset_se=np.full(3, np.nan),
            can_mount=can_mount, n_own=0, gauge=None, sigma_xy=0.0, sigma_yaw=0.0,
        )  # fmt: skip

    @property
    def is_as_stated(self) -> bool:
        """Return whether laser and poses are unchanged."""
        return self.terms.is_none and not self.offset.any() and self.sigma_xy == 0 == self.sigma_yaw

    @property
    def is_plausible(self) -> bool:
        """Return whether the deviations are plausible; inconsistent poses and scans lead to implausible ones."""
        return bool(
            np.hypot(*self.offset[:2]) < CALIBRATION.max_mount_offset
            and abs(self.offset[2]) < CALIBRATION.max_mount_turn
            and np.abs(self.terms.constant).max() < CALIBRATION.max_ray_bias
            and np.abs(self.terms.slope).max() < CALIBRATION.max_slope
        )

    def summary(self) -> dict[str, str]:
        """Return the main facts as label -> text."""
        out = {"mount": self._mount()}
        if not self.terms.is_none:
            shared = "with" if self.terms.has_incidence else "without"
            out["ray terms"] = (
                f"{self.n_own} of {len(self.terms.constant)} rays have individual terms, {shared} incidence terms"
            )
        else:
            out["ray terms"] = "none needed"
        if self.gauge is not None:
            g = self.gauge
            out["common shift of the walls"] = (
                f"{1e3 * g.shift:+.2f} ± {1e3 * g.stderr:.2f} mm, where occlusion edges are sharpest"
                if g.is_observed
                else "not observable: there are no occlusion edges; all walls may be some mm too near or too far"
            )
        if self.sigma_xy > 0 or self.sigma_yaw > 0:
            out["training poses"] = (
                f"refined; their noise was {1e3 * self.sigma_xy:.1f} mm and {math.degrees(self.sigma_yaw):.3f}°"
            )
        return out

    def _mount(self) -> str:
        if not self.can_mount:
            return "not identifiable: the poses are the laser's own"
        if not np.isfinite(self.offset_se).all():
            return "as stated"
        (x, y, yaw), (sx, sy, s_yaw) = self.offset, self.offset_se
        return (
            f"off by {1e3 * x:+.2f} ± {1e3 * sx:.2f} mm, {1e3 * y:+.2f} ± {1e3 * sy:.2f} mm, "
            f"{math.degrees(yaw):+.4f} ± {math.degrees(s_yaw):.4f}° from the specified mount"
        )

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return plain data and arrays that describe the calibration."""
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
        """Recreate the calibration from the output of `state`.

        Raises
        ------
        ValueError : An array has a wrong shape.
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
            offset=found["offset"], offset_se=found["offset_se"], can_mount=bool(header["can_mount"]),
            n_own=int(header["n_own"]), gauge=gauge, sigma_xy=float(header["sigma_xy"]),
            sigma_yaw=float(header["sigma_yaw"]),
        )  # fmt: skip
