"""Schemas of replies and of problems, for the OpenAPI document."""

from __future__ import annotations

from typing import Any, Final

from service.contract import CONTRACT
from service.http.bodies import Body

Schema = dict[str, Any]

_NUMBER: Final[Schema] = {"type": ["number", "null"]}
_THREE: Final[Schema] = {"type": "array", "items": _NUMBER, "minItems": 3, "maxItems": 3}
SIX: Final[Schema] = {"type": "array", "items": _NUMBER, "minItems": 6, "maxItems": 6}
_DERIVATIVE: Final[Schema] = {
    "type": ["array", "null"],
    "items": SIX,
    "minItems": 6,
    "maxItems": 6,
    "description": "with derivatives: du/dw, a line an output, m and rad over N and N·m; null "
    "where it is not known",
}
_COVERAGE: Final[Schema] = {"enum": ["covered", "thin", "outside"]}
_WITHIN: Final = (
    "whether the whole bar is within the tolerance, the request's or else the component's own. "
    "coverage asks that of the table's share alone, which more rows lower: covered and false means "
    "that the solver's own error is over the tolerance, and the component's warnings say what to "
    "do. null where there is no tolerance or no bar, or the solver's own error is not known"
)
_STATUS: Final = ["waiting", "running", "done", "failed", "cancelled"]
_VERSION: Final = (
    "the version of the table that was asked; where source is fea the answer is that of row, which "
    "may be newer than this version"
)
_ROW: Final = "the number of the row that the solve gave, in the ledger and in the table's exports"
_LINK: Final[dict[str, Schema]] = {
    "id": {"type": "integer"},
    "status": {"enum": _STATUS},
    "url": {"type": "string"},
}
JOB: Final[Schema] = {"type": "object", "properties": _LINK}
_WRENCH_JOB: Final[Schema] = {
    "type": "object",
    "properties": {
        "index": {"type": "integer", "description": "number of the wrench, from 0"},
        "id": {"type": ["integer", "null"], "description": "null: no solve is queued"},
        "status": {"enum": [*_STATUS, None]},
        "url": {"type": ["string", "null"]},
        "reason": {
            "enum": ["beyond-range", "queue-limit", "table-version"],
            "description": "why none is queued",
        },
    },
}

PROBLEM: Final[Schema] = {
    "type": "object",
    "description": "RFC 9457; further members tell more",
    "required": ["type", "title", "status", "detail"],
    "properties": {
        "type": {"type": "string", "description": "urn:wrenchbook:problem:..."},
        "title": {"type": "string"},
        "status": {"type": "integer"},
        "detail": {"type": "string", "description": "what is wrong and what to do"},
        "errors": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["loc", "msg"],
                "properties": {"loc": {"type": "string"}, "msg": {"type": "string"}},
            },
        },
    },
}
OBJECT: Final[Schema] = {"type": "object"}
_MATRIX: Final[Schema] = {
    "type": "array",
    "items": {"type": "array", "items": {"type": ["number", "null"]}},
    "minItems": 6,
    "maxItems": 6,
}
COMPLIANCE: Final[Schema] = {
    "type": "object",
    "properties": {
        "component": {"type": "string"},
        "table_version": {"type": "integer"},
        "tangent": {
            **_MATRIX,
            "description": "du/dw at zero load, a line an output, m and rad over N and N·m; null "
            "where it is not known",
        },
        "tangent_origin": {
            "type": "string",
            "description": "row: the tangent of the row at zero load; none: not known; else the "
            "method that interpolates it",
        },
        "matrix": {
            **_MATRIX,
            "description": "the mean over the load range: the fit of one 6x6 to all rows; of a "
            "linear component its compliance. Zero where no row tells a load: known_loads",
        },
        "origin": {"enum": ["stored", "fitted", "none"], "description": "of matrix"},
        "known_loads": {"type": "array", "items": {"type": "string"}},
        "error": {**SIX, "description": "95 % error bar of matrix at the rows, m and rad"},
        "rows": {"type": "array", "items": {"type": "string"}},
        "columns": {"type": "array", "items": {"type": "string"}},
        "rows_checked": {"type": "integer"},
        "ok": {"type": ["boolean", "null"]},
        "checks": {"type": "object", "description": "by name: ok, and what was found"},
    },
}
BYTES: Final[Schema] = {"type": "string", "format": "binary"}
TEXT: Final[Schema] = {"type": "string"}


def _with_contract(properties: dict[str, Schema]) -> Schema:
    told = " ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items())
    return {"type": "object", "description": told, "properties": properties}


DISPLACEMENT: Final[Schema] = _with_contract(
    {
        "component": {"type": "string"},
        "translation": {**_THREE, "type": ["array", "null"], "description": "m"},
        "rotation": {**_THREE, "type": ["array", "null"], "description": "rotation vector, rad"},
        "error": {
            "type": ["object", "null"],
            "description": "estimated 95 % error bar per output, m and rad",
            "properties": {"translation": _THREE, "rotation": _THREE},
        },
        "coverage": _COVERAGE,
        "within_tolerance": {"type": ["boolean", "null"], "description": _WITHIN},
        "source": {
            "type": ["string", "null"],
            "description": "table, or where the row that answers came from: fea, measured",
        },
        "method": {"type": ["string", "null"]},
        "table_version": {"type": "integer", "description": _VERSION},
        "elapsed_us": {"type": "number", "description": "time spent on the answer, µs"},
        "reason": {"type": "string", "description": "why not covered, why no solve is queued"},
        "row": {"type": "integer", "description": _ROW},
        "notes": {
            "type": "array",
            "items": {"type": "string"},
            "description": "what the solver says about that row: doubtful cells, ill conditioning",
        },
        "missing": {
            "type": "array",
            "items": {"type": "string"},
            "description": "the outputs that no row of the table holds",
        },
        "job": {**JOB, "type": ["object", "null"]},
        "axes": {"type": "array", "items": OBJECT, "description": "with detail"},
        "method_detail": {"type": "string", "description": "with detail: how the method answers"},
        "error_parts": {
            "type": "object",
            "description": "with detail: what error is the sum of. table: what more rows lower; "
            "mesh: what a finer mesh lowers; linearity: what a linear component leaves out. Each "
            "as error is, null where it is not known",
        },
        "derivative": _DERIVATIVE,
    }
)
DISPLACEMENTS: Final[Schema] = _with_contract(
    {
        "component": {"type": "string"},
        "displacements": {"type": "array", "items": SIX, "description": "m and rad"},
        "errors": {"type": "array", "items": SIX, "description": "95 % error bars, m and rad"},
        "coverage": {"type": "array", "items": _COVERAGE},
        "within_tolerance": {
            "type": "array",
            "items": {"type": ["boolean", "null"]},
            "description": f"{_WITHIN}; left out where there is no tolerance",
        },
        "derivatives": {"type": "array", "items": _DERIVATIVE},
        "method": {"type": "string"},
        "jobs": {
            "type": "array",
            "items": _WRENCH_JOB,
            "description": "one for each wrench that is not covered; several may share a job",
        },
        "table_version": {"type": "integer"},
        "elapsed_us": {"type": "number", "description": "time spent on the answers, µs"},
    }
)
JOBS: Final[Schema] = {
    "type": "object",
    "properties": {
        "component": {"type": "string"},
        "jobs": {"type": "array", "items": JOB},
        "stage": {"type": "string"},
        "reason": {"type": "string"},
    },
}
_NAMES: Final[Schema] = {"type": "array", "items": {"type": "string"}}
_PLAN: Final[Schema] = {
    "type": "object",
    "properties": {
        "decision": {
            "enum": ["rigid", "linear", "table"],
            "description": "leave the component out; one compliance answers; its table does",
        },
        "reason": {"type": "string"},
        "loads": {**_NAMES, "description": "the loads that can occur"},
        "axes": {
            "type": "object",
            "additionalProperties": {
                "type": "object",
                "properties": {"inputs": _NAMES, "dimensions": {"type": "integer"}},
            },
            "description": "the axes that are composed: their loads that can occur, and how many "
            "of these vary",
        },
        "outputs": {**_NAMES, "description": "the outputs that are read"},
        "tolerance": {
            "type": ["object", "null"],
            "description": "what is decided by, m and rad: the scene's, else the component's",
        },
        "displacement_bound": {
            **SIX,
            "description": "what no displacement within the scene exceeds, m and rad: by the "
            "compliance and the answers at the scene's corners, bars included; null if not known",
        },
        "solves": {
            "type": "object",
            "properties": {"whole": {"type": "integer"}, "scene": {"type": "integer"}},
            "description": "of the first design, from an empty table",
        },
        "saves": {
            "type": "object",
            "properties": {
                "build_s": _NUMBER,
                "memory_bytes": {"type": ["integer", "null"]},
                "us_per_answer": _NUMBER,
            },
            "description": "what the scene's table needs less than the whole one",
        },
        "saves_from": {
            "type": "object",
            "additionalProperties": {"type": "string"},
            "description": "where each number of saves and solves comes from",
        },
        "compliance": {
            "type": "array",
            "items": SIX,
            "description": "with linear, where it is known: the displacement over the wrench, m "
            "and rad over N and N·m; zero by loads that cannot occur",
        },
        "table_version": {"type": "integer"},
    },
}
PLANS: Final[Schema] = {
    "type": "object",
    "properties": {"components": {"type": "object", "additionalProperties": _PLAN}},
}
CANCELLED: Final[Schema] = {"type": "object", "properties": {"cancelled": {"type": "integer"}}}


def body_of(kind: type[Body]) -> Schema:
    """Return the schema of a body, with nested bodies where they are referred to."""
    schema = kind.model_json_schema()
    definitions = schema.pop("$defs", {})

    def walk(node: Any) -> Any:
        if isinstance(node, dict):
            if "$ref" in node:
                return walk(definitions[node["$ref"].rsplit("/", 1)[-1]])
            return {key: walk(value) for key, value in node.items()}
        return [walk(item) for item in node] if isinstance(node, list) else node

    return walk(schema)
