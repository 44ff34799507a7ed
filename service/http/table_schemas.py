"""Types of the replies about tables, recordings and the library, for the OpenAPI document alone.

Any key may be left out of a reply. All quantities are SI.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired

from pydantic import Field
from typing_extensions import TypedDict

from wrenchbook.service.http.schemas import Six, text

_Wrench = Annotated[list[float], Field(min_length=6, max_length=6, description="N and N·m")]
_Moved = Annotated[Six, text("m and rad; null where not measured")]
_Row = Annotated[list[float], Field(min_length=6, max_length=6)]


class TableRow(TypedDict):
    wrench: _Wrench
    displacement: _Moved
    uncertainty: NotRequired[Annotated[Six, text("m and rad; null where not known")]]
    compliance: NotRequired[
        Annotated[
            list[_Row],
            Field(min_length=6, max_length=6),
            text("tangent d(displacement)/d(wrench), a line an output, m and rad over N and N·m"),
        ]
    ]
    curvature: NotRequired[
        Annotated[list[float], text("third derivatives of the complementary energy by (F, mu), SI")]
    ]
    source: NotRequired[Annotated[str, text("fea, measured ...")]]
    note: NotRequired[str]
    fingerprint: NotRequired[Annotated[str, text("the setup that was solved")]]


class Table(TypedDict):
    rows: list[TableRow]
    units: NotRequired[Literal["SI"]]
    component: NotRequired[str]
    table_version: NotRequired[int]


class RowMistake(TypedDict, total=False):
    row: Annotated[int, text("line or place, from 1; 0: the whole file")]
    field: str
    message: Annotated[str, text("what is wrong and what to write")]


class PreviewRow(TypedDict, total=False):
    row: int
    wrench: _Wrench
    displacement: _Moved


class MistakeCause(RowMistake, total=False):
    count: int
    rows: Annotated[list[int], text("the first 10")]
    fields: Annotated[list[str], text("the first 10")]


class ImportFinding(TypedDict, total=False):
    cause: Annotated[
        str, text("outlier, sentinel, sign, unit, lever, asymmetry, drift, hysteresis, clock")
    ]
    message: Annotated[str, text("the error, its size and the remedy")]
    rows: Annotated[list[int], text("of the file, worst first, 500 at most; [] if all are meant")]
    count: Annotated[int, text("how many rows")]


Imported = TypedDict(
    "Imported",
    {
        "inserted": int,
        "existing": Annotated[
            int,
            text(
                "rows that were there already, withdrawn ones too; they stay as they are, without "
                "the slopes and second derivatives of this import"
            ),
        ],
        "errors": Annotated[list[RowMistake], text("1,000 at most")],
        "causes": Annotated[list[MistakeCause], text("the mistakes by cause")],
        "findings": Annotated[list[ImportFinding], text("probable systematic errors")],
        "dry_run": bool,
        "partial": bool,
        "format": Annotated[str, text("found from the content")],
        "gzip": bool,
        "import": Annotated[int | None, text("its number, in imports")],
        "rig": Annotated[dict[str, Any] | None, text("name, handedness, axes, points, load cell")],
        "rows": Annotated[
            dict[Literal["read", "loaded", "refused", "tare", "unmatched"], int],
            text("read = loaded + refused + tare + unmatched, but of a dry run"),
        ],
        "columns": Annotated[
            list[dict[Literal["column", "name", "unit"], str]],
            text("what each column was taken for"),
        ],
        "clock": Annotated[
            dict[Literal["applied_s", "lag_s", "uncertainty_s"], float | None] | None,
            text("of two logs: seconds added to the displacements' times, and those they show"),
        ],
        "ignored": list[str],
        "above": Annotated[list[str], text("lines of title above the header, left out")],
        "preview": list[PreviewRow],
        "table_version": Annotated[int, text("the version that holds these rows")],
        "in_use": Annotated[bool, text("whether the rows answer already")],
    },
    total=False,
)


class Card(TypedDict, total=False):
    component: str
    archived: bool
    notes: str


class Import(TypedDict, total=False):
    id: int
    rows: int
    table_version: Annotated[int | None, text("the first with all rows; null if it has none")]
    when: str
    who: str
    filename: str
    format: str
    sha256: str
    note: str
    rig: Annotated[str, text("the TOML of the rig; empty without one")]
    findings: Annotated[list[ImportFinding], text("of rows in the table; `rows` are their ids")]


ImportEdited = TypedDict(
    "ImportEdited",
    {
        "component": str,
        "import": int,
        "status": Literal["withdrawn", "restored"],
        "rows": Annotated[int, text("how many changed")],
        "current": Annotated[bool, text("whether answers come from the table without them")],
        "table_version": int,
    },
    total=False,
)


class Imports(TypedDict, total=False):
    imports: list[Import]


class DisagreeingRow(TypedDict, total=False):
    row: int
    wrench: dict[str, Any]
    output: str
    measured: float
    expected: float
    bar: float
    ratio: float


class Disagreement(TypedDict, total=False):
    measured: int
    solved: int
    beyond_range: int
    compared: int
    outside: int
    table_version: int
    outputs: Annotated[dict[str, Any], text("of each: compared, outside, mean_difference")]
    rows: list[DisagreeingRow]


class DemandCell(TypedDict, total=False):
    wrench: Annotated[Six, text("the middle of the cell, N and N·m")]
    count: int
    thin: int
    outside: int
    coverage: Literal["thin", "outside"]


class Demand(TypedDict, total=False):
    asked: Annotated[int, text("wrenches that were not covered")]
    elsewhere: Annotated[int, text("of them those that are in none of the cells")]
    since: Annotated[float | None, text("seconds since the epoch")]
    cell_size: Annotated[Six, text("N and N·m")]
    cells: list[DemandCell]
    latest: list[dict[Literal["wrench", "coverage", "when"], Six | str | float]]
