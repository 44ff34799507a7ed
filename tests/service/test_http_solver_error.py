"""What a real solver says of its own error reaches every bar, by cause, and downloaded tables."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.service.live import add_table, as_rows, full_wrenches, moved, served
from tests.service.test_runjob_evidence import BUNDLE
from wrenchbook.service.cli.render import answer_shown
from wrenchbook.service.client import Displacement
from wrenchbook.service.http.routes.components import component_body
from wrenchbook.service.jobs import solver
from wrenchbook.service.jobs.attempt import Attempt, prepare, read_outcome
from wrenchbook.service.ledger import Ledger, LedgerFullError
from wrenchbook.service.query import Query, answer
from wrenchbook.service.settings import Settings
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import read_table
from wrenchbook.surrogate.table.rows import Tolerance

WRENCH = [400.0, -30.0, 20.0, 5.0, -6.0, 7.0]
DETAIL = {"force": WRENCH[:3], "moment": WRENCH[3:], "detail": True}
TOLD = {"mesh": np.eye(6).tolist(), "loads": [1.0] * 6, "mesh_basis": "words"}
WHOLE = TOLD | {"mesh_stiffness": np.eye(6).tolist()}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """A server that has solved the shipped bar once, by its own finite elements."""
    with served(tmp_path_factory.mktemp("solved"), solvers=1) as client:
        assert "error_parts" not in json.loads(ask(client, "bar", DETAIL).content)
        client.solve("bar", WRENCH, wait_s=60)
        assert client.component("bar", wait_s=60)["rows"] >= 1
        yield client


def ask(client, name, body, call="displacement"):
    """Post a body without a job of its own, and return the reply as it comes."""
    content = json.dumps({**body, "on_thin": "estimate"}).encode()
    headers = {"Content-Type": "application/json"}
    return client.call("POST", f"/v1/components/{name}/{call}", content, headers=headers)


def told_of(client, **more):
    return json.loads(ask(client, "bar", {**DETAIL, **more}).content)


def six(bars):
    return np.array(bars["translation"] + bars["rotation"])


def test_a_bar_is_the_sum_of_its_parts_and_not_zero(client):
    reported = told_of(client)
    parts = reported["error_parts"]
    assert reported["coverage"] == "covered"
    assert (six(parts["mesh"]) > 0).all()
    assert (six(parts["linearity"]) > 0).all()
    total = sum(six(parts[cause]) for cause in ("table", "mesh", "linearity"))
    np.testing.assert_allclose(six(reported["error"]), total, rtol=1e-9)
    assert "coarser mesh" in parts["mesh_basis"]


def test_the_component_tells_it_at_full_range_with_its_buckling_factor(client):
    reported = client.component("bar")["solver_error"]
    assert 1e-6 < reported["mesh"][2] < 1e-4
    assert reported["buckling"] == pytest.approx(6.8, rel=0.05)
    assert reported["linearity"][2] > 1e-4


def test_copies_and_renames_keep_the_meshes_share(client):
    """The bar of u_z fell from 1.48e-4 to 1.06e-6 m in a copy."""
    own = told_of(client)
    post(client, "bar", "copy", {"name": "bar_copy"})
    post(client, "bar_copy", "rename", {"name": "bar_renamed"})
    for name in ("bar_copy", "bar_renamed"):
        reported = json.loads(ask(client, name, DETAIL).content)
        assert reported["error"] == own["error"]
        assert reported["error_parts"] == own["error_parts"]
        assert reported["within_tolerance"] == own["within_tolerance"]
        assert client.component(name)["solver_error"] == client.component("bar")["solver_error"]
    np.testing.assert_array_equal(
        client.download("bar_renamed").answer(WRENCH).error_vector, six(own["error"])
    )


def post(client, name, call, body):
    headers = {"Content-Type": "application/json"}
    content = json.dumps(body).encode()
    return client.call("POST", f"/v1/components/{name}/{call}", content, headers=headers)


def test_a_copy_is_not_seen_without_its_estimate_nor_made_if_that_cannot_be_written(
    tmp_path, monkeypatch
):
    workspace = Workspace(Settings(tmp_path, solvers=0))
    fingerprint = workspace.library["plate"].fingerprint
    workspace.errors.record("plate", fingerprint, WHOLE)
    seen = []

    def full_disk(*_):
        seen.append("second" in workspace.library)
        raise LedgerFullError("no space left")

    monkeypatch.setattr(workspace.ledger, "writing", full_disk)
    with pytest.raises(LedgerFullError):
        workspace.library.add_copy("plate", "second", None)
    assert seen == [False]
    assert "second" not in workspace.library
    monkeypatch.undo()
    assert workspace.library.add_copy("plate", "second", None).fingerprint == fingerprint
    assert workspace.errors.read("second", fingerprint).values == WHOLE
    workspace.close()


def test_a_copy_keeps_what_a_solve_has_told_since_the_check(tmp_path, monkeypatch):
    """The check's report is in the folder that is copied, and told of an older estimate."""
    workspace = Workspace(Settings(tmp_path, solvers=0))
    newer = WHOLE | {"mesh_basis": "newer"}
    workspace.errors.record("plate", workspace.library["plate"].fingerprint, newer)
    monkeypatch.setattr("wrenchbook.service.workspace.solver_error_of", lambda *_: WHOLE)
    created = workspace.library.add_copy("plate", "second", None)
    assert workspace.errors.read("second", created.fingerprint).values == newer
    workspace.close()


def test_a_component_without_a_tolerance_warns_of_buckling_in_its_range(tmp_path):
    workspace = Workspace(Settings(tmp_path, solvers=0))
    component = replace(workspace.library["plate"], tolerance=None)
    workspace.errors.record("plate", component.fingerprint, WHOLE | {"buckling": 0.5})
    warnings = component_body(workspace, component)["warnings"]
    assert any("the part buckles at 0.5" in warning["message"] for warning in warnings)
    workspace.close()


def test_a_component_that_was_never_solved_says_how_to_have_an_estimate(client):
    reported = client.component("plate")["solver_error"]
    assert reported["mesh"] is None
    assert "next solve" in reported["mesh_basis"]


def test_a_measured_table_has_no_mesh_part(client):
    wrenches = full_wrenches(30)
    add_table(client, "rig", as_rows(wrenches, moved(wrenches)))
    body = {"force": [1.0, 2.0, 3.0], "moment": [0.1, 0.2, 0.3], "detail": True}
    reported = json.loads(ask(client, "rig", body).content)
    assert reported["error_parts"].keys() == {"table"}
    assert client.component("rig")["solver_error"] is None


def test_an_attempt_estimates_only_if_it_is_asked_to(tmp_path, monkeypatch):
    from wrenchbook.fea.bundle.read import read_bundle

    monkeypatch.delenv(solver.SOLVE_VARIABLE, raising=False)
    bundle = tmp_path / "block"
    bundle.mkdir()
    (bundle / "component.toml").write_text(BUNDLE.format(height=0.1, across=2, poisson=0.3))
    fingerprint = read_bundle(bundle).fingerprint
    results = []
    for number, estimate in enumerate((False, True)):
        spec = Attempt(number, 1, "block", str(bundle), fingerprint, (1.0,) * 6, estimate)
        prepare(replace(spec, folder=tmp_path / str(number)))
        assert solver.run_attempt(tmp_path / str(number)) == solver.DONE
        results.append(read_outcome(replace(spec, folder=tmp_path / str(number), estimate=False)))
    assert results[0].solver_error is None
    assert np.shape(results[1].solver_error["mesh"]) == (6, 6)
    assert results[0].displacement == results[1].displacement


@pytest.fixture
def errors(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    yield SolverErrors(ledger)
    ledger.close()


def test_one_solve_at_a_time_estimates_and_another_one_if_that_told_nothing(errors):
    assert [errors.claim("bar", "f1"), errors.claim("bar", "f1")] == [True, False]
    errors.record("bar", "f1", None)
    assert errors.claim("bar", "f1")
    errors.record("bar", "f1", {"mesh": "nonsense"})
    assert errors.claim("bar", "f1")
    errors.record("bar", "f1", WHOLE)
    assert not errors.claim("bar", "f1")
    assert errors.claim("bar", "f2")


def test_an_estimate_that_no_row_can_make_grow_is_made_again(errors):
    errors.record("bar", "f1", TOLD)
    assert errors.claim("bar", "f1")
    for known in (WHOLE, TOLD | {"linearity": None}, TOLD | {"mesh": None}):
        errors.record("bar", "f1", known)
        assert not errors.claim("bar", "f1")


def test_a_damaged_estimate_is_as_none_and_is_made_again(errors):
    errors.record("bar", "f1", TOLD)
    with errors._ledger.writing() as db:
        db.execute("UPDATE solver_errors SET estimate = '[1, 2'")
    assert errors.read("bar", "f1") is None
    assert errors.claim("bar", "f1")


def test_a_covered_answer_whose_mesh_is_over_the_tolerance_says_so(client):
    reported = told_of(client, detail=False)
    assert reported["coverage"] == "covered"
    assert reported["within_tolerance"] is False
    wide = told_of(client, tolerance={"translation": 1.0, "rotation": 1.0})
    assert wide["within_tolerance"] is True
    solved = client.solve("bar", WRENCH, wait_s=60)
    assert (solved.coverage, solved.within_tolerance) == ("covered", False)
    assert (np.array(solved.error_vector) >= six(told_of(client)["error_parts"]["mesh"])).all()


def test_the_component_warns_once_of_what_more_rows_cannot_mend(client):
    warnings = [
        warning
        for warning in client.component("bar")["warnings"]
        if warning["where"] == "tolerance"
    ]
    assert len(warnings) == 2
    mesh, linearity = (warning["message"] for warning in warnings)
    assert "the mesh is too coarse" in mesh
    assert "cells about" in mesh
    assert "nonlinear = true" in linearity


@pytest.mark.parametrize(
    ("error", "mesh", "remedy"),
    [
        (1.3e-5, 6e-6, "so more rows help"),
        (1.3e-5, 1.1e-5, "more solves do not reduce"),
        (9e-6, 6e-6, ""),
    ],
)
def test_the_remedy_of_a_wide_error_bar_follows_from_the_sum_of_the_parts_besides_the_rows(
    error, mesh, remedy
):
    zeros = {"translation": [0.0] * 3, "rotation": [0.0] * 3}
    body = zeros | {
        "component": "bar",
        "coverage": "covered",
        "within_tolerance": False,
        "error": {"translation": [0.0, 0.0, error], "rotation": [0.0] * 3},
        "error_parts": {"table": {"translation": [0.0, 0.0, error - mesh], "rotation": [0.0] * 3}},
        "source": "table",
        "method": "kriging",
        "table_version": 9,
        "elapsed_us": 1.0,
    }
    shown = answer_shown(Displacement.read(body), "", {"translation": 1e-5, "rotation": 1e-5})
    notes = " ".join(str(line) for line in shown.renderables[2:])
    assert remedy in notes
    assert bool(notes) == bool(remedy)


def test_a_solve_whose_mesh_exceeds_the_tolerance_is_shown_with_the_remedy(client):
    tolerance = client.component("bar")["tolerance"]
    solved = client.solve("bar", WRENCH, wait_s=60)
    *_, notes = answer_shown(solved, "", tolerance).renderables
    assert "more solves do not reduce" in str(notes)


def test_nobody_is_told_that_a_bar_without_the_solvers_share_is_within_the_tolerance(
    client, tmp_path
):
    wide = {"translation": 1.0, "rotation": 1.0}
    assert client.displacement("bar", WRENCH, tolerance=wide).within_tolerance is True
    path = tmp_path / "bar.h5"
    path.write_bytes(client.export_table("bar", "hdf5"))
    rows, meta = read_table(path)
    query = Query(tuple(WRENCH), "estimate", 0.0, Tolerance(1.0, 1.0))
    for lost in (None, SolverError(TOLD | {"mesh": None})):
        table = build(rows, meta.load_range, linear=True, solver_error=lost)
        served = ServedTable(PackedTable.from_bytes(b"".join(pack(table))), built=table)
        result = answer(served, query)
        assert result.error is not None
        assert result.within_tolerance is None


def test_a_row_that_came_just_now_has_the_solvers_share_though_its_table_is_not_built(tmp_path):
    workspace = Workspace(Settings(tmp_path, solvers=0))
    plate, table = workspace.library["plate"], workspace.surrogate("plate")
    assert workspace.solver_error(plate, table) is None
    workspace.errors.record("plate", plate.fingerprint, TOLD)
    assert workspace.surrogate("plate").solver_error is None
    assert workspace.solver_error(plate, table).values == TOLD
    workspace.close()


def test_an_upload_estimates_so_that_the_first_answer_has_its_bar(client, tmp_path):
    folder = tmp_path / "block"
    folder.mkdir()
    text = BUNDLE.format(height=0.1, across=2, poisson=0.3)
    text = (
        text.replace('"block"', '"coarse"') + "[tolerance]\ntranslation = 1e-9\nrotation = 1e-9\n"
    )
    (folder / "component.toml").write_text(text)
    client.add_component(folder)
    about = client.component("coarse")
    assert about["solver_error"]["mesh"][0] > 0
    assert any("the mesh is too coarse" in warning["message"] for warning in about["warnings"])
    answer = client.solve("coarse", [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], wait_s=60)
    assert answer.error_vector[2] > 0
    assert answer.within_tolerance is False
