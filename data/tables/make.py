"""Make the sample files of this folder, and the reply that each gets.

Run it in a checkout with `python data/tables/make.py`. The rig is made up: a stiff bracket that
moves by 1 µm a newton and turns by 10 µrad a newton metre. `replies.json` names for each file the
query it is sent with and what the server says; a test sends all of them.
"""

from __future__ import annotations

import gzip
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent.parent))  # started by its path, it is beside no room

LOADS = ["fx", "fy", "fz", "mx", "my", "mz"]
MOVES = ["ux", "uy", "uz", "rx", "ry", "rz"]
SI = [f"{name} [N]" for name in LOADS[:3]] + [f"{name} [N*m]" for name in LOADS[3:]]
SI += [f"{name} [m]" for name in MOVES[:3]] + [f"{name} [rad]" for name in MOVES[3:]]
LBF, INCH, DEGREE = 4.4482216152605, 0.0254, np.pi / 180
ALL_IN = {"status": 200, "inserted": 20, "read": 20, "loaded": 20}
ZERO = {"missing_loads": "zero"}


def measured(count: int = 20, seed: int = 1) -> np.ndarray:
    """Rows of the rig, (count, 12), SI."""
    rng = np.random.default_rng(seed)
    loads = rng.uniform(-1, 1, (count, 6)) * [500, 500, 800, 40, 40, 20]
    moves = loads * [1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5]
    return np.hstack([loads.round(3), (moves + rng.normal(0, 1e-8, moves.shape)).round(10)])


def lines(labels: list[str], rows: Any, mark: str = ",") -> list[str]:
    """Lines of a CSV."""
    cells = [[repr(cell) if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    return [mark.join(labels), *(mark.join(row) for row in cells)]


def text(name: str, content: list[str], encoding: str = "utf-8", end: str = "\n") -> None:
    """Write lines."""
    (HERE / name).write_bytes((end.join(content) + end).encode(encoding))


def plain() -> None:
    """CSV in several units and spellings."""
    rows = measured().tolist()
    text("plain_si.csv", lines(SI, rows))
    (HERE / "gzipped.csv.gz").write_bytes(
        gzip.compress("\n".join(lines(SI, rows)).encode(), mtime=0)
    )
    imperial = [f"F{axis} [lbf]" for axis in "xyz"] + [f"M{axis} [in-lbf]" for axis in "xyz"]
    imperial += [f"u{axis} [thou]" for axis in "xyz"] + [f"r{axis} [deg]" for axis in "xyz"]
    scale = [LBF] * 3 + [LBF * INCH] * 3 + [1e-3 * INCH] * 3 + [DEGREE] * 3
    text("pounds_and_thou.csv", lines(imperial, (measured() / scale).round(6).tolist()))
    names = [f"Force_{axis}/N" for axis in "xyz"] + [f"Torque_{axis}_Nm" for axis in "xyz"]
    names += [f"disp_{axis}_um" for axis in "xyz"] + [f"rot_{axis} (mrad)" for axis in "xyz"]
    micro = measured() * ([1.0] * 6 + [1e6] * 3 + [1e3] * 3)
    text("spelled.csv", lines(names, micro.round(4).tolist()))
    bare = ["Fx", "Fy", "Fz", "Mx", "My", "Mz", "ux", "uy", "uz", "rx", "ry", "rz"]
    units = ["[N]"] * 3 + ["[Nm]"] * 3 + ["[mm]"] * 3 + ["[deg]"] * 3
    scaled = (measured() / ([1.0] * 6 + [1e-3] * 3 + [DEGREE] * 3)).round(8).tolist()
    head, *body = lines(bare, scaled, "\t")
    text("units_row.txt", [head, "\t".join(units), *body])
    german = lines(
        [f"{name} [N]" for name in LOADS[:3]] + ["uz [mm]", "Note"],
        [(*row[:3], round(1e3 * row[8], 6), "Prüfstand") for row in rows],
        ";",
    )
    comma = [german[0], *(line.replace(".", ",") for line in german[1:])]
    text("german.csv", ["# Messung 3. Mai", *comma], "cp1252", "\r\n")
    titles = ["Rig 3: stiffness of the mounting plate", "Ann, 5 May", ""]
    text("titled.csv", [*titles, *("|" + line for line in lines(SI, measured().tolist(), "|"))])


def mistakes() -> None:
    """Files that are refused, or loaded in part."""
    good = lines(SI, measured().tolist())
    bad = list(good)
    bad[4] = bad[4].replace(bad[4].split(",")[8], "n/a")
    bad[11] = ",".join([*bad[11].split(",")[:9], "0.9", "0", "0"])
    text("two_bad_rows.csv", bad)
    text("two_bad_rows_partial.csv", bad)
    text(
        "extra_columns.csv",
        [good[0] + ",Temp [C],Operator", *(f"{row},21.5,KL" for row in good[1:])],
    )
    text("extra_columns_named.csv", [good[0] + ",Temp", *(f"{row},21.5" for row in good[1:])])
    short = [",".join(line.split(",")[:3] + line.split(",")[6:]) for line in good]
    text("no_moments.csv", short)
    text("no_moments_zero.csv", short)
    text("thousands.csv", ["fz [N];uz [um]", "1,250;2,500", "1,500;3,000"])
    text("open_quote.csv", ["fz [N],uz [um],note", '100,1,"left open', "200,2,fine", "300,3,fine"])
    (HERE / "report.pdf").write_bytes(b"%PDF-1.4\nno table at all\n")


def tests_and_logs() -> None:
    """Uncertainties, notes, a tare, and two logs of one test."""
    rows = measured().tolist()
    labels = [*SI, "uz_err [um]", "ux_std [um]", "source", "note"]
    stated = [[*row, 0.5, 0.1, "measured", f"run {at}"] for at, row in enumerate(rows)]
    text("uncertainty.csv", lines(labels, stated))
    notes = [[*row, "'=HYPERLINK(0)" if at % 2 else "-"] for at, row in enumerate(rows)]
    text("formula_notes.csv", lines([*SI, "note"], notes))
    offset = np.array([12.0, -7.0, 30.0, 0.5, 0.2, -0.1] + [1e-5] * 6)
    unloaded = np.tile(offset, (5, 1))
    text("tare.csv", lines(SI, np.vstack([unloaded, measured() + offset]).round(12).tolist()))
    time = np.arange(0, 2.0, 0.01)
    force = 400 * np.sin(np.pi * time)
    counts = np.rint(force * 1e6).astype(int)
    head = ["Start Time: 3/5/2026 10:15:10 AM", "RDT Sample Rate: 100", "Force Units: N"]
    head += ["Counts per Unit Force: 1000000.0", "Torque Units: Nm"]
    head += ["Counts per Unit Torque: 1000000.0"]
    head += ["Status (hex),RDT Sequence,F/T Sequence,Fx,Fy,Fz,Tx,Ty,Tz,Time"]
    body = [f"0,{n},{4000 + n},0,0,{count},0,0,0,10:15:10" for n, count in enumerate(counts)]
    text("ati_loads.csv", [*head, *body])
    when = np.arange(0.005, 2.1, 0.05)
    gauge = [f"{t:.3f},{0.4 * np.sin(np.pi * t):.6f}" for t in when]
    text("gauge.csv", ["time [s],uz [mm]", *gauge])


def binary() -> None:
    """Workbooks, a data frame's file, and exports."""
    import pyarrow as arrow
    import pyarrow.parquet as parquet
    from openpyxl import Workbook

    from tests.service.table_files import read_csv, write_hdf5, write_json
    from wrenchbook.surrogate.table.meta import TableMeta
    from wrenchbook.surrogate.table.rows import LoadRange

    rows = measured().tolist()
    for name, spoilt in (("workbook.xlsx", False), ("workbook_errors.xlsx", True)):
        book = Workbook()
        sheet = book.active
        sheet.title = "Run 3"
        sheet.append(["Fz", "uz", "Remark"])
        sheet.append(["kN", "µm", ""])
        for at, row in enumerate(rows):
            broken = spoilt and at == 6
            sheet.append([row[2] / 1e3, "#DIV/0!" if broken else 1e6 * row[8], f"point {at}"])
        book.save(HERE / name)
    columns = {label: np.array([row[at] for row in rows]) for at, label in enumerate(SI)}
    parquet.write_table(arrow.table(columns), HERE / "frame.parquet")
    renamed = {
        "Load cell": -columns["fz [N]"],
        "LVDT 1": 1e3 * columns["uz [m]"],
        "T": columns["fx [N]"],
    }
    parquet.write_table(arrow.table(renamed), HERE / "mapped.parquet")
    table = read_csv("\n".join(lines(SI, rows)))
    (HERE / "export.json").write_text(write_json(table, {"component": "rig", "table_version": 20}))
    span = np.array([900.0] * 3 + [90.0] * 3)
    meta = TableMeta("rig", 20, LoadRange(-span, span))
    (HERE / "export.h5").write_bytes(write_hdf5(table, range(1, 21), meta))


REPLIES: dict[str, dict[str, Any]] = {
    "plain_si.csv": {**ALL_IN, "format": "csv"},
    "pounds_and_thou.csv": {**ALL_IN, "format": "csv"},
    "spelled.csv": {**ALL_IN, "format": "csv"},
    "units_row.txt": {**ALL_IN, "format": "csv"},
    "german.csv": {**ALL_IN, "format": "csv", "query": ZERO},
    "titled.csv": {
        **ALL_IN,
        "format": "csv",
        "above": ["Rig 3: stiffness of the mounting plate", "Ann, 5 May"],
    },
    "gzipped.csv.gz": {**ALL_IN, "format": "csv", "gzip": True},
    "uncertainty.csv": {**ALL_IN, "format": "csv"},
    "formula_notes.csv": {**ALL_IN, "format": "csv"},
    "tare.csv": {**ALL_IN, "read": 25, "tare": 5, "query": {"tare": 5}},
    "ati_loads.csv": {
        "status": 200,
        "displacements": "gauge.csv",
        "query": ZERO,
        "read": 42,
        "loaded": 40,
        "inserted": 40,
        "unmatched": 2,
        "ignored": ["Status (hex)", "RDT Sequence", "F/T Sequence"],
    },
    "workbook.xlsx": {
        **ALL_IN,
        "format": "xlsx",
        "query": {**ZERO, "ignore": "Remark", "sheet": "Run 3"},
        "ignored": ["Remark"],
        "sheets": ["Run 3"],
        "sheet": "Run 3",
    },
    "workbook_errors.xlsx": {
        "status": 422,
        "query": {**ZERO, "ignore_extra": "true"},
        "errors": [[9, "uz", "is a spreadsheet's error"]],
    },
    "frame.parquet": {**ALL_IN, "format": "parquet"},
    "mapped.parquet": {
        **ALL_IN,
        "format": "parquet",
        "query": {
            **ZERO,
            "ignore": "T",
            "mapping": '{"Load cell": "-fz [N]", "LVDT 1": "uz [mm]"}',
        },
        "ignored": ["T"],
    },
    "export.json": {**ALL_IN, "format": "json"},
    "export.h5": {**ALL_IN, "format": "hdf5"},
    "two_bad_rows.csv": {
        "status": 422,
        "errors": [[5, "uz [m]", "'n/a' is not a number"], [12, "rx [rad]", "a table ends at 20"]],
    },
    "two_bad_rows_partial.csv": {
        "status": 200,
        "query": {"partial": "true"},
        "read": 20,
        "loaded": 18,
        "refused": 2,
        "inserted": 18,
        "errors": [[5, "uz [m]", "'n/a' is not a number"], [12, "rx [rad]", "a table ends at 20"]],
    },
    "extra_columns.csv": {
        "status": 422,
        "errors": [
            [1, "Temp [C]", "is not a column of a table"],
            [1, "Operator", "is not a column of a table"],
        ],
    },
    "extra_columns_named.csv": {**ALL_IN, "query": {"ignore": "Temp"}, "ignored": ["Temp"]},
    "no_moments.csv": {"status": 422, "errors": [[1, "header", "say missing_loads=zero"]]},
    "no_moments_zero.csv": {**ALL_IN, "query": ZERO},
    "thousands.csv": {
        "status": 422,
        "query": ZERO,
        "errors": [[2, "fz [N]", "say decimal=, (--decimal ,) for 1.250"]],
    },
    "open_quote.csv": {
        "status": 422,
        "query": ZERO,
        "errors": [[2, "line", "is a quotation mark left open?"]],
    },
    "report.pdf": {"status": 422, "errors": [[0, "file", "is a PDF"]]},
}


def main() -> None:
    """Write all files."""
    for step in (plain, mistakes, tests_and_logs, binary):
        step()
    (HERE / "replies.json").write_text(json.dumps(REPLIES, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
