"""Components and their tables: list, add, import, export."""

from __future__ import annotations

import io
import json
import secrets
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .connection import Connection
from .errors import ProblemError, ServerTimeout, ServerUnreachable
from .questions import component_path

_KINDS = {
    "csv": "text/csv; charset=utf-8",
    "json": "application/json",
    "hdf5": "application/x-hdf5",
}
_ENDINGS = {".csv": "csv", ".json": "json", ".h5": "hdf5", ".hdf5": "hdf5"}
# What loggers call their CSV; an export has no tab form, so these are read only.
_READ_ENDINGS = _ENDINGS | {".txt": "csv", ".tsv": "csv"}


def table_format(file: str | Path, *, reading: bool = False) -> str:
    """Return the format of a table file by its ending.

    Raises
    ------
    ValueError
        If the ending is none of a table's; the message lists those there are.
    """
    endings = _READ_ENDINGS if reading else _ENDINGS
    suffix = Path(file).suffix
    if suffix.lower() not in endings:
        named = f"the ending {suffix}" if suffix else "no ending"
        raise ValueError(
            f"{file} has {named}, which is no form of a table; there are {', '.join(endings)}"
        )
    return endings[suffix.lower()]


class Library(Connection):
    """List and add components; carry tables in and out."""

    def components(self) -> list[dict[str, Any]]:
        """Return the library: per component its name, title, range, rows, table version."""
        return self.call_json("GET", "/v1/components")["components"]

    def component(self, name: str) -> dict[str, Any]:
        """Return all there is to say about one component, with its wrench contract.

        Raises
        ------
        ProblemError
            If there is no such component (404).
        """
        return self.call_json("GET", component_path(name))

    def add_component(self, component: str | Path | Mapping[str, Any]) -> dict[str, Any]:
        """Add a component.

        Parameters
        ----------
        component : path or mapping
            A bundle, as its folder or a zip of it; or, for a component that is a table only,
            ``{"name", "title", "range": {"force": [3], "moment": [3]}}``, N and N·m.

        Returns
        -------
        dict
            As from `component`.

        Raises
        ------
        FileNotFoundError
            If the path does not exist.
        ProblemError
            If the name is taken (409) or the bundle has mistakes (422, all of them listed).
        """
        path = "/v1/components"
        if isinstance(component, Mapping):
            return self.call_json("POST", path, dict(component), repeatable=False)
        bundle = Path(component)
        archive = _zipped(bundle) if bundle.is_dir() else bundle.read_bytes()
        kind, content = _form(f"{bundle.stem}.zip", archive)
        return self.call("POST", path, content, kind=kind, repeatable=False).json()

    def import_table(
        self,
        name: str,
        table: str | bytes | Path,
        format: str | None = None,  # noqa: A002 (the contract's word)
        dry_run: bool = False,
        decimal: str | None = None,
    ) -> dict[str, Any]:
        """Load a table from outside: all its rows, or none.

        Parameters
        ----------
        name : str
            The component.
        table : path, str or bytes
            A file's path, or its content; a text of one line that is no JSON is a path.
        format : {"csv", "json", "hdf5"}, optional
            By the file's ending if not given; csv for a text.
        dry_run : bool
            Only check: mistakes come back in ``errors`` instead of as a ProblemError.
        decimal : {".", ","}, optional
            The decimal mark of a CSV; told from its numbers if not given.

        Returns
        -------
        dict
            ``inserted``, ``existing``, ``errors`` (``{row, field, message}``), ``dry_run``,
            ``table_version`` and ``in_use``: whether the rows answer already.

        Raises
        ------
        ValueError
            If the file's ending is none of a table's.
        ProblemError
            If rows have mistakes (422); ``errors`` names them, and nothing is loaded.
        """
        chosen, content = _table_file(table, format)
        reply = self.call(
            "POST",
            component_path(name, "table"),
            content,
            kind=_KINDS[chosen],
            query={"format": chosen, "dry_run": dry_run or None, "decimal": decimal},
        )
        return reply.json()

    def export_table(
        self,
        name: str,
        format: str = "csv",  # noqa: A002 (the contract's word)
        units: Mapping[str, str] | None = None,
    ) -> Any:
        """Return a component's table.

        Parameters
        ----------
        name : str
            The component.
        format : {"csv", "json", "hdf5"}
            Text of the first two, bytes of the last.
        units : mapping, optional
            For csv, any of ``force``, ``moment``, ``translation``, ``rotation`` to a unit, such as
            ``{"force": "lbf", "translation": "mm"}``; SI otherwise.

        Returns
        -------
        str or bytes
            What `import_table` loads again.
        """
        chosen = _known(format)
        query = {"format": chosen, **(units or {})}
        content = self.call("GET", component_path(name, "table"), query=query).content
        return content.decode() if chosen in ("csv", "json") else content

    def invalidate_row(self, name: str, row: int) -> None:
        """Take a row out of a component's table; it stays in the ledger, see `restore_row`.

        Parameters
        ----------
        name : str
            The component.
        row : int
            Number of the row, as exports and the detail of an answer give it.

        Raises
        ------
        ProblemError
            If there is no such component or row (404).
        """
        self.call("DELETE", component_path(name, f"table/{int(row)}"))

    def restore_row(self, name: str, row: int) -> None:
        """Take a row back into a component's table; parameters and errors as `invalidate_row`."""
        self.call("POST", component_path(name, f"table/{int(row)}/restore"))

    def make_report(self, name: str, wrenches: int = 24, seed: int = 1) -> dict[str, Any]:
        """Start making a report of error against run time; it takes minutes.

        Parameters
        ----------
        wrenches, seed : int
            How many random full wrenches are compared with finite elements, and which.

        Returns
        -------
        dict
            As from `report_state`.

        Raises
        ------
        ProblemError
            If the component has no rows or no finite-element setup (409).
        """
        query = {"wrenches": wrenches, "seed": seed}
        path = component_path(name, "report")
        return self.call_json("POST", path, query=query, repeatable=False)

    def report_state(self, name: str) -> dict[str, Any]:
        """Return ``state`` (none, running, done, failed), ``fraction`` and ``message``."""
        return self.call_json("GET", component_path(name, "report"), query={"format": "state"})

    def report(self, name: str, format: str = "json") -> bytes:  # noqa: A002 (the contract's word)
        """Return the latest report as ``json``, ``md`` or ``html``.

        Raises
        ------
        ProblemError
            If there is none yet (404).
        """
        return self.call("GET", component_path(name, "report"), query={"format": format}).content

    def health(self) -> dict[str, Any]:
        """Return the server's readiness: ``status`` and, if it is not ready, its ``faults``.

        Raises
        ------
        ServerUnreachable, ServerTimeout
            If nothing answers.
        """
        try:
            return self.call_json("GET", "/health/ready")
        except ProblemError as error:
            if error.status == 503 and error.body:
                return error.body
            raise

    def is_ready(self) -> bool:
        """Tell whether a server answers and is ready to."""
        try:
            self.call("GET", "/health/ready")
        except (ServerUnreachable, ServerTimeout, ProblemError):
            return False
        return True


def _table_file(table: str | bytes | Path, format_: str | None) -> tuple[str, bytes]:
    """Return the format and the content of a table given as a file, a path or its content."""
    if isinstance(table, str) and table.lstrip()[:1] != "{" and len(table.splitlines()) <= 1:
        table = Path(table)
    if isinstance(table, Path):
        return _known(format_ or table_format(table, reading=True)), table.read_bytes()
    return _known(format_ or "csv"), table.encode() if isinstance(table, str) else table


def _known(format_: str) -> str:
    if format_ not in _KINDS:
        raise ValueError(f"{format_!r} is no form of a table; there are {', '.join(_KINDS)}")
    return format_


def _zipped(folder: Path) -> bytes:
    """Return a zip of a bundle's folder; hidden files stay behind."""
    if not (folder / "component.toml").is_file():
        raise FileNotFoundError(f"{folder} has no component.toml: it is no component bundle")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            inside = path.relative_to(folder)
            if path.is_file() and not any(part.startswith(".") for part in inside.parts):
                archive.write(path, inside.as_posix())
    return buffer.getvalue()


def _form(filename: str, archive: bytes) -> tuple[str, bytes]:
    """Return content type and body of a form with the one file ``bundle`` (RFC 7578)."""
    boundary = secrets.token_hex(16)
    quoted = json.dumps(filename, ensure_ascii=True)
    head = (
        f"--{boundary}\r\n"
        f'Content-Disposition: form-data; name="bundle"; filename={quoted}\r\n'
        "Content-Type: application/zip\r\n\r\n"
    )
    tail = f"\r\n--{boundary}--\r\n"
    content = head.encode() + archive + tail.encode()
    return f"multipart/form-data; boundary={boundary}", content
