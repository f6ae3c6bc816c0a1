"""Select the scans of a long run that are used."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools

GOLDEN_RATIO = (1 + np.sqrt(5)) / 2


def thinned_out(kept: Bools, n_rays: int) -> tuple[Bools, dict[str, int]]:
    """Keep one in n of the usable scans of a long run; return them, and the number of scans left out.

    One of each n successive scans is kept, at a position that changes by the golden ratio (Weyl 1916). At a
    fixed position, every n-th scan could belong to the same facet of a mirror.
    """
    count = int(kept.sum())
    step = min(-(-count * n_rays // SCAN.intake.max_readings), count // SCAN.intake.min_scans)
    if step <= 1:
        return kept, {}
    some, group = np.zeros_like(kept), np.arange(count // step)
    within = (step * (GOLDEN_RATIO * group % 1.0)).astype(np.intp)
    some[np.flatnonzero(kept)[step * group + within]] = True
    return some, {f"of a long run, of which one in {step} is used": count - int(some.sum())}
