"""`sensorgraph compile`."""

from __future__ import annotations

import typer


def compile_kernels() -> None:
    """Compile ahead what plan, record, build, evaluate and diagnose compile on first use, in two processes.

    The kernels are kept in the cache of numba: in the package, in the user's cache, or in NUMBA_CACHE_DIR.

    Examples:

      sensorgraph compile
    """
    import time
    from pathlib import Path
    from tempfile import TemporaryDirectory

    import logs
    from planners.kernel import can_cache
    from planners.maps import geojson
    from sensorgraph.building.build import build
    from sensorgraph.cli.progress import progress
    from sensorgraph.demo import BASELINE, ROOM, demo
    from sensorgraph.files import unfinished
    from sensorgraph.world.robot import load_robot

    if not can_cache():  # which has given the reason
        raise typer.Exit(2)
    began = time.monotonic()
    room = geojson.loads(ROOM)
    with TemporaryDirectory() as name:
        folder = Path(name)
        unfinished.add(folder)
        demo(
            folder,
            room,
            load_robot(),
            seed=0,
            progress=progress,
            show=lambda stage, _: typer.echo(f"{time.monotonic() - began:4.0f} s  {stage}: compiled"),
        )
        build([logs.read(folder / "coverage.mcap")], arena=room, model=BASELINE, progress=progress)
