"""nav2_params.yaml: AMCL's numbers, estimated from a run, and limits of range and speed from effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from sensorgraph.amending.findings import CannotHoldError, apply, why
from sensorgraph.amending.text import Why, decimal
from sensorgraph.amending.yaml_text import YamlFile, as_number, child
from sensorgraph.effects import Amendment
from sensorgraph.effects.max_range import MAX_RANGE
from sensorgraph.effects.min_range import MIN_RANGE
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.exporting.amcl import BootstrapEstimate, LaserModelChoice

AMCL_KEYS = ("laser_model_type", "laser_max_range", "laser_min_range", "alpha1")
"""Keys by which the parameters of all nodes, `/**`, are recognized as AMCL's."""
WHAT = "Nav2's parameter file"
TOP_SPEEDS = ("desired_linear_vel", "max_vel_x", "max_speed_xy", "vx_max", "v_linear_max")
"""Keys of controllers that limit the speed ahead [m/s]."""


def amend_nav2(
    data: YamlFile,
    amendments: tuple[Amendment, ...],
    *,
    amcl: tuple[Mapping[str, BootstrapEstimate], LaserModelChoice | None] | None,
    file: str,
) -> list[str]:
    """Amend a nav2_params.yaml; return what it cannot hold, one line each.

    Parameters
    ----------
    amcl : Estimates by their names in Nav2, and the better laser model; None: no run is given.
    """
    handlers = {
        MAX_RANGE: lambda a: _amcl(data, "laser_max_range", a["R"], why(a, "R")),
        MIN_RANGE: lambda a: _amcl(data, "laser_min_range", a["r_min"], why(a, "r_min")),
        SPEED_SATURATION: lambda a: _top_speed(data, a),
    }
    lines = apply(amendments, handlers, WHAT, file, [data.file])
    if amcl is None:
        return [*lines, f"{file}: AMCL's parameters: give a run with poses (--run) to estimate them"]
    estimates, model = amcl
    try:
        section = _section(data)
    except CannotHoldError as exc:
        return [*lines, f"{file}: AMCL's parameters: {exc}"]
    if any(a.effect is MAX_RANGE for a in amendments):  # found, and not only stated by the log
        estimates = {name: found for name, found in estimates.items() if name != "laser_max_range"}
    for name, found in estimates.items():
        node = child(section, name)
        reason = Why(cause=f"estimate {found}")
        if node is None:
            data.add(section, (name,), decimal(float(f"{found.value:.3g}")), reason)
            continue
        old = as_number(node)
        if old is None:
            lines.append(f"{file}: AMCL's `{name}` is not a number; estimated {found}")
        elif not found.low <= old <= found.high:
            data.put(node, float(f"{found.value:.3g}"), reason)
    node = child(section, "laser_model_type")
    if model is not None and node is not None and node.value.strip() != model.name:
        data.put_text(node, f'"{model.name}"' if node.style == '"' else model.name, str(model))
    return lines


def _section(data: YamlFile) -> Any:
    """Return the parameters of the node amcl, below any namespace, or those of all nodes, `/**`.

    Raises
    ------
    CannotHoldError : There is no such node, or there are several.
    """
    nodes = [(key, child(value, "ros__parameters")) for key, value in _pairs(data.root)]
    found = [(key, node) for key, node in nodes if key.rsplit("/", 1)[-1] == "amcl" and node is not None]
    if not found:
        found = [
            (key, node) for key, node in nodes
            if key.endswith("*") and any(child(node, one) is not None for one in AMCL_KEYS)
        ]  # fmt: skip
    if not found:
        raise CannotHoldError("it has no `amcl: ros__parameters:`")
    if len(found) > 1:
        raise CannotHoldError(f"it has {len(found)} nodes {found[0][0]}; give a file with one")
    return found[0][1]


def _amcl(data: YamlFile, key: str, value: float, reason: Why) -> None:
    section = _section(data)
    node = child(section, key)
    if node is None:
        data.add(section, (key,), decimal(value), reason)
    elif as_number(node) is None:
        raise CannotHoldError(f"`{key}` is not a number")
    else:
        data.put(node, value, reason)
    data.check_anchors()


def _top_speed(data: YamlFile, a: Amendment) -> None:
    """Lower every limit of the speed that exceeds the measured one."""
    found = 0
    for key, node in list(_pairs(data.root)):
        if key in TOP_SPEEDS:
            found += _lower(data, node, a)
        elif key in ("max_velocity", "min_velocity") and isinstance(node, yaml.SequenceNode) and node.value:
            found += _lower(data, node.value[0], a)
    if not found:
        raise CannotHoldError(
            f"it limits the speed nowhere: no velocity_smoother, and no {', '.join(TOP_SPEEDS)}"
        )
    data.check_anchors()


def _lower(data: YamlFile, node: Any, a: Amendment) -> int:
    old = as_number(node)
    if old is None:
        return 0
    if abs(old) > a["v_max"]:
        data.put(node, a["v_max"] if old > 0 else -a["v_max"], why(a, "v_max"))
    return 1


def _pairs(node: Any) -> Iterator[tuple[str, Any]]:
    """Yield all keys and values of a tree."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield str(key.value), value
            yield from _pairs(value)
