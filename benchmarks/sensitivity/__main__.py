"""Print which numbers change answers; see the package."""

from __future__ import annotations

import benchmarks.sensitivity
from benchmarks.arguments import parser_of
from benchmarks.sensitivity.cases import GROUPS


def main() -> None:
    """Vary the numbers of the groups."""
    parser = parser_of(benchmarks.sensitivity.__doc__)
    parser.add_argument("groups", nargs="*", choices=[[], *GROUPS], metavar="GROUP", help=", ".join(GROUPS))
    parser.add_argument("--only", default="", help="parts of the names of numbers, comma-separated")
    options = parser.parse_args()
    only = [part for part in options.only.split(",") if part]
    for name in options.groups or GROUPS:
        benchmarks.sensitivity.sweep(name, GROUPS[name].packages, GROUPS[name].cases, only)


if __name__ == "__main__":
    main()
