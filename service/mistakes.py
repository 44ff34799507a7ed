"""Pydantic's errors in plain words, for request bodies, queries and settings.

Apart from both, since settings are checked without a web framework.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

MAX_VALUE = 40  # characters of a quoted value: longer ones are cut
_TEXTS = {
    "extra_forbidden": "is unknown; correct its name, or leave it out (see the fields at /docs)",
    "missing": "is missing; add it (see the fields at /docs)",
    "greater_than": "must be above {gt}",
    "greater_than_equal": "must be {ge} or more",
    "less_than": "must be below {lt}",
    "less_than_equal": "must be {le} or less",
    "finite_number": "must be a finite number",
    "too_short": "must have {min_length} entries or more, not {actual_length}",
    "too_long": "must have {max_length} entries or fewer, not {actual_length}",
    "string_too_short": "must have {min_length} characters or more",
    "string_too_long": "must have {max_length} characters or fewer",
    "literal_error": "must be {expected}",
    # The names of rigs alone have a pattern.
    "string_pattern_mismatch": "must be 1 to 64 of a-z, A-Z, 0-9, _, . and -, and begin with a "
    "letter or digit",
}
# By the first word of an error's type: "int" is of int_type, int_parsing and int_from_float.
_KINDS = {
    "int": "must be a whole number",
    "float": "must be a number",
    "bool": "must be true or false",
    "string": "must be a text",
    "list": "must be a list",
    "tuple": "must be a list",
    "dict": "must be an object",
    "datetime": "must be a date or a time such as 2026-05-03 or 2026-05-03T09:00:00Z",
    "model": "must be an object",
}
_OBJECTS = {
    "DisplacementBody": ' such as {"force": [1, 2, 3]}',
    "ToleranceBody": " with translation (m) and rotation (rad)",
}


def mistake_of(error: Mapping[str, Any]) -> str:
    """Return the mistake of one of pydantic's errors, with the value that was sent."""
    kind, context = error["type"], error.get("ctx", {})
    text = _TEXTS.get(kind) or _KINDS.get(kind.split("_")[0])
    if text is None:
        return error["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    text = text.format(**context) + _OBJECTS.get(context.get("class_name"), "")
    return f"{text}, not {_sent(error['input'])}" if text.startswith("must be") else text


def _sent(value: Any) -> str:
    """Return a value as its sender wrote it, cut if it is long."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list | tuple):
        return "an array"
    if value is None or isinstance(value, int | float):
        return json.dumps(value)[:MAX_VALUE]
    return repr(str(value)[:MAX_VALUE])
