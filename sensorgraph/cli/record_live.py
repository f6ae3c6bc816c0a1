"""`sensorgraph record --live`."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from logs.live.recording import LiveRecording
    from sensorgraph.recording.plan_coverage import PlanCoverage

RecordLive = Annotated[
    bool, typer.Option("--live", help="Record your running ROS 2 robot instead, over zenoh; Ctrl-C ends it.")
]
RecordRouter = Annotated[
    str | None,
    typer.Option(metavar="HOST:PORT", help="--live: the zenoh router of the robot; default: 127.0.0.1:7447."),
]
RecordDomain = Annotated[
    int | None,
    typer.Option(min=0, max=232, help="--live: ROS domain; default: ROS_DOMAIN_ID, else 0."),
]
RecordDuration = Annotated[float | None, typer.Option(metavar="S", help="--live: end after so many seconds.")]
RecordUntilCovered = Annotated[
    Path | None,
    typer.Option(
        metavar="PLAN", help="--live: end when the bins of this plan have a pose; said is what is missing."
    ),
]
RecordShare = Annotated[
    float,
    typer.Option(min=0.0, max=1.0, help="--until-covered: the share of the plan's bins that suffices."),
]

LOOK_EVERY = 0.5
"""[s] between two looks at rates and coverage."""
PLAIN_EVERY = 5.0
"""[s] between two lines where there is no terminal."""


def check_options(*, live: bool, of_live: Mapping[str, Any], of_plan: Mapping[str, Any]) -> None:
    """Refuse options of the embedded robot with --live, and those of --live without it."""
    from sensorgraph.errors import SensorgraphError

    given = [name for name, value in (of_plan if live else of_live).items() if value not in (None, [])]
    if given and live:
        raise SensorgraphError(f"{given[0]} is for the embedded robot; --live records your own, as it drives")
    if given:
        raise SensorgraphError(f"{given[0]} is for --live; add it to record your own robot")


def record_live(
    out: Path,
    *,
    router: str | None,
    domain: int | None,
    topics: list[str] | None,
    duration: float | None,
    until_covered: Path | None,
    share: float,
    arena: str | None,
    robot: Path | None,
) -> None:
    """Record a running ROS 2 robot until Ctrl-C, the time is over, or a plan is covered."""
    from logs import parse_topics
    from logs.live.network import DEFAULT_ROUTER, RosNetwork
    from logs.live.recording import LiveRecording
    from sensorgraph.cli.inputs import check_output
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.recording.plan_coverage import PlanCoverage

    check_output(out)
    if out.suffix != ".mcap":
        raise SensorgraphError(f"{out}: a run is written as *.mcap; name it {out.with_suffix('.mcap').name}")
    if duration is not None and not duration > 0:
        raise SensorgraphError(f"--duration is {duration:g}, expected seconds above 0")
    coverage = None if until_covered is None else PlanCoverage.of(until_covered)
    kept = _attachments(until_covered, arena, robot)
    with (
        RosNetwork(router or DEFAULT_ROUTER, domain) as network,
        LiveRecording(out, network, topics=parse_topics(topics or []), attachments=kept) as recording,
    ):
        why = _listen(recording, coverage, share, duration)
    for name, rate in recording.rates.items():
        lost = f", {rate.n_lost:,} lost on the way" if rate.n_lost else ""
        gaps = f", {rate.n_gaps:,} gaps, the longest {rate.longest_gap:.2f} s" if rate.n_gaps else ""
        typer.echo(f"{name}: {rate.n_messages:,} messages{lost}{gaps}")
    for note in recording.notes:
        typer.echo(f"note: {note}")
    if coverage is not None:
        typer.echo(coverage.sentence())
        if coverage.missing.any():
            typer.echo(f"the rest: sensorgraph plan ARENA --resume {out} -o rest")
    typer.echo(f"{why}; wrote {out}")


def _listen(
    recording: LiveRecording, coverage: PlanCoverage | None, share: float, duration: float | None
) -> str:
    """Record and show how it goes; return why it ended."""
    began = time.monotonic()
    knows_place = False
    try:
        recording.wait_for_topics()
        with _display() as show:
            began = time.monotonic()
            while duration is None or time.monotonic() - began < duration:
                left = LOOK_EVERY if duration is None else duration - (time.monotonic() - began)
                recording.pump(min(LOOK_EVERY, max(left, 0.0)))
                if coverage is not None:
                    run = recording.recent()
                    knows_place = (run is not None and coverage.add(run)) or knows_place
                    if coverage.share >= share:
                        return "the plan is covered"
                show(recording, _coverage_text(coverage, knows_place), time.monotonic() - began)
    except KeyboardInterrupt:
        return f"stopped after {time.monotonic() - began:.0f} s"
    return f"{duration:g} s are over"


def _coverage_text(coverage: PlanCoverage | None, knows_place: bool) -> str:
    if coverage is None:
        return ""
    if not knows_place:
        return "no pose in map yet (/pose, or /tf map -> base_link)"
    return f"{100 * coverage.share:.1f} % of the plan's bins"


def _attachments(plan: Path | None, arena: str | None, robot: Path | None) -> dict[str, bytes]:
    """Return what the run keeps: arena and robot as given, else the plan's, and plan.json."""
    from planners.maps import geojson
    from sensorgraph.loading import load_arena
    from sensorgraph.recording.drive_source import open_drive
    from sensorgraph.world.robot import load_robot

    source = None if plan is None else open_drive(plan)
    out = {} if source is None else source.attachments()
    walls = load_arena(arena) if arena is not None else source.arena() if source is not None else None
    machine = load_robot(robot) if robot is not None else source.robot() if source is not None else None
    if walls is not None:
        out["arena.geojson"] = geojson.dumps(walls).encode()
    if machine is not None:
        out["robot.yaml"] = machine.text.encode()
    return out


@contextmanager
def _display() -> Iterator[Callable[[LiveRecording, str, float], None]]:
    """Yield what shows rates and gaps: a table on a terminal, a line every few seconds elsewhere; on stderr."""
    if not sys.stderr.isatty():
        yield _PlainLines().show
        return
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(stderr=True), transient=True, refresh_per_second=4) as live:

        def show(recording: LiveRecording, covered: str, elapsed: float) -> None:
            live.update(_table(recording, covered, elapsed))

        yield show


class _PlainLines:
    """Rates in one line every few seconds."""

    def __init__(self) -> None:
        self.said = time.monotonic()

    def show(self, recording: LiveRecording, covered: str, elapsed: float) -> None:
        if time.monotonic() - self.said < PLAIN_EVERY:
            return
        self.said = time.monotonic()
        now = time.time()
        rates = ", ".join(f"{name} {rate.hz(now):.1f} Hz" for name, rate in recording.rates.items())
        gaps = sum(rate.n_gaps for rate in recording.rates.values())
        lost = sum(rate.n_lost for rate in recording.rates.values())
        sys.stderr.write(
            f"recording: {elapsed:.0f} s: {rates}; {gaps} gaps, {lost} lost{f'; {covered}' if covered else ''}\n"
        )
        sys.stderr.flush()


def _table(recording: LiveRecording, covered: str, elapsed: float) -> Any:
    from rich.table import Table

    table = Table(
        title=f"recording {recording.path}, {elapsed:.0f} s, Ctrl-C ends it", caption=covered or None
    )
    table.add_column("topic")
    for column in ("messages", "Hz", "longest gap", "gaps", "lost"):
        table.add_column(column, justify="right")
    now = time.time()
    for name, rate in recording.rates.items():
        gap = f"{rate.longest_gap:.2f} s" if rate.n_messages > 1 else ""
        table.add_row(
            name, f"{rate.n_messages:,}", f"{rate.hz(now):.1f}", gap, f"{rate.n_gaps:,}", f"{rate.n_lost:,}"
        )
    return table
