"""Run inspect, locate, build and diagnose on every log of some folders, and print one table, a row a file.

    python -m benchmarks.strangers FOLDER... [--only PATTERN,...]

Logs are found recursively; a folder that is a rosbag2 is one log. Each log is copied first, so nothing is written beside
it. A file `options.yaml` in a FOLDER gives options by file pattern, with paths relative to the FOLDER:

    jarvis_*.bag: {topic: [scan=/front, pose=/nav/pose], arena: lab.yaml}
    old/sonars: {robot: old/robot.yaml}

`locate` and `build` show their result and, if the log has a reference pose, the ATE: the rms distance of located poses
from the reference after the best rigid motion. Seconds are of CPU time, of all processes of a command.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import logs
from benchmarks.arguments import heads, parser_of, processor_time
from benchmarks.locate import aligned
from logs.formats import format_of
from logs.formats.rosbag import logs_in
from logs.run import Run, pair
from logs.transforms import compose, invert
from sensorgraph.cli.inputs import read_options
from sensorgraph.localization.locate import has_reference, is_located

SUFFIXES = (".bag", ".db3", ".mcap", ".log", ".clf", ".gz", ".bz2", ".csv", ".active")
"""Files with other names are not tried."""
OPTIONS = "options.yaml"
LIMIT = 900.0
"""[s] of a command, of wall time."""
LINE = 110
"""Characters of a message in a cell."""


@dataclass(frozen=True)
class Row:
    """One log, and what each command said."""

    name: str
    what: str
    said: dict[str, tuple[int | None, str, float]]
    """Command -> exit code, None if it took too long; its result or its error line; its seconds."""


def logs_below(folder: Path) -> Iterator[Path]:
    """Yield the logs in a folder; a folder with a metadata.yaml or with the parts of one bag is one log."""
    if (folder / "metadata.yaml").is_file() or any(len(parts) > 1 for parts in logs_in(folder)):
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            yield from logs_below(path)
        elif path.suffix.lower() in SUFFIXES and ".located." not in path.name and _may_be_log(path):
            yield path


def _may_be_log(path: Path) -> bool:
    """Tell whether a file is a log; one that claims to be a bag and cannot be recognised is one, too."""
    try:
        format_of(path)
    except logs.LogError:
        return path.suffix.lower() in (".bag", ".db3", ".mcap", ".log", ".clf")
    return True


def options_of(folder: Path, path: Path) -> dict[str, Any]:
    """Return the options for a log: those of each pattern in options.yaml that matches, the last wins."""
    file = folder / OPTIONS
    given = yaml.safe_load(file.read_text()) if file.is_file() else {}
    name, found = path.relative_to(folder).as_posix(), dict[str, Any]()
    for pattern, values in (given or {}).items():
        if fnmatchcase(name, pattern):
            found |= values
    return found


def words_of(options: Mapping[str, Any], folder: Path, command: str) -> list[str]:
    """Return the options of a command as words."""
    topics = options.get("topic", [])
    words = [
        word for topic in ([topics] if isinstance(topics, str) else topics) for word in ("--topic", topic)
    ]
    for name in ("slice", "no-return"):
        words += [f"--{name}", str(options[name])] if name in options else []
    if "robot" in options:
        words += ["--robot", str(folder / options["robot"])]
    if "arena" in options and command == "diagnose":
        words += ["--arena", str(folder / options["arena"])]
    if command == "diagnose" and options.get("poses"):
        words += ["--poses", options["poses"]]
    return words


def run_command(words: Sequence[str], work: Path) -> tuple[int | None, list[str], float]:
    """Run a command in a folder.

    Returns
    -------
    Exit code, None if it took longer than LIMIT; its last lines; its seconds of CPU time.
    """
    before = processor_time()
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    process = subprocess.Popen(
        [sys.executable, "-m", "sensorgraph", *words], cwd=work, env=env, text=True, errors="replace",
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
    )  # fmt: skip
    code: int | None
    try:
        out, _ = process.communicate(timeout=LIMIT)
        code = process.returncode
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGTERM)
        out, _ = process.communicate()
        code = None
    return code, [line for line in out.splitlines() if line.strip()], processor_time() - before


def described(path: Path, options: Mapping[str, Any]) -> tuple[str, Run | None]:
    """Return what a log is, and its run; None if it cannot be read."""
    try:
        kind = format_of(path)
        topics = options.get("topic", [])
        given = [topics] if isinstance(topics, str) else list(topics)
        run = logs.read(
            path, **read_options(given or None, options.get("no-return"), None, options.get("slice"))
        )
    except (logs.LogError, OSError) as exc:
        return shortened(str(exc)), None
    parts = [
        run.meta.get("format", kind),
        f"{run.n_scans:,} × {run.sensor.n_rays} rays",
        f"{run.duration:.0f} s",
    ]
    parts += ["odometry"] if len(run.odom_stamps) else []
    if has_reference(run):
        parts.append(f"{run.meta.get('pose_source', 'pose')}")
    return ", ".join(parts), run


def shortened(text: str, most: int = LINE) -> str:
    """Return a message as one cell."""
    text = " ".join(text.split()).replace("|", "\\|")
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


def ate_of(run: Run, poses_csv: Path) -> float | None:
    """Return the ATE [m] of located poses against the reference of the log; None without a reference."""
    if not has_reference(run) or is_located(run) or run.meta.get("pose_source") == "slam":
        return None
    with poses_csv.open() as file:
        rows = list(csv.DictReader(file))
    found = np.array([[float(row[name]) for name in ("x", "y", "phi")] for row in rows])
    paired = pair(run, whole_sweep=False)
    used = paired.paired & np.array([row["status"] == "ok" for row in rows])
    if used.sum() < 3:
        return None
    truth = paired.poses[used]
    if run.pose_frame == "laser":
        truth = compose(truth, np.broadcast_to(invert(run.sensor.mount), truth.shape))
    errors, _ = aligned(found[used], truth)
    return float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()))


def _inspected(work: Path, run: Run | None) -> str:
    facts = json.loads((work / "inspect.json").read_text())
    uses = [f"{use['name'].removeprefix('diagnose ')}: {use['verdict']}" for use in facts["use"]]
    n = len(facts["warnings"])
    return ", ".join(uses) + (f"; {n} warning{'s' if n > 1 else ''}" if n else "")


def _located(work: Path, run: Run | None) -> str:
    facts = json.loads((work / "locate.json").read_text())
    sigma = facts["sigma_median"]
    text = f"{facts['ok']:,} of {facts['n_scans']:,}"
    if sigma[0] is not None:
        text += f", ± {100 * float(np.hypot(*sigma[:2]) / np.sqrt(2)):.1f} cm, {np.degrees(sigma[2]):.2f}°"
    error = None if run is None else ate_of(run, work / "locate.csv")
    return text + ("" if error is None else f"; ATE {100 * error:.1f} cm")


def _built(work: Path, run: Run | None) -> str:
    return f"{(work / 'log.sensorgraph').stat().st_size / 1e6:.1f} MB"


def _diagnosed(work: Path, run: Run | None) -> str:
    facts = json.loads((work / "diagnosis" / "report.json").read_text())
    named = [each["name"] for each in facts.get("effects", [])]
    unknown = facts.get("unknown")
    unknown = unknown.get("statement") if isinstance(unknown, dict) else unknown
    parts = [", ".join(named) if named else "no effect"]
    parts += [f"unknown: {unknown}"] if unknown else []
    return "; ".join(parts)


OUTPUTS: dict[str, tuple[tuple[str, ...], Callable[[Path, Run | None], str]]] = {
    "inspect": (("--json", "inspect.json"), _inspected),
    "locate": (("--csv", "locate.csv", "--json", "locate.json"), _located),
    "build": (("-o", "log.sensorgraph"), _built),
    "diagnose": (("-o", "diagnosis"), _diagnosed),
}
"""Command -> its output options, and its result from these files."""


def row_of(path: Path, folder: Path) -> Row:
    """Run the commands on a copy of a log."""
    options = options_of(folder, path)
    what, run = described(path, options)
    said: dict[str, tuple[int | None, str, float]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        copy = work / path.name
        shutil.copytree(path, copy) if path.is_dir() else shutil.copy(path, copy)
        for command, (output, result) in OUTPUTS.items():
            words = [command, path.name, *words_of(options, folder, command), *output]
            code, lines, seconds = run_command(words, work)
            if code is None:
                text = f"took longer than {LIMIT:.0f} s"
            elif code == 0:
                text = result(work, run)
            else:
                last = next(
                    (line for line in reversed(lines) if line.startswith("error")), (lines or [""])[-1]
                )
                text = last.removeprefix("error: ") + ("" if code == 2 else f" (exit {code})")
            said[command] = code, text, seconds
    return Row(path.relative_to(folder).as_posix(), what, said)


def lines_of(rows: Sequence[Row]) -> list[str]:
    """Return the table in Markdown."""
    lines = [heads("log", "what it is", *OUTPUTS, "s", text=2 + len(OUTPUTS))]
    for row in rows:
        said = [("✗ " if code != 0 else "") + shortened(text) for code, text, _ in row.said.values()]
        took = " / ".join(f"{seconds:.0f}" for _, _, seconds in row.said.values())
        lines.append(f"| {row.name} | {row.what} | {' | '.join(said)} | {took} |")
    codes = [code for row in rows for code, _, _ in row.said.values()]
    crashed, refused = sum(code not in (0, 2) for code in codes), codes.count(2)
    lines.append(
        f"\n{len(rows)} logs, {len(codes)} commands: {codes.count(0)} results, {refused} refused in one line, {crashed} other"
    )
    return lines


def main() -> int:
    """Print the table, and return 1 if a command ended with neither a result nor one line."""
    parser = parser_of(__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--only", default="*", help="patterns of names, separated by commas")
    given = parser.parse_args()
    rows = []
    for folder in given.folders:
        folder = folder.resolve()
        for path in logs_below(folder):
            name = path.relative_to(folder).as_posix()
            if not any(fnmatchcase(name, pattern) for pattern in given.only.split(",")):
                continue
            rows.append(row_of(path, folder))
            print(f"{time.strftime('%H:%M')} {name}", file=sys.stderr)
    print("\n".join(lines_of(rows)))
    return int(any(code not in (0, 2) for row in rows for code, _, _ in row.said.values()))


if __name__ == "__main__":
    sys.exit(main())
