"""The settings of a server: options of `serve`, variables of the environment, keys of a file.

``queue_limit`` is the option ``--queue-limit``, the variable ``WRENCHBOOK_QUEUE_LIMIT`` and the key
``queue_limit``. The option has priority over the variable, and the variable over the file.
"""

from __future__ import annotations

import difflib
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le

from wrenchbook.service.files.program import usable_cores
from wrenchbook.service.files.toml import toml_value
from wrenchbook.service.mistakes import mistake_of

PREFIX = "WRENCHBOOK_"
FILE = "wrenchbook.toml"  # settings file in the data directory, unless --config names another
# Variables of other commands and of tests; all others with this prefix are settings.
OTHERS = frozenset(
    {"SERVER", "KEY", "OWN_KEY", "MEMORY_MARGIN", "PARDISO", "SOLVE", "FUZZ"}
    | {"KILLS", "SOAK", "SOAK_KILLS", "SOAK_SEEDS", "BENCH_ROUNDS", "BENCH_UNKNOWNS"}
)
_SCHEMES = ("tcp", "tls", "ws", "wss", "ucx")  # schemes by which Dask connects to other machines
_DONE, _FAILED = "folders of done attempts", "folders of failed and cancelled attempts"
Count = Annotated[int, Ge(0)]
Days = Annotated[float, Ge(0)]
LogLevel = Literal["debug", "info", "warning", "error"]


@dataclass(frozen=True)
class Settings:
    """The settings of a server; the text beside each is the help of its option."""

    data: Annotated[Path, "data directory"] = Path("wrenchbook-data")
    solvers: Annotated[Count, "solves at once; by default one a core"] = field(
        default_factory=usable_cores
    )
    host: Annotated[str, "address to listen on"] = "127.0.0.1"
    port: Annotated[int, Ge(0), Le(65535), "port to listen on; 0: a free one"] = 8000
    processes: Annotated[int, Ge(1), Le(64), "web workers that answer"] = 1
    engine: Annotated[str, "where solves run: local or dask"] = "local"
    scheduler: Annotated[str | None, "Dask scheduler of --engine dask, tcp:// or tls://"] = None
    allow_decks: Annotated[bool, "accept uploads whose deck has a solver command"] = False
    method: Annotated[
        Literal["griddata", "additive", "kriging", "linear"] | None,
        "interpolation method if a request names none; by default each table's best",
    ] = None
    queue_limit: Annotated[
        Count, "largest number of open jobs that queries may queue for a component"
    ] = 64
    actor_jobs: Annotated[
        int | None, Ge(0), "largest number of open jobs of an actor (a key or user); by default any"
    ] = None
    actor_seconds: Annotated[
        float | None, Ge(0), "largest solver time of an actor in 24 h, s; by default any"
    ] = None
    table_memory: Annotated[Count, "memory for rows and numpy tables, MB"] = 700
    keep_days: Annotated[Days, f"days that {_DONE} are kept"] = 30.0
    keep_count: Annotated[Count, f"largest number of {_DONE}; each has 27 kB"] = 2000
    keep_failed_days: Annotated[Days, f"days that {_FAILED} are kept"] = 180.0
    keep_failed_count: Annotated[Count, f"largest number of {_FAILED}"] = 10_000
    log_level: Annotated[LogLevel, "lowest level that is logged"] = "info"
    log_format: Annotated[Literal["text", "json"], "log lines as text, or as JSON objects"] = "text"
    access_log: Annotated[bool, "log each request; this turns off the fast path of queries"] = False
    allow_host: Annotated[str | None, "further host names of this server, separated by commas"] = (
        None
    )
    allow_origin: Annotated[
        str | None, "origins whose pages may call, https://..., separated by commas"
    ] = None
    trust_proxy_user: Annotated[
        str | None, "header of a trusted proxy with the user's name: X-Forwarded-User"
    ] = None
    trust_proxy_from: Annotated[str | None, "networks of trusted proxies, separated by commas"] = (
        None
    )
    trust_proxy_groups: Annotated[
        str | None, "header of a trusted proxy with the user's groups"
    ] = None
    trust_proxy_scopes: Annotated[
        str, "scope of each group of users, * for all users: lab=write,*=read"
    ] = "*=write"
    replicate: Annotated[
        str | None, "URL of a replica of this data directory: file:///FOLDER, s3:// or sftp://"
    ] = None
    replicate_interval: Annotated[float, Ge(0.5), "longest work, s, that the replica may lack"] = (
        5.0
    )
    public_url: Annotated[
        str | None, "URL of this server, which messages of its read-only servers contain"
    ] = None
    read_only: Annotated[
        str | None, "URL of a replica: answer from it, without writes and solves"
    ] = None
    backup_every: Annotated[
        Days, "hours between backups, each of which is tested; 0: no backups"
    ] = 0.0
    backup_folder: Annotated[Path | None, "folder of the backups; by default DATA/backups"] = None
    backup_keep: Annotated[int, Ge(1), "number of newest backups that are kept"] = 7
    first_key: Annotated[bool, "make and print a key of scope admin if there is no key"] = False


class SettingsError(ValueError):
    """A file, a variable or an option has an unknown setting, or a wrong value."""


def read_settings(
    options: Mapping[str, Any], config: Path | None
) -> tuple[Settings, dict[str, str]]:
    """Merge options, environment and file; return the settings, and the origin of each.

    `options` are those of the command line alone. `config` is the file; by default that of the data
    directory, if there is one.

    Raises SettingsError if a setting is unknown or a value is wrong.
    """
    from pydantic import TypeAdapter, ValidationError  # no other command waits for its import

    names = [setting.name for setting in fields(Settings)]
    environment: dict[str, Any] = {}
    for variable, value in os.environ.items():
        name = variable.removeprefix(PREFIX)
        if name == variable or name in OTHERS or not value:
            continue
        if name.lower() not in names:
            raise _unknown(variable, [f"{PREFIX}{known.upper()}" for known in names], "environment")
        environment[name.lower()] = value
    data = Path(options.get("data") or environment.get("data") or Settings.data)
    file = config or data / FILE
    from_file = _read(file, names, named=config is not None)
    origins = dict.fromkeys(names, "default") | dict.fromkeys(from_file, str(file))
    origins |= {name: f"{PREFIX}{name.upper()}" for name in environment}
    origins |= dict.fromkeys(options, "command line")
    try:
        values = {**from_file, **environment, **options}
        return TypeAdapter(Settings).validate_python(values), origins
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0])
        place = origins[name]
        if place == str(file):
            place = f"{name} in {file}"
        elif place == "command line":
            place = f"--{name.replace('_', '-')}"
        raise SettingsError(f"{place}: {mistake_of(first)}") from error


def listed(text: str | None) -> list[str]:
    """Return the entries of a setting with commas, without blanks and empty ones."""
    return [entry for part in (text or "").split(",") if (entry := part.strip())]


def check_engine(name: str, scheduler: str | None) -> None:
    """Check the engine before anything is opened.

    Raises SettingsError if its name, scheduler or package is wrong.
    """
    why = None
    if name not in ("local", "dask"):
        why = f"--engine must be local or dask, not {name!r}"
    elif name == "local":
        why = scheduler and "--engine local has no --scheduler; add --engine dask"
    elif not scheduler:
        why = "--engine dask needs a scheduler; add --scheduler tcp://HOST:8786 (or tls://)"
    elif "://" not in scheduler:
        why = f"--scheduler {scheduler!r} lacks tcp:// or tls://; write tcp://{scheduler}"
    elif scheduler.split("://")[0] not in _SCHEMES:
        begins = " or ".join(f"{scheme}://" for scheme in _SCHEMES)
        why = f"--scheduler {scheduler!r} must begin with {begins}"
    elif find_spec("distributed") is None:
        why = "--engine dask lacks its package; run: pip install 'wrenchbook[cluster]'"
    if why:
        raise SettingsError(why)


def check_copies(settings: Settings) -> None:
    """Check the settings of replica and backups.

    Raises SettingsError if they contradict each other or cannot work.
    """
    for name in ("replicate", "read_only"):
        scheme, separator, path = (getattr(settings, name) or "file://").partition("://")
        why = ""  # without the URL, which may contain a password
        if not separator:
            why = "is not a URL"
        elif scheme == "file" and path[:1] not in ("", "/"):
            why = f"file://{path} has a relative path"
        elif scheme in ("http", "https"):
            why = f"{scheme}:// is the address of a server, not of a storage"
        if why:
            raise SettingsError(
                f"--{name.replace('_', '-')}: {why}; write file:///FOLDER, s3://BUCKET/FOLDER or "
                "sftp://HOST/FOLDER"
            )
        folder = Path(path).resolve()
        inside = folder.is_relative_to(settings.data.resolve())
        if scheme == "file" and path and (inside or (folder / "ledger.sqlite").exists()):
            option = f"--{name.replace('_', '-')}"
            raise SettingsError(f"{option}: {folder} is in a data directory; name one outside")
    if settings.read_only and (settings.replicate or settings.backup_every):
        copying = "--replicate" if settings.replicate else "--backup-every"
        raise SettingsError(f"{copying}: a server with --read-only makes no copies; remove either")


def check_names(settings: Settings) -> None:
    """Check names and origins of other machines; raises SettingsError for any other text."""
    for host in listed(settings.allow_host):
        if "/" in host:
            name = host.split("://")[-1].split("/")[0] or "HOST"
            text = f"takes a host name without http:// or a path: {name}"
            raise SettingsError(f"--allow-host {text}")
    for origin in listed(settings.allow_origin):
        if not re.fullmatch(r"https?://[^/]+/?", origin, re.IGNORECASE):
            host = origin.split("://")[-1].split("/")[0] or "HOST"
            text = f"{origin} is not an origin; write https://{host}"
            raise SettingsError(f"--allow-origin {text}")
    if settings.public_url and not re.match(r"https?://[^/]", settings.public_url, re.IGNORECASE):
        text = f"{settings.public_url} is not a URL; write https://HOST"
        raise SettingsError(f"--public-url {text}")


def as_file(settings: Settings, origins: Mapping[str, str]) -> str:
    """Return settings as a file with the same meaning, with the origin of each."""
    lines = []
    for name, origin in origins.items():
        value = getattr(settings, name)
        if isinstance(value, str | Path):  # a path may have bytes that no text has
            value = str(value).encode(errors="replace").decode()
        line = f"# {name} is not set" if value is None else f"{name} = {toml_value(value)}"
        lines.append(f"{line}  # {origin}")
    return "\n".join(lines) + "\n"


def _read(file: Path, names: Iterable[str], *, named: bool) -> dict[str, Any]:
    """Return the settings of a file; none if it does not exist and was not `named`.

    Raises SettingsError if the file cannot be read or has unknown settings.
    """
    try:
        values = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        if named:
            raise SettingsError(
                f"the file {file} does not exist; create it, or leave --config out"
            ) from None
        return {}
    except NotADirectoryError:
        raise SettingsError(
            f"{file.parent} must be a folder, but it or a part of its path is a file; name another "
            f"with {'--config' if named else '--data'}"
        ) from None
    except OSError as error:
        raise SettingsError(
            f"{file} cannot be read ({error.strerror}); let this user read it"
        ) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        why = str(error).replace("Cannot overwrite a value", "a name is there twice")
        raise SettingsError(f"{file} cannot be read as TOML ({why}); correct it") from error
    for name, value in values.items():
        if name not in names and isinstance(value, dict):
            raise SettingsError(
                f"{file}: [{name}] is a table, but settings stand at the top level; remove this "
                "line"
            )
        if name not in names:
            raise _unknown(name, names, str(file))
    if "data" in values and not named:
        raise SettingsError(f"{file} is in the data directory and cannot name another; use --data")
    return values


def _unknown(name: str, known: Iterable[str], place: str) -> SettingsError:
    known = sorted(known)
    near = difflib.get_close_matches(name, known, 1, 0.5)
    meant = f"; did you mean {near[0]}?" if near else f"; use one of {', '.join(known)}"
    return SettingsError(f"there is no setting {name} ({place}){meant}")
