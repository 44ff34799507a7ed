"""A fill of 60 on `plate_thin`: a fresh process a solve, as in version 0.1, and living solvers.

The same 60 wrenches, designed once, through ledger, dispatcher and engine on as many solvers as
there are cores; the rows must be the same to the last digit. Processor time is that of the solver
processes, from their first instruction to their end: it holds on a busy machine too.

    make bench NAME=solvers
"""

import resource
import time

import pytest

from tests.building import BuildingWorkspace
from tests.service.ledger_rows import stored
from wrenchbook.service.files.program import usable_cores
from wrenchbook.service.jobs.dispatcher import Dispatcher
from wrenchbook.service.jobs.solver_pool import LocalEngine
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.table.rows import Tolerance

COMPONENT, BUDGET = "plate_thin", 60
TIGHT = Tolerance(1e-9, 1e-9)  # m, rad: no round is the last one before all 60 are asked for


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """The bundle's folder, its fingerprint and the wrenches of a fill of 60, round by round."""
    workspace = BuildingWorkspace(Settings(tmp_path_factory.mktemp("workspace")))
    workspace.start()
    try:
        component = workspace.library[COMPONENT]
        while (left := BUDGET - len(stored(workspace.ledger, COMPONENT))) > 0:
            workspace.fill(COMPONENT, left, TIGHT)
            wait_for_all(workspace.ledger, 600)
        wrenches = [row.wrench for row in stored(workspace.ledger, COMPONENT)]
        return component.folder, component.fingerprint, wrenches
    finally:
        workspace.close()


def wait_for_all(ledger, seconds):
    deadline = time.monotonic() + seconds
    while (counts := ledger.counts())["waiting"] + counts["running"]:
        assert not counts["failed"], [job.error for job in ledger.jobs(status="failed")]
        assert time.monotonic() < deadline, counts
        time.sleep(0.1)


def solved(asked, folder, max_attempts):
    """Solve them; rows, jobs a minute, and the solvers' processor seconds a job."""
    bundle, fingerprint, wrenches = asked
    ledger = Ledger(folder / "ledger.sqlite")
    ledger.accept_many(COMPONENT, fingerprint, wrenches)
    options = {} if max_attempts is None else {"max_attempts": max_attempts}
    engine = LocalEngine(**options)
    dispatcher = Dispatcher(ledger, engine, lambda name: bundle, folder / "jobs")
    before, started = _children(), time.monotonic()
    dispatcher.start()
    try:
        wait_for_all(ledger, 600)
        seconds = time.monotonic() - started
    finally:
        dispatcher.stop()
        engine.close()
    _until_reaped(engine)
    rows = {row.wrench: (row.displacement, row.compliance) for row in stored(ledger, COMPONENT)}
    ledger.close()
    return rows, 60 * len(wrenches) / seconds, (_children() - before) / len(wrenches)


def _children():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _until_reaped(engine):
    deadline = time.monotonic() + 30
    while engine.solvers:
        assert time.monotonic() < deadline, "solvers did not end"
        time.sleep(0.01)


@pytest.mark.timeout(1200)
def test_solvers_that_live_give_the_same_rows_at_twice_the_rate(asked, tmp_path, monkeypatch):
    monkeypatch.delenv("WRENCHBOOK_SOLVE", raising=False)
    fresh, fresh_rate, fresh_used = solved(asked, tmp_path / "fresh", max_attempts=1)
    warm, warm_rate, warm_used = solved(asked, tmp_path / "warm", max_attempts=None)
    lines = (
        ("a fresh process each", fresh_rate, fresh_used),
        ("solvers that live", warm_rate, warm_used),
    )
    print(f"\n{len(asked[2])} solves of {COMPONENT} by {usable_cores()} solvers")
    print(f"{'':22}{'solves/min':>12}{'processor s a solve':>22}{'solves a core-minute':>22}")
    for name, rate, used in lines:
        print(f"{name:22}{rate:12.0f}{used:22.2f}{60 / used:22.0f}")
    print(f"{'times':22}{warm_rate / fresh_rate:12.2f}{fresh_used / warm_used:22.2f}")
    assert len(fresh) == len(asked[2])
    assert warm == fresh, "rows differ"
    assert fresh_used / warm_used >= 2
