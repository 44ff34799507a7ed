"""How much faster than real time a MuJoCo loop with a mount runs: 1 kHz physics, 5 ms sync.

A server in a process of its own, its table over HTTP and downloaded, by each method. Beside each
wall time stands that of the physics alone in the same round, so that a noisy machine slows both.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any

import mujoco as _mujoco
import numpy as np
import pytest

import wrenchbook
from tests.acceptance.conftest import RealServer
from tests.service.live import add_rows, as_rows, clean_wrenches

mujoco: Any = _mujoco
ARM = Path(__file__).parents[2] / "data" / "scenes" / "arm.xml"
# Short rounds, many of them: on a busy machine the best is one that nobody interrupted.
SECONDS, ROUNDS, SYNC = 0.1, 60, 0.005
FULL = np.array([500.0] * 3 + [200.0] * 3)  # N and N·m
AT_LEAST = {"http": 10.0, "table": 50.0}  # times real time


def respond(wrenches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A made-up stiffening response, (n, 6), m and rad, and its derivative, (n, 6, 6)."""
    loads = wrenches / FULL
    slopes = np.einsum("ni,ij->nij", 1e-4 / np.cosh(loads) ** 2, np.diag(1 / FULL))
    return 1e-4 * np.tanh(loads), slopes


def fill(client: Any) -> None:
    """A linear table, one for griddata and one for kriging."""
    span = {"force": FULL[:3].tolist(), "moment": FULL[3:].tolist()}
    client.add_component({"name": "griddata", "title": "clean rows", "range": span})
    client.add_component({"name": "kriging", "title": "solved rows", "range": span})
    clean = clean_wrenches() / np.abs(clean_wrenches()).max(axis=0) * FULL
    add_rows(client, "griddata", as_rows(clean, respond(clean)[0]))
    full = np.random.default_rng(1).uniform(-1, 1, (60, 6)) * FULL
    add_rows(client, "kriging", as_rows(full, *respond(full)))
    one, compliance = np.full((1, 6), 1.0), np.diag(1e-4 / FULL)
    add_rows(client, "bar", as_rows(one, one @ compliance, compliance[None]))


def physics() -> tuple[Any, Any]:
    model = mujoco.MjModel.from_xml_path(str(ARM))
    data = mujoco.MjData(model)
    data.ctrl[:] = [0.0, 0.4, 0.8, 0.0, 0.5, 0.0]
    return model, data


def seconds_of(mount: Any, model: Any, data: Any) -> float:
    """Wall time of a simulated round, s."""
    started = time.perf_counter()
    for _ in range(round(SECONDS / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if mount is not None:
            mount.step()
    return time.perf_counter() - started


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory):
    server = RealServer(tmp_path_factory.mktemp("bench") / "workspace")
    created = server.start(solvers=0)
    fill(created)
    yield created
    server.stop()


@pytest.mark.parametrize("method", ["bar", "griddata", "kriging"])
@pytest.mark.filterwarnings("ignore::wrenchbook.MountWarning")
def test_a_loop_is_faster_than_real_time(client: Any, method: str) -> None:
    sources = {"http": client, "table": client.download(method)}
    loops: dict[str, tuple] = {"physics alone": (None, *physics())}
    for name, source in sources.items():
        model, data = physics()
        mount = wrenchbook.MujocoMount(
            model, data, source=source, component=method, sync=SYNC, on_thin="estimate"
        )
        loops[name] = (mount, model, data)
    for loop in loops.values():
        seconds_of(*loop)  # compiled, connected, at rest
    spent = {name: [] for name in loops}
    for _ in range(ROUNDS):
        for name, loop in loops.items():
            spent[name].append(seconds_of(*loop))
    for name, results in spent.items():
        best, middle = SECONDS / min(results), SECONDS / statistics.median(results)
        goal = f", at least {AT_LEAST[name]:g} asked" if name in AT_LEAST else ""
        print(
            f"\n{method:>9} {name:>14}: {best:6.1f} x real time (median {middle:.1f}{goal})", end=""
        )
    print()
    assert loops["http"][0].mount.coverage.answers == round((ROUNDS + 1) * SECONDS / SYNC)
    assert SECONDS / min(spent["http"]) > 1.0  # printed, not asserted: the machine is shared
