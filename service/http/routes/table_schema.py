"""What OpenAPI says of the table's two calls, whose bodies are read by hand."""

from __future__ import annotations

from typing import Any, Final

MEDIA_TYPES: Final = {
    "csv": "text/csv",
    "json": "application/json",
    "hdf5": "application/x-hdf5",
    "xlsx": "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
    "parquet": "application/vnd.apache.parquet",
    "mat": "application/x-matlab-data",
}
PACKED_TYPE: Final = "application/octet-stream"
_BYTES: Final = {"schema": {"type": "string", "format": "binary"}}

_ROW_ERROR: Final = {
    "type": "object",
    "properties": {
        "row": {"type": "integer", "description": "line or place, from 1; 0: the whole file"},
        "field": {"type": "string"},
        "message": {"type": "string", "description": "what is wrong and what to write"},
    },
}


def _numbers(count: int, unit: str) -> dict[str, Any]:
    """Return a list of numbers of which some may be null."""
    items = {"type": ["number", "null"]}
    return {
        "type": "array",
        "items": items,
        "minItems": count,
        "maxItems": count,
        "description": unit,
    }


_ROW: Final = {
    "type": "object",
    "required": ["wrench", "displacement"],
    "properties": {
        "wrench": {**_numbers(6, "N and N·m"), "items": {"type": "number"}},
        "displacement": _numbers(6, "m and rad; null where not measured"),
        "uncertainty": _numbers(6, "m and rad; null where not known"),
        "compliance": {
            "type": "array",
            "items": {**_numbers(6, "m and rad over N and N·m"), "items": {"type": "number"}},
            "minItems": 6,
            "maxItems": 6,
            "description": "tangent d(displacement)/d(wrench), a line an output",
        },
        "source": {"type": "string", "description": "fea, measured ..."},
        "note": {"type": "string"},
        "fingerprint": {"type": "string", "description": "the setup that was solved"},
    },
}
_TABLE: Final = {
    "type": "object",
    "required": ["rows"],
    "properties": {
        "units": {"enum": ["SI"]},
        "component": {"type": "string"},
        "table_version": {"type": "integer"},
        "rows": {"type": "array", "items": _ROW},
    },
}
_FILES: Final = {
    MEDIA_TYPES["json"]: {"schema": _TABLE},
    MEDIA_TYPES["csv"]: {"schema": {"type": "string", "description": "units in the header"}},
    MEDIA_TYPES["hdf5"]: _BYTES,
    MEDIA_TYPES["xlsx"]: _BYTES,
    MEDIA_TYPES["parquet"]: _BYTES,
}
_LOGS: Final = {
    "schema": {
        "type": "object",
        "description": "one 'table', or two logs that are joined by their time columns",
        "properties": dict.fromkeys(("table", "loads", "displacements"), _BYTES["schema"]),
    }
}
_REPLY: Final = {
    "type": "object",
    "properties": {
        "inserted": {"type": "integer"},
        "existing": {"type": "integer", "description": "rows that were there already"},
        "errors": {"type": "array", "items": _ROW_ERROR, "description": "1,000 at most"},
        "dry_run": {"type": "boolean"},
        "partial": {"type": "boolean"},
        "format": {"type": "string", "description": "told from the content"},
        "gzip": {"type": "boolean"},
        "import": {"type": ["integer", "null"], "description": "its number, in imports"},
        "rows": {
            "type": "object",
            "description": "read = loaded + refused + tare + unmatched, but of a dry run",
            "properties": {
                word: {"type": "integer"}
                for word in ("read", "loaded", "refused", "tare", "unmatched")
            },
        },
        "columns": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {word: {"type": "string"} for word in ("column", "name", "unit")},
            },
            "description": "what each column was taken for",
        },
        "ignored": {"type": "array", "items": {"type": "string"}},
        "above": {
            "type": "array",
            "items": {"type": "string"},
            "description": "lines of title above the header, left out",
        },
        "preview": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "row": {"type": "integer"},
                    "wrench": _numbers(6, "N and N·m"),
                    "displacement": _numbers(6, "m and rad; null where not measured"),
                },
            },
        },
        "table_version": {"type": "integer", "description": "the version that holds these rows"},
        "in_use": {"type": "boolean", "description": "whether the rows answer already"},
    },
}


_ETAG: Final = {
    "ETag": {
        "schema": {"type": "string"},
        "description": "names the table version and setup; of packed the content",
    }
}

EXPORT_REPLIES: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "description": "the table",
        "content": {
            **_FILES,
            MEDIA_TYPES["mat"]: _BYTES,
            PACKED_TYPE: {
                "schema": {
                    **_BYTES["schema"],
                    "description": "packed: the table that answers, for `Table.open` and the "
                    "kernel's `wb_open`",
                }
            },
        },
        "headers": _ETAG,
    },
    409: {"description": "this form cannot hold this table"},
    304: {"description": "the version named by If-None-Match is the present one", "headers": _ETAG},
}
IMPORT_REPLIES: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "description": "the rows are in, or were counted",
        "content": {"application/json": {"schema": _REPLY}},
    },
    413: {"description": "the table is too large; send it in parts"},
    415: {"description": "the content type is no form of a table"},
    422: {"description": "the table has mistakes; nothing was loaded"},
}
IMPORT_BODY: Final[dict[str, Any]] = {
    "requestBody": {
        "required": True,
        "content": {
            **_FILES,
            "application/octet-stream": _BYTES,
            "application/gzip": _BYTES,
            "multipart/form-data": _LOGS,
        },
    }
}
