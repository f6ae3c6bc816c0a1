"""Draw the architecture, and the engine of `diagnose`.

python docs/architecture_picture.py architecture > docs/pages/pictures/architecture.svg
python docs/architecture_picture.py engine > docs/pages/pictures/engine.svg
"""

from __future__ import annotations

import sys
from html import escape

WIDTH, HEIGHT = 1080, 600
INK, GREY, PAPER = "#22303c", "#6b7a88", "#ffffff"
COLOURS = {
    "planners": "#2a788e",
    "logs": "#8a5a9e",
    "sensorgraph": "#1d8a7d",
    "ident": "#b8772a",
    "yours": "#6b7a88",
}


def box(x: float, y: float, w: float, h: float, title: str, lines: tuple[str, ...], colour: str) -> str:
    """Return a box with a title and lines of text below it."""
    text = [
        f'<rect x="{x}" y="{y}" width="{w}" height="{h}" rx="8" fill="{colour}" fill-opacity="0.09" stroke="{colour}" stroke-width="1.6"/>',
        f'<text x="{x + w / 2}" y="{y + 25}" class="t" fill="{colour}">{escape(title)}</text>',
    ]
    for k, line in enumerate(lines):
        text.append(f'<text x="{x + w / 2}" y="{y + 46 + 17 * k}" class="l">{escape(line)}</text>')
    return "\n".join(text)


def arrow(points: str, label: str = "", at: tuple[float, float] = (0, 0), anchor: str = "middle") -> str:
    """Return an arrow, with a label for the data that it carries."""
    text = f'<path d="{points}" fill="none" stroke="{INK}" stroke-width="1.6" marker-end="url(#head)"/>'
    if label:
        text += f'<text x="{at[0]}" y="{at[1]}" class="a" text-anchor="{anchor}">{escape(label)}</text>'
    return text


def head(height: int) -> list[str]:
    """Return the first lines of a picture."""
    return [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="system-ui, DejaVu Sans, sans-serif">',
        f'<defs><marker id="head" markerWidth="9" markerHeight="8" refX="8" refY="4" orient="auto"><path d="M0,0 L9,4 L0,8 z" fill="{INK}"/></marker>',
        f"<style>.t{{font-size:16px;font-weight:600;text-anchor:middle}}.l{{font-size:12.5px;text-anchor:middle;fill:{INK}}}"
        f".a{{font-size:12.5px;fill:{GREY};font-style:italic}}.h{{font-size:13px;fill:{GREY};letter-spacing:.06em}}</style></defs>",
        f'<rect width="{WIDTH}" height="{height}" fill="{PAPER}"/>',
    ]


def engine() -> str:
    """Return the engine of `diagnose`: from signals and hypotheses over evidence to verdicts."""
    c = COLOURS
    scan, wheels, motors = "#1d8a7d", "#2a788e", "#8a5a9e"
    parts = [
        *head(470),
        '<text x="30" y="34" class="h">CHANNELS</text>',
        box(30, 48, 210, 84, "scan", ("scans against the map,", "cast at the reference poses"), scan),
        box(30, 150, 210, 84, "wheels", ("odometry against", "the reference poses"), wheels),
        box(30, 252, 210, 84, "motors", ("commands against", "the measured motion"), motors),
        '<text x="30" y="380" class="h">HYPOTHESES</text>',
        box(30, 392, 330, 58, "effects", ("glass, mount yaw, wheel radius, dead time …",), c["ident"]),
        box(380, 392, 330, 58, "differences without a name", ("late scans, bias by bearing, wheel play …",), c["ident"]),
        box(330, 48, 200, 130, "fit", ("residuals, whitened;", "pose, map, mount and clock", "within their tolerances;", "effects of the model"), scan),
        box(620, 48, 200, 130, "best hypothesis", ("evidence = J(with)", "− J(without) − price", "of each hypothesis;", "the largest wins"), scan),
        box(620, 232, 200, 104, "superfluous?", ("evidence beside", "the others < threshold:", "remove the weakest"), scan),
        box(880, 48, 180, 130, "ledger", ("all hypotheses:", "place, size, evidence,", "price, rival, reason"), c["planners"]),
        box(880, 232, 180, 104, "verdict", ("named, undecided,", "unknown or silent:", "a function of the ledger"), c["planners"]),
        box(880, 392, 180, 58, "report", ("why, gap, next run",), c["yours"]),
        arrow("M240,90 H326"),
        arrow("M240,192 H285 V124 H326"),
        arrow("M240,294 H300 V150 H326"),
        arrow("M530,113 H616", "try each", (573, 103)),
        arrow("M195,392 V360 H590 V160 H616"),
        arrow("M710,421 H850 V150 H876", "tested on what the model leaves", (842, 380), "end"),
        arrow("M720,178 V228", "enough: add, refit", (730, 208), "start"),
        arrow("M620,284 H430 V182", "refit, next round", (520, 276)),
        arrow("M820,113 H876", "no more", (848, 103)),
        arrow("M970,178 V228"),
        arrow("M970,336 V388"),
        "</svg>",
    ]  # fmt: skip
    return "\n".join(parts) + "\n"


def picture() -> str:
    """Return the picture as SVG."""
    c = COLOURS
    row = 70
    parts = [
        *head(HEIGHT),
        '<text x="30" y="34" class="h">DATA FLOW</text>',
        box(30, row, 150, 112, "arena, robot", ("lab.geojson", "robot.yaml"), c["yours"]),
        box(250, row, 150, 112, "plan", ("every reachable", "(x, y, φ), checked"), c["planners"]),
        box(470, row, 150, 112, "record", ("your robot, or", "the simulated robot"), c["logs"]),
        box(690, row, 150, 112, "build", ("faces: equations", "of every ray"), c["sensorgraph"]),
        box(910, row, 150, 112, "sensorgraph", ("range of each ray,", "its uncertainty, and", "what is unobserved"), c["sensorgraph"]),
        arrow(f"M180,{row + 56} H246"),
        arrow(f"M400,{row + 56} H466", "trajectory", (433, row + 46)),
        arrow(f"M620,{row + 56} H686", "run", (653, row + 46)),
        arrow(f"M840,{row + 56} H906"),
        box(690, 262, 150, 92, "diagnose", ("the missing effect:", "name, size, place,", "standard error"), c["sensorgraph"]),
        box(910, 262, 150, 92, "use it", ("predict, evaluate,", "review, simulate"), c["sensorgraph"]),
        box(470, 262, 150, 92, "identify", ("one signal as a", "polynomial of others"), c["ident"]),
        arrow("M545,182 V258"),
        arrow("M590,182 V222 H745 V258", "run, arena, robot", (668, 216)),
        arrow("M985,182 V258"),
        arrow("M950,182 V222 H800 V258", "as the map", (876, 216)),
        arrow("M495,262 V186", "controller", (485, 228), "end"),
        arrow("M765,354 V392 H325 V186", "effects.yaml: simulate again; next_run: the next plan", (545, 386)),
        arrow(f"M985,{row} V52 H325 V{row - 4}", "expected error: drive next where the graph does not answer", (655, 46)),
        '<text x="30" y="446" class="h">PACKAGES: SENSORGRAPH IMPORTS THE THREE BELOW</text>',
        box(30, 456, 1030, 58, "sensorgraph", ("combines them: ray casting, simulated robot, effects, models, diagnosis, command line",), c["sensorgraph"]),
        box(30, 526, 330, 58, "planners", ("where to drive",), c["planners"]),
        box(380, 526, 330, 58, "logs", ("recorded runs and their files",), c["logs"]),
        box(730, 526, 330, 58, "robotmodic_ident", ("polynomial models of signals",), c["ident"]),
        "</svg>",
    ]  # fmt: skip
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    sys.stdout.write({"architecture": picture, "engine": engine}[sys.argv[1]]())
