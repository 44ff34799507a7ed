"""The query parameters of an import."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, Literal

import orjson
from pydantic import ConfigDict, Field, field_validator, model_validator

from wrenchbook.service.formats import MAX_PREVIEW, MAX_ZERO_ROWS, Options
from wrenchbook.service.formats.rig import MAX_RIG, Rig, rig_text
from wrenchbook.service.http.bodies import Body

_MAX_COLUMNS = 1000
WAIT_S = 10.0  # a table of 20,000 measured rows is built by then
MAX_WAIT_S = 600.0  # a million rows take minutes
_POINT = "x,y,z from the interface's point in its frame, m: the point that"
_LOAD_CELL = "the point where it is now, or where it was: translation x force is taken off them"
_Text = Annotated[str, Field(max_length=1000)]


class ImportQuery(Body):
    """The query of an import; what is not named is refused."""

    model_config = ConfigDict(extra="forbid")

    format: Annotated[
        Literal["csv", "xlsx", "parquet", "hdf5", "json", "mat"] | None,
        Field(description="checked against the content; detected if left out"),
    ] = None
    dry_run: Annotated[bool, Field(description="check and count; nothing is changed")] = False
    partial: Annotated[bool, Field(description="load the good rows of a file with mistakes")] = (
        False
    )
    preview: Annotated[
        int, Field(ge=0, le=MAX_PREVIEW, description="so many first good rows come back")
    ] = 0
    decimal: Annotated[
        Literal[".", ","] | None,
        Field(description="mark of numbers in text; detected if left out"),
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
            "a - before it turns the sign",
        ),
    ] = None
    missing_loads: Annotated[
        Literal["zero"] | None, Field(description="loads without a column were zero")
    ] = None
    tare: Annotated[
        int, Field(ge=0, le=MAX_ZERO_ROWS, description="rows whose mean is taken off all others")
    ] = 0
    sheet: Annotated[str | None, Field(max_length=200, description="xlsx: its name")] = None
    frame: Annotated[
        _Text, Field(description="the rig's axes in the interface's: x=-y,y=x,z=z or nine numbers")
    ] = ""
    load_point: Annotated[_Text, Field(description=f"{_POINT} moments are about")] = ""
    displacement_point: Annotated[_Text, Field(description=f"{_POINT} was measured")] = ""
    load_cell: Annotated[
        Literal["moving", "fixed"] | None, Field(description=f"moments are about {_LOAD_CELL}")
    ] = None
    rig: Annotated[
        str, Field(max_length=MAX_RIG, description="TOML: these four, name; kept with the import")
    ] = ""
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
    note: Annotated[str, Field(max_length=10_000, description="kept with the import")] = ""
    filename: Annotated[str, Field(max_length=1000, description="kept with the import")] = ""

    @model_validator(mode="before")
    @classmethod
    def _lag_is_the_offset(cls, values: Any) -> Any:
        if isinstance(values, dict) and "lag" in values and "time_offset_s" not in values:
            return {"time_offset_s" if name == "lag" else name: one for name, one in values.items()}
        return values

    @field_validator("mapping")
    @classmethod
    def _is_a_mapping(cls, text: str | None) -> str | None:
        if text is not None:
            _pairs(text)
        return text

    @model_validator(mode="after")
    def _has_one_rig(self) -> ImportQuery:
        if self.rig and rig_text(self.frame, self.load_point, self.displacement_point):
            raise ValueError("rig has the frame and the points: send either it or these three")
        if self.load_cell and Rig.read(self.rig).load_cell:
            raise ValueError("rig has the load_cell already: send it once")
        if text := self._rig_text():
            Rig.read(text)
        return self

    def _rig_text(self) -> str:
        parts = self.frame, self.load_point, self.displacement_point, self.load_cell or ""
        axes = rig_text(*parts) if any(parts) else ""
        return "\n".join(filter(None, (self.rig, axes)))

    @field_validator("note", "filename", "rig")
    @classmethod
    def _can_be_kept(cls, text: str) -> str:
        try:
            text.encode()
        except UnicodeEncodeError:
            raise ValueError("holds half a character (a lone surrogate)") from None
        if "\0" in text:
            raise ValueError("holds a zero byte")
        return text

    def options(self) -> Options:
        """Return the options of reading the file."""
        same = self.model_dump(include={field.name for field in fields(Options)})
        return Options(
            **same
            | {
                "ignore": tuple(self.ignore),
                "mapping": _pairs(self.mapping) if self.mapping else {},
                "zero_rows": self.tare,
                "rig": self._rig_text(),
            }
        )


def _pairs(text: str) -> dict[str, str]:
    try:
        pairs = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise ValueError(f"is not JSON: {error}") from None
    if not isinstance(pairs, dict) or not all(isinstance(one, str) for one in pairs.values()):
        raise ValueError('is not of the form {"column in the file": "fz [N]"}')
    if len(pairs) > _MAX_COLUMNS:
        raise ValueError(f"names more than {_MAX_COLUMNS} columns")
    return pairs
