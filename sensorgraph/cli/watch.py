"""`sensorgraph watch`."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sensorgraph.cli.options import GraphFile, NoReturn, RunRobot, Slice, TopicsByExample
from sensorgraph.cli.record_live import RecordDomain, RecordDuration, RecordRouter, RecordWait
from sensorgraph.termination import TERMINATED, Terminated, allow_to_finish

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

    from logs.run import Run
    from sensorgraph.show.review.watched import WatchRecording
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
WatchLive = Annotated[
    bool, typer.Option("--live", help="Watch your own running ROS 2 robot over zenoh, until Ctrl-C.")
]
WatchShow = Annotated[
    bool,
    typer.Option("--show", help="Also show each statement in rerun's viewer as it comes, and write OUT.rrd."),
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
    live: WatchLive = False,
    show: WatchShow = False,
    router: RecordRouter = None,
    domain: RecordDomain = None,
    duration: RecordDuration = None,
    wait: RecordWait = None,
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

      sensorgraph watch office.sensorgraph --live --router 192.168.0.5 -o watch.mcap
    """
    from sensorgraph.cli.inputs import check_output, read_options
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.watching.policy import LEVELS, WatchPolicy, load_policy

    for path, suffix in ((out, None if init_policy else ".mcap"), (json, None)):
        if path is not None:
            check_output(path, graph, *(runs or []), suffix=suffix)
    reading = read_options(topic, no_return, robot, heights)
    if init_policy:
        _init_policy(graph, runs or [], out, reading, robot)
        return
    if live == bool(runs) or len(runs or []) > 1:
        raise SensorgraphError(
            f"{len(runs or [])} runs are given{' with --live' if live else ''}, expected one, or --live; "
            "to learn limits, add --init-policy"
        )
    limits = WatchPolicy() if policy is None else load_policy(policy)
    model = Sensorgraph.load(graph)
    if show and out is None:
        raise SensorgraphError("--show needs -o OUT.mcap; OUT.rrd is written to the same folder")
    output = _Output(model, limits, graph, None if live or not runs else runs[0], out, json, show=show)
    if live:
        level = _watch_live(output, topic, router, domain, duration, wait)
    else:
        assert runs is not None
        run = _read(runs[0], reading, robot)
        level = output.take(_statuses(model, run, limits), run.epoch_ns, runs[0].name)
        output.print()
    if output.is_terminated:
        raise typer.Exit(TERMINATED)
    if policy is not None and level != "ok":
        raise typer.Exit(LEVELS.index(level))


def _watch_live(
    output: _Output,
    topics: list[str] | None,
    router: str | None,
    domain: int | None,
    duration: float | None,
    wait: float | None,
) -> str:
    """Watch a running robot until Ctrl-C or until the time is over; return the level."""
    from logs import parse_topics
    from logs.live.network import DEFAULT_ROUTER, RosNetwork
    from logs.live.recording import LiveScans
    from sensorgraph.watching.live import LiveWatch, warm_up

    warm_up(output.model)  # compiling takes a minute, in which scans would be left out
    with RosNetwork(router or DEFAULT_ROUTER, domain, wait=wait) as network:
        watched = LiveWatch(
            output.model, LiveScans(network, topics=parse_topics(topics or [])), output.limits, wait=wait
        )
        level = output.take(
            watched.statuses(duration), watched.epoch_ns, "live", partial(watched.publish, network)
        )
    output.print()
    typer.echo(f"{watched.n_used:,} scans watched, {watched.n_dropped:,} left out")
    return level


def _read(path: Path, reading: dict[str, Any], robot: Path | None) -> Run:
    from sensorgraph.cli.inputs import read_run
    from sensorgraph.intake import check_ranges

    run = read_run(path, reading, robot, name=path.name)
    check_ranges(run, path.name)  # a robot's mount replaces one that moves
    return run


def _statuses(model: Any, run: Run, limits: WatchPolicy) -> Iterator[WatchStatus]:
    """Yield the statements; the notes on the log are printed before the first."""
    from sensorgraph.cli.inputs import print_log_notes
    from sensorgraph.watching.watcher import watch_run

    for status in watch_run(model, run, baseline=limits.baseline):
        print_log_notes(run)
        yield status


class _Output:
    """What is written and shown of the statements."""

    def __init__(
        self,
        model: Any,
        limits: WatchPolicy,
        graph: Path,
        run: Path | None,
        out: Path | None,
        json: Path | None,
        *,
        show: bool,
    ) -> None:
        from sensorgraph.building.build import can_update
        from sensorgraph.watching.summary import WatchSummary

        self.model, self.limits, self.graph_name, self.out, self.json = model, limits, graph.name, out, json
        self.rrd = out.with_suffix(".rrd") if show and out is not None else None
        self.is_terminated = False
        self.summary = WatchSummary(run, graph, can_update=can_update(model))

    def take(
        self,
        statuses: Iterator[WatchStatus],
        epoch_ns: int,
        name: str,
        publish: Callable[[WatchStatus], None] | None = None,
    ) -> str:
        """Take all statements until the end, or of a live robot until Ctrl-C or SIGTERM; return the level."""
        import json as as_text

        from logs.files import atomic_file
        from sensorgraph.errors import SensorgraphError
        from sensorgraph.localization.graph_walls import walls_of_graph
        from sensorgraph.watching.messages import WatchFile
        from sensorgraph.watching.page import watch_page

        summary, line, walls = self.summary, _StatusLine(), walls_of_graph(self.model)[0]
        with ExitStack() as stack:
            lines = None if self.json is None else stack.enter_context(
                stack.enter_context(atomic_file(self.json)).open("w")
            )  # fmt: skip
            file = None if self.out is None else stack.enter_context(WatchFile(self.out, epoch_ns))
            recording = None if self.rrd is None else stack.enter_context(_recording(walls, self.rrd))
            stack.callback(line.end)
            with self._until_stopped(is_live=publish is not None):
                for status in statuses:
                    level, reason = self.limits.level(status)
                    summary.add(status, level, reason)
                    if lines is not None:
                        lines.write(as_text.dumps(status.to_dict()) + "\n")
                    if file is not None:
                        file.add(status, self.limits)
                    if recording is not None:
                        recording.add(status)
                    if publish is not None:
                        publish(status)
                    line.show(status, summary)
        summary.conclude()
        if summary.last is None:
            raise SensorgraphError(f"{name} has no scan to watch; expected messages on /scan")
        if self.out is not None:
            page = watch_page(summary.page(name, self.graph_name, walls))
            with atomic_file(self.out.with_suffix(".html")) as part:
                part.write_text(page, encoding="utf-8")
        return summary.level

    @contextmanager
    def _until_stopped(self, *, is_live: bool) -> Iterator[None]:
        """End a live watch normally at Ctrl-C and SIGTERM, so that its files are complete."""
        try:
            yield
        except KeyboardInterrupt:
            if not is_live:
                raise
        except Terminated:
            if not is_live:
                raise
            allow_to_finish()
            self.is_terminated = True

    def print(self) -> None:
        """Print the result."""
        summary = self.summary
        for span in summary.spans["pose"]:
            if span.word not in ("ok", "unknown"):
                typer.echo(f"{span.first:.0f} to {span.last:.0f} s: {span.text}")
        for text in summary.at_the_end():
            typer.echo(text)
        for note in summary.notes:
            typer.echo(f"note: {note}")
        if step := summary.next_step():
            typer.echo(step)
        typer.echo(summary.result())
        if self.out is not None:
            rrd = "" if self.rrd is None else f", {self.rrd}"
            typer.echo(f"wrote {self.out}{rrd} and {self.out.with_suffix('.html')}")


def _recording(walls: Any, path: Path) -> AbstractContextManager[WatchRecording]:
    """Return the recording of rerun, with the viewer open."""
    from sensorgraph.show.review.watched import watched_recording

    return watched_recording(walls, path)


def _init_policy(
    graph: Path, runs: list[Path], out: Path | None, reading: dict[str, Any], robot: Path | None
) -> None:
    from logs.expectations import expected_topics
    from logs.inspection import inspect
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.watching.policy import WatchPolicy, learn, save_policy

    if not runs or out is None:
        raise SensorgraphError(
            "--init-policy takes good runs and the file of the policy: --init-policy RUN... -o site.yaml"
        )
    model = Sensorgraph.load(graph)
    found = learn([list(_statuses(model, _read(path, reading, robot), WatchPolicy())) for path in runs])
    save_policy(out, found, expected_topics([inspect(path, **reading) for path in runs]))
    typer.echo(f"{60 * found.hours:.1f} min of good runs: limits written to {out}")


class _StatusLine:
    """One line on stderr: rewritten on a terminal, every few seconds elsewhere."""

    def __init__(self) -> None:
        self.is_terminal = sys.stderr.isatty()
        self.cpu, self.began = time.process_time(), time.monotonic()
        self.shown = self.began

    def show(self, status: WatchStatus, summary: Any) -> None:
        from shutil import get_terminal_size

        from sensorgraph.cli.progress import PLAIN_EVERY, rate_text

        now = time.monotonic()
        if now - self.shown < (0.1 if self.is_terminal else PLAIN_EVERY):
            return
        self.shown = now
        driven = max(status.t - (summary.first or 0.0), 1.0)
        rate = driven / max(now - self.began, 1e-9)
        load = (time.process_time() - self.cpu) / driven  # at the pace of the robot, also in a replay
        pace = f"{rate_text(rate)} times real time, {100 * load:.0f} % of a core"
        text = f"{status.t:.0f} s: {'; '.join(status.sentences())} ({pace})"
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
