"""The client's calls about tables, components and health, against a stub."""

from __future__ import annotations

import json
import os
from pathlib import Path
from urllib.parse import parse_qsl

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.service.stub_server import Answer, Stub
from wrenchbook.service.cli.main import app
from wrenchbook.service.client import Client, InvalidArgument, ProblemError
from wrenchbook.service.client.library import table_format


def test_a_table_is_imported_from_a_file_a_text_or_bytes(stub: Stub, client, tmp_path: Path):
    stub.answers(Answer({"inserted": 1, "existing": 0, "errors": []}))
    text = "fx [N],ux [m]\n1,2\n"
    file = tmp_path / "table.csv"
    file.write_text(text)
    for table in (file, str(file), text, text.encode()):
        assert client.import_table("bar", table)["inserted"] == 1
    assert {seen.content for seen in stub.seen} == {text.encode()}
    path = "/v1/components/bar/table"
    assert {seen.path for seen in stub.seen} == {path, f"{path}?filename=table.csv"}
    assert {seen.headers["Content-Type"] for seen in stub.seen} == {"application/octet-stream"}
    client.import_table("bar", b"{}", format="json", dry_run=True)
    assert stub.seen[-1].path == f"{path}?format=json&dry_run=true"
    client.import_table("bar", text, decimal=",", ignore=["a", "b"], missing_loads="zero")
    asked = f"{path}?decimal=%2C&ignore=a&ignore=b&missing_loads=zero"
    assert stub.seen[-1].path == asked
    with pytest.raises(ValueError, match="not 'png'"):
        client.import_table("bar", text, format="png")
    with pytest.raises(FileNotFoundError):
        client.import_table("bar", "no such file.csv")


@pytest.mark.parametrize("kind", ["lvm", "tdms", "xls", "mat"])
def test_a_format_that_the_server_reads_is_sent(stub: Stub, client: Client, kind: str):
    stub.answers(Answer({}))
    client.import_table("bar", b"content", format=kind)
    assert stub.seen[-1].path == f"/v1/components/bar/table?format={kind}"


@pytest.mark.parametrize("kind", ["packed", "bushing"])
def test_a_format_that_is_only_exported_is_not_sent(stub: Stub, client: Client, kind: str):
    with pytest.raises(InvalidArgument, match=f"not '{kind}'"):
        client.import_table("bar", b"content", format=kind)


def test_rows_of_numpy_are_appended_as_lists(stub: Stub, client: Client):
    stub.answers(Answer({}))
    row = {"wrench": np.arange(6.0), "displacement": np.zeros(6), "note": "first"}
    client.append("bar", "run 17", row)
    assert stub.seen[-1].body["rows"][0]["wrench"] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_a_row_that_json_cannot_have_is_not_sent(stub: Stub, client: Client):
    with pytest.raises(InvalidArgument, match="no JSON value; give numbers and texts"):
        client.append("bar", "run 17", {"fz [N]": 1j})


MISTAKE = {"row": 2, "field": "ux [mm]", "message": "'x' is not a number"}


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({}, r"  row 2, ux \[mm\]: 'x' is not a number\n(.*\n)*.*and 2 more$"),
        (
            {"causes": [{**MISTAKE, "count": 295, "rows": [2, 3]}]},
            r"rows 2, 3, ux \[mm\]: 'x' is not a number \(295 mistakes\)$",
        ),
        (
            {
                "causes": [
                    {
                        "row": 1,
                        "message": "is not a known column.",
                        "fields": ["A", "B"],
                        "count": 2,
                    }
                ]
            },
            r"row 1, A, B: are not known columns. \(2 mistakes\)$",
        ),
    ],
)
def test_refused_rows_are_read_out_by_row_field_and_reason(stub: Stub, client: Client, more, says):
    rows = [{**MISTAKE, "row": row} for row in range(2, 9)]
    problem = {"title": "The table has mistakes", "detail": "Nothing was loaded", "errors": rows}
    stub.answers(Answer(problem | more, status=422, kind="application/problem+json"))
    with pytest.raises(ProblemError, match=says) as caught:
        client.import_table("bar", "a\nb")
    assert len(caught.value.errors) == 7


def test_queued_jobs_name_their_component(stub: Stub, client: Client):
    queued = {"component": "bar", "jobs": [{"id": 3, "status": "waiting", "new": True}]}
    for call in (client.start_recording, client.start_envelope, client.resolve, client.fill):
        stub.answers(Answer(queued))
        (job,) = call("bar").jobs
        assert (job.component, job.new) == ("bar", True)


def test_a_table_is_exported_as_text_in_the_units_asked_for(stub: Stub, client: Client):
    stub.answers(Answer(b"fx [lbf]\n", kind="text/csv"))
    assert client.export_table("bar", units={"force": "lbf"}) == "fx [lbf]\n"
    assert stub.seen[0].path == "/v1/components/bar/table?format=csv&force=lbf"
    stub.answers(Answer(b"\x89HDF", kind="application/x-hdf5"))
    assert client.export_table("bar", "hdf5") == b"\x89HDF"


def test_a_file_that_is_no_table_is_not_sent(stub: Stub, client: Client, tmp_path: Path):
    file = tmp_path / "table.pdf"
    file.write_bytes(b"x")
    with pytest.raises(ValueError, match=r"ends in \.pdf, which is not the ending of a table"):
        client.import_table("bar", file)
    assert stub.seen == []


def test_two_logs_go_as_one_form(stub: Stub, client: Client, tmp_path: Path):
    stub.answers(Answer({"inserted": 1}))
    file = tmp_path / "moved.csv"
    file.write_text("time [s],uz [mm]\n")
    client.import_table("bar", "time [s],fz [N]\n1,2\n", displacements=file)
    seen = stub.seen[-1]
    assert seen.headers["Content-Type"].startswith("multipart/form-data; boundary=")
    assert b'name="loads"' in seen.content
    assert b'name="displacements"; filename="moved.csv"' in seen.content


def test_a_form_has_the_names_of_files_as_utf_8(stub: Stub, client: Client, tmp_path: Path):
    """The server kept `\\u00e9.csv` as the name of é.csv."""
    stub.answers(Answer({"inserted": 1}))
    file = tmp_path / 'é "2".csv'
    file.write_text("time [s],uz [mm]\n")
    client.import_table("bar", "time [s],fz [N]\n1,2\n", displacements=file)
    assert 'filename="é %222%22.csv"'.encode() in stub.seen[-1].content


@pytest.mark.parametrize("text", ['[{"fz [N]": 1, "uz [m]": 2}]', "[]", '{"rows": []}'])
def test_a_line_of_json_is_content_and_no_path(stub: Stub, client: Client, text: str):
    stub.answers(Answer({"inserted": 1}))
    client.import_table("bar", text)
    assert stub.seen[-1].content == text.encode()


def test_a_bundle_with_a_file_dated_before_1980_is_sent(stub: Stub, client: Client, tmp_path: Path):
    """It was a ValueError of zipfile."""
    file = tmp_path / "component.toml"
    file.write_text('name = "rig"')
    os.utime(file, (0, 0))
    client.add_component(tmp_path)
    assert b"component.toml" in stub.seen[-1].content


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("t.csv", "csv"),
        ("T.JSON", "json"),
        ("t.h5", "hdf5"),
        ("t.xlsx", "xlsx"),
        ("t.wbt", "packed"),
    ],
)
def test_an_export_has_the_format_of_its_ending_and_the_bytes_that_came(
    stub: Stub, tmp_path: Path, name: str, kind: str
):
    content = b"{}\n" if kind in ("csv", "json") else b"\x89HDF\r\n"
    stub.answers(Answer(content, kind="application/octet-stream"))
    run = CliRunner().invoke(app, ["export", "bar", str(tmp_path / name), "--server", stub.url])
    assert run.exit_code == 0, run.output
    assert (tmp_path / name).read_bytes() == content
    assert stub.seen[0].path == f"/v1/components/bar/table?format={kind}"


@pytest.mark.parametrize("name", ["x.png", "x.tsv", "x", "-"])
def test_an_ending_that_is_no_tables_is_refused_with_those_there_are(stub, client, tmp_path, name):
    with pytest.raises(ValueError, match=r"one of \.csv, \.json, \.h5, \.hdf5, "):
        table_format(name)
    run = CliRunner().invoke(app, ["export", "bar", str(tmp_path / "x.png"), "--server", stub.url])
    assert run.exit_code == 1
    with pytest.raises(InvalidArgument, match="one of csv, xlsx, parquet, hdf5, json, packed"):
        client.export_table("bar", "mat")
    assert (stub.seen, list(tmp_path.iterdir())) == ([], [])


LOADED = {
    "inserted": 1,
    "existing": 0,
    "restored": 0,
    "beyond_range": 0,
    "dry_run": False,
    "errors": [],
    "causes": [],
    "findings": [],
    "ignored": [],
    "above": [],
    "format": "hdf5",
    "sheets": [],
    "rig": None,
    "clock": None,
    "columns": [],
    "in_use": True,
}
"""The reply to an import of one row."""


def test_import_says_what_became_of_the_rows(stub: Stub, tmp_path: Path):
    rows = {"read": 9, "loaded": 1, "refused": 0, "tare": 5, "unmatched": 3}
    reply = {**LOADED, "in_use": False}
    sheets = {"sheets": ["cover", "run"], "sheet": "run"}
    causes = {"causes": [{"row": 0, "fields": ["file"], "message": "is torn", "count": 1}]}
    stub.answers(Answer({**reply, "rows": rows, "ignored": ["Temp"], **sheets, **causes}))
    for name in ("t.h5", "t.tsv"):
        file = tmp_path / name
        file.write_bytes(b"x")
        words = ["--decimal", ",", "--column", "Load cell=-fz [N]", "--tare", "5"]
        words += ["--column", "3=ux", "--unit", "mm", "--column", "4=uy", "--unit", "[um]"]
        run = CliRunner().invoke(app, ["import", "bar", str(file), *words, "--server", stub.url])
        assert run.exit_code == 0, run.output
        asked = dict(parse_qsl(stub.seen[-1].path.partition("?")[2]))
        meanings = {"Load cell": "-fz [N]", "3": "ux [mm]", "4": "uy [um]"}
        assert json.loads(asked["mapping"]) == meanings
        assert (asked["tare"], asked["decimal"], asked["filename"]) == ("5", ",", name)
        assert "Of 9 rows read 5 are the tare, 3 have no load" in run.output
        assert run.output.startswith("file: is torn")
        assert "Columns left out: Temp" in run.output
        assert "Sheet run was read, of cover, run." in run.output
        assert "still builds its table" in run.output


def test_units_that_are_not_one_a_column_are_refused_with_the_form_to_write(tmp_path: Path):
    words = ["--column", "3=ux", "--column", "4=uy", "--unit", "mm"]
    run = CliRunner().invoke(app, ["import", "bar", __file__, *words])
    assert run.exit_code == 2
    assert "'COLUMN=fz [kN]'" in run.output


def test_a_rig_is_sent_as_text_from_numbers_and_from_its_file(stub: Stub, client, tmp_path: Path):
    stub.answers(Answer({"inserted": 1, "existing": 0, "errors": []}))
    frame = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    client.import_table("bar", "a\nb", frame=frame, load_point=(0, 0, 0.05))
    query = dict(parse_qsl(stub.seen[-1].path.partition("?")[2]))
    assert query == {"frame": "0.0,-1.0,0.0,1.0,0.0,0.0,0.0,0.0,1.0", "load_point": "0.0,0.0,0.05"}
    file = tmp_path / "rig.toml"
    file.write_text("\ufeffname = 'bench 3'\n", "utf-8")  # as Windows' editor writes it
    client.import_table("bar", "a\nb", rig=file)
    assert dict(parse_qsl(stub.seen[-1].path.partition("?")[2])) == {"rig": "name = 'bench 3'\n"}


def test_the_import_command_sends_the_rig_and_says_which_was_applied(stub: Stub, tmp_path: Path):
    counts = {"read": 1, "loaded": 1, "refused": 0, "tare": 0, "unmatched": 0}
    rig = {"name": "bench 3", "left_handed": True}
    stub.answers(Answer({**LOADED, "rows": counts, "rig": rig}))
    file = tmp_path / "table.csv"
    file.write_text("a\nb\n")
    options = ["--frame", "x=-y,y=z,z=x", "--load-point", "-0.1,0,0", "--displacement-point=0,0,1"]
    run = CliRunner().invoke(app, ["import", "bar", str(file), *options, "--server", stub.url])
    assert run.exit_code == 0, run.output
    assert "from rig bench 3, left-handed" in run.output
    query = dict(parse_qsl(stub.seen[-1].path.partition("?")[2]))
    sent = {"frame": "x=-y,y=z,z=x", "load_point": "-0.1,0,0", "displacement_point": "0,0,1"}
    assert query == {"filename": "table.csv", **sent}
