"""Two recordings of one place: what changed in the office since its graph was built.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.two_recordings DIR

Drives the office once and builds a graph. Then a desk is pushed by (+15, -10) cm, the column is taken away and a box of
30 cm is put into the corridor; the office is driven again, and the second run is diagnosed against the graph of the first.
The report and its pictures are in DIR/diagnosis.
"""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from benchmarks.arguments import parser_of
from sensorgraph.cli import run as command

NEW_BOX = [[7.2, 5.8], [7.5, 5.8], [7.5, 6.1], [7.2, 6.1], [7.2, 5.8]]


def changed(office: dict[str, Any]) -> dict[str, Any]:
    """Push desk_3, take the column away, put a box into the corridor."""
    features = [f for f in office["features"] if f["properties"]["name"] != "column"]
    for feature in features:
        if feature["properties"]["name"] == "desk_3":
            (ring,) = feature["geometry"]["coordinates"]
            feature["geometry"]["coordinates"] = [[[x + 0.15, y - 0.10] for x, y in ring]]
    box = {"type": "Polygon", "coordinates": [NEW_BOX]}
    return {
        **office,
        "features": [
            *features,
            {"type": "Feature", "properties": {"name": "box", "kind": "obstacle"}, "geometry": box},
        ],
    }


def main() -> None:
    """Drive, build, change, drive, diagnose."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, metavar="DIR")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    office = json.loads((files("sensorgraph.data") / "office.geojson").read_text())
    for feature in office["features"]:
        feature["properties"].pop("surfaces", None)
    (folder / "before.geojson").write_text(json.dumps(office))
    (folder / "after.geojson").write_text(json.dumps(changed(json.loads(json.dumps(office)))))
    for seed, when in enumerate(("before", "after")):
        arena, plan, run = (str(folder / f"{when}{end}") for end in (".geojson", "_plan", ".mcap"))
        grid = ["--cell", "0.5", "--headings", "12"]
        _do("plan", arena, *grid, "--seed", str(seed), "-o", plan)
        _do("record", plan, "--arena", arena, "--seed", str(seed), "-o", run)
    graph = str(folder / "before.sensorgraph")
    _do("build", str(folder / "before.mcap"), "-o", graph)
    _do("diagnose", str(folder / "after.mcap"), "--arena", graph, "-o", str(folder / "diagnosis"))


def _do(*words: str) -> None:
    print("sensorgraph", *words)
    if command(list(words)):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
