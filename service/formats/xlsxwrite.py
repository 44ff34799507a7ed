"""Write a table as an XLSX workbook: a sheet of rows, and one that says what they are.

openpyxl writes 16 significant digits, which is one too few for every third float; here the cells
get their digits as text, of which `xlsxread` and every spreadsheet make the number. Texts are
typed as such, so that none of them is a formula.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from service.formats.layout import Layout
from service.formats.parsed import TableRows
from service.formats.sheettext import escaped
from service.formats.xlsxread import SHEET_NOTES

MOST_ROWS = 1_048_575  # of a sheet, beside its header (ECMA-376)


class SheetFullError(ValueError):
    """The table has more rows than a sheet."""


def write_xlsx(
    path: Path, pieces: Iterable[TableRows], layout: Layout, about: Mapping[str, str]
) -> None:
    """Write pieces of a table; `about` stands on a sheet of its own.

    Raises
    ------
    SheetFullError
        If the table has more rows than a sheet can.
    """
    # Imported when it is needed, as in `xlsxread`.
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    sheet = book.create_sheet("table")
    sheet.append([_cell(sheet, label, "s") for label in layout.labels()])
    count = 0
    for piece in pieces:
        numbers = [column.digits(piece) for column in layout.numbers]
        texts = layout.words(piece)
        count += len(piece.wrench)
        if count > MOST_ROWS:
            raise SheetFullError(
                f"the table has more than {MOST_ROWS:,} rows, the most of a sheet; export it as "
                "CSV, Parquet or HDF5"
            )
        kinds = ["n"] * len(numbers) + ["s"] * len(texts)
        for cells in zip(*numbers, *texts, strict=True):
            sheet.append([_cell(sheet, *pair) for pair in zip(cells, kinds, strict=True)])
    notes = book.create_sheet(SHEET_NOTES)
    for word, meaning in about.items():
        notes.append([_cell(notes, word, "s"), _cell(notes, meaning, "s")])
    book.save(path)


def _cell(sheet: Any, text: str, kind: str) -> Any:
    """Return a cell of a text, or of a number by its digits; None for an empty one."""
    from openpyxl.cell import WriteOnlyCell

    if not text:
        return None
    cell = WriteOnlyCell(sheet)
    cell._value = text if kind == "n" else escaped(text)
    cell.data_type = kind
    return cell
