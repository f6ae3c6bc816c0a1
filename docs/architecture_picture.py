"""Draw the architecture: python docs/architecture_picture.py > docs/pages/pictures/architecture.svg."""

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


def picture() -> str:
    """Return the picture as SVG."""
    c = COLOURS
    row = 70
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="system-ui, DejaVu Sans, sans-serif">',
        f'<defs><marker id="head" markerWidth="9" markerHeight="8" refX="8" refY="4" orient="auto"><path d="M0,0 L9,4 L0,8 z" fill="{INK}"/></marker>',
        f"<style>.t{{font-size:16px;font-weight:600;text-anchor:middle}}.l{{font-size:12.5px;text-anchor:middle;fill:{INK}}}"
        f".a{{font-size:12.5px;fill:{GREY};font-style:italic}}.h{{font-size:13px;fill:{GREY};letter-spacing:.06em}}</style></defs>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="{PAPER}"/>',
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
    sys.stdout.write(picture())
