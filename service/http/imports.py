"""The query of a bulk import and its reply, for pydantic and OpenAPI."""

from __future__ import annotations

import json
import re
from dataclasses import fields
from math import isfinite
from typing import Annotated, Any, Literal

import orjson
from pydantic import AliasChoices, BeforeValidator, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError
from typing_extensions import TypedDict

from wrenchbook.fea.spec.problems import suggest
from wrenchbook.fea.spec.schema import ACCELERATIONS, TEMPERATURE
from wrenchbook.service.contract import ImportFormat
from wrenchbook.service.formats.cells import text_problem
from wrenchbook.service.formats.columns import columns_of
from wrenchbook.service.formats.header import readings_of
from wrenchbook.service.formats.options import MAX_ZERO_ROWS, Options
from wrenchbook.service.formats.read import MAX_PREVIEW
from wrenchbook.service.formats.rig import MAX_RIG, NAME, Rig, RigError, rig_text
from wrenchbook.service.http.bodies import Body
from wrenchbook.service.messages import ImportFinding, PreviewRow, RowMistake, RowMistakes
from wrenchbook.service.mistakes import MAX_VALUE
from wrenchbook.surrogate.table.space import Input, space_of

_MAX_COLUMNS = 1000  # columns of a mapping: a logger has some hundred
# The columns of a component with one interface and all further inputs.
_ALL = columns_of(
    space_of(
        scalars=[
            Input(TEMPERATURE, "degC", "scalar"),
            *(Input(name, "m/s^2", "scalar") for name in ACCELERATIONS),
        ]
    )
)
_MAPPING_FORM = '{"column in the file": "fz [N]"}'
# Options for whole files; the rows of an appended block are read one by one.
_OF_FILES = frozenset(
    {"tare", "preview", "sheet", "time_offset_s", "max_gap_s", "filename"}
    | {"skip_cycles", "branch", "thin", "mean_cycles"}
)
WAIT_S = 10.0  # s: a table of 20,000 measured rows is built by then
MAX_WAIT_S = 600.0  # s: a million rows take minutes
_Text = Annotated[str, Field(max_length=1000)]


def _offset(text: Any) -> Any:
    """Return an offset, s, or ``auto``: with one message, of which a union has two."""
    try:
        if text == "auto" or isfinite(float(text)):
            return text
    except (TypeError, ValueError):
        pass
    known = {"sent": repr(str(text)[:MAX_VALUE])}
    text = "must be seconds or 'auto' (--lag SECONDS, --lag auto), not {sent}"
    raise PydanticCustomError("offset", text, known)


class ImportQuery(Body):
    """The query of an import; unknown parameters are refused."""

    format: ImportFormat | None = None
    dry_run: bool = False
    partial: bool = False
    preview: Annotated[int, Field(ge=0, le=MAX_PREVIEW)] = 0
    decimal: Literal[".", ","] | None = None
    ignore: Annotated[list[_Text], Field(default_factory=list, max_length=_MAX_COLUMNS)]
    ignore_extra: bool = False
    mapping: Annotated[str | None, Field(max_length=100000)] = None
    missing_loads: Literal["zero"] | None = None
    tare: Annotated[int, Field(ge=0, le=MAX_ZERO_ROWS)] = 0
    sheet: Annotated[str | None, Field(max_length=200)] = None
    frame: _Text = ""
    load_point: _Text = ""
    displacement_point: _Text = ""
    load_cell: Literal["moving", "fixed"] | None = None
    rig: Annotated[str, Field(max_length=MAX_RIG)] = ""
    skip_cycles: Annotated[int, Field(ge=0, lt=2**31)] = 0
    branch: Literal["loading", "unloading"] | None = None
    thin: Annotated[float | None, Field(gt=0, le=0.5)] = None
    mean_cycles: bool = False
    time_offset_s: Annotated[
        Annotated[float, Field(allow_inf_nan=False)] | Literal["auto"],
        BeforeValidator(_offset),
        Field(validation_alias=AliasChoices("time_offset_s", "lag")),
    ] = 0.0
    max_gap_s: Annotated[float | None, Field(gt=0, allow_inf_nan=False)] = None
    wait_s: Annotated[float, Field(ge=0, le=MAX_WAIT_S, allow_inf_nan=False)] = WAIT_S
    append: Annotated[str | None, Field(min_length=1, max_length=200)] = None
    note: Annotated[str, Field(max_length=10000)] = ""
    filename: Annotated[str, Field(max_length=1000)] = ""

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
            names = _listed(others)
            why = f"append does not allow {names}: it adds rows as they are"
            raise ValueError(why + "; leave them out, or import the file without append")
        return self

    @field_validator("note", "filename", "rig", "append")
    @classmethod
    def _check_text(cls, text: str) -> str:
        problem = text_problem(text)
        if problem:
            raise ValueError(problem)
        return text

    def options(self, rig: str) -> Options:
        """Return the options for reading the file, completed by those of the profile `rig`.

        Raises RigError if the profile or its combination with the query is not valid.
        """
        rig = self._with_axes(rig)
        profile = profile_of(rig)
        others = profile.model_fields_set & _OF_FILES
        if self.append is not None and others:
            names = _listed(others)
            why = f"append cannot go with {names} of this rig: it adds rows as they are"
            raise RigError(why + "; name a rig without them, or import the file without append")
        own_mapping, rig_mapping = _pairs(self.mapping or "{}"), _pairs(profile.mapping or "{}")
        rig_ignore = set(profile.ignore) - own_mapping.keys()
        # A file may lack columns that only the rig names.
        only_of_rig = (rig_ignore | rig_mapping.keys()) - own_mapping.keys() - set(self.ignore)
        query = profile.model_copy(update=self.model_dump(include=self.model_fields_set))
        options = query.model_dump(include={field.name for field in fields(Options)})
        options["ignore"] = (*self.ignore, *rig_ignore)
        options["mapping"] = rig_mapping | own_mapping
        options["optional"] = [*only_of_rig]
        options["optional_sheet"] = "sheet" not in self.model_fields_set
        options["zero_rows"] = query.tare
        options["rig"] = rig
        return Options(**options)


def _listed(parameters: set[str]) -> str:
    """Return the names of parameters, with the other name that one of them has."""
    names = {"time_offset_s": "time_offset_s (lag)"}
    return ", ".join(names.get(name, name) for name in sorted(parameters))


def profile_of(text: str) -> ImportQuery:
    """Return a rig's profile as a query; raises RigError or ValidationError if it is wrong."""
    values = Rig.read(text).options
    if "columns" in values:
        pairs = values.pop("columns")
        if not isinstance(pairs, dict) or not all(isinstance(name, str) for name in pairs.values()):
            raise RigError('columns: must be a table of texts such as {"Load cell" = "fz [N]"}')
        values["mapping"] = orjson.dumps(pairs).decode()
    return ImportQuery.model_validate(values)


def check_meanings(profile: ImportQuery) -> None:
    """Raise RigError for the first column of a profile whose meaning no component has."""
    for label, meaning in _pairs(profile.mapping or "{}").items():
        if not _is_known(meaning.lstrip("- ")):
            near = suggest(meaning[:100].partition("[")[0].strip("- "), _ALL.numbers)
            raise RigError(
                f"columns: {label[:100]!r} has the meaning {meaning[:100]!r}, which is not a known "
                f"column{near or '; write for example fz [N]'}"
            )


def _is_known(meaning: str) -> bool:
    """Return whether a meaning, without the name of an interface before it, is a column's."""
    starts = [0, *(gap.end() for gap in re.finditer(r"[\s._/-]+", meaning.partition("[")[0]))]
    return any(readings_of(meaning[start:], _ALL) for start in starts)


def _pairs(text: str) -> dict[str, str]:
    """Return the pairs of a JSON object of texts."""
    try:
        # A tuple keeps repeated names, and tells an object from a list.
        pairs = json.loads(text, object_pairs_hook=tuple)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"is not JSON ({error}); write {_MAPPING_FORM}") from None
    if not isinstance(pairs, tuple):
        raise ValueError(f"must be a JSON object of the form {_MAPPING_FORM}")
    mapping: dict[str, str] = {}
    for column, name in pairs:
        if not isinstance(name, str):
            why = f"maps the column {column[:100]!r} to {name!r:.100}, which is not a string"
            raise ValueError(why + f"; write {_MAPPING_FORM}")
        if column in mapping:
            raise ValueError(f"the column {column[:100]!r} is there more than once; send one")
        mapping[column] = name
    if len(mapping) > _MAX_COLUMNS:
        raise ValueError(f"names {len(mapping)} columns, more than {_MAX_COLUMNS}; leave some out")
    return mapping


# A dataclass cannot have a field named `import`.
Imported = TypedDict(
    "Imported",
    {
        "inserted": int,
        "existing": int,
        "restored": int,
        "beyond_range": int,
        "errors": list[RowMistake],
        "causes": list[RowMistakes],
        "findings": list[ImportFinding],
        "dry_run": bool,
        "partial": bool,
        "format": str,
        "gzip": bool,
        "import": int | None,
        "rig": dict[str, Any] | None,
        "rows": dict[str, int],
        "columns": list[dict[Literal["column", "name", "unit"], str]],
        "clock": dict[Literal["applied_s", "lag_s", "uncertainty_s"], float | None] | None,
        "ignored": list[str],
        "above": list[str],
        "sheets": list[str],
        "sheet": str | None,
        "preview": list[PreviewRow],
        "table_version": int,
        "in_use": bool,
    },
    total=False,
)
