"""Imports of readings in a rig's frame and at its points, from the file to the answer."""

import csv
import io
from dataclasses import replace

import numpy as np
import orjson
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from tests.column import FILE
from tests.service.live import served
from tests.service.test_import_findings import CALL, HEADER, add, csv_of, send
from tests.surrogate.findings.rigs import Rig as Measured
from wrenchbook.service.cli.main import app
from wrenchbook.service.client import ProblemError
from wrenchbook.service.formats.options import Options, ParsedTable, ReadReport
from wrenchbook.service.formats.rig import Rig, rigged, with_known_point
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import DEFAULT, space_of

POINT = [0.12, -0.05, 0.08]
TEXT = "0.12,-0.05,0.08"
ONE = "100,0,0,0,0,0, 0.001,0,0,0,0,0"


@pytest.fixture
def measured():
    return Measured(8, ("random",))


def sole(http):
    """Return the rows of the table as columns of texts."""
    text = http.get(CALL, params={"format": "csv"}).text
    return list(csv.DictReader(io.StringIO(text)))


def six(row, names):
    return [float(next(value for key, value in row.items() if key.startswith(n))) for n in names]


LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
OUTPUTS = ("ux", "uy", "uz", "rx", "ry", "rz")


def test_moments_about_a_load_point_are_those_of_the_interface_after_the_import(http, measured):
    add(http, measured)
    rows = measured.measured()
    about = rows.wrench.copy()
    about[:, 3:] -= np.cross(POINT, about[:, :3])
    file = csv_of(Rows.of(about, rows.displacement))
    (result,) = send(http, file, dry_run=True).json()["findings"]
    assert result["cause"] == "lever"
    np.testing.assert_allclose(result["lever"], np.negative(POINT), atol=0.01)
    reply = send(http, file, load_point=TEXT).json()
    assert (reply["findings"], reply["rig"]["load_point"]) == ([], POINT)
    wrench = [six(row, LOADS) for row in sole(http)]
    np.testing.assert_allclose(wrench, rows.wrench, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("option", ["load_point", "displacement_point"])
def test_the_point_that_a_lever_finding_names_silences_it(http, measured, option):
    add(http, measured)
    rows = measured.measured()
    about = rows.wrench.copy()
    about[:, 3:] -= np.cross(POINT, about[:, :3])
    file = csv_of(Rows.of(about, rows.displacement))
    (result,) = send(http, file, dry_run=True).json()["findings"]
    texts = result["message"].split(f"--{option.replace('_', '-')} ")[1]
    reply = send(http, file, **{option: texts.split(" ")[0].rstrip(";")}).json()
    assert reply["findings"] == []


def test_translations_beside_the_interface_are_moved_to_it(http, measured):
    add(http, measured)
    rows = measured.measured()
    beside = rows.displacement.copy()
    beside[:, :3] += Rotation.from_rotvec(beside[:, 3:]).apply(POINT) - POINT
    file = csv_of(Rows.of(rows.wrench, beside))
    assert send(http, file, displacement_point=TEXT).json()["inserted"] == len(rows)
    moved = [six(row, OUTPUTS) for row in sole(http)]
    np.testing.assert_allclose(moved, rows.displacement, rtol=0, atol=1e-15)


def test_a_rig_file_is_kept_named_in_the_source_and_read_back(http, measured):
    add(http, measured)
    text = "# load cell 4711\nname = 'bench 3'\nframe = 'x=-y,y=x,z=z'\nload_point = [0, 0, 0.05]\n"
    reply = send(http, f"{HEADER}\n{ONE}\n", rig=text).json()
    frame = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    reported = {"name": "bench 3", "left_handed": False, "frame": frame}
    assert reply["rig"].items() >= reported.items()
    (row,) = sole(http)
    assert row["source"] == "measured, rig bench 3"
    assert six(row, LOADS) == [0, -100, 0, 5, 0, 0]
    assert six(row, OUTPUTS) == [0, -0.001, 0, 0, 0, 0]
    (kept,) = http.get("/v1/components/rig/imports").json()["imports"]
    assert kept["rig"] == text
    row = http.get(f"{CALL}/{reply['table_version']}").json()
    assert row["provenance"]["import"]["rig"] == text


def test_an_export_of_a_rigs_rows_comes_back_as_the_same_rows_and_is_not_turned_twice(
    http, measured
):
    add(http, measured)
    send(http, f"{HEADER}\n{ONE}\n", frame="x=-y,y=x,z=z")
    text = http.get(CALL, params={"format": "csv"}).text
    again = send(http, text).json()
    assert (again["inserted"], again["existing"]) == (0, 1)
    refused = send(http, text, frame="x=-y,y=x,z=z")
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "source"
    assert "already in the interface frame" in refused.json()["errors"][0]["message"]


def test_a_point_beside_the_interface_without_rotations_is_refused_with_a_remedy(http, measured):
    add(http, measured)
    file = "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],uz [mm]\n1,0,0,0,0,0,1\n"
    refused = send(http, file, displacement_point=TEXT)
    assert refused.status_code == 422
    (mistake,) = refused.json()["errors"]
    assert (mistake["row"], mistake["field"]) == (2, "rx")
    assert "needs all three rotations; measure them" in mistake["message"]
    assert send(http, file, displacement_point="0,0,0").status_code == 200


def test_a_frame_in_which_nothing_is_measured_is_refused_with_a_remedy(http, measured):
    add(http, measured)
    file = "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],uz [mm]\n1,0,0,0,0,0,1\n"
    refused = send(http, file, frame="1,0,0, 0,0.6,0.8, 0,-0.8,0.6")
    (mistake,) = refused.json()["errors"]
    assert "leave the frame out" in mistake["message"]


def test_loads_are_compared_with_the_range_in_the_interfaces_frame(http):
    body = {"name": "rig", "title": "Rig", "range": {"force": [10, 10, 1000], "moment": [1, 1, 1]}}
    assert http.post("/v1/components", json=body).status_code == 201
    file = f"{HEADER}\n900,0,0,0,0,0, 0.001,0,0,0,0,0\n"
    assert send(http, file).status_code == 422
    assert send(http, file, frame="x=z,y=x,z=y").status_code == 200


def test_the_zero_offset_is_that_of_the_rigs_readings(http, measured):
    add(http, measured)
    rows = ["10,0,0,0,1,0, 0,0.001,0,0,0,0.01", "110,0,0,0,1,0, 0,0.002,0,0,0,0.01"]
    send(
        http, "\n".join([HEADER, *rows]), tare=1, load_point="0,0,0.05", displacement_point="1,0,0"
    )
    (row,) = sole(http)
    np.testing.assert_allclose(six(row, LOADS), [100, 0, 0, 0, 5, 0], atol=1e-12)
    np.testing.assert_allclose(six(row, OUTPUTS), [0, 0.001, 0, 0, 0, 0], atol=1e-12)


def test_a_rig_of_more_text_than_is_kept_is_refused(http, measured):
    add(http, measured)
    refused = send(http, f"{HEADER}\n{ONE}\n", rig="#" * 9000)
    assert (refused.status_code, "8000 characters" in refused.text) == (422, True)


def test_two_logs_are_joined_before_their_readings_are_taken_to_the_interface(http, measured):
    add(http, measured)
    loads = (
        "time [s],Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm]\n0,0,0,0,0,0,0\n1,100,0,0,0,1,0\n"
    )
    moved = "time [s],ux [m]\n0.5,0.001\n"
    files = {"loads": ("a.csv", loads), "displacements": ("b.csv", moved)}
    point = {"load_point": "0,0,0.05", "frame": "x=-y,y=x,z=z"}
    assert http.post(CALL, files=files, params=point).status_code == 200
    (row,) = sole(http)
    np.testing.assert_allclose(six(row, LOADS), [0, -50, 0, 3, 0, 0], atol=1e-12)
    assert (row["uy [m]"], row["ux [m]"]) == ("-0.001", "")


def test_rows_of_json_are_taken_to_the_interface_and_their_mistakes_name_their_places(
    http, measured
):
    add(http, measured)
    good = {"wrench": [1, 0, 0, 0, 0, 0], "displacement": [1e-3, 0, 0, 0, 0, 0]}
    bad = {"wrench": [1, 0, 0, 0, 0, 0], "displacement": [1e-3, 0, 0, 0, None, 0]}
    solve = {**good, "source": "fea"}
    point = {"displacement_point": "0,0,1"}
    refused = http.post(CALL, json={"rows": [good, bad, solve]}, params=point).json()
    result = [(error["row"], error["field"]) for error in refused["errors"]]
    assert result == [(2, "displacement[4]"), (3, "source")]
    assert http.post(CALL, json={"rows": [good]}, params=point).status_code == 200


# -- which point the moments are about, where translation x force matters ------------------------

RANGE = {"force": [250, 20, 20], "moment": [10, 20, 20]}
SPAN = LoadRange(-np.array([250.0, 20, 20, 10, 20, 20]), np.array([250.0, 20, 20, 10, 20, 20]))


@pytest.fixture
def solved():
    """Wrenches of the solver, about the moving point, and displacements, (n, 6) each."""
    with np.load(FILE) as file:
        return file["wrench"], file["displacement"]


def on_the_ground(wrench, displacement):
    """The same wrenches as a load cell under the part reads them."""
    read = wrench.copy()
    read[:, 3:] += np.cross(displacement[:, :3], wrench[:, :3])
    return read


def text(wrench, displacement):
    rows = np.hstack((wrench, displacement)).tolist()
    lines = (",".join("" if np.isnan(item) else repr(item) for item in row) for row in rows)
    return "\n".join([HEADER, *lines])


def add_cell(http, name="rig", span=RANGE):
    body = {"name": name, "title": "Rig", "range": span}
    assert http.post("/v1/components", json=body).status_code == 201


def loaded(http):
    """The wrenches and sources of the table."""
    rows = list(csv.DictReader(io.StringIO(http.get(CALL, params={"format": "csv"}).text)))
    names = [name for name in rows[0] if name[0] in "fm" and name[1] in "xyz"]
    return np.array([[float(row[k]) for k in names] for row in rows]), {r["source"] for r in rows}


def test_moments_of_a_cell_on_the_ground_are_taken_to_the_moving_point(http, solved):
    add_cell(http)
    reply = send(http, text(on_the_ground(*solved), solved[1]), load_cell="fixed").json()
    assert (reply["inserted"], reply["rig"]["load_cell"]) == (64, "fixed")
    wrench, _ = loaded(http)
    np.testing.assert_allclose(wrench, solved[0], rtol=0, atol=1e-12)


def test_moments_of_a_cell_on_the_moving_side_stay_as_they_are(http, solved):
    add_cell(http)
    assert send(http, text(*solved), load_cell="moving").json()["inserted"] == 64
    wrench, _ = loaded(http)
    np.testing.assert_array_equal(wrench, solved[0])


@pytest.mark.parametrize("query", [{}, {"load_point": "0,0,0.01"}, {"rig": "name = 'bench'"}])
def test_where_the_point_matters_an_import_without_it_is_refused(http, solved, query):
    add_cell(http)
    reply = send(http, text(*solved), **query)
    assert reply.status_code == 422
    (error,) = reply.json()["errors"]
    assert (error["row"], error["field"]) == (0, "load_cell")
    assert "--load-cell moving" in error["message"]
    assert "load_cell=fixed" in error["message"]
    product = np.abs(np.cross(solved[1][:, :3], solved[0][:, :3]))
    share = product / RANGE["moment"]
    largest = product[np.unravel_index(share.argmax(), share.shape)]
    assert f": {largest:.3g} N*m," in error["message"]
    assert f"{100 * share.max():.2g} %)" in error["message"]
    assert http.get("/v1/components/rig?wait_s=60").json()["rows"] == 0


def test_where_translation_x_force_is_small_nothing_is_asked(http, solved):
    add_cell(http)
    wrench, moved = solved
    assert send(http, text(wrench, 1e-3 * moved)).json()["inserted"] == 64
    np.testing.assert_array_equal(loaded(http)[0], wrench)


def test_moments_without_a_column_were_read_by_no_cell_and_nothing_is_asked(http, solved):
    add_cell(http)
    lines = [line.split(",") for line in text(*solved).splitlines()]
    forces = "\n".join(",".join(line[:3] + line[6:]) for line in lines)
    assert send(http, forces, missing_loads="zero").json()["inserted"] == 64


def test_a_single_outlier_asks_for_no_load_cell(http, solved):
    add_cell(http)
    wrench, moved = solved[0], 1e-3 * solved[1]
    moved[7, 2] *= 1e4
    assert send(http, text(wrench, moved)).status_code == 200


def test_an_export_comes_back_without_the_question(http, solved):
    add_cell(http)
    add_cell(http, "other")
    send(http, text(on_the_ground(*solved), solved[1]), load_cell="fixed")
    exported = http.get(CALL, params={"format": "csv"}).content
    reply = send(http, exported, "/v1/components/other/table")
    assert reply.json()["inserted"] == 64
    again = send(http, exported, "/v1/components/other/table", load_cell="fixed")
    assert again.status_code == 422
    assert "already in the interface frame" in again.json()["errors"][0]["message"]


def test_the_load_cell_is_kept_with_the_import_and_named_in_its_rows(http, solved):
    add_cell(http)
    send(http, text(on_the_ground(*solved), solved[1]), load_cell="fixed", rig="name = 'bench 3'")
    (kept,) = http.get("/v1/components/rig/imports").json()["imports"]
    assert Rig.read(kept["rig"]).load_cell == "fixed"
    wrench, sources = loaded(http)
    np.testing.assert_allclose(wrench, solved[0], rtol=0, atol=1e-12)
    assert sources == {"measured, rig bench 3"}


def test_a_translation_that_a_cell_on_the_ground_needs_and_nobody_measured_is_named(http, solved):
    add_cell(http)
    wrench, moved = solved[0].copy(), solved[1].copy()
    wrench[3] = [5.0, 0, 0, 0, 0, 0]  # along x alone: u_x turns no moment
    moved[3, 0], moved[9, 2] = np.nan, np.nan
    reply = send(http, text(on_the_ground(wrench, np.nan_to_num(moved)), moved), load_cell="fixed")
    (error,) = reply.json()["errors"]
    assert (error["row"], error["field"]) == (11, "uz [m]")
    assert "load_cell=fixed subtracts translation x force" in error["message"]


@pytest.mark.parametrize(
    ("query", "problem"),
    [
        ({"load_cell": "ground"}, "moving"),
        ({"rig": "load_cell = 'ground'"}, "load_cell: must be moving or fixed"),
        ({"rig": "[import]\nload_cell = 'fixed'", "load_cell": "fixed"}, "import"),
    ],
)
def test_a_load_cell_of_no_kind_or_told_twice_is_refused(http, query, problem):
    add_cell(http)
    reply = send(http, HEADER, **query)
    assert reply.status_code == 422
    assert problem in reply.text


def pieces_of(wrench, moved, uncertainty=None, space=DEFAULT):
    known = {} if uncertainty is None else {"uncertainty": uncertainty}
    return [replace(ParsedTable.of(wrench, moved, space, **known), note=[""] * len(wrench))]


@pytest.mark.parametrize(("bar", "asked"), [(1e-7, True), (1e-2, False)])
def test_a_shift_beyond_the_stated_uncertainty_is_asked_for_where_solves_tell_it(
    solved, bar, asked
):
    wrench, moved = solved[0], 1e-2 * solved[1]
    compliance = np.load(FILE)["compliance"][0].tolist()
    options, report = Options(load_range=SPAN, solved=compliance), ReadReport()
    pieces = pieces_of(wrench, moved, np.full(moved.shape, bar))
    assert len(list(with_known_point(iter(pieces), options, report))) == 1
    assert report.mistakes.is_ruined == asked


def test_moments_without_a_column_are_exempt_beside_stated_uncertainties_too(solved):
    """The shift of a moment that no cell had measured was compared with the uncertainties."""
    wrench, moved = solved[0].copy(), 1e-2 * solved[1]
    wrench[:, 3:] = 0.0
    compliance = np.load(FILE)["compliance"][0].tolist()
    options, report = Options(load_range=SPAN, solved=compliance), ReadReport()
    report.columns = [(f"{name} [N]", name, None) for name in LOADS[:3]]
    pieces = pieces_of(wrench, moved, np.full(moved.shape, 1e-7))
    assert len(list(with_known_point(iter(pieces), options, report))) == 1
    assert not report.mistakes.is_ruined


def test_each_interface_of_a_part_has_its_own_cell(solved):
    space = space_of(["left", "right"])
    options = Options(
        load_range=LoadRange(np.tile(SPAN.low, 2), np.tile(SPAN.high, 2), space),
        rig='load_cell = "fixed"',
    )
    wrench, moved = np.hstack((solved[0], solved[0][::-1])), np.hstack((solved[1], solved[1][::-1]))
    ground = [on_the_ground(wrench[:, k : k + 6], moved[:, k : k + 6]) for k in (0, 6)]
    report = ReadReport()
    (result,) = rigged(iter(pieces_of(np.hstack(ground), moved, space=space)), options, report)
    assert not report.mistakes
    np.testing.assert_allclose(result.wrench, wrench, rtol=0, atol=1e-12)


def test_the_client_and_the_command_line_take_the_load_cell(tmp_path, solved):
    file = tmp_path / "ground.csv"
    file.write_text(text(on_the_ground(*solved), solved[1]))
    with served(tmp_path / "data") as client:
        for name in ("python", "shell"):
            client.add_component({"name": name, "title": name, "range": RANGE})
        with pytest.raises(ProblemError, match="load_cell"):
            client.import_table("python", file)
        client.import_table("python", file, load_cell="fixed")
        words = ["import", "shell", str(file), "--server", client.url]
        refused = CliRunner().invoke(app, words)
        assert refused.exit_code != 0
        assert "--load-cell moving" in str(refused.exception)
        ran = CliRunner().invoke(app, [*words, "--load-cell", "fixed"])
        assert ran.exit_code == 0, ran.output
        assert "--load-cell fixed" in " ".join(ran.output.split())
        rows = [
            orjson.loads(client.export_table(name, "json"))["rows"] for name in ("python", "shell")
        ]
        assert [row["wrench"] for row in rows[0]] == [row["wrench"] for row in rows[1]]
        first = np.array([row["wrench"] for row in rows[0]])
        np.testing.assert_allclose(first, solved[0], rtol=0, atol=1e-12)
