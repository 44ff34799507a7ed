"""What is written is read back: the same numbers, the same texts."""

from __future__ import annotations

import csv
import gzip
import io
import math
import resource
import tempfile
import zipfile
from dataclasses import replace
from datetime import timedelta
from decimal import Decimal
from functools import partial

import numpy as np
import openpyxl
import pyarrow.parquet as parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.service import table_files
from tests.service.table_files import ReadTable, read, write_csv, write_hdf5, write_json, written
from wrenchbook.service.formats.cells import guard_formula, time_seconds, unguard_formula
from wrenchbook.service.formats.columnar import write_parquet
from wrenchbook.service.formats.units import (
    QUANTITIES,
    UnitError,
    in_unit,
    scaled,
    si_factor,
)
from wrenchbook.service.formats.xlsx import _text, escape, unescape, write_xlsx
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange

# These files have the columns that they are about; loads they do not name were zero.
read_csv = partial(table_files.read_csv, missing_loads="zero")
numbers = st.floats(allow_nan=False, allow_infinity=False)
moves = st.floats(-10, 10)  # m, what a table may hold
# A rotation vector of these components is never longer than 20 degrees.
angles = st.floats(-0.2, 0.2)
unsure = [st.one_of(st.just(math.nan), st.floats(0, limit)) for limit in [10] * 3 + [0.2] * 3]
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])).map(str.strip)


UNITS = {"force": "lbf", "moment": "in-lbf", "translation": "mm", "rotation": "deg"}
any_units = st.fixed_dictionaries(
    {quantity.name: st.sampled_from(quantity.examples) for quantity in QUANTITIES}
)
FORCE = "fx [N],ux [m]"


@st.composite
def tables(draw: st.DrawFn, exponent: int = 308) -> ReadTable:
    """Rows of any floats, or of numbers up to 10 to an exponent: other units may be smaller."""
    count, largest = draw(st.integers(1, 4)), 10.0**exponent if exponent < 308 else None
    loads = numbers if largest is None else st.floats(-largest, largest)

    def block(*parts: st.SearchStrategy[float]) -> np.ndarray:
        rows = st.lists(st.tuples(*parts), min_size=count, max_size=count)
        return np.array(draw(rows), dtype=float).reshape(count, len(parts))

    def tangents() -> np.ndarray:
        # A seed instead of 36 drawn numbers a row: they would use up what Hypothesis may draw.
        rng = np.random.default_rng(draw(st.integers(0, 2**32)))
        known = np.array(draw(st.lists(st.booleans(), min_size=count, max_size=count)))
        scale = 10.0 ** rng.uniform(-min(exponent, 300), min(exponent, 300), (count, 6, 6))
        return np.where(known[:, None, None], rng.normal(size=(count, 6, 6)) * scale, np.nan)

    def words() -> tuple[str, ...]:
        return tuple(draw(st.lists(texts, min_size=count, max_size=count)))

    return ReadTable(
        wrench=block(*[loads] * 6),
        displacement=block(*[moves] * 3, *[angles] * 3),
        uncertainty=block(*unsure),
        compliance=tangents(),
        curvature=np.empty((count, 0)),
        source=np.array(words(), dtype=str),
        note=words(),
        fingerprint=np.array(words(), dtype=str),
        seq=np.arange(count),
        errors=(),
    )


def same(first: ReadTable, second: ReadTable) -> None:
    assert second.errors == ()
    for name in ("wrench", "displacement", "uncertainty", "compliance"):
        assert np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True)
    for name in ("source", "note", "fingerprint"):
        assert list(getattr(first, name)) == list(getattr(second, name))


def same_to_rounding(first: ReadTable, second: ReadTable) -> None:
    """What another unit costs: an import takes such rows for the same."""
    assert second.errors == ()
    for name in ("wrench", "displacement", "uncertainty", "compliance"):
        there, back = getattr(first, name), getattr(second, name)
        np.testing.assert_allclose(back, there, rtol=1e-15, atol=1e-290)
    for name in ("source", "note", "fingerprint"):
        assert list(getattr(first, name)) == list(getattr(second, name))


META = TableMeta("plate", 9, LoadRange(-np.ones(6), np.ones(6)), fingerprint="abc")
WRITERS = {
    "csv": lambda table: write_csv(table).encode(),
    "json": lambda table: write_json(table).encode(),
    "hdf5": lambda table: write_hdf5(table, range(len(table)), META),
    "xlsx": partial(written, write_xlsx),
    "parquet": partial(written, write_parquet),
}


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS.keys())
@settings(max_examples=30)  # each writes and syncs a file
@given(tables())
def test_an_export_is_read_back_to_the_same_floats_and_texts(write, table: ReadTable):
    same(table, read(write(table))[0])


@settings(max_examples=30)
@given(tables(280), any_units)
def test_an_export_in_any_unit_is_read_back_to_rounding(table: ReadTable, units):
    result, report = read(gzip.compress(write_csv(table, units).encode()))
    same_to_rounding(table, result)
    assert (report.format, report.gzip) == ("csv", True)
    same_to_rounding(table, read(written(write_xlsx, table, units))[0])


@pytest.mark.parametrize(
    ("earlier", "later"),
    [
        ("Nov 29, 2026 10:00:00 PM", "Nov 29, 2026 10:00:02 PM"),
        ("29.11.2026 22:00:00,5", "29.11.2026 22:00:02,5"),
    ],
)
def test_a_clock_time_is_read_beside_decimal_commas(earlier, later):
    """The comma of an English date became a point, and the time unknown."""
    first, second = (time_seconds(text, None, comma=True) for text in (earlier, later))
    assert second - first == pytest.approx(2.0)


@given(texts)
def test_texts_survive_the_guards_of_spreadsheets(text):
    assert unguard_formula(guard_formula(text)) == text
    assert unescape(escape(text)) == text


@pytest.mark.parametrize(
    ("escaped", "text"),
    [("_xD83D__xDE00_", "\U0001f600"), ("a_x0009_b", "a\tb")],
)
def test_escapes_of_utf_16_are_read_as_characters(escaped, text):
    assert unescape(escaped) == text


def test_a_duration_beyond_a_day_goes_on_after_the_clock_times_of_the_first():
    durations = [timedelta(hours=23), timedelta(hours=26, seconds=0.5)]
    first, second = (time_seconds(_text(duration), None, comma=False) for duration in durations)
    assert second - first == 3 * 3600 + 0.5


def test_a_duration_beyond_all_dates_stays_a_text():
    assert _text(timedelta(days=999_999_999)) == "999999999 days, 0:00:00"


@pytest.mark.parametrize("note", ["=1+1", "+1", "-1", "@SUM(A1)", "'=1", "''=1", "＝1"])
def test_no_note_of_an_export_is_a_formula_and_all_come_back(note):
    table = replace(read_csv(f"{FORCE},note\n1,0,x\n"), note=(note,))
    text = write_csv(table)
    cell = text.splitlines()[1].rsplit(",", 1)[1].strip('"')
    assert cell.startswith("'")
    same(table, read_csv(text))
    content = written(write_xlsx, table)
    same(table, read(content)[0])
    sheet = zipfile.ZipFile(io.BytesIO(content)).read("xl/worksheets/sheet1.xml")
    assert b"<f>" not in sheet


def test_an_export_says_its_contract_and_its_units():
    table = read_csv(f"{FORCE}\n1,0\n")
    book = openpyxl.load_workbook(io.BytesIO(written(write_xlsx, table)))
    assert book.sheetnames == ["table", "about"]
    assert [cell.value for cell in book["about"][1]] == ["contract", "SI"]
    file = parquet.ParquetFile(io.BytesIO(written(write_parquet, table)))
    assert file.schema_arrow.metadata[b"wrenchbook:contract"] == b"SI"
    assert file.schema_arrow.field("fz [N]").metadata[b"unit"] == b"N"


def test_a_workbook_that_a_full_disk_refuses_is_an_error_of_the_disk(tmp_path, monkeypatch):
    """It was a 500, and its temporary file stayed; the limit of file sizes stands for the disk."""
    table = read_csv(f"{FORCE}\n" + "1,0\n" * 3000)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            written(write_xlsx, table)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.rglob("openpyxl*")) == []


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS.keys())
def test_a_table_without_rows_is_written(write):
    none = read_csv(f"{FORCE}\n1,0\n").take(np.zeros(1, dtype=bool))
    assert len(read(write(none))[0]) == 0


@pytest.mark.parametrize(
    "note", ["a\rb", "a\r\nb", "a\n\nb", '"', '","', "# a", "'", "a\u2028b", "=1"]
)
def test_awkward_notes_survive(note: str):
    quoted = '"' + note.replace('"', '""') + '"'
    table = read_csv(f"{FORCE},note\n1,0,{quoted}\n")
    assert table.note == (note,)
    same(table, read_csv(write_csv(table)))


@pytest.mark.parametrize(
    ("quantity", "unit"), [(of, unit) for of in QUANTITIES for unit in of.examples]
)
@given(number=st.floats(-1e290, 1e290))
def test_every_float_survives_every_unit_within_17_digits(quantity, unit: str, number: float):
    factor = si_factor(unit, quantity)
    text = in_unit(number, factor)
    (back,) = scaled(np.array([float(text)]), factor)
    assert back == pytest.approx(number, rel=1e-15, abs=1e-290)
    assert len(Decimal(text).as_tuple().digits) <= 17


def test_500_measured_rows_in_lbf_and_mm_export_to_the_same_numbers():
    rng = np.random.default_rng(7)
    sent = np.round(rng.normal(size=(500, 8)) * [100, 100, 500, 40, 0.1, 0.2, 3, 1], 4)
    lines = ["fx [lbf],fy [lbf],fz [lbf],mz [in-lbf],ux [mm],uy [mm],uz [mm],rx [deg]"]
    lines[0] += ",ry [deg],rz [deg],source"
    lines += [",".join(map(repr, row)) + ",0,0,measured" for row in sent.tolist()]
    table = read_csv("\n".join(lines))
    assert table.errors == ()
    assert len(table) == 500
    written = list(csv.DictReader(io.StringIO(write_csv(table, UNITS))))
    names = ["fx [lbf]", "fy [lbf]", "fz [lbf]", "mz [in-lbf]"]
    names += ["ux [mm]", "uy [mm]", "uz [mm]", "rx [deg]"]
    back = np.array([[float(row[name]) for name in names] for row in written])
    assert np.array_equal(back, sent)  # to the digit
    assert {row["source"] for row in written} == {"measured"}
    same(table, read_csv(write_csv(table)))
    same(table, read_csv(write_csv(table, UNITS)))  # as few digits, so the same bits


def test_columns_that_say_nothing_are_left_out_of_an_export():
    table = read_csv("fx [N],ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]\n1,0,0,0,0,0,0\n")
    text = write_csv(table)
    assert text.splitlines() == [
        "fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],"
        "ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]",
        "1.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0",
    ]
    assert "source" not in write_json(table)


def test_an_export_in_a_wrong_unit_is_refused():
    table = read_csv("fx [N],ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]\n1,0,0,0,0,0,0\n")
    with pytest.raises(UnitError, match="is not a unit of force"):
        write_csv(table, {"force": "mm"})
