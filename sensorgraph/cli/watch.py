"""`sensorgraph watch`."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sensorgraph.cli.options import GraphFile, NoReturn, RunRobot, Slice, TopicsByExample

if TYPE_CHECKING:
    from collections.abc import Iterator

    from logs.run import Run
    from sensorgraph.watching.policy import WatchPolicy
    from sensorgraph.watching.status import WatchStatus

WatchRuns = Annotated[
    list[Path] | None, typer.Argument(metavar="RUN...", help="Run to watch; with --init-policy, good runs.")
]
WatchOut = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--out",
        help="MCAP file of the statements; the page OUT.html is also written. With --init-policy: the yaml.",
    ),
]
WatchJson = Annotated[Path | None, typer.Option(help="File of the statements, one JSON object a line.")]
WatchPolicyFile = Annotated[
    Path | None,
    typer.Option("--policy", help="Limits (yaml) that decide the exit code: 0 ok, 1 warning, 2 error."),
]
WatchInit = Annotated[
    bool, typer.Option("--init-policy", help="Learn limits from good runs, and write them to OUT.")
]


def watch(
    graph: GraphFile,
    runs: WatchRuns = None,
    out: WatchOut = None,
    json: WatchJson = None,
    policy: WatchPolicyFile = None,
    init_policy: WatchInit = False,
    topic: TopicsByExample = None,
    no_return: NoReturn = None,
    robot: RunRobot = None,
    heights: Slice = None,
) -> None:
    """Watch a robot: is its pose right, has the place changed, do laser and wheels work.

    Examples:

      sensorgraph watch office.sensorgraph today.mcap -o watch.mcap

      sensorgraph watch office.sensorgraph --init-policy good1.mcap good2.mcap -o site.yaml

      sensorgraph watch office.sensorgraph today.mcap --policy site.yaml --json watch.jsonl
    """
    from sensorgraph.cli.inputs import check_output, read_options
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.watching.policy import LEVELS, WatchPolicy, load_policy

    for path in (out, json):
        if path is not None:
            check_output(path, graph, *(runs or []))
    reading = read_options(topic, no_return, robot, heights)
    if init_policy:
        _init_policy(graph, runs or [], out, reading, robot)
        return
    if runs is None or len(runs) != 1:
        raise SensorgraphError(
            f"{len(runs or [])} runs are given, expected one; to learn limits, add --init-policy"
        )
    if out is not None and out.suffix != ".mcap":
        raise SensorgraphError(
            f"{out}: statements are written as *.mcap; name it {out.with_suffix('.mcap').name}"
        )
    limits = WatchPolicy() if policy is None else load_policy(policy)
    model, run = Sensorgraph.load(graph), _read(runs[0], reading, robot)
    level = _watch_run(model, run, limits, names=(graph.name, runs[0].name), out=out, json=json)
    if policy is not None and level != "ok":
        raise typer.Exit(LEVELS.index(level))


def _read(path: Path, reading: dict[str, Any], robot: Path | None) -> Run:
    from logs import read
    from sensorgraph.cli.inputs import with_robot
    from sensorgraph.cli.progress import reading_bar

    with reading_bar() as tick:
        run = read(path, **reading, progress=tick)
    return with_robot(run, path.name, robot)


def _statuses(model: Any, run: Run, limits: WatchPolicy) -> Iterator[WatchStatus]:
    from sensorgraph.watching.observation import observations
    from sensorgraph.watching.watcher import watch_scans

    return watch_scans(model, observations(run), run.sensor, baseline=limits.baseline)


def _watch_run(
    model: Any, run: Run, limits: WatchPolicy, *, names: tuple[str, str], out: Path | None, json: Path | None
) -> str:
    """Watch a run, write the statements, print the result; return the level."""
    import json as as_text

    from logs.files import atomic_file
    from sensorgraph.cli.inputs import print_log_notes
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.localization.graph_walls import walls_of_graph
    from sensorgraph.watching.messages import WatchFile
    from sensorgraph.watching.page import watch_page
    from sensorgraph.watching.summary import WatchSummary

    summary, began = WatchSummary(), time.monotonic()
    line = _StatusLine(began)
    with ExitStack() as stack:
        lines = (
            None if json is None else stack.enter_context(stack.enter_context(atomic_file(json)).open("w"))
        )
        file = None if out is None else WatchFile(out, run.epoch_ns)
        try:
            for status in _statuses(model, run, limits):
                level, reason = limits.level(status)
                summary.add(status, level, reason)
                if lines is not None:
                    lines.write(as_text.dumps(status.to_dict()) + "\n")
                if file is not None:
                    file.add(status, limits)
                line.show(status, summary)
        except BaseException:
            if file is not None:
                file.close(interrupted=True)
            raise
        if file is not None:
            file.close()
    line.end()
    if summary.last is None:
        raise SensorgraphError(f"{names[1]} has no scan to watch; expected messages on /scan")
    if out is not None:
        page = summary.page(names[1], names[0], walls_of_graph(model)[0])
        with atomic_file(out.with_suffix(".html")) as part:
            part.write_text(watch_page(page), encoding="utf-8")
    print_log_notes(run)
    _print_summary(summary, names[1], out)
    return summary.level


def _print_summary(summary: Any, name: str, out: Path | None) -> None:
    for span in summary.spans["pose"]:
        if span.word not in ("ok", "unknown"):
            typer.echo(f"{span.first:.0f} to {span.last:.0f} s: {span.text}")
    for text in summary.last.sentences():
        typer.echo(text)
    for note in summary.notes:
        typer.echo(f"note: {note}")
    if step := summary.next_step(name):
        typer.echo(step)
    typer.echo(f"{summary.level}{': ' + summary.reason if summary.reason else ''}")
    if out is not None:
        typer.echo(f"wrote {out} and {out.with_suffix('.html')}")


def _init_policy(
    graph: Path, runs: list[Path], out: Path | None, reading: dict[str, Any], robot: Path | None
) -> None:
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.watching.policy import WatchPolicy, learn, save_policy

    if not runs or out is None:
        raise SensorgraphError(
            "--init-policy takes good runs and the file of the policy: --init-policy RUN... -o site.yaml"
        )
    model = Sensorgraph.load(graph)
    found = learn([list(_statuses(model, _read(path, reading, robot), WatchPolicy())) for path in runs])
    save_policy(out, found)
    typer.echo(f"{60 * found.hours:.1f} min of good runs: limits written to {out}")


class _StatusLine:
    """One line on stderr: rewritten on a terminal, every few seconds elsewhere."""

    def __init__(self, began: float) -> None:
        self.is_terminal = sys.stderr.isatty()
        self.cpu, self.began, self.shown = time.process_time(), began, began

    def show(self, status: WatchStatus, summary: Any) -> None:
        from shutil import get_terminal_size

        from sensorgraph.cli.progress import PLAIN_EVERY

        now = time.monotonic()
        if now - self.shown < (0.1 if self.is_terminal else PLAIN_EVERY):
            return
        self.shown = now
        rate = (status.t - (summary.first or 0.0)) / max(now - self.began, 1e-9)
        load = (time.process_time() - self.cpu) / max(now - self.began, 1e-9)
        text = f"{status.t:.0f} s ({rate:.0f}x, {load:.0%} of a core): {'; '.join(status.sentences())}"
        if self.is_terminal:
            width = get_terminal_size().columns - 1
            sys.stderr.write(f"\r\x1b[2K{text[:width]}")
        else:
            sys.stderr.write(f"{text}\n")
        sys.stderr.flush()

    def end(self) -> None:
        """Clear the line."""
        if self.is_terminal:
            sys.stderr.write("\r\x1b[2K")
            sys.stderr.flush()
