"""Result of `fleet`: the table, the changes of robots, robots that differ, and the logs that failed."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from sensorgraph.surveying.quantities import LABELS
from sensorgraph.surveying.trends import OddRobot
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True)
class RobotChange:
    """A change of one robot between two of its logs."""

    robot: str
    quantity: str
    day: str
    """Day of the first log after it."""
    after: str
    """First log after it."""
    size: float
    sigma: float
    probability: float
    is_drift: bool
    seen_in: tuple[str, ...] = ()
    """Quantities that show the change as well, and none once it is taken out."""

    def __str__(self) -> str:
        label = LABELS[self.quantity]
        when = "over all logs" if self.is_drift else f"since {self.day}"
        return f"{label.title} of {self.robot} {label.change(self.size, self.sigma)} {when}"


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """Result of `sg.fleet`."""

    rows: tuple[Mapping[str, Any], ...]
    """One for each analysed log, by robot and time; `quantities` maps a name to [value, standard error]."""
    failures: tuple[tuple[str, str], ...]
    """Log and reason."""
    same: tuple[tuple[str, str], ...]
    """Log and the log of equal content that stands for both."""
    changes: tuple[RobotChange, ...]
    """Changes with a probability of at least 95 %."""
    possible: tuple[RobotChange, ...]
    """Changes with a probability between 50 and 95 %."""
    odd: tuple[OddRobot, ...]
    """Robots that differ from their sisters."""
    n_new: int
    """Number of logs that were analysed in this call; the others were kept."""
    n_outdated: int
    """Number of logs with results of another version or of other settings."""
    walls: Mapping[str, Floats] = field(default_factory=dict, repr=False)
    """Place -> (n, 2, 2) [m] walls, for the map of changes."""

    def __repr__(self) -> str:
        """Summarise the result in one line."""
        return f"Fleet: {self.extent}; {self.changed_robots}; {len(self.failures)} logs failed"

    @property
    def extent(self) -> str:
        """Number of logs and robots, and the length of the logs, in words."""
        n, robots = len(self.rows), len({str(row["robot"]) for row in self.rows})
        hours = sum(float(row["length_s"]) for row in self.rows) / 3600
        return (
            f"{n:,} log{'' if n == 1 else 's'} of {robots} robot{'' if robots == 1 else 's'}, {hours:.1f} h"
        )

    @property
    def changed_robots(self) -> str:
        """Number of robots that changed, in words."""
        n, total = len({one.robot for one in self.changes}), len({str(row["robot"]) for row in self.rows})
        return f"{n} of {total} robots changed" if n else "No robot changed"

    @property
    def shared_names(self) -> list[str]:
        """One line for each robot with logs that overlap in time, which may be those of several robots."""
        pairs: dict[str, list[tuple[str, str]]] = {}
        for one, later in itertools.pairwise(self.rows):  # by robot and time
            if one["robot"] == later["robot"] and later["epoch_s"] < float(one["epoch_s"]) + float(
                one["length_s"]
            ):
                pairs.setdefault(str(one["robot"]), []).append((str(one["log"]), str(later["log"])))
        return [
            f"{found[0][0]} and {found[0][1]} overlap in time and count as logs of one robot, {robot}"
            f"{f' (and {len(found) - 1} more)' if len(found) > 1 else ''}; if they are of several robots, "
            "`--name REGEX` takes the robot's name from the path"
            for robot, found in pairs.items()
        ]

    def lines(self) -> list[str]:
        """Return the summary as lines."""
        out = [f"{self.extent}; {self.n_new} analysed now, {len(self.failures)} failed"]
        if self.n_outdated:
            out.append(
                f"{self.n_outdated} logs had results of another version or of other settings, and were analysed again"
            )
        out += [f"note: {one}" for one in self.shared_names]
        out += [f"{self.changed_robots}{':' if self.changes else ''}", *(f"  {one}" for one in self.changes)]
        out += [
            f"{one.robot} differs from its sisters: {LABELS[one.quantity].title} "
            f"{LABELS[one.quantity].change(one.size, one.sigma)}"
            for one in self.odd
        ]
        out += [f"possible ({100 * one.probability:.0f} %): {one}" for one in self.possible]
        out += [f"{log}: the same content as {other}, counted once" for log, other in self.same]
        return [*out, *(f"{log}: {reason}" for log, reason in self.failures)]

    def to_dict(self) -> dict[str, Any]:
        """Return the table, the changes and the failures as plain data."""
        return {
            "rows": [dict(row) for row in self.rows],
            "failures": [{"log": log, "reason": reason} for log, reason in self.failures],
            "changes": [asdict(one) for one in self.changes],
            "possible": [asdict(one) for one in self.possible],
            "odd": [asdict(one) for one in self.odd],
        }
