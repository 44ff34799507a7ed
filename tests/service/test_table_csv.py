"""CSV tables as test engineers send them."""

from __future__ import annotations

import math
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.refusals import assert_told, cases
from tests.service import table_files
from tests.service.table_files import ReadTable
from wrenchbook.service.formats import csv as csv_table
from wrenchbook.service.formats.columns import columns_of
from wrenchbook.service.formats.options import FileMistake, Options, ReadReport
from wrenchbook.surrogate.table.rows import LoadRange

SI = (
    "fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],"
    "ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]"
)
# These files have the columns that they are about; loads they do not name were zero.
read_csv = partial(table_files.read_csv, missing_loads="zero")
MARKED = "fx [N];ux [mm];note\n"
LBF = 4.4482216152605  # N, exact: 0.45359237 kg x 9.80665 m/s^2


def only_error(table: ReadTable) -> FileMistake:
    assert len(table.errors) == 1, table.errors
    assert len(table) == 0
    return table.errors[0]


def test_pounds_millimetres_and_degrees_become_si():
    table = read_csv(
        "Fz [lbf],My [in-lbf],Ux [mm],Uy [mm],Uz [mm],Rx [deg],Ry [mrad],Rz [rad],"
        "uz_err [um],source,note\n"
        "-100,2,0,0.5,-1.5,1,2,0.003,10,measured,rig 2\n"
    )
    assert table.errors == ()
    expected = [0, 0, -100 * LBF, 0, 2 * LBF * 0.0254, 0]
    assert np.allclose(table.wrench[0], expected, rtol=1e-15, atol=0)
    displacement = [0, 0.5e-3, -1.5e-3, math.pi / 180, 2e-3, 3e-3]
    assert np.allclose(table.displacement[0], displacement, rtol=1e-15, atol=0)
    assert table.uncertainty[0, 2] == pytest.approx(1e-5, rel=1e-15)
    assert np.isnan(np.delete(table.uncertainty[0], 2)).all()
    assert (table.source.tolist(), table.note) == (["measured"], ("rig 2",))
    assert table.seq.tolist() == [2]


def test_a_german_spreadsheet_export_reads_the_same():
    plain = read_csv(
        "Fz [N],ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg],note\n"
        "-100.5,0,0,-1.25,0.1,0,0,Prüfstand\n"
        "200,0,0,2.5e-1,0,0,0,\n"
    )
    text = (
        "sep=;\r\n"
        '# Messung vom 3. Mai, "Rig 2\r\n'
        "Fz [N];ux [mm];uy [mm];uz [mm];rx [°];ry [°];rz [°];note;;\r\n"
        "\r\n"
        " -100,5 ;0;0;-1,25;0,1;0;0;Prüfstand;;\r\n"
        ";;;;;;;;;\r\n"
        "200;0;0;2,5E-1;0;0;0;;;\r\n"
        ";;;;;;;;;\r\n"
    )
    for form in (text, text.encode("cp1252"), text.encode("utf-8-sig"), text.encode("utf-16")):
        table = read_csv(form)
        assert table.errors == ()
        assert np.array_equal(table.wrench, plain.wrench)
        assert np.array_equal(table.displacement, plain.displacement)
        assert table.note == ("Prüfstand", "")
        assert table.seq.tolist() == [5, 7]  # lines of the file, as an editor counts


def test_a_unit_behind_a_comma_is_read():
    table = read_csv('"Fz, kN";"uz, mm"\n-1;-0.5\n')
    assert table.errors == ()
    assert (table.wrench[0, 2], table.displacement[0, 2]) == (-1000.0, -5e-4)


def test_columns_with_one_mistake_are_one_cause():
    report = ReadReport(format="csv")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "upload"
        path.write_text("Sample,Fz [N],uz [mm],Temp (F)\n1,2,3,4\n")
        list(csv_table.read_csv(path, Options(missing_loads="zero"), report))
    (cause,) = report.mistakes.causes()
    assert (cause["fields"], cause["count"]) == (["Sample", "Temp (F)"], 2)


def test_a_catman_export_is_read():
    """Titles, a line of names with a rate after the time, a line of units."""
    text = (
        "catmanAP 5.5\tWaage.tst\nDatum: 3.5.2026\tKanäle: 3\n"
        "Zeit  1 - Standardmessrate\tFz\tdz\n"
        "s\tkN\tmm\n"
        "0\t-0,5\t-0,125\n0,02\t-0,7\t-0,175\n"
    )
    table = read_csv(text)
    assert table.errors == ()
    assert np.allclose(table.wrench[:, 2], [-500, -700])
    assert np.allclose(table.displacement[:, 2], [-1.25e-4, -1.75e-4])


def test_tabs_old_line_ends_quotes_and_round_brackets_are_read():
    table = read_csv(
        '"fx (kN)"\tux (mm)\tuy (mm)\tuz (mm)\trx (mrad)\try (mrad)\trz (mrad)\tnote\r'
        '"1"\t0\t0\t0\t0\t0\t0\t"two\rlines"\r'
        "2,5\t0\t0\t0\t0\t0\t0\tplain"
    )
    assert table.errors == ()
    assert table.wrench[:, 0].tolist() == [1000.0, 2500.0]
    assert table.note == ("two\rlines", "plain")
    assert table.seq.tolist() == [2, 4]


def test_three_bad_rows_among_500_are_each_named_by_row_field_and_reason():
    lines = ["fz [lbf],ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]"]
    lines += [f"{-n},0,0,{-n / 100},0,0,0" for n in range(500)]
    lines[100] = "-99,0,0,abc,0,0,0"
    lines[200] = "-199,0,0,nan,0,0,0"
    lines[300] = "-299,0,0,-2.99,0,30,0"
    table = read_csv("\n".join(lines))
    assert [error.as_dict() for error in table.errors] == [
        {"row": 101, "field": "uz [mm]", "message": "'abc' is not a number"},
        {
            "row": 201,
            "field": "uz [mm]",
            "message": "'nan' is not finite; leave the row out",
        },
        {
            "row": 301,
            "field": "ry [deg]",
            "message": "the rotation is 30 degrees; a table ends at 20 (check the unit: rad or "
            "deg?)",
        },
    ]
    assert len(table) == 497
    assert not {101, 201, 301} & set(table.seq.tolist())


@cases(__file__, "csv")
def test_a_mistake_says_where_it_is_and_what_to_write(case):
    table = read_csv(case["text"], **case.get("options", {}))
    (error,) = table.errors
    assert [error.row, error.field] == case["at"]
    assert len(table) == case.get("kept", 0)
    assert_told(case, [error.message])


def test_several_mistakes_of_one_row_are_all_named():
    table = read_csv(f"{SI}\na,0,0,0,0,0,0,b,0,0,0,0\n1,0,0,0,0,0,0,0,0,0,0,0\n")
    assert [(error.row, error.field) for error in table.errors] == [(2, "fx [N]"), (2, "uy [m]")]
    assert table.wrench[:, 0].tolist() == [1.0]


def test_mixed_decimal_marks_are_an_error_and_not_a_guess():
    header = "fx [N];ux [m];uy [m];uz [m];rx [rad];ry [rad];rz [rad]"
    table = read_csv(f"{header}\n1,5;0;0;0;0;0;0\n1.234;0;0;0;0;0;0\n1.234,5;0;0;0;0;0;0\n")
    assert [(error.row, error.field) for error in table.errors] == [(3, "fx [N]")]
    assert (
        "the file has a decimal comma; write no other mark, or say decimal=, (--decimal ,) for 1234"
        in table.errors[0].message
    )
    assert table.wrench[:, 0].tolist() == [1.5, 1234.5]


@pytest.mark.parametrize(
    ("cell", "decimal"),
    [
        ("-1,234.5", None),
        ("-1 234.5", None),
        ("-1\u202f234,5", None),
        ("-1'234.5", None),
        ("-1.234,5", None),
        ("-1,234.5", "."),
        ("-1.234,50", ","),
    ],
)
def test_marks_between_thousands_are_left_out(cell: str, decimal: str | None):
    table = read_csv(f"{MARKED}{cell};0;\n", decimal=decimal)
    assert (table.errors, table.wrench[:, 0].tolist()) == ((), [-1234.5])


@pytest.mark.parametrize("cell", ["1,234,567", "1.234.567", "1 234 567", "1’234’567"])
def test_millions_show_their_own_marks(cell: str):
    table = read_csv(f"{MARKED}{cell};0;\n")
    assert (table.errors, table.wrench[:, 0].tolist()) == ((), [1234567.0])


def test_exactly_20_degrees_is_still_a_table_and_a_hair_more_is_not():
    header = "fx [N],ux [m],uy [m],uz [m],rx [deg],ry [deg],rz [deg]"
    assert read_csv(f"{header}\n1,0,0,0,0,20,0").errors == ()
    assert only_error(read_csv(f"{header}\n1,0,0,0,0,20.0001,0")).field == "ry [deg]"


def test_a_negative_uncertainty_is_refused_and_an_empty_one_is_unknown():
    table = read_csv(f"{SI},ux_err [mm],rz_err [deg]\n{'0,' * 12}-1,\n{'0,' * 12}2,\n")
    assert [(error.row, error.field) for error in table.errors] == [(2, "ux_err [mm]")]
    assert "an uncertainty is not negative" in table.errors[0].message
    assert table.uncertainty[0, 0] == pytest.approx(2e-3)
    assert np.isnan(table.uncertainty[0, 5])


def test_missing_load_columns_are_zero_and_missing_displacements_not_measured():
    rest = "ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]"
    table = read_csv(f"mz [Nm],{rest}\n3,0,0,0,0,0,0")
    assert table.wrench.tolist() == [[0, 0, 0, 0, 0, 3]]
    part = read_csv("fx [N],ux [m],uz [m],rx [deg]\n1,2,,0\n1,,3,0\n")
    assert not part.errors
    nan = math.nan
    expected = [[2, nan, nan, 0, nan, nan], [nan, nan, 3, 0, nan, nan]]
    np.testing.assert_array_equal(part.displacement, expected)


def test_a_log_of_loads_alone_is_refused_with_the_way_to_send_its_displacements():
    log = (Path(__file__).parents[2] / "data/tables/ati_loads.csv").read_text()
    message = only_error(read_csv(log)).message
    assert "no displacement column" in message
    assert "displacements=FILE" in message


def test_all_mistakes_of_a_header_come_at_once():
    table = read_csv("fx [mm],ux,uy [N],uz [m],rx [m],ry [rad],temperature [K]\n1,1,1,1,1,1,1\n")
    assert [error.field for error in table.errors] == [
        "fx [mm]",
        "ux",
        "uy [N]",
        "rx [m]",
        "temperature [K]",
    ]


@pytest.mark.parametrize("text", [b"\xff\xfe\x00", b"caf\x81"])
def test_a_file_in_no_known_encoding_says_so(text: bytes):
    assert "save the file as UTF-8" in only_error(read_csv(text)).message


def test_a_hash_begins_a_comment_only_at_the_start_of_a_record():
    table = read_csv(f'{SI},note\n{"0," * 12}"a\n# b"\n# c, "d\n{"1," * 6}{"0," * 6}#e\n')
    assert table.errors == ()
    assert table.note == ("a\n# b", "#e")
    assert table.seq.tolist() == [2, 5]


def test_texts_that_no_store_can_keep_are_refused():
    table = read_csv(f"{SI},note\n{'0,' * 12}a\0b\n{'0,' * 12}fine\n")
    assert [(error.row, error.field) for error in table.errors] == [(2, "note")]
    assert table.note == ("fine",)


def test_a_field_without_end_is_an_error_and_not_a_crash():
    table = read_csv(f'{SI},note\n{"0," * 12}"{"x" * 200_000}\n')
    assert "cannot be read as CSV" in only_error(table).message


def test_295_mistakes_of_one_cause_are_one_cause_with_its_count():
    lines = "".join(f"{k},x{k}\n" for k in range(295))
    report = ReadReport(format="csv")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "upload"
        path.write_text(f"Fz [N],uz [mm]\n{lines}5,\n")
        list(csv_table.read_csv(path, Options(missing_loads="zero"), report))
    first, second = report.mistakes.causes()
    assert (first["field"], first["count"]) == ("uz [mm]", 295)
    assert first["rows"] == list(range(2, 12))
    assert "'x0' is not a number" in first["message"]
    assert (second["count"], second["rows"]) == (1, [297])


def test_a_file_of_nothing_but_mistakes_gives_a_list_that_can_be_read():
    table = read_csv(SI + "\n" + "a,b,c,d,e,f,g,h,i,j,k,l\n" * 1000)
    assert len(table.errors) == 1001
    assert table.errors[-1].message == "11000 more errors are not listed; correct these first"


NOTED = "fx [N],ux [m],note\n"


def test_an_open_quote_in_a_first_column_swallows_nothing_either():
    table = read_csv('note,fx [N],ux [m]\n"first,1,0\nsecond",2,0\n')
    assert [(error.row, error.field) for error in table.errors] == [(2, "line")]
    fine = read_csv('note,fx [N],ux [m]\r"first, 1\rsecond",2,0\r')
    assert (fine.errors, fine.note) == ((), ("first, 1\rsecond",))


def test_a_note_of_two_lines_is_no_swallowed_row():
    table = read_csv(NOTED + '1,0,"first, then\nsecond, and third, 4"\n')
    assert table.errors == ()
    assert table.note == ("first, then\nsecond, and third, 4",)


def test_the_decimal_mark_that_was_asked_for_is_taken():
    comma = read_csv(f"{MARKED}1,234;0;\n", decimal=",")
    assert (comma.errors, comma.wrench[0, 0]) == ((), 1.234)
    assert read_csv(f"{MARKED}1,234;0;\n", decimal=".").wrench[0, 0] == 1234
    assert read_csv(f"{MARKED}1.234;0;\n", decimal=".").wrench[0, 0] == 1.234
    assert read_csv(f"{MARKED}1.234;0;\n", decimal=",").wrench[0, 0] == 1234
    quoted = read_csv('fx [N],ux [mm]\n"1,234",0\n', decimal=",")
    assert (quoted.errors, quoted.wrench[0, 0]) == ((), 1.234)


@pytest.mark.parametrize(
    ("cells", "decimal", "loads"),
    [
        (("915.009", "1,354"), ".", [915.009, 1354.0]),
        (("1,354.250", "12.125"), ".", [1354.25, 12.125]),
        (("915,009", "1.354"), ",", [915.009, 1354.0]),
    ],
)
def test_three_decimals_stand_beside_thousands_with_a_declared_mark(cells, decimal, loads):
    table = read_csv(MARKED + "".join(f"{cell};0;\n" for cell in cells), decimal=decimal)
    assert (table.errors, table.wrench[:, 0].tolist()) == ((), loads)


@pytest.mark.parametrize("other", ["0,5", "1,2", "0,123", "1,2345", "1,234e0", ",5"])
def test_any_other_number_with_the_mark_tells_what_it_is(other: str):
    table = read_csv(f"{MARKED}1,234;0;\n{other};0;\n")
    assert (table.errors, table.wrench[0, 0]) == ((), 1.234)


RIG = LoadRange(low=np.array([-900, 0, -50, -90, 0, 0.0]), high=np.array([900, 0, 10, 90, 0, 0]))


def test_a_load_beyond_10_times_the_range_is_refused_with_the_range():
    header = "fx [N],fy [N],fz [N],mx [N*m],ux [m]\n"
    table = read_csv(f"{header}9000,0,0,0,0\n0,0,-501,0,0\n0,0,0,1e308,0\n", load_range=RIG)
    assert [(error.row, error.field) for error in table.errors] == [(3, "fz [N]"), (4, "mx [N*m]")]
    says = "the component's range is -50 to 10 N, and a table ends at 500"
    assert says in table.errors[0].message
    assert table.wrench[:, 0].tolist() == [9000.0]


def test_a_load_without_a_range_of_its_own_goes_by_the_largest_of_its_kind():
    header = "fy [N],mx [N*m],ux [m]\n"
    assert read_csv(f"{header}9000,0,0\n", load_range=RIG).errors == ()
    assert only_error(read_csv(f"{header}9001,0,0\n", load_range=RIG)).field == "fy [N]"
    none = LoadRange(low=np.zeros(6), high=np.zeros(6))
    assert read_csv(f"{header}1e6,0,0\n", load_range=none).errors == ()


def test_a_row_has_all_36_tangents_or_none():
    names = [
        f"{name} [{'m' if name[1] == 'u' else 'rad'}/{'N' if '/df' in name else '(N*m)'}]"
        for name in columns_of().compliance
    ]
    header = "fx [N],ux [m]," + ",".join(names)
    tangents = ",".join(str(number) for number in range(36))
    table = read_csv(f"{header}\n1,0,{tangents}\n1,0{',' * 36}\n")
    assert table.errors == ()
    assert table.compliance[0].ravel().tolist() == list(range(36))
    assert np.isnan(table.compliance[1]).all()
    error = only_error(read_csv(f"{header}\n1,0,{tangents[:-2]}\n"))
    assert (error.row, error.field) == (2, "drz/dmz")


WRITTEN = [
    "1",
    "-2.5",
    "+3",
    ".5",
    "2.",
    "1e3",
    "7E+2",
    "1e-400",
    "1e-99",
    "-0",
    "0",
    "",
    " 4 ",
    " ",
]
WRITTEN += ["nan", "inf", "-Infinity", "1e999", "1_0", "0x1", "1.5.2", "12 N", "#N/A", " ", "1"]
LINES = st.lists(st.sampled_from(WRITTEN), min_size=3, max_size=3).map(",".join)
OTHERS = st.sampled_from(["", "# a", ",,", "1,2", "1,2,3,4", '1,2,"a b"', "1,2,a\r", "=1,2,x"])


@settings(max_examples=60)
@given(st.lists(st.one_of(LINES, OTHERS), min_size=1, max_size=6), st.sampled_from(["\n", "\r\n"]))
def test_rows_read_in_blocks_are_those_read_line_by_line(lines: list[str], end: str):
    text = end.join(["fx [N],ux [mm],note", "1,2,", *lines])
    table = read_csv(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_table._Body, "_by_arrow", lambda *_: None)
        line_by_line = read_csv(text)
    assert table.errors == line_by_line.errors
    for name in ("wrench", "displacement", "seq"):
        np.testing.assert_array_equal(getattr(table, name), getattr(line_by_line, name))
    assert table.note == line_by_line.note


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_quoted_fields_of_one_line_are_read_in_blocks_too(monkeypatch, delimiter: str):
    lines = ["fx [N]~ux [mm]~note", '1~"2"~"a, b; c|d"', '"3"~4~""', '5~6~"# c"', ""]
    content = "\n".join(lines).replace("~", delimiter)
    line_by_line = read_csv(content + '7~8~"a ""b"""\n'.replace("~", delimiter), decimal=".")
    assert line_by_line.note[3] == 'a "b"'
    monkeypatch.setattr(csv_table, "text_pieces", None)
    table = read_csv(content, decimal=".")
    assert table.errors == line_by_line.errors == ()
    assert table.wrench[:, 0].tolist() == line_by_line.wrench[:3, 0].tolist() == [1, 3, 5]
    assert table.note == line_by_line.note[:3] == ("a, b; c|d", "", "# c")


def test_a_line_that_ends_in_two_carriage_returns_counts_as_an_editor_counts():
    table = read_csv("fx [N],ux [mm],note\r\n1,2,\r\n1,2,a\r\r\n1,1,1")
    assert table.errors == ()
    assert table.seq.tolist() == [2, 3, 5]


def test_a_file_of_plain_rows_is_read_in_blocks_alone(monkeypatch):
    monkeypatch.setattr(csv_table, "text_pieces", None)
    monkeypatch.setattr(csv_table, "_BLOCK", 40)
    text = "fx [N];ux [mm];note\n" + "".join(f"{k},5;-{k}e-1;row {k}\n" for k in range(20))
    table = read_csv(text, decimal=",")
    assert table.errors == ()
    assert table.wrench[:, 0].tolist() == [k + 0.5 for k in range(20)]
    assert table.seq.tolist() == list(range(2, 22))
    assert table.note[19] == "row 19"
