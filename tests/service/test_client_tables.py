"""The client's calls about tables, components and health, against a stub."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.cli.main import app
from service.client import Client, ProblemError
from service.client.library import table_format
from tests.service.stub_server import Answer, Stub, running_stub


@pytest.fixture
def stub() -> Iterator[Stub]:
    with running_stub() as running:
        yield running


@pytest.fixture
def client(stub: Stub) -> Iterator[Client]:
    with Client(stub.url, timeout=5.0) as made:
        yield made


def test_a_table_is_imported_from_a_file_a_text_or_bytes(stub: Stub, client, tmp_path: Path):
    stub.answers(Answer({"inserted": 1, "existing": 0, "errors": []}))
    text = "fx [N],ux [m]\n1,2\n"
    file = tmp_path / "table.csv"
    file.write_text(text)
    for table in (file, str(file), text, text.encode()):
        assert client.import_table("bar", table)["inserted"] == 1
    assert {seen.content for seen in stub.seen} == {text.encode()}
    assert {seen.path for seen in stub.seen} == {"/v1/components/bar/table?format=csv"}
    assert {seen.headers["Content-Type"] for seen in stub.seen} == {"text/csv; charset=utf-8"}
    client.import_table("bar", b"{}", format="json", dry_run=True)
    assert stub.seen[-1].path == "/v1/components/bar/table?format=json&dry_run=true"
    client.import_table("bar", text, decimal=",")
    assert stub.seen[-1].path == "/v1/components/bar/table?format=csv&decimal=%2C"
    with pytest.raises(ValueError, match="'xlsx' is no form of a table"):
        client.import_table("bar", text, format="xlsx")
    with pytest.raises(FileNotFoundError):
        client.import_table("bar", "no such file.csv")


def test_refused_rows_are_read_out_by_row_field_and_reason(stub: Stub, client: Client):
    rows = [{"row": n, "field": "ux [mm]", "message": "'x' is not a number"} for n in range(2, 9)]
    problem = {"title": "The table has mistakes", "detail": "Nothing was loaded.", "errors": rows}
    stub.answers(Answer(problem, status=422, kind="application/problem+json"))
    with pytest.raises(ProblemError) as caught:
        client.import_table("bar", "a\nb")
    assert "  row 2, ux [mm]: 'x' is not a number\n" in str(caught.value)
    assert str(caught.value).endswith("and 2 more")
    assert len(caught.value.errors) == 7


def test_a_table_is_exported_as_text_in_the_units_asked_for(stub: Stub, client: Client):
    stub.answers(Answer(b"fx [lbf]\n", kind="text/csv"))
    assert client.export_table("bar", units={"force": "lbf"}) == "fx [lbf]\n"
    assert stub.seen[0].path == "/v1/components/bar/table?format=csv&force=lbf"
    stub.answers(Answer(b"\x89HDF", kind="application/x-hdf5"))
    assert client.export_table("bar", "hdf5") == b"\x89HDF"


@pytest.mark.parametrize(
    ("name", "kind"), [("t.csv", "csv"), ("T.JSON", "json"), ("t.h5", "hdf5"), ("t.hdf5", "hdf5")]
)
def test_the_format_of_a_table_comes_from_its_ending(name: str, kind: str):
    assert table_format(name) == table_format(name, reading=True) == kind


@pytest.mark.parametrize("name", ["x.parquet", "x.xlsx", "x.tsv", "x", "-"])
def test_an_ending_that_is_no_tables_is_refused_with_those_there_are(name: str):
    with pytest.raises(ValueError, match=r"there are \.csv, \.json, \.h5, \.hdf5$"):
        table_format(name)


def test_a_file_of_unknown_ending_is_not_sent_as_csv(stub: Stub, client: Client, tmp_path: Path):
    file = tmp_path / "table.parquet"
    file.write_bytes(b"PAR1")
    with pytest.raises(ValueError, match=r"the ending \.parquet, which is no form of a table"):
        client.import_table("bar", file)
    assert stub.seen == []


def test_export_to_x_parquet_does_not_write_csv(stub: Stub, tmp_path: Path):
    target = tmp_path / "x.parquet"
    run = CliRunner().invoke(app, ["export", "bar", str(target), "--server", stub.url])
    assert run.exit_code == 1
    assert "there are .csv, .json, .h5, .hdf5" in str(run.exception)
    assert stub.seen == []
    assert list(tmp_path.iterdir()) == []


def test_export_to_x_h5_writes_the_bytes_that_came(stub: Stub, tmp_path: Path):
    stub.answers(Answer(b"\x89HDF\r\n", kind="application/x-hdf5"))
    target = tmp_path / "x.h5"
    run = CliRunner().invoke(app, ["export", "bar", str(target), "--server", stub.url])
    assert run.exit_code == 0, run.output
    assert target.read_bytes() == b"\x89HDF\r\n"
    assert stub.seen[0].path == "/v1/components/bar/table?format=hdf5"


def test_import_takes_the_format_from_the_ending_and_the_decimal_mark(stub: Stub, tmp_path: Path):
    reply = {"inserted": 1, "existing": 0, "errors": [], "dry_run": False, "in_use": False}
    stub.answers(Answer(reply))
    for name, kind in (("t.h5", "hdf5"), ("t.tsv", "csv")):
        file = tmp_path / name
        file.write_bytes(b"x")
        arguments = ["import", "bar", str(file), "--decimal", ",", "--server", stub.url]
        run = CliRunner().invoke(app, arguments)
        assert run.exit_code == 0, run.output
        assert stub.seen[-1].path == f"/v1/components/bar/table?format={kind}&decimal=%2C"
        assert "still builds its table" in run.output


def test_a_table_only_component_is_one_json_post(stub: Stub, client: Client):
    stub.answers(Answer({"name": "mount"}, status=201))
    body = {"name": "mount", "title": "M", "range": {"force": [1, 1, 1], "moment": [1, 1, 1]}}
    assert client.add_component(body)["name"] == "mount"
    assert (stub.seen[0].path, stub.seen[0].body) == ("/v1/components", body)


def test_a_bundle_folder_is_sent_as_a_zip_form(stub: Stub, client: Client, tmp_path: Path):
    folder = tmp_path / "plate"
    folder.mkdir()
    (folder / "component.toml").write_text('name = "plate"\n')
    (folder / "plate.msh").write_bytes(b"\x00\r\n--mesh")
    (folder / ".DS_Store").write_text("x")
    stub.answers(Answer({"name": "plate"}, status=201))
    client.add_component(folder)
    seen = stub.seen[0]
    boundary = seen.headers["Content-Type"].partition("boundary=")[2]
    head, _, rest = seen.content.partition(b"\r\n\r\n")
    assert head.startswith(f"--{boundary}\r\n".encode())
    assert b'name="bundle"; filename="plate.zip"' in head
    archive, _, tail = rest.rpartition(f"\r\n--{boundary}".encode())
    assert tail == b"--\r\n"
    with zipfile.ZipFile(io.BytesIO(archive)) as members:
        assert members.namelist() == ["component.toml", "plate.msh"]
        assert members.read("plate.msh") == b"\x00\r\n--mesh"


def test_a_folder_without_component_toml_is_refused_at_once(stub: Stub, client, tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"no component\.toml"):
        client.add_component(tmp_path)
    assert stub.seen == []


def test_health_reports_faults_and_readiness_is_a_yes_or_no(stub: Stub, client: Client):
    stub.answers(Answer({"status": "not ready", "faults": ["disk is full"]}, status=503))
    assert client.health()["faults"] == ["disk is full"]
    assert not client.is_ready()
    stub.answers(Answer({"status": "ready"}))
    assert client.is_ready()
    assert client.health() == {"status": "ready"}


def test_components_are_listed_and_shown(stub: Stub, client: Client):
    stub.respond = lambda seen: Answer(
        {"components": [{"name": "bar"}]} if seen.path == "/v1/components" else {"name": "bar"}
    )
    assert client.components() == [{"name": "bar"}]
    assert client.component("bar") == {"name": "bar"}


def test_a_row_is_taken_out_and_back_by_its_number(stub, client):
    stub.answers(Answer({}))
    client.invalidate_row("my plate", 17)
    client.restore_row("my plate", 17)
    assert [(seen.method, seen.path) for seen in stub.seen] == [
        ("DELETE", "/v1/components/my%20plate/table/17"),
        ("POST", "/v1/components/my%20plate/table/17/restore"),
    ]
