"""The calls of the library, for the OpenAPI document."""

from __future__ import annotations

from typing import Any, Final

from service.http.bodies import CopyBody, NotesBody, RenameBody
from service.http.call import JSON, Call
from service.http.schemas import OBJECT, SIX, Schema, body_of

_OF = "/v1/components/{name}"
_REFUSED = (404, 422)


def _list_of(what: dict[str, Any]) -> Schema:
    return {"type": "array", "items": {"type": "object", "properties": what}}


_NUMBER: Final[Schema] = {"type": "number"}
_COUNT: Final[Schema] = {"type": "integer"}
_WORD: Final[Schema] = {"type": "string"}
_CARD: Final[Schema] = {
    "type": "object",
    "properties": {"component": _WORD, "archived": {"type": "boolean"}, "notes": _WORD},
}
_IMPORTS: Final[Schema] = {
    "type": "object",
    "properties": {
        "imports": _list_of(
            {
                "id": _COUNT,
                "rows": _COUNT,
                "table_version": {
                    "type": ["integer", "null"],
                    "description": "the first that has them all; null if it brought none",
                },
                **dict.fromkeys(("when", "who", "filename", "format", "sha256", "note"), _WORD),
            }
        )
    },
}
_DISAGREEMENT: Final[Schema] = {
    "type": "object",
    "properties": {
        **dict.fromkeys(("measured", "solved", "beyond_range", "compared", "outside"), _COUNT),
        "table_version": _COUNT,
        "outputs": {**OBJECT, "description": "of each: compared, outside, mean_difference"},
        "rows": _list_of(
            {
                "row": _COUNT,
                "wrench": OBJECT,
                "output": _WORD,
                **dict.fromkeys(("measured", "expected", "bar", "ratio"), _NUMBER),
            }
        ),
    },
}
_DEMAND: Final[Schema] = {
    "type": "object",
    "properties": {
        "asked": {**_COUNT, "description": "wrenches that were not covered"},
        "elsewhere": {**_COUNT, "description": "of them those that are in none of the cells"},
        "since": {"type": ["number", "null"], "description": "seconds since the epoch"},
        "cell_size": {**SIX, "description": "N and N·m"},
        "cells": _list_of(
            {
                "wrench": {**SIX, "description": "the middle of the cell, N and N·m"},
                **dict.fromkeys(("count", "thin", "outside"), _COUNT),
                "coverage": {"enum": ["thin", "outside"]},
            }
        ),
        "latest": _list_of({"wrench": SIX, "coverage": _WORD, "when": _NUMBER}),
    },
}

LIBRARY_CALLS: Final[dict[tuple[str, str], Call]] = {
    ("post", f"{_OF}/copy"): Call(
        {201: "copied"}, (404, 409, 413, 422), {JSON: OBJECT}, {JSON: body_of(CopyBody)}
    ),
    ("post", f"{_OF}/rename"): Call(
        {201: "copied, and the old one put away"},
        (404, 409, 413, 422),
        {JSON: OBJECT},
        {JSON: body_of(RenameBody)},
    ),
    ("post", f"{_OF}/archive"): Call({200: "put away"}, _REFUSED, {JSON: _CARD}),
    ("post", f"{_OF}/unarchive"): Call({200: "in the list again"}, _REFUSED, {JSON: _CARD}),
    ("put", f"{_OF}/notes"): Call(
        {200: "written down"}, (404, 413, 422), {JSON: _CARD}, {JSON: body_of(NotesBody)}
    ),
    ("get", f"{_OF}/imports"): Call({200: "the imports"}, _REFUSED, {JSON: _IMPORTS}),
    ("get", f"{_OF}/disagreement"): Call({200: "the comparison"}, _REFUSED, {JSON: _DISAGREEMENT}),
    ("get", f"{_OF}/demand"): Call({200: "the map"}, _REFUSED, {JSON: _DEMAND}),
    ("delete", f"{_OF}/demand"): Call({200: "forgotten"}, _REFUSED, {JSON: OBJECT}),
}
