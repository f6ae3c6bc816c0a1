"""Print the table of effects that is the page reference/effects.md: python docs/effects_table.py > docs/pages/reference/effects.md."""

from __future__ import annotations

import sys

from sensorgraph.effects import EFFECTS, Effect, Parameter

HEAD = """# Effects

What a bare ray caster lacks: the physics that `sensorgraph record --effects` adds to the embedded robot, its sensor and
the room. An effect stands in `effects.yaml` by its name, for instance

```yaml
- name: glass
  parameters: {a: 0.5, b: 2.0, alpha_ret: 0.3, depth: 1.0}
  location: {name: lab/edge_0}
- {name: wheel_radius, parameters: {s: 0.01}}
```

`location.name` is a wall `NAME/edge_i` or an obstacle of the arena, where the table says so. A parameter's materiality is
the size below which it is within the tolerance of a careful set-up; several of one effect add as a vector. Where
`tolerances` of robot.yaml states a mount or stamps worse than usual, that takes in proportion more. Any subset of effects
composes; the order in the file does not matter. This page is what `python docs/effects_table.py` prints.
"""
CHANNELS = {
    "scan": "Scans against map and pose",
    "odometry": "Odometry against pose",
    "drive": "Commands against motion",
}


def page() -> str:
    """Return the page."""
    parts = [HEAD]
    for channel, title in CHANNELS.items():
        rows = [row(effect) for effect in EFFECTS.values() if effect.channel == channel]
        head = "| name | physics | parameters [unit], materiality | sits on | source |\n|---|---|---|---|---|"
        parts.append("\n".join([f"## {title}\n", head, *rows, ""]))
    return "\n".join(parts)


def row(effect: Effect) -> str:
    """Return one line of the table."""
    numbers = "; ".join(parameter(p) for p in effect.parameters) or "none"
    place = effect.place if effect.place in ("wall", "obstacle") else ""
    cells = (f"`{effect.name}`", effect.physics, numbers, place, effect.source)
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def parameter(p: Parameter) -> str:
    """Say what a parameter is."""
    unit = f" [{p.unit}]" if p.unit else ""
    size = f", {p.materiality:.3g}" if p.materiality is not None else ""
    return f"`{p.name}`{unit} {p.doc}{size}"


if __name__ == "__main__":
    sys.stdout.write(page())
