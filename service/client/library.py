"""Components and their tables: list, add, import, export."""

from __future__ import annotations

import io
import json
import re
import secrets
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ..contract import ExportFormat, ImportFormat
from .errors import Document, InvalidArgument, Json, ProblemError, ServerTimeout, ServerUnreachable
from .transport import BINARY, Connection, component_path
from .wrenches import require_one_of

_TEXTS = ("csv", "json", "bushing")
_ENDINGS = {
    ".csv": "csv",
    ".json": "json",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".xlsx": "xlsx",
    ".parquet": "parquet",
    ".wbt": "packed",
}
# The content decides how a file is read; files with these endings are no tables.
_NOT_READ = frozenset({".fmu", ".wbt", ".pdf"})
_JSON = re.compile(r"\s*(\{|\[\s*[\[{\]])")  # a file's name may begin with [1]
# The same pattern as the server's profiles.
RIG_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_IMPORT_S = 300.0  # s: a million rows take a minute, and an earlier import in the queue as long


def table_format(file: str | Path, further: Mapping[str, str] | None = None) -> str:
    """Return the format of a table file to be written; raises InvalidArgument by its ending.

    `further`: formats by ending beside those of tables, such as ``.fmu``.
    """
    more = ", or use wrenchbook export for .fmu and .zip" if further is None else ""
    return format_of(file, "table", _ENDINGS | dict(further or {}), more)


def format_of(file: str | Path, kind: str, formats: Mapping[str, str], more: str = "") -> str:
    """Return the format of a file's ending; raises InvalidArgument if it is not in `formats`."""
    suffix = Path(file).suffix
    if suffix.lower() not in formats:
        named = f"the ending {suffix}" if suffix else "no ending"
        raise InvalidArgument(
            f"{file} has {named}; name a {kind} file that ends in one of {', '.join(formats)}{more}"
        )
    return formats[suffix.lower()]


def check_readable(file: str | Path) -> None:
    """Raise InvalidArgument if a file's ending is that of a file other than a table."""
    suffix = Path(file).suffix.lower()
    if suffix in _NOT_READ:
        raise InvalidArgument(
            f"{file} ends in {suffix}, which is not the ending of a table; send CSV, XLSX, XLS, "
            "Parquet, JSON, HDF5, MAT, LVM or TDMS, gzipped or not"
        )


class LibraryCalls(Connection):
    """Components, and their tables as files."""

    def components(self) -> list[Document]:
        """Return the library: per component its name, title, range, rows, table version."""
        components: list[Document] = []
        next_page = "/v1/components"
        while next_page:
            page = self.call_json("GET", next_page)
            components += page["components"]
            next_page = page.get("next")
        return components

    def component(self, name: str, wait_s: float = 0.0) -> Document:
        """Return a component: its wrench contract, load range, rows and coverage.

        Parameters
        ----------
        wait_s : float
            Longest wait, s, until the table has all present rows; else ``pending_rows`` counts the
            others.

        Raises
        ------
        ProblemError
            If there is no such component (404).
        """
        query = {"wait_s": wait_s or None}
        return self.call_json("GET", component_path(name), query=query, wait_s=wait_s)

    def compliance(self, name: str) -> Document:
        """Return a component's 6x6 compliance and checks of its rows against physics.

        Returns
        -------
        dict
            ``tangent``: at zero load, 6 lines of 6, m/N, m/(N·m), rad/N, rad/(N·m), None where it
            is not known; ``tangent_origin``. ``matrix``: the mean over the load range, with its
            ``origin`` and ``error``. ``checks``.

        Raises
        ------
        ProblemError
            If there is no such component (404).
        """
        return self.call_json("GET", component_path(name, "compliance"))

    def add_component(self, component: str | Path | Mapping[str, Json]) -> Document:
        """Add a component.

        Parameters
        ----------
        component : path or mapping
            A bundle, as its folder or a zip of it; or, for a component that is a table only,
            ``{"name", "title", "range": {"force": [3], "moment": [3]}}``, N and N·m; several
            interfaces are ``"interface": [{"name", "range"}]``.

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
        if not bundle.is_dir():
            archive = bundle.read_bytes()
        elif not (bundle / "component.toml").is_file():
            raise FileNotFoundError(
                f"the folder {bundle} has no component.toml; name the folder that holds this file"
            )
        else:
            buffer = io.BytesIO()
            # A zip has no date before 1980, which files of archives and containers have.
            packing = zipfile.ZIP_DEFLATED
            with zipfile.ZipFile(buffer, "w", packing, strict_timestamps=False) as packed:
                for source in sorted(bundle.rglob("*")):
                    inside = source.relative_to(bundle)
                    if source.is_file() and not any(part.startswith(".") for part in inside.parts):
                        packed.write(source, inside.as_posix())  # hidden files are left out
            archive = buffer.getvalue()
        kind, content = _form({"bundle": (f"{bundle.stem}.zip", archive)})
        return self.call("POST", path, content, kind=kind, repeatable=False).json()

    def import_table(
        self,
        name: str,
        table: str | bytes | Path,
        format: str | None = None,  # noqa: A002 (the contract's word)
        dry_run: bool = False,
        decimal: str | None = None,
        *,
        displacements: str | Path | None = None,
        **columns: Json,
    ) -> Document:
        """Load a table from outside: all its rows, or none; with ``partial=True`` the good ones.

        Parameters
        ----------
        table : path, str or bytes
            A path (a text of one line that is no JSON) or the content, gzipped or not: CSV, XLSX,
            XLS, Parquet, HDF5, JSON, MAT, LVM, TDMS. With `displacements` the log of the loads.
        dry_run : bool
            Only check: mistakes are in ``errors``, no ProblemError.
        displacements : path, optional
            A second log, joined by time.
        **columns
            ``mapping`` (``{"Load cell": "fz [N]", "3": "uz"}``), ``ignore``, ``ignore_extra``,
            ``partial``, ``missing_loads``, ``tare``, ``preview``, ``sheet``, ``note``,
            ``time_offset_s`` or ``lag`` (s, or ``"auto"``), ``wait_s`` (10 s: until answers come
            from the rows), ``frame`` (a rig's axes, a text or shape (3, 3)), ``load_point``,
            ``displacement_point`` ((3,), m), ``load_cell`` (``"moving"``: moments are about the
            point where it is now, ``"fixed"``: where it was on the ground), ``rig`` (a TOML file,
            else the name of a profile of `rigs`), ``skip_cycles``, ``branch`` (``"loading"``,
            ``"unloading"``), ``thin`` (part of the load range), ``mean_cycles``.

        Returns
        -------
        dict
            ``inserted``, ``existing``, ``restored`` (existing rows that were withdrawn before),
            ``errors`` (``{row, field, message}``), ``causes`` (with ``count`` and ``rows``),
            ``columns``, ``findings``, ``rows``, ``ignored``, ``sheets``, ``sheet``,
            ``table_version`` and ``in_use``.

        Raises
        ------
        OSError
            If the path cannot be read.
        InvalidArgument, ProblemError
            If it is no table; if rows have mistakes (422), which ``errors`` names.
        """
        if format is not None:
            require_one_of("format", format, get_args(ImportFormat))
        if isinstance(table, str) and not _JSON.match(table) and len(table.splitlines()) <= 1:
            table = Path(table)
        if isinstance(table, Path):
            filename, content = _named_file(table)
        else:
            filename = ""
            content = table.encode() if isinstance(table, str) else table
            if not isinstance(content, bytes | bytearray | memoryview):
                raise InvalidArgument(
                    "table must be a path, or the content of a file as str or bytes, not "
                    f"{type(table).__name__}"
                )
        kind = BINARY
        if displacements is not None:
            logs = {"loads": (filename, content), "displacements": _named_file(displacements)}
            kind, content = _form(logs)

        mapping, ignore, rig = (columns.pop(name, None) for name in ("mapping", "ignore", "rig"))
        for part in ("frame", "load_point", "displacement_point"):
            value = columns.get(part)
            if value is not None and not isinstance(value, str):
                columns[part] = ",".join(map(repr, np.ravel(value).astype(float).tolist()))
        query = {
            "format": format,
            "dry_run": dry_run or None,
            "decimal": decimal,
            "mapping": json.dumps(dict(mapping)) if mapping else None,
            "ignore": list(ignore or ()) or None,
            "filename": filename or None,
            "rig": _profile(rig) if rig else None,
            **columns,
        }
        path = component_path(name, "table")
        wait_s = _IMPORT_S + float(columns.get("wait_s") or 0)
        return self.call("POST", path, content, kind=kind, query=query, wait_s=wait_s).json()

    def append(
        self,
        name: str,
        test: str,
        rows: Mapping[str, Json] | Sequence[Mapping[str, Json]],
        **columns: Any,
    ) -> Document:
        """Append rows to the table while a test runs: all of them, or none.

        A block that is sent again adds nothing.

        Parameters
        ----------
        test : str
            The name of the test: all of its blocks are one import of this sender.
        rows : mapping or sequence of mappings
            One row or 1,000 at most: ``wrench`` and ``displacement``, shape (6,), SI, None where
            not measured, ``uncertainty``, ``source``, ``note``; or numbers by column,
            ``{"fz [kN]": 1.2, "uz [mm]": 0.31}``.
        **columns
            Those of `import_table` that are no options of files; ``wait_s`` is 0 if left out.

        Returns
        -------
        dict
            As of `import_table`, without findings.

        Raises
        ------
        ProblemError
            If rows have mistakes (422); if the import is withdrawn or of another rig (409).
        """
        many = [rows] if isinstance(rows, Mapping) else list(rows)
        in_si = any("wrench" in row for row in many)
        content = json.dumps({"rows": many} if in_si else many, default=_plain).encode()
        return self.import_table(name, content, append=test, **columns)

    def comparison(
        self,
        name: str,
        number: int | None = None,
        against: int | None = None,
        format: str = "json",  # noqa: A002 (the contract's word)
    ) -> Json:
        """Return measured rows beside the answer of the solves alone, or of another import.

        Parameters
        ----------
        number : int, optional
            The import whose rows are compared; all measured rows otherwise.
        against : int, optional
            The import whose rows are the reference, by a kriging of them; the solves otherwise.
        format : {"json", "csv"}
            ``csv``: the rows alone, as text.

        Returns
        -------
        dict or str
            Rows by column (``wrench``, ``displacement``, ``expected``, ``residual``, ``bar``), and
            for each of ``outputs`` and ``campaigns`` the ``factor`` with its ``half_width``.

        Raises
        ------
        ProblemError
            If there is no such component (404) or import (409).
        """
        query = {"import": number, "against": against, "format": format}
        content = self.call("GET", component_path(name, "comparison"), query=query).content
        return content.decode() if format == "csv" else json.loads(content)

    def export_table(
        self,
        name: str,
        format: str = "csv",  # noqa: A002 (the contract's word)
        units: Mapping[str, str] | None = None,
        table_version: int | None = None,
        **curves: Json,
    ) -> Json:
        """Return a component's table.

        Parameters
        ----------
        name : str
            The component.
        format : {"csv", "xlsx", "parquet", "hdf5", "json", "packed", "bushing"}
            Text of csv and json, bytes of the others; packed is what `Table.open` opens. bushing is
            CSV of load over displacement of each axis, for bushings of multibody programs.
        units : mapping, optional
            For csv and xlsx, any of ``force``, ``moment``, ``translation``, ``rotation`` to a unit,
            such as ``{"force": "lbf", "translation": "mm"}``; SI otherwise.
        table_version : int, optional
            The table as it was at this version; now if not given.
        **curves
            Of bushing: ``points`` of each axis (21), ``others``, zero on the other axes:
            ``"displacement"`` or ``"load"``.

        Returns
        -------
        str or bytes
            What `import_table` loads again, but packed and bushing: they are derived from the rows.
        """
        require_one_of("format", format, get_args(ExportFormat))
        query = {"format": format, "table_version": table_version, **(units or {}), **curves}
        content = self.call("GET", component_path(name, "table"), query=query).content
        return content.decode() if format in _TEXTS else content

    def invalidate_row(self, name: str, row: int) -> None:
        """Withdraw a row from a component's table; it stays in the ledger, see `restore_row`.

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
        self.call("DELETE", component_path(name, f"table/{_whole('row', row)}"))

    def restore_row(self, name: str, row: int) -> None:
        """Restore a withdrawn row of a table; errors as of `invalidate_row`."""
        self.call("POST", component_path(name, f"table/{_whole('row', row)}/restore"))

    def withdraw_import(
        self, name: str, number: int, finding: str | None = None, *, restore: bool = False
    ) -> Document:
        """Withdraw the rows of an import, or those that one of its findings names.

        The rows stay in the ledger. Rows that are withdrawn already do not change.

        Parameters
        ----------
        number : int
            Of the import: ``import`` in the reply of `import_table` and in a component's warnings.
        finding : str, optional
            The finding's ``cause``; all rows of the import if left out.
        restore : bool
            Bring the rows back instead.

        Returns
        -------
        dict
            ``rows``, how many changed; ``current``, whether answers come from the table as it is
            now; ``table_version``.

        Raises
        ------
        ProblemError
            If there is no such component, import or finding (404).
        """
        call = f"imports/{_whole('number', number)}"
        path = component_path(name, call + "/restore" if restore else call)
        return self.call("POST" if restore else "DELETE", path, query={"finding": finding}).json()

    def stiffness(
        self,
        name: str,
        between: Sequence[float],
        axis: str | None = None,
        of: str | None = None,
        number: int | None = None,
    ) -> Document:
        """Return the slope of a load over a displacement in measured rows between two loads.

        It is that of ``numpy.polyfit(displacement, load, 1)``: the displacement is x, the load y.

        Parameters
        ----------
        between : two floats, N or N·m
            The rows whose load is between them.
        axis, of : str, optional
            Load and output, such as ``"fz"`` and ``"uz"``; that of the largest range otherwise.
        number : int, optional
            Of an import: its rows alone.

        Returns
        -------
        dict
            ``lines`` of ``all``, ``loading``, ``unloading`` and ``opposite`` (loads of the other
            sign): ``slope`` in ``unit`` with ``slope_half_width`` (95 %), ``residual``, ``r2``,
            ``rows``, ``unloaded``; ``play`` at no load between ``branches`` and ``signs``.

        Raises
        ------
        ProblemError
            If there is no such component or import (404), load or output (422).
        """
        query = {"between": ",".join(repr(float(load)) for load in between), "axis": axis, "of": of}
        path = component_path(name, "stiffness")
        return self.call_json("GET", path, query=query | {"import": number})

    def make_report(self, name: str, wrenches: int = 24, seed: int = 1) -> Document:
        """Start a report of error against run time; it takes minutes.

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
        return self.call("POST", path, query=query, repeatable=False).json()

    def report_state(self, name: str) -> Document:
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

    def health(self) -> Document:
        """Return the server's readiness: ``status`` and, if it is not ready, its ``faults``.

        Raises
        ------
        ServerUnreachable, ServerTimeout
            If nothing answers.
        """
        try:
            return self.call_json("GET", "/health/ready", retry=False)
        except ProblemError as error:
            if error.status == 503 and error.body:
                return error.body
            raise

    def is_ready(self) -> bool:
        """Return whether a server answers and is ready."""
        try:
            self.call("GET", "/health/ready", retry=False)
        except (ServerUnreachable, ServerTimeout, ProblemError):
            return False
        return True


def _whole(name: str, value: int) -> int:
    """Return the number of a row or an import; raises InvalidArgument unless it is whole."""
    try:
        number = int(value)
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None or (isinstance(value, float) and number != value):
        raise InvalidArgument(f"{name} must be a whole number, not {value!r:.80}")
    return number


def _named_file(file: str | Path) -> tuple[str, bytes]:
    check_readable(file)
    return Path(file).name, Path(file).read_bytes()


def _plain(value: Any) -> Json:
    """Return numpy's array or number as Python's lists and numbers."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise InvalidArgument(f"{value!r:.80} in rows is no JSON value; give numbers and texts")


def _profile(rig: str | Path) -> str:
    """Return the text of a TOML file, or the name of a stored profile of the server."""
    if isinstance(rig, str) and RIG_NAME.fullmatch(rig) and not Path(rig).is_file():
        return rig
    return Path(rig).read_text("utf-8-sig", "replace")


def _form(files: Mapping[str, tuple[str, bytes]]) -> tuple[str, bytes]:
    """Return content type and body of a form of files by field: name and content (RFC 7578)."""
    boundary = secrets.token_hex(16)
    parts = []
    for field, (filename, content) in files.items():
        for mark in '"\r\n':  # browsers escape these three alone; the rest is UTF-8
            filename = filename.replace(mark, f"%{ord(mark):02X}")
        head = (
            f"--{boundary}\r\n"
            f'Content-Disposition: form-data; name="{field}"; filename="{filename}"\r\n'
            "Content-Type: application/octet-stream\r\n\r\n"
        )
        parts.append(head.encode() + content + b"\r\n")
    body = b"".join(parts) + f"--{boundary}--\r\n".encode()
    return f"multipart/form-data; boundary={boundary}", body
