"""Write the sample tables of this folder.

Run it in a checkout with `python data/tables/make.py`. The rig is made up: a stiff bracket that
moves by 1 µm a newton and turns by 10 µrad a newton metre. `replies.json` has the query of each
file and the server's expected reply; a test uploads all of them.
"""

from __future__ import annotations

import gzip
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as arrow
import pyarrow.parquet as parquet
from openpyxl import Workbook

from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1]))  # a script finds only its own folder; `tests` is above


def axis_labels(*templates: str) -> list[str]:
    """Return each template with the axes x, y and z in place of its braces."""
    return [template.format(axis) for template in templates for axis in "xyz"]


SI = axis_labels("f{} [N]", "m{} [N*m]", "u{} [m]", "r{} [rad]")
LBF, INCH, DEGREE = 4.4482216152605, 0.0254, np.pi / 180  # N, m, rad


def rig_rows() -> np.ndarray:
    """Return the rig's rows, shape (20, 12): loads, N and N·m, and displacements, m and rad."""
    rng = np.random.default_rng(1)
    loads = rng.uniform(-1, 1, (20, 6)) * [500, 500, 800, 40, 40, 20]
    exact = loads * np.repeat([1e-6, 1e-5], 3)
    return np.hstack([loads.round(3), (exact + rng.normal(0, 1e-8, exact.shape)).round(10)])


def csv_lines(
    labels: Sequence[str], rows: Iterable[Iterable[object]], delimiter: str = ","
) -> list[str]:
    """Return the header and a line for each row; floats have all their digits."""
    return [delimiter.join(labels), *(delimiter.join(map(str, row)) for row in rows)]


def write_lines(name: str, lines: list[str], encoding: str = "utf-8", end: str = "\n") -> None:
    """Write lines to a file of this folder."""
    (HERE / name).write_bytes((end.join(lines) + end).encode(encoding))


def write_units_and_headers() -> None:
    """Write CSV files in several units and spellings."""
    rows = rig_rows()
    lines = csv_lines(SI, rows.tolist())
    write_lines("plain_si.csv", lines)
    (HERE / "gzipped.csv.gz").write_bytes(gzip.compress("\n".join(lines).encode(), mtime=0))

    labels = axis_labels("F{} [lbf]", "M{} [in-lbf]", "u{} [thou]", "r{} [deg]")
    units = np.repeat([LBF, LBF * INCH, 1e-3 * INCH, DEGREE], 3)
    write_lines("pounds_and_thou.csv", csv_lines(labels, (rows / units).round(6).tolist()))

    labels = axis_labels("Force_{}/N", "Torque_{}_Nm", "disp_{}_um", "rot_{} (mrad)")
    small = rows * np.repeat([1.0, 1.0, 1e6, 1e3], 3)
    write_lines("spelled.csv", csv_lines(labels, small.round(4).tolist()))

    labels = axis_labels("F{}", "M{}", "u{}", "r{}")
    units_row = "\t".join(np.repeat(["[N]", "[Nm]", "[mm]", "[deg]"], 3))
    scaled = (rows / np.repeat([1.0, 1.0, 1e-3, DEGREE], 3)).round(8).tolist()
    header, *body = csv_lines(labels, scaled, "\t")
    write_lines("units_row.txt", [header, units_row, *body])

    header, *body = csv_lines(
        [*SI[:3], "uz [mm]", "Note"],
        [(*row[:3], round(1e3 * row[8], 6), "Prüfstand") for row in rows.tolist()],
        ";",
    )
    body = [line.replace(".", ",") for line in body]
    write_lines("german.csv", ["# Messung 3. Mai", header, *body], "cp1252", "\r\n")

    titles = ["Rig 3: stiffness of the mounting plate", "Ann, 5 May", ""]
    lines = csv_lines(SI, rows.tolist(), "|")
    write_lines("titled.csv", [*titles, *("|" + line for line in lines)])


def write_mistakes() -> None:
    """Write files that are refused, or loaded in part."""
    rows = rig_rows().tolist()
    bad_rows = [list(row) for row in rows]
    bad_rows[3][8] = "n/a"
    bad_rows[10][9:] = [0.9, 0, 0]
    bad = csv_lines(SI, bad_rows)
    write_lines("two_bad_rows.csv", bad)
    write_lines("two_bad_rows_partial.csv", bad)
    extra = csv_lines([*SI, "Temp [C]", "Operator"], [[*row, 21.5, "KL"] for row in rows])
    write_lines("extra_columns.csv", extra)
    extra = csv_lines([*SI, "Temp"], [[*row, 21.5] for row in rows])
    write_lines("extra_columns_named.csv", extra)
    short = csv_lines(SI[:3] + SI[6:], [row[:3] + row[6:] for row in rows])
    write_lines("no_moments.csv", short)
    write_lines("no_moments_zero.csv", short)
    write_lines("thousands.csv", ["fz [N];uz [um]", "1,250;2,500", "1,500;3,000"])
    write_lines(
        "open_quote.csv", ["fz [N],uz [um],note", '100,1,"left open', "200,2,fine", "300,3,fine"]
    )
    (HERE / "report.pdf").write_bytes(b"%PDF-1.4\nno table at all\n")


def write_measurements() -> None:
    """Write tables with uncertainties, notes and a tare, and two logs of one test."""
    table = rig_rows()
    rows = table.tolist()
    labels = [*SI, "uz_err [um]", "ux_std [um]", "source", "note"]
    stated = [[*row, 0.5, 0.1, "measured", f"run {number}"] for number, row in enumerate(rows)]
    write_lines("uncertainty.csv", csv_lines(labels, stated))
    noted = [[*row, "'=HYPERLINK(0)" if at % 2 else "-"] for at, row in enumerate(rows)]
    write_lines("formula_notes.csv", csv_lines([*SI, "note"], noted))
    offset = np.array([12.0, -7.0, 30.0, 0.5, 0.2, -0.1] + [1e-5] * 6)
    unloaded = np.tile(offset, (5, 1))
    with_tare = np.vstack([unloaded, table + offset]).round(12)
    write_lines("tare.csv", csv_lines(SI, with_tare.tolist()))

    force = 400 * np.sin(np.pi * np.arange(0, 2.0, 0.01))
    counts = np.rint(force * 1e6).astype(int)
    header = ["Start Time: 3/5/2026 10:15:10 AM", "RDT Sample Rate: 100", "Force Units: N"]
    header += ["Counts per Unit Force: 1000000.0", "Torque Units: Nm"]
    header += ["Counts per Unit Torque: 1000000.0"]
    header += ["Status (hex),RDT Sequence,F/T Sequence,Fx,Fy,Fz,Tx,Ty,Tz,Time"]
    body = [f"0,{n},{4000 + n},0,0,{count},0,0,0,10:15:10" for n, count in enumerate(counts)]
    write_lines("ati_loads.csv", [*header, *body])
    times = np.arange(0.005, 2.1, 0.05)
    gauge = [f"{time:.3f},{0.4 * np.sin(np.pi * time):.6f}" for time in times]
    write_lines("gauge.csv", ["time [s],uz [mm]", *gauge])


def write_binary() -> None:
    """Write workbooks, Parquet files and exports."""
    from tests.service.table_files import read_csv, write_hdf5, write_json

    rows = rig_rows().tolist()
    for name, bad_row in (("workbook.xlsx", None), ("workbook_errors.xlsx", 6)):
        book = Workbook()
        sheet = book.worksheets[0]
        sheet.title = "Run 3"
        sheet.append(["Fz", "uz", "Remark"])
        sheet.append(["kN", "µm", ""])
        for at, row in enumerate(rows):
            uz = "#DIV/0!" if at == bad_row else 1e6 * row[8]
            sheet.append([row[2] / 1e3, uz, f"point {at}"])
        book.save(HERE / name)
    columns = {label: np.array([row[at] for row in rows]) for at, label in enumerate(SI)}
    parquet.write_table(arrow.table(columns), HERE / "frame.parquet")
    renamed = {
        "Load cell": -columns["fz [N]"],
        "LVDT 1": 1e3 * columns["uz [m]"],
        "T": columns["fx [N]"],
    }
    parquet.write_table(arrow.table(renamed), HERE / "mapped.parquet")
    table = read_csv("\n".join(csv_lines(SI, rows)))
    (HERE / "export.json").write_text(write_json(table, {"component": "rig", "table_version": 20}))
    span = np.repeat([900.0, 90.0], 3)
    meta = TableMeta("rig", 20, LoadRange(-span, span))
    (HERE / "export.h5").write_bytes(write_hdf5(table, range(1, 21), meta))


if __name__ == "__main__":
    write_units_and_headers()
    write_mistakes()
    write_measurements()
    write_binary()
