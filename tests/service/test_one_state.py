"""A reply is made from one state, whatever other threads change between two reads."""

import copy
import threading
from contextlib import contextmanager
from dataclasses import replace

import pytest
from starlette.testclient import TestClient

from tests.service.ledger_rows import claim, insert, new_rows
from tests.until import until
from wrenchbook.service.demand import DemandMaps
from wrenchbook.service.events import poll
from wrenchbook.service.fields.deformed import TooFarError
from wrenchbook.service.http.app import create_app
from wrenchbook.service.library.library import Library
from wrenchbook.service.recording.start import start_recording
from wrenchbook.service.report import queue
from wrenchbook.service.tables.coordinator_state import Status
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.solver_error import SolverError

RIG = "/v1/components/rig"
BAR = "/v1/components/bar"
PLATE = "/v1/components/plate_thin"
RANGE = {"force": [10.0] * 3, "moment": [10.0] * 3}
FORCE = {"force": [1.0, 0.0, 0.0], "moment": [0.0, 0.0, 0.0]}
WRENCH = [*FORCE["force"], *FORCE["moment"]]


@pytest.fixture
def http(folder, stand_in):
    """A server without solvers, with a table of measured rows."""
    with TestClient(create_app(Settings(folder, solvers=0))) as client:
        reply = client.post("/v1/components", json={"name": "rig", "title": "rig", "range": RANGE})
        assert reply.status_code == 201
        yield client


@pytest.fixture
def workspace(http):
    return http.app.state.workspace


def rows(count, first=0):
    return [
        {"wrench": list(row.wrench), "displacement": list(row.displacement)}
        for row in new_rows(count, first)
    ]


def load(http, count, first=0, **query):
    query |= {"wait_s": 60}  # the default may be too short on a busy machine
    reply = http.post(f"{RIG}/table", json={"rows": rows(count, first)}, params=query)
    assert reply.json()["in_use"]
    return reply.json()


def is_of_a_call():
    """Whether this thread answers a request or a test, and does not follow the ledger."""
    background = ("tables-", "build-", "watcher", "demand", "counts")
    return not threading.current_thread().name.startswith(background)


def in_turn(monkeypatch, place, name, values):
    """Let calls of a method return these values, the last one again and again."""
    remaining = list(values)
    was = getattr(place, name)

    def read(*arguments, **options):
        if not is_of_a_call():
            return was(*arguments, **options)
        return remaining.pop(0) if len(remaining) > 1 else remaining[0]

    monkeypatch.setattr(place, name, read)


def between(monkeypatch, event, *reads):
    """Let an event happen once, before the second of some reads: (object, name of a method)."""
    state = {"calls": 0}

    def patched(place, name):
        was = getattr(place, name)

        def read(*arguments, **options):
            state["calls"] += is_of_a_call()
            if state["calls"] == 2:
                event()
            return was(*arguments, **options)

        monkeypatch.setattr(place, name, read)

    for place, name in reads:
        patched(place, name)


def after(monkeypatch, place, name, event):
    """Let an event happen once, at the end of a call."""
    was = getattr(place, name)
    happened = []

    def call(*arguments, **options):
        result = was(*arguments, **options)
        if not happened:
            happened.append(True)
            event()
        return result

    monkeypatch.setattr(place, name, call)


def with_error(table, mesh):
    """The table with another estimate of the solver's error."""
    other = copy.copy(table)
    values = {"loads": [10.0] * 6, "mesh": [[mesh] * 6] * 6, "mesh_basis": "a test"}
    other.solver_error = SolverError(values)
    return other


# -- tables -----------------------------------------------------------------------------------


def test_the_solvers_error_of_a_component_is_that_of_its_table(http, workspace, monkeypatch):
    table = workspace.tables.surrogate("bar")
    first, second = with_error(table, 0.01), with_error(table, 0.02)
    in_turn(monkeypatch, workspace.tables, "surrogate", [first])
    expected = http.get(BAR).json()
    in_turn(monkeypatch, workspace.tables, "surrogate", [first, first, second])
    assert http.get(BAR).json()["solver_error"] == expected["solver_error"]


def test_a_deformed_surface_takes_the_solvers_error_of_its_table(http, workspace, monkeypatch):
    table = workspace.tables.surrogate("plate_thin")
    first, second = with_error(table, 0.01), with_error(table, 0.02)
    solvers = []

    def answer(component, rows, wrench, hyperparameters, solver, parts):
        solvers.append(solver)
        raise TooFarError("a test")

    monkeypatch.setattr(workspace.shapes, "answer", answer)
    in_turn(monkeypatch, workspace.tables, "surrogate", [first, first, second])
    assert http.get(f"{PLATE}/deformed").status_code == 409
    assert solvers == [first.solver_error]


def test_a_row_that_no_table_has_takes_the_solvers_error_of_one_table(http, workspace, monkeypatch):
    solved = new_rows(1, first=1)
    fingerprint = workspace.library["plate_thin"].fingerprint
    table = workspace.tables.surrogate("plate_thin")
    first, second = with_error(table, 0.01), with_error(table, 0.02)
    body = {**FORCE, "on_thin": "queue", "detail": True}

    in_turn(monkeypatch, workspace.tables, "surrogate", [first])
    in_turn(monkeypatch, workspace.tables, "progress", [lambda: None])
    insert(
        workspace.ledger,
        "plate_thin",
        fingerprint,
        [replace(row, source="fea", compliance=[[1e-6] * 6] * 6) for row in solved],
    )
    expected = http.post(f"{PLATE}/displacement", json=body).json()
    assert expected["row"] == 1
    in_turn(monkeypatch, workspace.tables, "surrogate", [first, first, second])
    assert http.post(f"{PLATE}/displacement", json=body).json()["error"] == expected["error"]


def test_readiness_and_its_reasons_are_read_once(http, workspace, monkeypatch):
    for reasons in ([{}, {"bar": "damaged"}], [{"bar": "damaged"}, {}]):
        in_turn(monkeypatch, workspace, "broken", reasons)
        body = http.get("/health/ready").json()
        assert ("bar" in body["broken"]) == (body["tables"]["bar"] == "degraded")


def test_a_table_that_is_mapped_between_two_reads_is_building_or_ready(
    http, workspace, monkeypatch
):
    present = workspace.tables.present()
    before = {name: table for name, table in present.items() if name != "rig"}
    in_turn(monkeypatch, workspace.tables, "present", [before, present])
    body = http.get("/health/ready").json()
    assert body["tables"]["rig"] == "building"
    assert body["building"] == ["rig"]


def test_a_table_that_is_built_meanwhile_is_not_one_that_cannot_be_built(workspace, monkeypatch):
    insert(workspace.ledger, "rig", "", new_rows(1))
    goal = workspace.ledger.last_seq("rig")
    tables = workspace.tables
    empty = tables.surrogate("bar")  # of an earlier version
    states = [Status(faults={"rig": "a full disk"}, failed={"rig": goal - 1})]
    states += [Status(faults={}, failed={"rig": goal})]

    class Changing(type(tables)):
        _status = property(
            lambda _: states.pop(0) if len(states) > 1 else states[0], lambda *_: None
        )

    monkeypatch.setattr(tables, "__class__", Changing)
    progress = tables.progress("rig")
    monkeypatch.setattr(tables, "_tables", {"rig": empty})
    assert progress() is None


# -- the library ------------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["/v1/components", "/v1/jobs", "/health/ready"])
def test_a_component_that_is_removed_between_two_reads_fails_no_list(
    http, workspace, monkeypatch, call
):
    fingerprint = workspace.library["plate_thin"].fingerprint
    workspace.ledger.accept("plate_thin", fingerprint, WRENCH)
    find = Library._find
    finds = []

    def found_once(self, name):
        if name != "plate_thin" or not is_of_a_call():
            return find(self, name)
        finds.append(name)
        return find(self, name) if len(finds) == 1 else None

    monkeypatch.setattr(Library, "_find", found_once)
    assert http.get(call).status_code == 200


# -- the ledger -------------------------------------------------------------------------------


def test_the_version_of_an_import_is_not_that_of_a_later_row(http, workspace, monkeypatch):
    was = workspace.caught_up

    async def then_another(name, seconds):
        result = await was(name, seconds)
        insert(workspace.ledger, "rig", "", new_rows(1, first=50))
        return result

    monkeypatch.setattr(workspace, "caught_up", then_another)
    before = workspace.ledger.last_seq("rig")
    reply = load(http, 3)
    assert (reply["in_use"], reply["table_version"]) == (True, before + 3)


def test_the_version_of_a_withdrawal_is_not_that_of_a_later_row(http, workspace, monkeypatch):
    number = load(http, 3)["import"]
    later = lambda: insert(workspace.ledger, "rig", "", new_rows(1, first=50))  # noqa: E731
    after(monkeypatch, workspace.tables, "catch_up", later)
    before = workspace.ledger.last_seq("rig")
    reply = http.delete(f"{RIG}/imports/{number}").json()
    assert (reply["current"], reply["table_version"]) == (True, before + 3)


def test_rows_and_version_of_an_import_are_of_one_state(http, workspace, monkeypatch):
    """Rows appended between two reads gave their version to an import without them."""
    before = load(http, 2, append="run")["table_version"]
    reading = workspace.ledger.reading
    reads = []

    @contextmanager
    def then_append():
        with reading() as db:
            yield db
        if is_of_a_call() and not reads:
            reads.append(True)
            load(http, 2, first=20, append="run")

    monkeypatch.setattr(workspace.ledger, "reading", then_append)
    (listed,) = http.get(f"{RIG}/imports").json()["imports"]
    assert (listed["rows"], listed["table_version"]) == (2, before)


def test_a_widened_envelope_counts_what_its_reply_has(http, monkeypatch):
    store = http.app.state.recording_store
    other = [[5.0] * 6] * 3

    def widen():
        assert http.post(f"{PLATE}/envelope", json={"wrenches": other}).status_code == 200

    after(monkeypatch, store, "widen", widen)
    reply = http.post(f"{PLATE}/envelope", json={"wrenches": [[1.0] * 6]}).json()
    assert (reply["count"], reply["max"]) == (1, [1.0] * 6)


def test_a_damaged_row_that_is_found_meanwhile_fails_no_health_check(http, workspace):
    """The dictionary changed its size while it was read."""

    class Finding(int):
        def __format__(self, spec):
            workspace.ledger.damaged[len(workspace.ledger.damaged)] = "rig"
            return super().__format__(spec)

    workspace.ledger.damaged[Finding(7)] = "rig"
    assert "row 7 is damaged" in http.get("/health/ready").json()["broken"]["rig"]


def test_statistics_that_another_scrape_drops_leave_no_metrics_of_half_a_ledger(http):
    metrics = http.app.state.metrics

    class Dropping:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            metrics._read = None

    metrics._lock = Dropping()
    text = http.get("/metrics").text
    assert "wrenchbook_ledger_usable 1.0" in text
    assert "wrenchbook_ledger_bytes" in text


# -- jobs -------------------------------------------------------------------------------------


def test_a_job_that_ends_after_the_first_poll_is_an_event(workspace, monkeypatch):
    """It was accepted between two reads of that poll, and no listener heard of its end."""
    accepted = []
    fingerprint = workspace.library["plate_thin"].fingerprint

    def accept():
        accepted.append(workspace.ledger.accept("plate_thin", fingerprint, WRENCH)[0])

    ledger = workspace.ledger
    between(monkeypatch, accept, (ledger, "jobs"), (ledger, "unfinished"))
    state, _ = poll(workspace, None)
    job = claim(ledger, "test")
    assert job is not None
    assert job.id == accepted[0].id
    ledger.cancel(job.id)
    _, notices = poll(workspace, state)
    told = [body for kind, _, body in notices if kind == "job"]
    assert [(body["id"], body["status"]) for body in told] == [(job.id, "cancelled")]


def test_a_query_over_the_limit_names_the_limit_though_jobs_end_meanwhile(
    http, workspace, monkeypatch
):
    """It named the caller's quota."""
    workspace.submission.queue_limit = 1
    body = {**FORCE, "on_thin": "queue"}
    assert http.post(f"{PLATE}/displacement", json=body).json()["job"]
    end = lambda: workspace.ledger.cancel_many(None, "waiting")  # noqa: E731
    after(monkeypatch, workspace.submission, "queue", end)
    far = {"force": [-900.0, 0.0, 0.0], "moment": [0.0, 0.0, 0.0], "on_thin": "queue"}
    reply = http.post(f"{PLATE}/displacement", json=far).json()
    assert reply["job"] is None
    assert "1 jobs of queries are open" in reply["reason"]


def test_a_linear_component_that_is_solved_at_once_has_no_failed_solves(
    http, workspace, monkeypatch
):
    store = http.app.state.recording_store
    assert http.post(f"{BAR}/recording", json={"wrenches": [WRENCH]}).status_code == 201

    def solve():
        while job := claim(workspace.ledger, "test"):
            compliance = [[1e-6 * (row == column) for column in range(6)] for row in range(6)]
            moved = [1e-6 * load for load in job.wrench]
            workspace.ledger.commit(job.id, job.attempt, moved, compliance=compliance)

    after(monkeypatch, workspace, "fill", solve)
    started = start_recording(workspace, "bar", store, budget=5, beyond_range=False)
    assert "failed" not in started.reason
    assert {job.status for job in started.jobs} == {"done"}


# -- files and counts -------------------------------------------------------------------------


def test_a_report_that_ends_between_two_reads_is_shown(http, workspace, monkeypatch):
    """It was "No report yet"."""
    folder = workspace.settings.data / "reports" / "bar"
    folder.mkdir(parents=True)

    def end():
        (folder / "order.json").write_text("{}")
        (folder / "report.json").write_text('{"made": "now"}')

    reports = workspace.reports
    between(monkeypatch, end, (reports, "file"), (reports, "state"))
    assert http.get(f"{BAR}/report").json() == {"made": "now"}


def test_a_report_is_of_the_rows_that_its_order_has_waited_for(http, workspace, monkeypatch):
    """It read the table's file of before, to which rows are written a second later."""
    component = workspace.library["plate_thin"]
    solved = [replace(row, source="fea", compliance=[[1e-6] * 6] * 6) for row in new_rows(2, 1)]
    insert(workspace.ledger, component.name, component.fingerprint, solved[:1])
    until(lambda: workspace.tables.written(component.name))
    insert(workspace.ledger, component.name, component.fingerprint, solved[1:])
    versions = []

    def make(component, *_):
        versions.append(workspace.tables.written_version(component))
        return False

    monkeypatch.setattr(workspace.reports, "make", make)
    assert http.post(f"{PLATE}/report").status_code == 200
    assert versions == [workspace.ledger.last_seq(component.name)]


def test_the_state_of_a_report_is_not_that_of_one_begun_meanwhile(workspace, monkeypatch):
    """It was a failed one: the order was newer than the report."""
    folder = workspace.settings.data / "reports" / "bar"
    folder.mkdir(parents=True)
    (folder / "order.json").write_text("{}")
    (folder / "report.json").write_text("{}")
    read = queue._read

    def begin_first(path):
        if workspace.reports._lock.acquire(blocking=False):  # as `make` does
            (folder / "report.json").unlink()
            workspace.reports._lock.release()
        return read(path)

    monkeypatch.setattr(queue, "_read", begin_first)
    assert workspace.reports.state("bar").state == "done"


@pytest.mark.parametrize("call", ["map_of", "forget"])
def test_queries_whose_counts_are_being_saved_are_on_the_map_and_forgotten(
    workspace, monkeypatch, call
):
    load_range = workspace.library["rig"].load_range
    counts = DemandMaps(workspace.ledger)
    counts.note("rig", load_range, tuple(WRENCH), "thin")
    writing = workspace.ledger.writing
    begun, may_end = threading.Event(), threading.Event()

    @contextmanager
    def held(**options):
        if threading.current_thread() is saver:
            begun.set()
            assert may_end.wait(600)
        with writing(**options) as db:
            yield db

    monkeypatch.setattr(workspace.ledger, "writing", held)
    saver = threading.Thread(target=counts.save)
    saver.start()
    assert begun.wait(600)
    arguments = ("rig", load_range) if call == "map_of" else ("rig",)
    asked = []
    reader = threading.Thread(target=lambda: asked.append(getattr(counts, call)(*arguments)))
    reader.start()
    reader.join(0.2)  # a reader that does not wait for the saver has ended by then
    may_end.set()
    for thread in (saver, reader):
        thread.join(600)
    result = asked[0] if call == "map_of" else counts.map_of("rig", load_range)
    assert result.asked == (1 if call == "map_of" else 0)
