"""A scene's plan on a terminal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from wrenchbook.service.client import ComponentPlan
from wrenchbook.service.contract import OUTPUTS


def show(out: Console, plans: Mapping[str, ComponentPlan]) -> None:
    """Print what each component of a scene needs, then why, and where the numbers come from."""
    out.print(plan_table(plans))
    for name, plan in plans.items():
        out.print(f"{name}: {plan.reason}.", markup=False, highlight=False)
        numbers_of: dict[str, list[str]] = {}
        for number, origin in plan.saves_from.items():
            numbers_of.setdefault(origin, []).append(number)
        for origin, numbers in numbers_of.items():
            out.print(f"  {', '.join(numbers)}: {origin}.", markup=False, highlight=False)


def plan_table(plans: Mapping[str, ComponentPlan]) -> Table:
    """Lay out a scene's plan, one line a component."""
    table = Table()
    for heading in ("component", "decision", "axes: loads", "moves at most", "solves", "saves"):
        table.add_column(heading, no_wrap=True)
    for name, plan in plans.items():
        table.add_row(
            escape(name),
            plan.decision,
            _axes(plan),
            _bounds(plan),
            f"{plan.solves['scene']} of {plan.solves['whole']}",
            _saved(plan),
        )
    return table


def _axes(plan: ComponentPlan) -> str:
    """Name each axis with its loads and how many of these vary."""
    axes = plan.axes.items()
    return (
        "\n".join(f"{a}: {' '.join(one['inputs'])}, {one['dimensions']}-D" for a, one in axes)
        or "none"
    )


def _bounds(plan: ComponentPlan) -> str:
    """Name what the outputs that are read do not exceed."""
    lines = []
    for name, bound in zip(OUTPUTS, plan.displacement_bound, strict=True):
        if name in plan.outputs:
            unit = "m" if name[0] == "u" else "rad"
            lines.append(f"{name} {bound:.2g} {unit}" if np.isfinite(bound) else f"{name} unknown")
    return "\n".join(lines)


def _saved(plan: ComponentPlan) -> str:
    """Name what the scene's table needs less than the whole."""
    saves = plan.saves
    if saves["build_s"] is None:
        return "not known yet"
    return "\n".join(
        (
            f"{saves['build_s']:.2g} s building",
            f"{saves['memory_bytes'] / 1e6:.2g} MB",
            f"{saves['us_per_answer']:.2g} µs an answer",
        )
    )
