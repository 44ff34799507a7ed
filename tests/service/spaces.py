"""A component of two interfaces and a temperature on a test server, with rows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tests.surrogate.test_space import range_of, solved
from wrenchbook.service.ledger import ImportOrigin, NotedRows
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.space import Input, space_of
from wrenchbook.surrogate.table.spread import spread_wrenches

SPACE = space_of(("left", "right"), [Input("temperature", "degC", "scalar")])
N, M = len(SPACE.inputs), len(SPACE.outputs)


def add_component(http: Any, name: str = "two_ends", *, linear: bool = False, **more: Any) -> None:
    """Add a component without rows, whose inputs lie within -1 and 1."""
    body = {"name": name, "title": name, "range": {"force": [1] * 3, "moment": [1] * 3}}
    assert http.post("/v1/components", json=body).status_code == 201
    library = http.app.state.workspace.library
    load_range: LoadRange = range_of(SPACE)
    tolerance = Tolerance(0.003, 0.003)
    whole = replace(
        library[name], load_range=load_range, linear=linear, tolerance=tolerance, **more
    )
    library._components = {**library._components, name: whole}
    library._version += 1


def add_link(http: Any, count: int = 40, name: str = "two_ends", **more: Any) -> None:
    """Add a component with rows of a smooth response; its table holds them on return."""
    add_component(http, name, **more)
    workspace = http.app.state.workspace
    if count:
        rows = solved(SPACE, spread_wrenches(range_of(SPACE), count))
        if more.get("linear"):
            straight = np.einsum("kmn,kn->km", rows.compliance, rows.wrench)
            rows = replace(rows, displacement=straight)
        add(workspace, name, rows)
    assert workspace.tables.catch_up(name, 600), workspace.tables.faults()


def add(workspace: Any, name: str, rows: Rows) -> None:
    """Add rows to the ledger as those of an import."""
    plain = Rows.of(
        rows.wrench,
        rows.displacement,
        rows.space,
        compliance=rows.compliance,
        source=["fea"] * len(rows),
    )
    block = NotedRows(plain, [""] * len(rows))
    workspace.ledger.import_rows(name, [block], ImportOrigin("rows.json", "json", "", "", ""))
