"""The query of a bulk import and its reply, as pydantic and OpenAPI have them."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, Literal

import orjson
from pydantic import Field, field_validator, model_validator
from typing_extensions import TypedDict

from wrenchbook.service.formats.cells import text_problem
from wrenchbook.service.formats.options import MAX_ZERO_ROWS, Options
from wrenchbook.service.formats.options import Format as FileFormat
from wrenchbook.service.formats.read import MAX_PREVIEW
from wrenchbook.service.formats.rig import MAX_RIG, NAME, OPTIONS, Rig, RigError, rig_text
from wrenchbook.service.http.bodies import Body
from wrenchbook.service.messages import ImportFinding, PreviewRow, RowMistake, RowMistakes

_MAX_COLUMNS = 1000
# Options of files, which a block is not.
_OF_FILES = {"tare", "preview", "sheet", "time_offset_s", "max_gap_s", "filename"}
_OF_FILES |= {"skip_cycles", "branch", "thin", "mean_cycles"}
WAIT_S = 10.0  # a table of 20,000 measured rows is built by then
MAX_WAIT_S = 600.0  # a million rows take minutes
_POINT = "x,y,z from the interface's point in its frame, m: the point that"
_LOAD_CELL = "the point where it is now, or where it was: translation x force is taken off them"
_THIN = "rows of a pass of the main load within it become their mean"
_MEAN = "become their mean, with its 95 % half width as uncertainty"
_Text = Annotated[str, Field(max_length=1000)]


class ImportQuery(Body):
    """The query of an import; what is not named is refused."""

    format: Annotated[
        FileFormat | None, Field(description="checked against the content; detected if left out")
    ] = None
    dry_run: Annotated[bool, Field(description="check and count; nothing is changed")] = False
    partial: Annotated[bool, Field(description="load the good rows of a file with mistakes")] = (
        False
    )
    preview: Annotated[
        int, Field(ge=0, le=MAX_PREVIEW, description="so many first good rows come back")
    ] = 0
    decimal: Annotated[
        Literal[".", ","] | None, Field(description="mark of numbers in text; detected if left out")
    ] = None
    ignore: Annotated[
        list[_Text],
        Field(default_factory=list, max_length=_MAX_COLUMNS, description="columns to leave out"),
    ]
    ignore_extra: Annotated[bool, Field(description="leave out all unknown columns")] = False
    mapping: Annotated[
        str | None,
        Field(
            max_length=100_000,
            description='JSON: from columns of the file to what they are, {"Load cell": "fz [N]"}; '
            "a - before it turns the sign, without [N] the file's unit counts, and 3 is the third "
            "column unless that is a label",
        ),
    ] = None
    missing_loads: Annotated[
        Literal["zero"] | None, Field(description="loads without a column were zero")
    ] = None
    tare: Annotated[
        int, Field(ge=0, le=MAX_ZERO_ROWS, description="rows whose mean is taken off all others")
    ] = 0
    sheet: Annotated[
        str | None, Field(max_length=200, description="xlsx, xls: its name; tdms: the group's")
    ] = None
    frame: Annotated[
        _Text, Field(description="the rig's axes in the interface's: x=-y,y=x,z=z or nine numbers")
    ] = ""
    load_point: Annotated[_Text, Field(description=f"{_POINT} moments are about")] = ""
    displacement_point: Annotated[_Text, Field(description=f"{_POINT} was measured")] = ""
    load_cell: Annotated[
        Literal["moving", "fixed"] | None, Field(description=f"moments are about {_LOAD_CELL}")
    ] = None
    rig: Annotated[
        str,
        Field(
            max_length=MAX_RIG,
            description="TOML of a profile, or the name of one of /v1/rigs, kept with the import: "
            f"these four, name, {', '.join(OPTIONS)}. Options of the query win",
        ),
    ] = ""
    skip_cycles: Annotated[int, Field(ge=0, lt=2**31, description="first ones to leave out")] = 0
    branch: Annotated[
        Literal["loading", "unloading"] | None, Field(description="the one of the main load")
    ] = None
    thin: Annotated[
        float | None, Field(gt=0, le=0.5, description=f"part of the load range: {_THIN}")
    ] = None
    mean_cycles: Annotated[bool, Field(description=f"repeated ones {_MEAN}")] = False
    time_offset_s: Annotated[
        Annotated[float, Field(allow_inf_nan=False)] | Literal["auto"],
        Field(
            description="added to the displacements' times, s; auto: the lag that the logs show. "
            "`lag` is another name of it"
        ),
    ] = 0.0
    max_gap_s: Annotated[
        float | None,
        Field(gt=0, allow_inf_nan=False, description="between loads that a row lies between, s"),
    ] = None
    wait_s: Annotated[
        float,
        Field(ge=0, le=MAX_WAIT_S, allow_inf_nan=False, description="for answers from the rows, s"),
    ] = WAIT_S
    append: Annotated[
        str | None,
        Field(
            min_length=1,
            max_length=200,
            description="the name of a running test: this JSON, of 1,000 rows and 1 MB at most, is "
            "appended to its import, which the first block makes. wait_s is 0 if left out",
        ),
    ] = None
    note: Annotated[str, Field(max_length=10_000, description="kept with the import")] = ""
    filename: Annotated[str, Field(max_length=1000, description="kept with the import")] = ""

    @model_validator(mode="before")
    @classmethod
    def _lag_is_the_offset(cls, values: Any) -> Any:
        if isinstance(values, dict) and "lag" in values and "time_offset_s" not in values:
            return {
                "time_offset_s" if name == "lag" else name: text for name, text in values.items()
            }
        return values

    @field_validator("mapping")
    @classmethod
    def _is_a_mapping(cls, text: str | None) -> str | None:
        if text is not None:
            _pairs(text)
        return text

    @model_validator(mode="after")
    def _rig_can_be_read(self) -> ImportQuery:
        Rig.read(self._with_axes("" if NAME.fullmatch(self.rig) else self.rig))
        return self

    def _with_axes(self, rig: str) -> str:
        parts = self.frame, self.load_point, self.displacement_point, self.load_cell or ""
        return rig_text(*parts, of=rig)

    @model_validator(mode="after")
    def _can_be_appended(self) -> ImportQuery:
        others = self.model_fields_set & _OF_FILES
        if self.append is not None and others:
            raise ValueError(f"append does not allow {', '.join(sorted(others))}; leave them out")
        return self

    @field_validator("note", "filename", "rig", "append")
    @classmethod
    def _check_text(cls, text: str) -> str:
        if problem := text_problem(text):
            raise ValueError(problem)
        return text

    def options(self, rig: str) -> Options:
        """Return the options of reading the file; those of the profile `rig` where it has none."""
        profile = profile_of(rig := self._with_axes(rig))
        others = profile.model_fields_set & _OF_FILES
        if self.append is not None and others:
            names = ", ".join(sorted(others))
            raise RigError(f"append cannot be combined with {names} of this profile; use another")
        mapped, mapping = _pairs(self.mapping or "{}"), _pairs(profile.mapping or "{}")
        ignore = set(profile.ignore) - mapped.keys()
        query = profile.model_copy(update=self.model_dump(include=self.model_fields_set))
        same = query.model_dump(include={field.name for field in fields(Options)})
        return Options(
            **same
            | {
                "ignore": (*self.ignore, *ignore),
                "mapping": mapping | mapped,
                "optional": [*(ignore | mapping.keys()) - mapped.keys() - set(self.ignore)],
                "zero_rows": query.tare,
                "rig": rig,
            }
        )


def profile_of(text: str) -> ImportQuery:
    """Return the options of a rig's profile as a query; RigError or ValidationError if wrong."""
    values = Rig.read(text).options
    if "columns" in values:
        values["mapping"] = orjson.dumps(values.pop("columns"), default=str).decode()
    return ImportQuery.model_validate(values)


def _pairs(text: str) -> dict[str, str]:
    try:
        pairs = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise ValueError(f"is not JSON ({error}); correct it") from None
    if not isinstance(pairs, dict) or not all(isinstance(name, str) for name in pairs.values()):
        raise ValueError('must have the form {"column in the file": "fz [N]"}')
    if len(pairs) > _MAX_COLUMNS:
        raise ValueError(f"names more than {_MAX_COLUMNS} columns; remove some")
    return pairs


# A dataclass has no field of the name `import`.
Imported = TypedDict(
    "Imported",
    {
        "inserted": int,
        "existing": Annotated[
            int,
            Field(
                description="rows that were there already, withdrawn ones too; they stay as they "
                "are, without the slopes and second derivatives of this import"
            ),
        ],
        "errors": Annotated[list[RowMistake], Field(description="1,000 at most")],
        "causes": Annotated[list[RowMistakes], Field(description="the mistakes by cause")],
        "findings": Annotated[list[ImportFinding], Field(description="probable systematic errors")],
        "dry_run": bool,
        "partial": bool,
        "format": Annotated[str, Field(description="detected from the content")],
        "gzip": bool,
        "import": Annotated[int | None, Field(description="its number, in imports")],
        "rig": Annotated[
            dict[str, Any] | None, Field(description="name, handedness, axes, points, load cell")
        ],
        "rows": Annotated[
            dict[str, int],
            Field(
                description="read = loaded + refused + tare + unmatched + skipped + branch + "
                "averaged (of cycles, if asked for), but of a dry run"
            ),
        ],
        "columns": Annotated[
            list[dict[Literal["column", "name", "unit"], str]],
            Field(description="what each column was taken for"),
        ],
        "clock": Annotated[
            dict[Literal["applied_s", "lag_s", "uncertainty_s"], float | None] | None,
            Field(
                description="of two logs: seconds added to the displacements' times, and those "
                "they show"
            ),
        ],
        "ignored": list[str],
        "above": Annotated[
            list[str], Field(description="lines of title above the header, left out")
        ],
        "sheets": Annotated[list[str], Field(description="of a workbook; groups of a TDMS file")],
        "sheet": Annotated[str | None, Field(description="the one of these that was read")],
        "preview": list[PreviewRow],
        "table_version": Annotated[int, Field(description="the version that holds these rows")],
        "in_use": Annotated[bool, Field(description="whether the rows answer already")],
    },
    total=False,
)
