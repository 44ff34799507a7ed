"""An import says which point its moments are about, where translation x force matters."""

import csv
import io
from dataclasses import replace

import numpy as np
import orjson
import pytest
from typer.testing import CliRunner

from tests.column import FILE
from tests.service.live import served
from tests.service.test_import_findings import HEADER
from wrenchbook.service.cli.main import app
from wrenchbook.service.client import ProblemError
from wrenchbook.service.formats.options import Options, ParsedTable, ReadReport
from wrenchbook.service.formats.rig import Rig, rigged, with_known_point
from wrenchbook.surrogate.table.rows import LoadRange
from wrenchbook.surrogate.table.space import DEFAULT, space_of

CALL = "/v1/components/rig/table"
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
    lines = (",".join("" if np.isnan(one) else repr(one) for one in row) for row in rows)
    return "\n".join([HEADER, *lines])


def add(http, name="rig", span=RANGE):
    body = {"name": name, "title": "Rig", "range": span}
    assert http.post("/v1/components", json=body).status_code == 201


def load(http, content, call=CALL, **query):
    return http.post(call, content=content, params=query, headers={"content-type": "text/csv"})


def loaded(http):
    """The wrenches and sources of the table."""
    rows = list(csv.DictReader(io.StringIO(http.get(CALL, params={"format": "csv"}).text)))
    names = [name for name in rows[0] if name[0] in "fm" and name[1] in "xyz"]
    return np.array([[float(row[k]) for k in names] for row in rows]), {r["source"] for r in rows}


def test_moments_of_a_cell_on_the_ground_are_taken_to_the_moving_point(http, solved):
    add(http)
    reply = load(http, text(on_the_ground(*solved), solved[1]), load_cell="fixed").json()
    assert (reply["inserted"], reply["rig"]["load_cell"]) == (64, "fixed")
    wrench, _ = loaded(http)
    np.testing.assert_allclose(wrench, solved[0], rtol=0, atol=1e-12)


def test_moments_of_a_cell_on_the_moving_side_stay_as_they_are(http, solved):
    add(http)
    assert load(http, text(*solved), load_cell="moving").json()["inserted"] == 64
    wrench, _ = loaded(http)
    np.testing.assert_array_equal(wrench, solved[0])


@pytest.mark.parametrize("query", [{}, {"load_point": "0,0,0.01"}, {"rig": "name = 'bench'"}])
def test_where_the_point_matters_an_import_without_it_is_refused(http, solved, query):
    add(http)
    reply = load(http, text(*solved), **query)
    assert reply.status_code == 422
    (error,) = reply.json()["errors"]
    assert (error["row"], error["field"]) == (0, "load_cell")
    assert "--load-cell moving" in error["message"]
    assert "load_cell=fixed" in error["message"]
    product = np.abs(np.cross(solved[1][:, :3], solved[0][:, :3]))
    share = product / RANGE["moment"]
    largest = product[np.unravel_index(share.argmax(), share.shape)]
    assert f"by up to {largest:.3g} N*m (row" in error["message"]
    assert f"{100 * share.max():.2g} %)" in error["message"]
    assert http.get("/v1/components/rig").json()["rows"] == 0


def test_where_translation_x_force_is_small_nothing_is_asked(http, solved):
    add(http)
    wrench, moved = solved
    assert load(http, text(wrench, 1e-3 * moved)).json()["inserted"] == 64
    np.testing.assert_array_equal(loaded(http)[0], wrench)


def test_moments_without_a_column_were_read_by_no_cell_and_nothing_is_asked(http, solved):
    add(http)
    lines = [line.split(",") for line in text(*solved).splitlines()]
    forces = "\n".join(",".join(line[:3] + line[6:]) for line in lines)
    assert load(http, forces, missing_loads="zero").json()["inserted"] == 64


def test_a_single_outlier_asks_for_no_load_cell(http, solved):
    add(http)
    wrench, moved = solved[0], 1e-3 * solved[1]
    moved[7, 2] *= 1e4
    assert load(http, text(wrench, moved)).status_code == 200


def test_an_export_comes_back_without_the_question(http, solved):
    add(http)
    add(http, "other")
    load(http, text(on_the_ground(*solved), solved[1]), load_cell="fixed")
    exported = http.get(CALL, params={"format": "csv"}).content
    reply = load(http, exported, "/v1/components/other/table")
    assert reply.json()["inserted"] == 64
    again = load(http, exported, "/v1/components/other/table", load_cell="fixed")
    assert again.status_code == 422
    assert "of the interface already" in again.json()["errors"][0]["message"]


def test_the_load_cell_is_kept_with_the_import_and_named_in_its_rows(http, solved):
    add(http)
    load(http, text(on_the_ground(*solved), solved[1]), load_cell="fixed", rig="name = 'bench 3'")
    (kept,) = http.get("/v1/components/rig/imports").json()["imports"]
    assert Rig.read(kept["rig"]).load_cell == "fixed"
    wrench, sources = loaded(http)
    np.testing.assert_allclose(wrench, solved[0], rtol=0, atol=1e-12)
    assert sources == {"measured, rig bench 3"}


def test_a_translation_that_a_cell_on_the_ground_needs_and_nobody_measured_is_named(http, solved):
    add(http)
    wrench, moved = solved[0].copy(), solved[1].copy()
    wrench[3] = [5.0, 0, 0, 0, 0, 0]  # along x alone: u_x turns no moment
    moved[3, 0], moved[9, 2] = np.nan, np.nan
    reply = load(http, text(on_the_ground(wrench, np.nan_to_num(moved)), moved), load_cell="fixed")
    (error,) = reply.json()["errors"]
    assert (error["row"], error["field"]) == (11, "uz [m]")
    assert "load_cell=fixed takes translation x force off" in error["message"]


@pytest.mark.parametrize(
    ("query", "problem"),
    [
        ({"load_cell": "ground"}, "moving"),
        ({"rig": "load_cell = 'ground'"}, "load_cell: is moving or fixed"),
        ({"rig": "load_cell = 'fixed'", "load_cell": "fixed"}, "send it once"),
    ],
)
def test_a_load_cell_of_no_kind_or_told_twice_is_refused(http, query, problem):
    add(http)
    reply = load(http, HEADER, **query)
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
    assert report.mistakes.whole == asked


def test_each_interface_of_a_part_has_its_own_cell(solved):
    space = space_of(["left", "right"])
    options = Options(
        load_range=LoadRange(np.tile(SPAN.low, 2), np.tile(SPAN.high, 2), space),
        rig='load_cell = "fixed"',
    )
    wrench, moved = np.hstack((solved[0], solved[0][::-1])), np.hstack((solved[1], solved[1][::-1]))
    ground = [on_the_ground(wrench[:, k : k + 6], moved[:, k : k + 6]) for k in (0, 6)]
    report = ReadReport()
    (found,) = rigged(iter(pieces_of(np.hstack(ground), moved, space=space)), options, report)
    assert not report.mistakes
    np.testing.assert_allclose(found.wrench, wrench, rtol=0, atol=1e-12)


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
        assert "load cell fixed" in " ".join(ran.output.split())
        rows = [
            orjson.loads(client.export_table(name, "json"))["rows"] for name in ("python", "shell")
        ]
        assert [row["wrench"] for row in rows[0]] == [row["wrench"] for row in rows[1]]
        first = np.array([row["wrench"] for row in rows[0]])
        np.testing.assert_allclose(first, solved[0], rtol=0, atol=1e-12)
