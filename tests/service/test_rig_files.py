"""Files of test rigs that are no text: TDMS, old workbooks, MATLAB's and pandas' other forms."""

import io
import struct
from dataclasses import replace

import h5py
import numpy as np
import openpyxl
import pyarrow as arrow
import pytest
from nptdms import ChannelObject, TdmsWriter
from pyarrow.parquet import write_table
from scipy.io import savemat

from tests.service.table_files import ZERO, read
from tests.service.test_table_files import DIALECTS
from wrenchbook.service.formats.options import ReadReport
from wrenchbook.service.formats.read import read_logs, read_untrusted
from wrenchbook.service.formats.text import PIECE

RNG = np.random.default_rng(5)
FORCE, PATH = RNG.uniform(-2, 2, 25), RNG.uniform(-0.5, 0.5, 25)  # kN, mm
NAMED = replace(ZERO, mapping={"Kraft": "fz", "Weg": "-uz"})
IN_UNITS = replace(ZERO, mapping={"Kraft": "fz [kN]", "Weg": "-uz [mm]"})
KN, MM = {"unit_string": "kN"}, {"unit_string": "mm"}
WAVE = {"wf_increment": 0.25, "wf_start_offset": 0.5}


def assert_loaded(content: bytes, options=NAMED, n: int = 25):
    table, report = read(content, options)
    assert not report.mistakes, report.mistakes.listed()
    np.testing.assert_allclose(table.wrench[:, 2], FORCE[:n] * 1000, rtol=1e-15, atol=0)
    np.testing.assert_allclose(table.displacement[:, 2], -PATH[:n] / 1000, rtol=1e-15, atol=0)
    return report


def message(content: bytes, options=NAMED) -> str:
    table, report = read(content, options)
    assert len(table) == 0
    return report.mistakes.listed()[0].message


def tdms(**groups) -> bytes:
    """A TDMS file: of each group the values and properties of its channels."""
    file = io.BytesIO()
    with TdmsWriter(file) as writer:
        for group, channels in groups.items():
            objects = [ChannelObject(group, n, np.asarray(v), p) for n, (v, p) in channels.items()]
            writer.write_segment(objects)
    return file.getvalue()


RUN = {"Kraft": (FORCE, KN), "Weg": (PATH, MM)}


def test_channels_of_a_tdms_group_are_columns_in_their_units():
    report = assert_loaded(tdms(about={"Version": ([1.0], {})}, run=RUN))
    assert (report.format, report.sheets, report.sheet) == ("tdms", ["about", "run"], "run")


def test_a_tdms_file_is_read_in_pieces_of_many_segments():
    force = np.arange(PIECE + 30.0) % 100
    parts = [{"Kraft": (p, KN), "Weg": (p, MM)} for p in np.split(force, [7, PIECE - 1])]
    file = io.BytesIO()
    with TdmsWriter(file) as writer:
        for part in parts:
            writer.write_segment([ChannelObject("run", n, v, p) for n, (v, p) in part.items()])
    table, _ = read(file.getvalue(), NAMED)
    assert np.array_equal(table.wrench[:, 2], force * 1000)


@pytest.mark.parametrize("lost", [1, 8, 40, 130])
def test_a_tdms_file_that_was_cut_off_is_refused_and_loses_no_rows_in_silence(lost):
    file = io.BytesIO()
    with TdmsWriter(file) as writer:
        for part in (slice(0, 12), slice(12, 25)):
            channels = {"Kraft": (FORCE[part], KN), "Weg": (PATH[part], MM)}
            writer.write_segment([ChannelObject("run", n, v, p) for n, (v, p) in channels.items()])
    assert "cut off" in message(file.getvalue()[:-lost])


def test_a_tdms_waveform_has_times_of_its_start_and_increment():
    log = tdms(run={"Kraft": (FORCE, KN | WAVE), "Weg": (PATH, MM)})
    table, _ = read(log, replace(NAMED, role="displacements"))
    assert np.array_equal(table.time, 0.5 + 0.25 * np.arange(25))


def test_a_labview_log_and_a_tdms_log_join_by_their_clocks(tmp_path):
    loads, moves = tmp_path / "loads", tmp_path / "moves"
    head = DIALECTS["LabVIEW: channels of two clocks"]["text"].partition("\t1.5")[0]
    rows = "".join(f"\t{force!r}\t0\n" for force in FORCE.tolist())
    loads.write_text(head.replace("X0\t0\t0.1", "X0\t0.5\t0.5") + rows)
    moves.write_bytes(tdms(run={"Weg": (PATH[::2], MM | WAVE | {"wf_increment": 0.5})}))
    report = ReadReport()
    options = replace(ZERO, mapping={"Kraft": "fz", "Weg": "uz"})
    (piece,) = read_logs(loads, moves, options, report)
    assert not report.mistakes
    np.testing.assert_allclose(piece.wrench[:, 2], 1000 * FORCE[::2], rtol=1e-15)
    assert not list(read_logs(loads, moves, replace(ZERO, mapping={"2": "fz"}), report))
    assert "is ambiguous with two logs" in report.mistakes.listed()[0].message


def test_displacements_in_gaps_of_the_loads_are_told_from_those_outside(tmp_path):
    loads, moves = tmp_path / "loads", tmp_path / "moves"
    loads.write_text("time [s],fz [N]\n0,0\n1,10\n2,20\n")
    for times, lag, words in (
        ((0.5, 1.5), 0.0, "2 lie between two loads more than 0.1 s apart"),
        ((7.0, 8.0), 0.0, "0 s to 2 s; the displacements' are 7 s to 8 s"),
        ((0.5, 1.5), 1e308, "no displacement lies within the times of the loads, 0 s to 2 s"),
    ):
        moves.write_text("time [s],uz [mm]\n" + "".join(f"{t},0.1\n" for t in times))
        report = ReadReport()
        options = replace(ZERO, max_gap_s=0.1, time_offset_s=lag)
        assert not any(map(len, read_logs(loads, moves, options, report)))
        assert words in report.mistakes.listed()[0].message


def test_times_of_logs_without_a_common_time_are_dates_if_the_logs_have_dates(tmp_path):
    """They were seconds since 1970, rounded to six digits."""
    loads, moves = tmp_path / "loads", tmp_path / "moves"
    loads.write_text("time,fz [N]\n2026-03-01 10:00:00,0\n2026-03-01 10:00:02,1\n")
    moves.write_text("time,uz [mm]\n2026-03-01 12:00:00,0.1\n2026-03-01 12:00:01,0.2\n")
    report = ReadReport()
    assert not any(map(len, read_logs(loads, moves, ZERO, report)))
    (mistake,) = report.mistakes.listed()
    assert "of the loads, 2026-03-01 10:00:00 to 2026-03-01 10:00:02; " in mistake.message
    assert "displacements' are 2026-03-01 12:00:00 to 2026-03-01 12:00:01. " in mistake.message


@pytest.mark.parametrize(
    ("times", "says"),
    [
        (("23:59:59.5", "0:00:00.5"), "00:00:00.500 is not after the sample before, 23:59:59.500;"),
        (("1.7e12", "1e12"), "1e+12 s is not after the sample before, 1.7e+12 s;"),
    ],
)
def test_a_log_that_passes_midnight_is_refused_with_its_clock_times(tmp_path, times, says):
    """They were negative seconds since 1970. A number beyond every year stays a number."""
    loads, moves = tmp_path / "loads", tmp_path / "moves"
    unit = " [s]" if "e" in times[0] else ""
    loads.write_text(f"time{unit},fz [N]\n{times[0]},0\n{times[1]},1\n")
    moves.write_text(f"time{unit},uz [mm]\n{times[0]},0.1\n")
    report = ReadReport()
    assert not any(map(len, read_logs(loads, moves, ZERO, report)))
    assert says in report.mistakes.listed()[0].message


def test_of_two_tdms_groups_with_columns_the_sender_names_one():
    content = tdms(first={"Kraft": ([0.0], KN), "Weg": ([0.0], MM)}, second=RUN)
    assert read(content, NAMED)[1].sheet == "first"
    assert_loaded(content, replace(NAMED, sheet="second"))
    assert "'third'; choose first, second" in message(content, replace(NAMED, sheet="third"))
    assert message(tdms(run={"Kraft": ([], KN)})).startswith("there is no sheet with data")


@pytest.mark.parametrize(
    ("weg", "says"),
    [
        (
            (PATH[:5], MM),
            "its channels differ in length (Kraft 25, Weg 5); resample them to one time",
        ),
        (
            (PATH, MM | WAVE | {"wf_increment": 0.1}),
            "Kraft and Weg have different times (wf_increment 0.25 and 0.1)",
        ),
    ],
)
def test_tdms_channels_of_two_clocks_are_refused_and_load_resampled(weg, says):
    refusal = message(tdms(run={"Kraft": (FORCE, KN | WAVE), "Weg": weg}))
    assert says in refusal
    assert "cannot be read as TDMS" not in refusal
    assert_loaded(tdms(run={"Kraft": (FORCE, KN | WAVE), "Weg": (PATH, MM | WAVE)}))


def xls(sheets: dict[str, list[list]]) -> bytes:
    """An old workbook of numbers and texts: BIFF8 in a compound file (MS-XLS, MS-CFB)."""

    def record(kind: int, content: bytes = b"") -> bytes:
        return struct.pack("<HH", kind, len(content)) + content

    def text(value: str, size: str) -> bytes:
        return struct.pack(f"<{size}B", len(value), 1) + value.encode("utf-16-le")

    def begin(kind: int) -> bytes:
        return record(0x0809, struct.pack("<HHHHII", 0x0600, kind, 0, 0, 0, 0))

    def cell(row: int, column: int, value) -> bytes:
        at = struct.pack("<HHH", row, column, 0)
        if isinstance(value, str):
            return record(0x0204, at + text(value, "H"))
        return record(0x0203, at + struct.pack("<d", value))

    bodies = [
        begin(0x10)
        + b"".join(cell(r, c, v) for r, row in enumerate(rows) for c, v in enumerate(row))
        + record(0x0A)
        for rows in sheets.values()
    ]
    heads = [record(0x85, struct.pack("<IH", 0, 0) + text(name, "B")) for name in sheets]
    at, book = len(begin(5)) + len(b"".join(heads)) + len(record(0x0A)), begin(5)
    for head, body in zip(heads, bodies, strict=True):
        book += head[:4] + struct.pack("<I", at) + head[8:]
        at += len(body)
    stream = (book + record(0x0A) + b"".join(bodies)).ljust(4096, b"\0")
    stream += bytes(-len(stream) % 512)
    end, free = 0xFFFFFFFE, 0xFFFFFFFF
    chain = [0xFFFFFFFD, end, *range(3, len(stream) // 512 + 2), end]
    table = struct.pack("<128I", *chain, *[free] * (128 - len(chain)))

    def entry(name: str, kind: int, child: int, first: int, size: int) -> bytes:
        label = f"{name}\0".encode("utf-16-le")
        links = struct.pack("<HBBIII", len(label), kind, 1, free, free, child)
        return label.ljust(64, b"\0") + links + bytes(36) + struct.pack("<IQ", first, size)

    folder = entry("Root Entry", 5, 1, end, 0) + entry("Workbook", 2, free, 2, len(stream))
    numbers = (0x3E, 3, 0xFFFE, 9, 6, 0, 1, 1, 0, 4096, end, 0, end, 0)
    head = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(16) + struct.pack("<5H6x9I", *numbers)
    head += struct.pack("<109I", 0, *[free] * 108)
    return head + table + folder.ljust(512, b"\0") + stream


ROWS = [["Kraft", "Weg"], ["kN", "mm"], *map(list, zip(FORCE.tolist(), PATH.tolist(), strict=True))]
SHEETS = {"cover": [], "run 3": ROWS, "run 4": [["Fz [N]", "uz [m]"], [1.0, 2.0]]}


def xlsx(sheets: dict[str, list[list]]) -> bytes:
    book, file = openpyxl.Workbook(), io.BytesIO()
    book.remove(book.worksheets[0])
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(file)
    return file.getvalue()


@pytest.mark.parametrize("write", [xls, xlsx])
def test_a_workbook_says_which_sheets_it_has_and_which_was_read(write):
    content = write(SHEETS)
    report = assert_loaded(content)
    assert (report.sheets, report.sheet) == (list(SHEETS), "run 3")
    table, report = read(content, replace(ZERO, sheet="run 4"))
    assert (table.displacement[:, 2].tolist(), report.sheet) == ([2.0], "run 4")
    assert "no sheet 'run 5'; choose cover, run 3, run 4" in message(
        content, replace(NAMED, sheet="run 5")
    )


@pytest.mark.parametrize("content", [xls(SHEETS), tdms(run=RUN)], ids=["xls", "tdms"])
def test_a_damaged_file_of_a_rig_is_named(content):
    for cut in (9, 60, len(content) // 2):
        assert message(content[:cut])


@pytest.mark.parametrize(
    ("module", "content"), [("python_calamine", xls(SHEETS)), ("nptdms", tdms(run=RUN))]
)
def test_a_reader_that_is_not_installed_is_named_with_its_command(monkeypatch, module, content):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    assert "pip install 'wrenchbook[rig]'" in message(content)


def test_a_cell_far_from_all_others_ends_the_reader_and_not_the_server(tmp_path):
    far = tmp_path / "far.xls"
    far.write_bytes(xls({"run": [*ROWS, *[[]] * 65_000, [""] * 3_000]}))
    (error,) = read_untrusted([far], NAMED).report["errors"]
    assert "Its reader stopped without an answer" in error["message"]


# -- MATLAB and pandas ---------------------------------------------------------------------------


def mat(**variables) -> bytes:
    file = io.BytesIO()
    savemat(file, variables)
    return file.getvalue()


def records(*fields) -> np.ndarray:
    """A struct array of MATLAB."""
    array = np.zeros((len(fields), 1), dtype=[("Kraft", "O"), ("Weg", "O")])
    for at, values in enumerate(fields):
        array[at, 0] = values
    return array


def opaque(kind: bytes) -> bytes:
    """A MAT file of one object of a class, as MATLAB stores a table."""

    def element(number: int, content: bytes) -> bytes:
        return struct.pack("<II", number, len(content)) + content + bytes(-len(content) % 8)

    size, link = struct.pack("<ii", 6, 1), struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)
    flags = [element(6, struct.pack("<II", number, 0)) for number in (13, 17)]
    value = flags[0] + element(5, size) + element(1, b"") + element(6, link)
    texts = b"".join(element(1, word) for word in (b"T", b"MCOS", kind))
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    return head + element(14, flags[1] + texts + element(14, value))


def hdf5(tmp_path, fill) -> bytes:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        fill(file)
    return (tmp_path / "a.h5").read_bytes()


STRUCT = mat(S={"Kraft": FORCE[:, None], "Weg": PATH[:, None]})  # table2struct(T,'ToScalar',true)


def test_records_of_matlab_are_rows_and_an_empty_field_is_unknown():
    fields = list(zip(FORCE.tolist(), PATH.tolist(), strict=True))
    assert_loaded(mat(S=records(*fields)), IN_UNITS)
    table, report = read(mat(S=records(*fields[:4], (1.0, np.zeros((0, 0))))), IN_UNITS)
    assert [(error.row, error.field) for error in report.mistakes.listed()] == [(5, "Weg")]
    assert len(table) == 4
    said = message(mat(S=records((1.0, 2.0), (1.0, np.ones(3)))), IN_UNITS)
    assert "Weg is not one (shape (2,), type object); save each column" in said


@pytest.mark.parametrize("level", ["5", "7.3"])
@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("table", "S = table2struct(T,'ToScalar',true)"),
        ("timetable", "table2struct(timetable2table(T,'ConvertRowTimes',false),'ToScalar',true)"),
        ("string", "save it as double"),
    ],
)
def test_an_object_of_matlab_is_refused_by_name_and_loads_as_a_struct(tmp_path, level, kind, says):
    def fill(file):
        file["T"] = np.arange(6, dtype="u4").reshape(1, 6)
        file["T"].attrs.update(MATLAB_class=np.bytes_(kind), MATLAB_object_decode=3)

    content = opaque(kind.encode()) if level == "5" else hdf5(tmp_path, fill)
    assert f"has T, a {kind} object" in message(content)
    assert says in message(content)
    assert_loaded(STRUCT, IN_UNITS)


def test_records_of_matlab_7_3_are_refused_by_name(tmp_path):
    def fill(file):
        file["#refs#/a"] = np.ones((1, 1))
        file["S/Kraft"] = np.full((1, 2), file["#refs#/a"].ref, dtype=h5py.ref_dtype)

    assert "table2struct(struct2table(S),'ToScalar',true)" in message(hdf5(tmp_path, fill))


@pytest.mark.parametrize("key", ["df", "runs/one"])
def test_a_frame_of_to_hdf_is_refused_by_name_and_loads_by_to_parquet(tmp_path, key):
    def fill(file):
        group = file.create_group(key)
        group.attrs["pandas_type"] = b"frame"
        for name, values in {"axis0": [b"Kraft", b"Weg"], "axis1": [0, 1]}.items():
            group[name] = values
        group["block0_values"] = np.ones((2, 2))

    says = f"pandas.read_hdf('table.h5', '{key}').to_parquet('table.parquet')"
    assert says in message(hdf5(tmp_path, fill))
    file = io.BytesIO()
    write_table(arrow.table({"Kraft": FORCE, "Weg": PATH, "__index_level_0__": range(25)}), file)
    assert_loaded(file.getvalue(), IN_UNITS)
