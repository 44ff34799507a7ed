"""A data directory with a table of every kind, all of them imported by the public interface."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from tests.fea.two_interfaces import rod_between_loads
from tests.service.live import FULL, add_rows, add_table, as_rows, full_wrenches, moved, tangents
from tests.service.spaces import SPACE
from tests.service.test_http_weight import BUNDLE as HANGING
from tests.service.test_http_weight import HANGS
from tests.service.test_runjob_evidence import BUNDLE
from tests.surrogate.energies import PARTS, part
from tests.surrogate.kernel.kinds import clean, grid
from tests.surrogate.responses import HIGH
from tests.surrogate.softening import SOFT, column
from tests.surrogate.test_space import range_of, solved
from wrenchbook.service.client import Client
from wrenchbook.service.settings import Settings
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.table.spread import spread_wrenches

Rows = list[dict[str, Any]]
LIMIT = {"translation": 1e-5, "rotation": 1e-5}  # m, rad
GUIDED = [2, 5]  # F_z and M_z: the loads of `spring` that are not on locked freedoms
SOFTNESS = np.array([1e-3, 2.0])  # m/N, rad/(N·m)


def tables() -> dict[str, tuple[Rows, dict[str, Any]]]:
    """Rows of tables that have no finite elements, and what else the component is given."""
    mixed = np.concatenate((clean(15), full_wrenches(20)))
    near = np.concatenate((mixed, full_wrenches(3) + 1e-8 * FULL, mixed[-6:]))
    rigs = np.array(["rig"] * len(mixed) + ["other rig"] * 9)
    solved, few = full_wrenches(20), full_wrenches(5)
    beyond = np.concatenate((clean(20), 3 * full_wrenches(4)))
    partial = moved(mixed)
    partial[:, 4], partial[20:, 2] = np.nan, np.nan
    rig = np.concatenate((clean(8), full_wrenches(12)))
    doubt = 1e-6 * np.abs(np.random.default_rng(5).normal(size=(len(rig), 6)))
    doubt[:, 5] *= 100
    part_rows = part(PARTS["stiffening"], 1).rows(np.random.default_rng(2).uniform(-1, 1, (20, 6)))
    curved = as_rows(part_rows.wrench, part_rows.displacement, part_rows.compliance)
    told(curved[:12], curvature=part_rows.curvature[:12])
    return {
        "curved": (curved, {"range": by_parts(1.1 * HIGH)}),
        "clean": (as_rows(clean(40), moved(clean(40))), {}),
        "clean_and_full": (as_rows(mixed, moved(mixed)), {"tolerance": LIMIT}),
        "full": (as_rows(full_wrenches(40), moved(full_wrenches(40))), {}),
        "kriging": (as_rows(solved, moved(solved), tangents(solved)), {"tolerance": LIMIT}),
        "few_with_tangents": (as_rows(few, moved(few), tangents(few)), {}),
        "measured": (told(as_rows(rig, moved(rig) + 3e-5), uncertainty=doubt), {}),
        "near_each_other": (told(as_rows(near, moved(near)), source=rigs), {}),
        "partial": (as_rows(mixed, partial), {"tolerance": LIMIT}),
        "thin": (as_rows(clean(4), moved(clean(4))), {}),
        "planar": (as_rows(grid((2, 3), 5), moved(grid((2, 3), 5))), {}),
        "one_row": (as_rows(few[:1], moved(few[:1])), {}),
        "beyond": (as_rows(beyond, moved(beyond)), {}),
    }


def by_parts(loads: np.ndarray) -> dict[str, list[float]]:
    """Loads (6,), N and N·m, as a range of the API."""
    return {"force": loads[:3].tolist(), "moment": loads[3:].tolist()}


def told(rows: Rows, **columns: Any) -> Rows:
    """Rows with more columns: a value for all of them, or an array with a line for each."""
    for name, values in columns.items():
        for place, row in enumerate(rows):
            row[name] = values[place].tolist() if isinstance(values, np.ndarray) else values
    return rows


SOLVED = ("bar", "bar_unknown", "spring", "softening", "hanging", "rod")
"""Those of components with finite elements.

They are linear, known in part, guided, growing soft, under their own weight, and of two interfaces
and a temperature.
"""
SAG = np.array([0, 0, -1e-5, 0, 2e-5, 0])  # m and rad
KINDS = (*tables(), *SOLVED, "nothing")


def prepare(folder: Path) -> None:
    """Write what no import brings: a bundle that softens, and what solvers say of their errors."""
    bundle = folder / "components" / "softening"
    bundle.mkdir(parents=True)
    text = BUNDLE.format(height=0.1, across=2, poisson=0.3).replace('"block"', '"softening"')
    (bundle / "component.toml").write_text(text)
    for name in ("hanging", "rod"):
        (folder / "components" / name).mkdir()
    hangs = HANGING.format(name="hanging", nonlinear="false", **HANGS)
    (folder / "components" / "hanging" / "component.toml").write_text(hangs)
    rod = rod_between_loads(folder / "components" / "rod") / "component.toml"
    text = rod.read_text().replace("nonlinear = false", "nonlinear = true")
    text = text.replace("density", "thermal_expansion = 23e-6\ndensity", 1)
    rod.write_text(text + "[inputs.temperature]\nrange = [0, 120]\nreference = 20\n")
    workspace = Workspace(Settings(folder, solvers=0))
    loads = {name: workspace.library[name].load_range.scale.tolist() for name in SOLVED[::2]}
    linear = {"mesh": (1e-9 * np.eye(6)).tolist(), "linearity": [1e-7] * 6, "loads": loads["bar"]}
    bending = np.random.default_rng(8).normal(size=(6, 6, 6)) / np.outer(loads["bar"], loads["bar"])
    linear["second_derivatives"] = (1e-7 * (bending + bending.swapaxes(1, 2))).tolist()
    linear["linearity_remainder"] = [1e-8] * 6
    linear["linearity_saturation"] = [2.0] * 6
    short, stiffer = np.zeros((6, 6)), np.zeros((6, 6))
    short[GUIDED, GUIDED], stiffer[GUIDED, GUIDED] = 1e-2 * SOFTNESS, 1e-2 / SOFTNESS
    guided = {"mesh": short.tolist(), "mesh_stiffness": stiffer.tolist(), "loads": loads["spring"]}
    for name, error in (("bar", linear), ("spring", guided), ("softening", SOFT)):
        workspace.errors.record(name, workspace.library[name].fingerprint, error)
    workspace.close()


def load(client: Client) -> None:
    """Import all tables."""
    with ThreadPoolExecutor(3) as pool:
        created = [pool.submit(_add, client, name, *one) for name, one in tables().items()]
    for one in created:
        one.result()
    reach = {"force": [100.0] * 3, "moment": [10.0] * 3}
    client.add_component({"name": "nothing", "title": "Without rows", "range": reach})
    client.call_json("POST", "/v1/components/bar/copy", {"name": "bar_unknown", "rows": False})
    ranges = client.component("bar")["range"]
    loads = np.array([high for _, high in ranges["force"] + ranges["moment"]])
    compliance = np.random.default_rng(3).normal(size=(6, 6)) * 1e-6 / loads
    unit = np.diag(loads)
    _add_solved(client, "bar", as_rows(unit, unit @ compliance.T))
    _add_solved(client, "bar_unknown", as_rows(unit[:4], unit[:4] @ compliance.T))
    guided = full_wrenches(20, 3) / FULL * [0, 0, 2.0, 0, 0, 0.01]
    reached, slopes = np.zeros((20, 6)), np.zeros((20, 6, 6))
    pushed = guided[:, GUIDED]
    reached[:, GUIDED] = SOFTNESS * (pushed + 0.02 * pushed**2)
    slopes[:, GUIDED, GUIDED] = SOFTNESS * (1 + 0.04 * pushed)
    _add_solved(client, "spring", as_rows(guided, reached, slopes))
    soft = column(np.linspace(0.0, 0.85, 18))
    _add_solved(client, "softening", as_rows(soft.wrench, soft.displacement, soft.compliance))
    C = compliance[None]
    _add_solved(client, "hanging", as_rows(np.zeros((1, 6)), SAG[None], 1e-4 * C))
    _add_solved(client, "rod", rod_rows())
    client.call("DELETE", "/v1/jobs")  # of linear components, which are solved once they are there


def rod_rows() -> Rows:
    """Rows of a smooth response of two interfaces and a temperature."""
    span = np.array([20, 20, 5000, 5, 5, 5] * 2 + [60.0])
    asked = spread_wrenches(range_of(SPACE), 40)
    rows = solved(SPACE, asked)
    hot = np.array([0.0] * 12 + [60.0])
    return as_rows(asked * span + hot, 1e-2 * rows.displacement, 1e-2 * rows.compliance / span)


def _add(client: Client, name: str, rows: Rows, about: dict[str, Any]) -> None:
    add_table(client, name, rows, **about)


def _add_solved(client: Client, name: str, rows: Rows) -> None:
    """Import rows as an export of another server's solves has them."""
    fingerprint = client.component(name)["fingerprint"]
    add_rows(client, name, told(rows, source="fea", fingerprint=fingerprint))
