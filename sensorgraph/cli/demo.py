"""`sensorgraph demo`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sensorgraph.cli.options import RobotFile

if TYPE_CHECKING:
    from sensorgraph.demo_effect import HiddenEffect


DemoOut = Annotated[
    Path | None, typer.Option("-o", "--out", help="Folder for the results; default: runs/demo-DATE-TIME.")
]
DemoArena = Annotated[
    str, typer.Option(help="GeoJSON file, map_server yaml, or a shipped arena: square, office.")
]
DemoFull = Annotated[
    bool,
    typer.Option("--full", help="Compare with a random drive of the same length and with the model of 2004."),
]
DemoReal = Annotated[
    bool, typer.Option("--real", help="Use a shipped real log instead: locate, build, evaluate, review.")
]
DemoSeed = Annotated[int, typer.Option(min=0, help="Random seed of planning and noise.")]


def demo(
    out: DemoOut = None,
    arena: DemoArena = "square",
    robot: RobotFile = None,
    seed: DemoSeed = 0,
    full: DemoFull = False,
    real: DemoReal = False,
) -> None:
    """Run the whole loop on a shipped arena: plan, record, build, evaluate, review, and find a hidden effect.

    Works offline and without a display.

    Examples:

      sensorgraph demo

      sensorgraph demo -o runs/mine --seed 7

      sensorgraph demo --full

      sensorgraph demo --real
    """
    import time

    from sensorgraph.cli.inputs import check_folder, write_json
    from sensorgraph.cli.progress import progress
    from sensorgraph.demo import COMPARISON, STAGES, to_dict
    from sensorgraph.demo import demo as run_demo
    from sensorgraph.demo_effect import to_dict as hidden_dict
    from sensorgraph.loading import load_arena
    from sensorgraph.version import __version__
    from sensorgraph.world.robot import load_robot

    if real:
        _demo_real(out or Path("runs") / time.strftime("demo-%Y%m%d-%H%M%S"), is_latest=out is None)
        return
    began = time.monotonic()
    folder = out or Path("runs") / time.strftime("demo-%Y%m%d-%H%M%S")
    walls, machine = load_arena(arena), load_robot(robot)
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    config = {
        "version": __version__,
        "command": "demo",
        "arena": arena,
        "robot": str(robot or "shipped"),
        "seed": seed,
    }
    write_json(folder / "config.json", config)
    stages = (*STAGES, COMPARISON) if full else STAGES
    typer.echo(f"{' -> '.join(stages)}; each line names a file to open")

    to_come = list(stages)

    def show(stage: str, path: Path) -> None:
        to_come.remove(stage)
        number = len(stages) - len(to_come)
        following = f"  next: {to_come[0]}" if to_come else ""
        typer.echo(
            f"[{number}/{len(stages)}] {time.monotonic() - began:4.0f} s  {stage:<10}  {path}{following}"
        )

    drives, hidden = run_demo(folder, walls, machine, seed=seed, full=full, progress=progress, show=show)
    results = to_dict(drives)
    write_json(folder / "demo.json", {**results, "hidden_effect": hidden_dict(hidden)})
    if out is None:
        _link_latest(folder)
    typer.echo("\n" + "\n".join(comparison_table(results)))
    typer.echo("\n" + "\n".join(hidden_effect_lines(hidden)))
    typer.echo(f"\n{time.monotonic() - began:.0f} s; all files are in {folder}")
    typer.echo(f"review:          rerun {folder / 'review.rrd'}")
    typer.echo(f"diagnosis:       {folder / 'diagnosis' / 'report.html'}")
    typer.echo(f"one equation:    sensorgraph show {folder / 'coverage.sensorgraph'} --ray 67")
    typer.echo(f"the log:         sensorgraph inspect {folder / 'coverage.mcap'}")
    if not full:
        typer.echo(
            "comparison:      sensorgraph demo --full drives at random, too, and fits the model of 2004"
        )


def _demo_real(folder: Path, *, is_latest: bool) -> None:
    """Run the loop on the shipped real log."""
    import time

    from sensorgraph.cli.inputs import check_folder, write_json
    from sensorgraph.cli.progress import progress
    from sensorgraph.demo_real import LOG, demo_real
    from sensorgraph.localization.locate import summary_lines

    began = time.monotonic()
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    done = demo_real(folder, progress=progress)
    write_json(folder / "demo.json", done.to_dict())
    if is_latest:
        _link_latest(folder)
    held, wheels = done.held_out.all, done.found.wheels
    lines = [f"{LOG}: a real log without reference poses (CC-BY 3.0, see {folder / 'fr079.ATTRIBUTION.md'})"]
    lines += [f"locate:    {line}" for line in summary_lines(done.found)]
    if wheels is not None:
        before, after = done.drift
        lines.append(
            f"wheels:    median drift after 10 m {100 * before:.0f} cm as logged, {100 * after:.0f} cm with these parameters"
        )
    lines += [
        f"evaluate:  {_scaled(held['median_m'], 'cm')} median error, {_scaled(held['within_0.1m'], '%')} within 10 cm, on "
        "held-out parts of the log",
        f"{time.monotonic() - began:.0f} s; all files are in {folder}",
        f"review:          rerun {folder / 'review.rrd'}   and   {folder / 'map.png'}",
        f"poses:           {folder / 'poses.csv'}, with standard deviations",
        f"one equation:    sensorgraph show {folder / 'fr079.sensorgraph'} --ray 180",
    ]
    typer.echo("\n".join(lines))


def _scaled(value: float | None, unit: str) -> str:
    """Return a length [m] in cm or a share in %."""
    return "–" if value is None else f"{100 * value:.1f} {unit}"


def hidden_effect_lines(hidden: HiddenEffect) -> list[str]:
    """Return the printed lines: the hidden effect, the diagnosis, and the gap before and after."""
    from sensorgraph.diagnosis.report.quantities import brief
    from sensorgraph.diagnosis.report.summary import summarise

    lines = [
        f"hidden by seed:  {brief(hidden.planted)}",
        f"diagnosis:       {summarise(hidden.finding).headline}",
    ]
    gap = hidden.finding.second_gap
    if gap is not None:
        lines.append(
            f"second run:      gap {100 * gap.before.rmse_m:.2f} -> {100 * gap.after.rmse_m:.2f} cm, "
            f"noise floor {100 * gap.noise_floor.rmse_m:.2f} cm; mean negative log likelihood of a ray "
            f"{gap.before.nats_per_ray:.2f} -> {gap.after.nats_per_ray:.2f} nats"
        )
    return lines


HEADS = {
    "coverage": "planned",
    "random_bounce": "random, same time",
    "coverage_polynomial": "planned, form of 2004",
}
"""Drive of demo.json -> column header."""


def comparison_table(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the table of the demo in Markdown from the numbers in demo.json."""
    heads, drives = [HEADS[name] for name in results], list(results.values())
    rows = [
        ("driven", [f"{drive['drive_time_s'] / 60:.0f} min" for drive in drives]),
        ("reachable (x, y, φ) bins visited", [f"{100 * drive['coverage']:.1f} %" for drive in drives]),
        ("rays answered, anywhere in the arena", [f"{100 * drive['answered']:.1f} %" for drive in drives]),
    ]
    for label, name, scale, unit in (
        ("median error of all rays", "median_m", 100, "cm"),
        ("MAE", "mae_m", 100, "cm"),
        ("RMSE", "rmse_m", 100, "cm"),
    ):
        values = [drive["all"][name] for drive in drives]
        rows.append((label, ["–" if v is None else f"{scale * v:.3g} {unit}" for v in values]))
    correlations = [drive["all"]["pearson_r"] for drive in drives]
    rows.append(("Pearson r", ["–" if r is None else f"{r:.3f}" for r in correlations]))
    width = max(len(label) for label, _ in rows)
    columns = [max(len(head), *(len(cells[k]) for _, cells in rows)) for k, head in enumerate(heads)]

    def line(label: str, cells: list[str]) -> str:
        return (
            f"| {label:<{width}} | "
            + " | ".join(f"{c:>{w}}" for c, w in zip(cells, columns, strict=True))
            + " |"
        )

    ruler = f"|{'-' * (width + 2)}|" + "|".join("-" * (w + 1) + ":" for w in columns) + "|"
    return [line("", heads), ruler, *(line(label, cells) for label, cells in rows)]


def _link_latest(folder: Path) -> None:
    """Link runs/latest to the folder if the file system supports links."""
    latest = folder.parent / "latest"
    try:
        latest.unlink(missing_ok=True)
        latest.symlink_to(folder.name, target_is_directory=True)
    except OSError:
        return
