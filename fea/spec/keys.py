"""Keys of ``component.toml`` as fields of pydantic models: types, units, texts and messages.

A table of the file is a class under `table`, whose fields are made by `key`. `validate` returns an
instance, or adds a problem for every mistake.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, is_dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, cast, dataclass_transform, get_args, get_origin

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    GetPydanticSchema,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)
from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError, core_schema

from wrenchbook.fea.spec.problems import STEERING, BundleProblem, suggest

MAX_COUNT = 10**9  # largest number of cells, layers and faces: far above any mesh, within an int32
_ORTHONORMAL = 1e-6  # axes are written to six digits and more
_QUOTED = re.compile("'([^']*)'")  # the choices in pydantic's ``expected``
_SLUG = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")  # a name for a folder and a URL
_MAX_SHOWN = 60  # characters of a value in a message: its rest would hide the remedy

_T = TypeVar("_T")


def key(
    unit: str = "",
    example: str = "",
    default: Any = ...,
    *,
    default_text: str = "",
    name: str | None = None,
    expected_text: str = "",
    choices: tuple[str, ...] = (),
    **bounds: Any,
) -> Any:
    """Return the field of a table: a key of the file. The text below the field is its description.

    unit, example: texts of the reference; `example` is TOML.
    default: a value, or a function that makes it; without it the key is required.
    default_text: the reference's text for a default that no value shows.
    name: the key, if it differs from the attribute's name.
    expected_text: the text of messages for a valid value, if the key's type does not give it.
    choices: the values to choose from, if the type does not have all of them.
    """
    texts = {"default_text": default_text, "expected_text": expected_text}
    extra = {"unit": unit, "example": example, **texts, "choices": list(choices)}
    metadata: Any = {name: value for name, value in extra.items() if value}
    if default is not ...:
        bounds["default_factory" if callable(default) else "default"] = default
    return Field(alias=name, json_schema_extra=metadata, **bounds)


_CONFIG = ConfigDict(
    extra="forbid", validate_by_name=True, arbitrary_types_allowed=True, defer_build=True
)


@dataclass_transform(frozen_default=True, field_specifiers=(key, field))
def table(cls: type[_T]) -> type[_T]:
    """Make a class a table of the file: a frozen dataclass that pydantic validates."""
    return cast(Any, dataclass(frozen=True, config=_CONFIG)(cls))


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(key, field))
def array_table(cls: type[_T]) -> type[_T]:
    """Make a class a `table` with arrays, which is equal to itself alone."""
    return cast(Any, dataclass(frozen=True, eq=False, config=_CONFIG)(cls))


class MistakesError(ValueError):
    """Mistakes that follow from several keys of a table together."""

    def __init__(self, *pairs: tuple[str, str]) -> None:
        super().__init__("; ".join(message for _, message in pairs))
        self.pairs = pairs


def _text(value: str) -> str:
    """Return a text of one line that is not blank and has no control character."""
    if steering := STEERING.search(value):
        raise ValueError(f"must be one line of printable characters; remove {steering[0]!r}")
    if not value.strip():
        raise ValueError("must not be blank; write at least one letter or digit")
    return value


def is_slug(name: str) -> bool:
    """Return whether a name can be a component's, which is a folder's and in a URL."""
    return _SLUG.fullmatch(name) is not None


def _name(value: str) -> str:
    """Return a name that `is_slug`."""
    if is_slug(value):
        return value
    raise ValueError(
        f"{shown(value)} cannot be used in a path and a URL; use 1 to 64 of a-z, 0-9, _ and -, "
        "beginning with a letter or digit"
    )


def different(values: tuple[_T, ...]) -> tuple[_T, ...]:
    """Return values of which no two are equal."""
    if len(set(values)) < len(values):
        twice = next(value for value in values if values.count(value) > 1)
        raise ValueError(f"has {shown(twice)} twice; remove one of the two")
    return values


def _in_folder(value: object, handler: Any, info: ValidationInfo) -> Path:
    """Return the path of a file of the bundle that exists and lies within its folder."""
    if isinstance(value, Path):
        return value
    name: str = handler(value)
    folder: Path = (info.context or {}).get("folder", Path())
    path = folder / name
    try:
        # Resolved, so that a symbolic link out of the folder is refused too.
        is_inside = path.resolve().is_relative_to(folder.resolve())
        is_there = path.is_file()
    except (OSError, RuntimeError) as error:  # a name that no disk allows; a loop of symbolic links
        reason = error.strerror if isinstance(error, OSError) else "a loop of symbolic links"
        raise ValueError(f'"{name[:100]}" cannot be a file ({reason}); rename it') from None
    if not is_inside:
        raise ValueError(f'"{name}" is outside the bundle; put the file into its folder')
    if Path(name).is_absolute():
        relative = path.resolve().relative_to(folder.resolve()).as_posix()
        raise ValueError(
            f'"{name}" is an absolute path; write it relative to component.toml: "{relative}"'
        )
    if not is_there:
        entries = folder.iterdir() if folder.is_dir() else ()
        # pydantic cannot pass on a message with surrogates, of a name that is no UTF-8.
        known = sorted(entry.name.encode(errors="backslashreplace").decode() for entry in entries)
        files = f"only {', '.join(known)}" if known else "which has no files"
        remedy = suggest(name, known) or "; correct the name, or add the file"
        raise ValueError(f'there is no file "{name}" in the bundle, {files}{remedy}')
    return path


def counted(count: int, message: str = "", names: str = "") -> BeforeValidator:
    """Require a list of `count` numbers; a mistake has their `names`, or is the `message`."""

    def check(value: object) -> object:
        if isinstance(value, list | tuple) and len(value) == count:
            return value
        if message:
            raise ValueError(message)
        raise PydanticCustomError("count", "{count} numbers", {"count": count, "names": names})

    return BeforeValidator(check)


def array_of(inner: Any, make: Callable[[Any], np.ndarray] = np.array) -> GetPydanticSchema:
    """Make an array, of the shape of an `inner`, by `make`; an array is returned unchanged."""

    def check(value: object, handler: Callable[[object], Any]) -> np.ndarray:
        return value if isinstance(value, np.ndarray) else make(handler(value))

    return GetPydanticSchema(
        lambda _, handler: core_schema.no_info_wrap_validator_function(
            check, handler.generate_schema(inner)
        )
    )


# Branches of unions have negative tags, ~0 = -1, ~1 = -2: in the path of a mistake, where pydantic
# puts them, no index of a list is negative.


def either(single: Any, several: Any, depth: int = 1) -> GetPydanticSchema:
    """Take `several` for a list nested `depth` levels, else `single`."""

    def choose(value: Any) -> int:
        for _ in range(depth - 1):
            value = value[0] if isinstance(value, list | tuple) and value else None
        return ~1 if isinstance(value, list | tuple) else ~0

    return GetPydanticSchema(
        lambda _, handler: core_schema.tagged_union_schema(
            {~0: handler.generate_schema(single), ~1: handler.generate_schema(several)},
            discriminator=choose,
        )
    )


def union(choose: Callable[[Mapping[str, Any]], type], *classes: type) -> GetPydanticSchema:
    """Take one of several classes under `table`: the result of `choose` for a parsed table."""

    def tag(value: object) -> int:
        return ~classes.index(choose(value)) if isinstance(value, dict) else ~0

    return GetPydanticSchema(
        lambda _, handler: core_schema.tagged_union_schema(
            {~i: handler.generate_schema(cls) for i, cls in enumerate(classes)}, discriminator=tag
        )
    )


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
Integer = Annotated[int, Field(strict=True, le=MAX_COUNT)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True), AfterValidator(_text)]
Name = Annotated[Text, AfterValidator(_name)]
Texts = Annotated[tuple[Text, ...], AfterValidator(different)]
Pair = Annotated[tuple[Number, Number], counted(2)]
Three = Annotated[tuple[Number, Number, Number], counted(3)]
ThreePositive = Annotated[tuple[Positive, Positive, Positive], counted(3)]
Six = Annotated[tuple[Number, Number, Number, Number, Number, Number], counted(6)]
BundleFile = Annotated[
    Path,
    GetPydanticSchema(
        lambda _, handler: core_schema.with_info_wrap_validator_function(
            _in_folder, handler.generate_schema(Text)
        )
    ),
]
Point = Annotated[np.ndarray, array_of(Three)]


def unit_vector(v: Sequence[float]) -> tuple[float, float, float]:
    """Return a direction's unit vector, in plain floats."""
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return v[0] / length, v[1] / length, v[2] / length


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """Return the vector product: indices i - 2 and i - 1 are those after i, cyclically."""
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def _orthonormal(rows: Sequence[Sequence[float]]) -> np.ndarray:
    """Return three directions made exactly orthonormal, shape (3, 3), dimensionless.

    Raises ValueError if they are not orthonormal to `_ORTHONORMAL`, or are left-handed.
    """
    axes = np.array(rows)
    wanted = "must be three directions of length 1 at right angles"
    for number, length in enumerate(np.hypot.reduce(axes, axis=1).tolist(), start=1):
        if abs(length - 1.0) > 0.5 * _ORTHONORMAL:  # the square differs by twice as much
            raise ValueError(
                f"{wanted}; direction {number} has length {length:.8g}: divide it by this length"
            )
    for i, j in combinations(range(3), 2):
        if abs(cosine := float(axes[i] @ axes[j])) > _ORTHONORMAL:
            angle = f"{math.degrees(math.acos(max(-1.0, min(cosine, 1.0)))):.6g} degrees"
            raise ValueError(
                f"{wanted}; directions {i + 1} and {j + 1} are at {angle}: correct one of them"
            )
    if np.linalg.det(axes) < 0.0:
        raise ValueError("must be right-handed, but z is against x cross y; reverse one direction")
    # An exact frame with the same x, in plain floats: the digits are part of the fingerprint, so
    # they must not depend on a machine's linear algebra library.
    first, second, _ = axes.tolist()
    x = unit_vector(first)
    z = unit_vector(_cross(x, second))
    return np.array([x, unit_vector(_cross(z, x)), z])


_Directions = Annotated[
    tuple[Three, Three, Three], counted(3, "must be three directions, the frame's x, y and z")
]
Axes = Annotated[np.ndarray, array_of(_Directions, _orthonormal)]


def mesh_axes() -> np.ndarray:
    """Return the mesh's axes, shape (3, 3)."""
    return np.eye(3)


def validate(
    kind: Any, value: object, where: str, problems: list[BundleProblem], folder: Path | None = None
) -> Any:
    """Return `value`, of the key `where`, as a `kind`; None if it cannot be used.

    kind: a type of fields, or a class under `table`.
    problems: mistakes are added, each with its path from `where`.
    folder: the bundle's folder, in which its files lie.
    """
    try:
        return _adapter(kind).validate_python(
            value, by_alias=True, by_name=False, context={"folder": folder or Path()}
        )
    except ValidationError as error:
        entries: list[Any] = list(error.errors(include_url=False))
        for entry in entries:
            if entry["type"] == "too_short" and len(entry["input"]) >= entry["ctx"]["min_length"]:
                continue  # counted without its wrong items
            for problem in _problems(kind, where, entry):
                if problem not in problems:
                    problems.append(problem)
        return None


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def keys_of(cls: type) -> dict[str, FieldInfo]:
    """Return the fields of a class under `table` by their keys in the file: its own first."""
    fields: dict[str, FieldInfo] = vars(cls)["__pydantic_fields__"]
    # Inherited keys are keyword-only; `generator` is too, but comes first.
    ordered = sorted(
        fields.items(), key=lambda item: bool(item[1].kw_only and item[0] != "generator")
    )
    return {info.alias or name: info for name, info in ordered if info.init is not False}


def tables_in(kind: Any) -> Iterator[type]:
    """Yield the classes under `table` that a type has at one path."""
    if isinstance(kind, type) and is_dataclass(kind):
        yield kind
    for part in get_args(kind) if get_origin(kind) is not Literal else ():
        yield from tables_in(part)


def extra_of(info: FieldInfo | None) -> Mapping[str, Any]:
    """Return the metadata of `key` besides the description."""
    extra = info.json_schema_extra if info is not None else None
    return extra if isinstance(extra, dict) else {}


def _problems(kind: Any, where: str, entry: Mapping[str, Any]) -> Iterator[BundleProblem]:
    """Yield the mistakes of one of pydantic's errors, each at its path."""
    path = where
    info = None
    classes = list(tables_in(kind))
    is_map = False  # the next part of the path is a name that the user has chosen
    for part in entry["loc"]:
        if isinstance(part, int) and part < 0:  # the branch of a union
            classes = classes[~part:][:1]
        elif isinstance(part, int):
            path += f"[{part}]"
        else:
            path += f".{part}" if path else part
            known = [keys_of(cls)[part] for cls in classes if part in keys_of(cls)]
            if known and not is_map:
                info = known[0]
                classes = list(tables_in(info.annotation))
            # As in mesh.groups.NAME, between a key and the next table's.
            is_map = bool(known) and not is_map and get_origin(known[0].annotation) is Mapping
    unit = extra_of(info).get("unit") or "no unit"
    if entry["type"] == "literal_error":
        path = re.sub(r"\[\d+\]$", "", path)  # path of the list
    if entry["type"] == "value_error":
        error = entry["ctx"]["error"]
        if isinstance(error, MistakesError):
            yield from (BundleProblem(f"{path}.{at}", text) for at, text in error.pairs)
        else:
            yield BundleProblem(path, str(error).replace("{unit}", unit))
    elif entry["type"] == "unexpected_keyword_argument":
        yield BundleProblem(path, unknown(entry["loc"][-1], classes[0]))
    elif entry["type"] == "tuple_type" and classes and type(entry["input"]) is dict:
        yield BundleProblem(path, not_single(path))
    else:
        yield BundleProblem(path, _sentence(entry, info))


def not_single(path: str) -> str:
    """Return the message for one table in place of a list of tables."""
    key = re.sub(r"\[\d+\]", "", path)
    return f"must be a list; write [[{key}]] instead of [{key}]"


def unknown(name: str, cls: type) -> str:
    """Return the message for a key that a table does not have."""
    refused: Mapping[str, str] = getattr(cls, "refused", {})
    known = list(keys_of(cls))
    message = f"is an unknown key (known here: {', '.join(known)}); correct it"
    return refused.get(name) or message + suggest(name, known)


_NOUNS = {  # of pydantic's types of errors
    "bool_type": "true or false",
    "tuple_type": "a list",
    "dataclass_type": "a table",
    "dict_type": "a table",
}


def _sentence(entry: Mapping[str, Any], info: FieldInfo | None) -> str:
    """Return the message for one of pydantic's errors: the mistake and its correction."""
    error = entry["type"]
    value = entry["input"]
    context = entry.get("ctx", {})
    extra = extra_of(info)
    unit = extra.get("unit") or "no unit"
    if error == "missing":
        return missing(info)
    if error in _NOUNS:
        return f"must be {_NOUNS[error]}, not {shown(value)}"
    if error == "string_type" or (error == "literal_error" and type(value) is not str):
        return f"must be a string, not {shown(value)}; put it in quotation marks"
    if error == "literal_error":
        choices = extra.get("choices") or _QUOTED.findall(context["expected"])
        return f'must be one of {", ".join(choices)}, not "{value}"{suggest(value, choices)}'
    if error == "too_short":
        example = f"; write for example {extra['example']}" if "example" in extra else ""
        return f"must name at least {context['min_length']}, but the list is empty{example}"
    noun = _noun(info)
    if noun.startswith("a whole number") or "expected_text" in extra:
        return f"must be {noun}, not {shown(value)}"
    for bound, side in (("gt", "above"), ("ge", "at least"), ("lt", "below")):
        if bound in context:
            return f"must be {side} {context[bound]:g} ({unit}), not {value:g}"
    if error == "count":
        numbers = f"{context['count']} numbers {context['names']}".rstrip()
        return f"must be a list of {numbers} in {unit}, not {shown(value)}"
    return f"must be a finite number in {unit}, not {shown(value)}"


def missing(info: FieldInfo | None) -> str:
    """Return the message for a required key that is missing."""
    noun = _noun(info)
    example = extra_of(info).get("example", "")
    is_open = example and not noun.startswith("one of ")
    return f"is missing; write {noun}" + (f", such as {example}" if is_open else "")


def _noun(info: FieldInfo | None) -> str:
    """Return the expected value of a key, in words."""
    if info is None:
        return "a value"
    extra = extra_of(info)
    kind = _adapter(kind_of(info)).json_schema()
    kind = kind.get("anyOf", [kind])[0]  # without null
    unit = extra.get("unit") or "no unit"
    if expected_text := extra.get("expected_text"):
        return expected_text
    if choices := extra.get("choices") or kind.get("enum"):
        return f"one of {', '.join(choices)}"
    if kind.get("type") == "integer":
        return f"a whole number from {kind['minimum']} to {MAX_COUNT}"
    nouns = {"number": f"a number in {unit}", "string": "a string", "boolean": "true or false"}
    return (nouns | {"array": "a list"}).get(kind.get("type", ""), "a table")


def kind_of(info: FieldInfo) -> Any:
    """Return the type of a field with all its bounds."""
    return Annotated[(info.annotation, *info.metadata)] if info.metadata else info.annotation


def shown(value: object) -> str:
    """Return `value` shortened for a message."""
    text = repr(value).replace("'", '"') if type(value) is not bool else str(value).lower()
    return text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 3] + "..."
