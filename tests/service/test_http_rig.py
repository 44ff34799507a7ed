"""Imports of readings in a rig's frame and at its points, from the file to the answer."""

import csv
import io

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.service.test_import_findings import CALL, HEADER, add, csv_of
from tests.surrogate.findings.rigs import Rig as Measured
from wrenchbook.surrogate.table.rows import Rows

POINT = [0.12, -0.05, 0.08]
TEXT = "0.12,-0.05,0.08"
ONE = "100,0,0,0,0,0, 0.001,0,0,0,0,0"


@pytest.fixture
def measured():
    return Measured(8, ("random",))


def load(http, content, **query):
    """Send a CSV to the component `rig`."""
    return http.post(CALL, content=content, params=query, headers={"content-type": "text/csv"})


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
    (found,) = load(http, file, dry_run=True).json()["findings"]
    assert found["cause"] == "lever"
    np.testing.assert_allclose(found["lever"], np.negative(POINT), atol=0.01)
    reply = load(http, file, load_point=TEXT).json()
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
    (found,) = load(http, file, dry_run=True).json()["findings"]
    words = found["message"].split(f"--{option.replace('_', '-')} ")[1]
    reply = load(http, file, **{option: words.split(" ")[0].rstrip(";")}).json()
    assert reply["findings"] == []


def test_translations_beside_the_interface_are_moved_to_it(http, measured):
    add(http, measured)
    rows = measured.measured()
    beside = rows.displacement.copy()
    beside[:, :3] += Rotation.from_rotvec(beside[:, 3:]).apply(POINT) - POINT
    file = csv_of(Rows.of(rows.wrench, beside))
    assert load(http, file, displacement_point=TEXT).json()["inserted"] == len(rows)
    moved = [six(row, OUTPUTS) for row in sole(http)]
    np.testing.assert_allclose(moved, rows.displacement, rtol=0, atol=1e-15)


def test_a_rig_file_is_kept_named_in_the_source_and_read_back(http, measured):
    add(http, measured)
    text = "# load cell 4711\nname = 'bench 3'\nframe = 'x=-y,y=x,z=z'\nload_point = [0, 0, 0.05]\n"
    reply = load(http, f"{HEADER}\n{ONE}\n", rig=text).json()
    frame = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    told = {"name": "bench 3", "left_handed": False, "frame": frame}
    assert reply["rig"].items() >= told.items()
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
    load(http, f"{HEADER}\n{ONE}\n", frame="x=-y,y=x,z=z")
    text = http.get(CALL, params={"format": "csv"}).text
    again = load(http, text).json()
    assert (again["inserted"], again["existing"]) == (0, 1)
    refused = load(http, text, frame="x=-y,y=x,z=z")
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "source"
    assert "of the interface already" in refused.json()["errors"][0]["message"]


def test_a_kept_rig_gives_the_same_rows_as_the_options_that_it_came_from(http, measured):
    add(http, measured)
    load(http, f"{HEADER}\n{ONE}\n", frame="x=-y,y=x,z=z", load_point=TEXT)
    (kept,) = http.get("/v1/components/rig/imports").json()["imports"]
    again = load(http, f"{HEADER}\n{ONE}\n", rig=kept["rig"]).json()
    assert (again["inserted"], again["existing"]) == (0, 1)


def test_a_point_beside_the_interface_without_rotations_is_refused_with_a_remedy(http, measured):
    add(http, measured)
    file = "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],uz [mm]\n1,0,0,0,0,0,1\n"
    refused = load(http, file, displacement_point=TEXT)
    assert refused.status_code == 422
    (mistake,) = refused.json()["errors"]
    assert (mistake["row"], mistake["field"]) == (2, "rx")
    assert "needs all three rotations: measure them" in mistake["message"]
    assert load(http, file, displacement_point="0,0,0").status_code == 200


def test_a_frame_in_which_nothing_is_measured_is_refused_with_a_remedy(http, measured):
    add(http, measured)
    file = "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],uz [mm]\n1,0,0,0,0,0,1\n"
    refused = load(http, file, frame="1,0,0, 0,0.6,0.8, 0,-0.8,0.6")
    (mistake,) = refused.json()["errors"]
    assert "leave the frame out" in mistake["message"]


def test_loads_are_compared_with_the_range_in_the_interfaces_frame(http):
    body = {"name": "rig", "title": "Rig", "range": {"force": [10, 10, 1000], "moment": [1, 1, 1]}}
    assert http.post("/v1/components", json=body).status_code == 201
    file = f"{HEADER}\n900,0,0,0,0,0, 0.001,0,0,0,0,0\n"
    assert load(http, file).status_code == 422
    assert load(http, file, frame="x=z,y=x,z=y").status_code == 200


def test_the_zero_offset_is_that_of_the_rigs_readings(http, measured):
    add(http, measured)
    rows = ["10,0,0,0,1,0, 0,0.001,0,0,0,0.01", "110,0,0,0,1,0, 0,0.002,0,0,0,0.01"]
    load(
        http, "\n".join([HEADER, *rows]), tare=1, load_point="0,0,0.05", displacement_point="1,0,0"
    )
    (row,) = sole(http)
    np.testing.assert_allclose(six(row, LOADS), [100, 0, 0, 0, 5, 0], atol=1e-12)
    np.testing.assert_allclose(six(row, OUTPUTS), [0, 0.001, 0, 0, 0, 0], atol=1e-12)


def test_a_rig_of_more_text_than_is_kept_is_refused(http, measured):
    add(http, measured)
    refused = load(http, f"{HEADER}\n{ONE}\n", rig="#" * 5000)
    assert (refused.status_code, "4000 characters" in refused.text) == (422, True)


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
    found = [(one["row"], one["field"]) for one in refused["errors"]]
    assert found == [(2, "displacement[4]"), (3, "source")]
    assert http.post(CALL, json={"rows": [good]}, params=point).status_code == 200
