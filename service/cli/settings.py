"""Settings of `wrenchbook serve`: the command line, then the environment, then a file.

What can be set is what the command has options for; nothing is listed twice. An option
``--queue-limit`` is ``WRENCHBOOK_QUEUE_LIMIT`` in the environment and ``queue_limit`` in the file.
"""

from __future__ import annotations

import difflib
import inspect
import json
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer
from pydantic import Field, TypeAdapter, ValidationError, create_model
from pydantic.fields import FieldInfo
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)
from typer.models import OptionInfo

PREFIX = "WRENCHBOOK_"
FILE = "wrenchbook.toml"  # in the data directory, unless --config names another
# Variables of other commands and of tests; all others that begin so are taken for settings.
OTHERS = frozenset(
    [
        "SERVER",
        "KEY",
        "OWN_KEY",
        "FUZZ",
        "SOLVE",
        "KILLS",
        "SOAK",
        "SOAK_KILLS",
        "SOAK_SEEDS",
        "PARDISO",
        "BENCH_ROUNDS",
        "BENCH_UNKNOWNS",
        "MEMORY_MARGIN",
        "WORKER_FOLDER",
    ]
)
_NOT_SETTINGS = frozenset({"ctx", "config", "show_settings", "as_json"})


@dataclass(frozen=True)
class Setting:
    """The value of a setting, and where it comes from."""

    value: Any
    origin: str


class _Strict(BaseSettings):
    model_config = SettingsConfigDict(
        env_prefix=PREFIX, env_ignore_empty=True, extra="forbid", validate_default=False
    )

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Let the environment win over the file, whose values are given to the initialiser."""
        return env_settings, init_settings


def settings_of(
    ctx: typer.Context, command: Callable[..., Any], config: Path | None
) -> dict[str, Setting]:
    """Return each setting of a command as it holds.

    Parameters
    ----------
    ctx : typer.Context
        Of the command's call: tells what was said on its line.
    command : callable
        Its function.
    config : path or None
        The file; that in the data directory, if there is one, by default.

    Raises
    ------
    typer.BadParameter
        If a file or a variable has a setting that there is not, or a value that cannot be.
    """
    fields = _fields(command)
    given = {name for name in fields if _was_given(ctx, name)}
    environment = _environment(fields)
    here = Path(ctx.params["data"])
    data = here if "data" in given else environment.get("data") or here
    file = config or Path(data) / FILE
    from_file = _read(file, fields, named=config is not None)
    values = _checked(fields, from_file, file)
    origins = dict.fromkeys(fields, "default")
    origins |= dict.fromkeys(from_file, str(file))
    origins |= {name: f"{PREFIX}{name.upper()}" for name in environment}
    found = {}
    for name in fields:
        explicit = name in given
        if explicit:  # as typer parsed it: a path is still its text
            value = TypeAdapter(fields[name][0]).validate_python(ctx.params[name])
        else:
            value = getattr(values, name)
        found[name] = Setting(value, "command line" if explicit else origins[name])
    return found


def shown(settings: Mapping[str, Setting]) -> str:
    """Return settings as a file that says the same, with where each comes from."""
    lines = []
    for name, setting in settings.items():
        value = setting.value
        # JSON's texts, numbers, lists and truth values are TOML's too.
        written = json.dumps(value if isinstance(value, int | float | list) else str(value))
        line = f"# {name} is not set" if value is None else f"{name} = {written}"
        lines.append(f"{line}  # {setting.origin}")
    return "\n".join(lines) + "\n"


def _fields(command: Callable[..., Any]) -> dict[str, tuple[Any, FieldInfo]]:
    """Return the options of a command as fields: type, default, bounds."""
    hints = get_type_hints(command, include_extras=True)
    found = {}
    for name, parameter in inspect.signature(command).parameters.items():
        if name in _NOT_SETTINGS or get_origin(hints[name]) is not Annotated:
            continue
        kind, option = get_args(hints[name])[:2]
        assert isinstance(option, OptionInfo)
        found[name] = (
            kind,
            Field(parameter.default, ge=option.min, le=option.max, description=option.help),
        )
    return found


def _was_given(ctx: typer.Context, name: str) -> bool:
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"  # typer may bring a click of its own


def _environment(fields: Iterable[str]) -> dict[str, str]:
    """Return the settings that the environment has; an empty one is none."""
    found = {}
    for variable, value in os.environ.items():
        name = variable.removeprefix(PREFIX)
        if name == variable or name in OTHERS or not value:
            continue
        if name.lower() not in fields:
            raise _unknown(variable, [f"{PREFIX}{one.upper()}" for one in fields], "environment")
        found[name.lower()] = value
    return found


def _read(file: Path, fields: Iterable[str], *, named: bool) -> dict[str, Any]:
    try:
        found = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        if named:
            raise typer.BadParameter(f"there is no file {file}") from None
        return {}
    except NotADirectoryError:
        raise typer.BadParameter(
            f"{file.parent} is no data directory: it, or a folder of its path, is a file"
        ) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise typer.BadParameter(f"{file} cannot be read as TOML: {error}") from error
    for name in found:
        if name not in fields:
            raise _unknown(name, fields, str(file))
    if "data" in found and not named:
        raise typer.BadParameter(
            f"{file} lies in the data directory and cannot name another one; say it with --data"
        )
    return found


def _unknown(name: str, known: Iterable[str], place: str) -> typer.BadParameter:
    known = sorted(known)
    near = difflib.get_close_matches(name, known, 1, 0.5)
    meant = f"; did you mean {near[0]}?" if near else f". There are: {', '.join(known)}"
    return typer.BadParameter(f"there is no setting {name} ({place}){meant}")


def _checked(
    fields: Mapping[str, tuple[Any, FieldInfo]], from_file: dict[str, Any], file: Path
) -> BaseSettings:
    kind = create_model("ServeSettings", __base__=_Strict, **dict(fields))  # pyright: ignore
    try:
        return kind(**from_file)
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0]) if first["loc"] else ""
        variable = f"{PREFIX}{name.upper()}"
        place = variable if os.environ.get(variable) else f"{name} in {file}"
        raise typer.BadParameter(f"{place}: {first['msg']}, not {first['input']!r}") from error
