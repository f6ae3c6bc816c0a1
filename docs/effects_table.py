"""Print the page of effects: python docs/effects_table.py > docs/pages/reference/effects.md."""

from __future__ import annotations

import sys

from sensorgraph.effects import EFFECTS, Effect, Parameter

HEAD = """# Effects

An effect is a piece of physics that a bare ray caster lacks. `sensorgraph record --effects` adds effects to the
simulated robot, its sensor and the arena; `sensorgraph diagnose` looks for them. `effects.yaml` lists effects by name:

```yaml
- name: glass
  parameters: {a: 0.5, b: 2.0, alpha_ret: 0.3, depth: 1.0}
  location: {name: lab/edge_0}
- {name: wheel_radius, parameters: {s: 0.01}}
```

Any subset of effects can be combined, and the order in the file does not matter. If the column "location" names a wall
or an obstacle, `location.name` is required: a wall `NAME/edge_i`, or an obstacle of the arena.

The **materiality** of a parameter is the size below which it is within the tolerance of a careful setup. Several
parameters of one effect add as a vector. If `tolerances` in robot.yaml are larger than the defaults for the mount or
the stamps, the materiality grows in proportion.

`python docs/effects_table.py` prints this page.
"""
CHANNELS = {
    "scan": "Scans against map and pose",
    "odometry": "Odometry against pose",
    "drive": "Commands against motion",
}


def page() -> str:
    """Return the page as Markdown."""
    parts = [HEAD]
    for channel, title in CHANNELS.items():
        rows = [row(effect) for effect in EFFECTS.values() if effect.channel == channel]
        head = (
            "| name | physics | parameters [unit], materiality | location | source |\n|---|---|---|---|---|"
        )
        parts.append("\n".join([f"## {title}\n", head, *rows, ""]))
    return "\n".join(parts)


def row(effect: Effect) -> str:
    """Return the row of an effect in the table."""
    numbers = "; ".join(parameter(p) for p in effect.parameters) or "none"
    place = effect.place if effect.place in ("wall", "obstacle") else ""
    cells = (f"`{effect.name}`", effect.physics, numbers, place, effect.source)
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def parameter(p: Parameter) -> str:
    """Describe a parameter: name, unit, meaning and materiality."""
    unit = f" [{p.unit}]" if p.unit else ""
    size = f", {p.materiality:.3g}" if p.materiality is not None else ""
    return f"`{p.name}`{unit} {p.doc}{size}"


if __name__ == "__main__":
    sys.stdout.write(page())
