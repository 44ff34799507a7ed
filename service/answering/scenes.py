"""What a scene needs of its components: plans, and tables cut to them."""

from __future__ import annotations

from statistics import median
from typing import Any

import numpy as np

from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.scene.cut import cut
from wrenchbook.surrogate.scene.need import Need
from wrenchbook.surrogate.scene.plan import ScenePlan, plan_of
from wrenchbook.surrogate.scene.savings import Savings, measured

SOLVES_TIMED = 32  # the last done ones, whose median is what a solve takes


def scene_reply(
    workspace: Workspace, component: Component, table: ServedTable, need: Need
) -> dict[str, Any]:
    """Return a scene's plan of one component, JSON-able."""
    built = table.surrogate()
    plan = plan_of(built, need, solved=component.has_fea)
    return _plan_body(workspace, component, plan, measured(built, plan), table.version)


def scene_file(workspace: Workspace, component: Component, table: ServedTable, need: Need) -> bytes:
    """Return a component's packed table cut to a scene, with the scene plan in it.

    A component that is rigid or linear in the scene has one too.
    """
    plan = scene_reply(workspace, component, table, need)
    return b"".join(cut(table.packed, need, plan))


def _plan_body(
    workspace: Workspace, component: Component, plan: ScenePlan, savings: Savings, version: int
) -> dict[str, Any]:
    need, (whole, scene) = plan.need, plan.solves
    limit = need.tolerance
    body: dict[str, Any] = {
        "decision": plan.decision,
        "reason": plan.reason,
        "loads": need.loads,
        "axes": need.axes(),
        "outputs": need.output_names(),
        "tolerance": limit and {"translation": limit.translation, "rotation": limit.rotation},
        "displacement_bound": [_number(one) for one in plan.bound.tolist()],
        "solves": {"whole": whole, "scene": scene},
        "saves": {
            "build_s": savings.build_s,
            "memory_bytes": savings.memory_bytes,
            "us_per_answer": savings.us_per_answer,
        },
        "saves_from": savings.origin | {"solves": _solves_from(workspace, component, plan)},
        "table_version": version,
    }
    if plan.compliance is not None:
        body["compliance"] = plan.compliance.tolist()
    return body


def _number(value: float) -> float | None:
    """Return a number, None if it is not known."""
    return value if np.isfinite(value) else None


def _solves_from(workspace: Workspace, component: Component, plan: ScenePlan) -> str:
    """Return what the numbers of solves are, and what those saved would take."""
    whole, scene = plan.solves
    if not component.has_fea:
        return "the component has no finite-element setup: nothing is solved"
    counted = (
        f"counted: the first design of an empty table has {whole} wrenches for the whole load range"
        f" and {scene} for the scene"
    )
    jobs = workspace.ledger.jobs(component.name, "done", SOLVES_TIMED)
    took = [job.seconds for job in jobs if job.seconds is not None]
    if not took:
        return f"{counted}; no solve of it has been timed here yet"
    each = median(took)
    return (
        f"{counted}; at {each:.3g} s a solve, the median of the last {len(took)}, that is "
        f"{(whole - scene) * each:.3g} s less"
    )
