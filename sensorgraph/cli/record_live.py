"""`sensorgraph record --live`."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sensorgraph.cli.progress import PlainLines
from sensorgraph.termination import TERMINATED, Terminated, allow_to_finish

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from logs.live.recording import LiveRecording
    from sensorgraph.recording.plan_coverage import PlanCoverage

RecordLive = Annotated[
    bool, typer.Option("--live", help="Record your own running ROS 2 robot over zenoh, until Ctrl-C.")
]
RecordRouter = Annotated[
    str | None,
    typer.Option(metavar="HOST:PORT", help="--live: zenoh router of the robot; default: 127.0.0.1:7447."),
]
RecordDomain = Annotated[
    int | None,
    typer.Option(min=0, max=232, help="--live: ROS domain ID; default: ROS_DOMAIN_ID, else 0."),
]
RecordDuration = Annotated[
    float | None, typer.Option(metavar="S", help="--live: stop after this many seconds; default: no limit.")
]
RecordWait = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        help="--live: time limit in seconds for the first connection to router and robot; default: 3 and 10.",
    ),
]
RecordUntilCovered = Annotated[
    Path | None,
    typer.Option(
        metavar="PLAN", help="--live: stop when the bins of this plan are covered; report the missing bins."
    ),
]
RecordShare = Annotated[
    float,
    typer.Option(min=0.0, max=1.0, help="--until-covered: share of the plan's bins to cover, 0 to 1."),
]

LOOK_EVERY = 0.5
"""[s] Interval at which rates and coverage are updated."""


def check_options(*, live: bool, of_live: Mapping[str, Any], of_plan: Mapping[str, Any]) -> None:
    """Refuse options of the simulated robot with --live, and options of --live without it."""
    from sensorgraph.errors import SensorgraphError

    given = [name for name, value in (of_plan if live else of_live).items() if value not in (None, [])]
    if given and live:
        raise SensorgraphError(
            f"{given[0]} is for the simulated robot, and --live records your own; leave out one"
        )
    if given:
        raise SensorgraphError(f"{given[0]} requires --live; add it to record your own robot")


def record_live(
    out: Path,
    *,
    router: str | None,
    domain: int | None,
    topics: list[str] | None,
    duration: float | None,
    wait: float | None,
    until_covered: Path | None,
    share: float,
    arena: str | None,
    robot: Path | None,
) -> None:
    """Record a running ROS 2 robot until Ctrl-C, until the time is over, or until a plan is covered."""
    from logs import parse_topics
    from logs.live.network import DEFAULT_ROUTER, RosNetwork
    from logs.live.recording import LiveRecording
    from sensorgraph.cli.inputs import check_output
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.recording.plan_coverage import PlanCoverage

    check_output(out, suffix=".mcap")
    for name, seconds in (("--duration", duration), ("--wait", wait)):
        if seconds is not None and not seconds > 0:
            raise SensorgraphError(f"{name} is {seconds:g}, expected seconds above 0")
    coverage = None if until_covered is None else PlanCoverage.of(until_covered)
    kept = _attachments(until_covered, arena, robot)
    with (
        RosNetwork(router or DEFAULT_ROUTER, domain, wait=wait) as network,
        LiveRecording(out, network, topics=parse_topics(topics or []), attachments=kept) as recording,
    ):
        why, code = _listen(recording, coverage, share, duration, wait)
        ended = time.time()
    for line in _summary(recording, ended):
        typer.echo(line)
    if coverage is not None:
        typer.echo(coverage.sentence())
        if coverage.missing.any():
            where = "" if "arena.geojson" in kept else " ARENA"
            grid = f"--cell {coverage.driven.cell:g} --headings {coverage.planned.shape[2]}"
            typer.echo(f"plan the missing bins: sensorgraph plan{where} --resume {out} {grid} -o rest")
    typer.echo(f"{why}; wrote {out}")
    if code:
        raise typer.Exit(code)


def _summary(recording: LiveRecording, ended: float) -> list[str]:
    """Return one line per topic and one line per note; times are relative to the first message."""
    began = recording.began or ended
    out = []
    for name, rate in recording.rates.items():
        line = f"{name}: {rate.n_messages:,} message{'' if rate.n_messages == 1 else 's'}"
        if rate.n_lost:
            line += f", {rate.n_lost:,} lost in transport"
        if rate.n_gaps:
            word = "1 gap of" if rate.n_gaps == 1 else f"{rate.n_gaps:,} gaps, the longest"
            line += f", {word} {rate.longest_gap:.2f} s at {rate.longest_gap_began - began:.2f} s"
        if rate.is_gap(rate.silence(ended)):
            line += f", silent for the last {rate.silence(ended):.1f} s"
        out.append(line)
    for outage in recording.outages:
        at = f"no connection to the router at {recording.network.router} from {outage.began - began:.1f} s"
        back = "until the end" if outage.ended is None else f"to {outage.ended - began:.1f} s"
        out.append(f"note: {at} {back} ({(outage.ended or ended) - outage.began:.1f} s)")
    return out + [f"note: {note}" for note in recording.notes]


def _listen(
    recording: LiveRecording,
    coverage: PlanCoverage | None,
    share: float,
    duration: float | None,
    wait: float | None,
) -> tuple[str, int]:
    """Record and show the state; return the reason why the recording ended, and the exit code."""
    began = time.monotonic()
    knows_place = False
    try:
        recording.wait_for_topics(wait)
        with _display() as show:
            began = time.monotonic()
            while duration is None or time.monotonic() - began < duration:
                left = LOOK_EVERY if duration is None else duration - (time.monotonic() - began)
                recording.pump(min(LOOK_EVERY, max(left, 0.0)))
                if coverage is not None:
                    run = recording.recent()
                    knows_place = (run is not None and coverage.add(run)) or knows_place
                    if coverage.share >= share:
                        return "the plan is covered", 0
                state = [_outage_text(recording), _coverage_text(coverage, knows_place)]
                show(recording, "; ".join(text for text in state if text), time.monotonic() - began)
    except KeyboardInterrupt:
        return f"stopped after {time.monotonic() - began:.0f} s", 0
    except Terminated:
        allow_to_finish()
        return f"terminated after {time.monotonic() - began:.0f} s", TERMINATED
    return f"reached the duration of {duration:g} s", 0


def _outage_text(recording: LiveRecording) -> str:
    now = time.time()
    if recording.outages and recording.outages[-1].ended is None:
        return f"no router for {now - recording.outages[-1].began:.0f} s; waiting for it"
    silent = [rate.silence(now) for rate in recording.rates.values() if rate.is_gap(rate.silence(now))]
    if silent and len(silent) == sum(rate.n_messages > 3 for rate in recording.rates.values()):
        return f"no message for {min(silent):.0f} s; waiting for the robot"
    return ""


def _coverage_text(coverage: PlanCoverage | None, knows_place: bool) -> str:
    if coverage is None:
        return ""
    if not knows_place:
        return "no pose in map yet (/pose, or /tf map -> base_link)"
    return f"{100 * coverage.share:.1f} % of the plan's bins"


def _attachments(plan: Path | None, arena: str | None, robot: Path | None) -> dict[str, bytes]:
    """Return the attachments of the run: the given arena and robot, else those of the plan, and plan.json."""
    from sensorgraph.loading import attachments_of, load_arena
    from sensorgraph.recording.drive_source import open_drive
    from sensorgraph.world.robot import load_robot

    source = None if plan is None else open_drive(plan)
    out = {} if source is None else source.attachments()
    walls = load_arena(arena) if arena is not None else source.arena() if source is not None else None
    machine = load_robot(robot) if robot is not None else source.robot() if source is not None else None
    return {**out, **attachments_of(walls, machine)}


@contextmanager
def _display() -> Iterator[Callable[[LiveRecording, str, float], None]]:
    """Yield a function that shows rates and gaps on stderr: a table on a terminal, lines elsewhere."""
    if not sys.stderr.isatty():
        yield _print_rates
        return
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(stderr=True), transient=True, refresh_per_second=4) as live:

        def show(recording: LiveRecording, state: str, elapsed: float) -> None:
            live.update(_table(recording, state, elapsed))

        yield show


def _print_rates(recording: LiveRecording, state: str, elapsed: float) -> None:
    """Print the rates as one line every few seconds."""
    if not PlainLines.are_due():
        return
    now = time.time()
    rates = ", ".join(f"{name} {rate.hz(now):.1f} Hz" for name, rate in recording.rates.items())
    gaps = sum(rate.n_gaps for rate in recording.rates.values())
    lost = sum(rate.n_lost for rate in recording.rates.values())
    PlainLines.write(
        f"recording: {elapsed:.0f} s: {rates}; {gaps} gaps, {lost} lost{f'; {state}' if state else ''}"
    )


def _table(recording: LiveRecording, state: str, elapsed: float) -> Any:
    from rich.table import Table

    table = Table(
        title=f"recording {recording.path}, {elapsed:.0f} s, stop with Ctrl-C", caption=state or None
    )
    table.add_column("topic")
    for column in ("messages", "Hz", "longest gap", "gaps", "lost"):
        table.add_column(column, justify="right")
    now = time.time()
    for name, rate in recording.rates.items():
        gap = f"{max(rate.longest_gap, rate.silence(now)):.2f} s" if rate.n_messages > 1 else ""
        table.add_row(
            name, f"{rate.n_messages:,}", f"{rate.hz(now):.1f}", gap, f"{rate.n_gaps:,}", f"{rate.n_lost:,}"
        )
    return table
