"""Table files of every format: from untrusted files to pieces of SI arrays, in bounded memory.

The format comes from the content. A child process with limits reads the file; it returns arrays and
JSON, one part a piece and a last one with the report, so a hostile file can at worst give wrong
numbers. Findings look at a bounded sample of the rows.
"""

from __future__ import annotations

import codecs
import gzip
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.contract import ImportFormat
from wrenchbook.service.formats.cells import ContentError
from wrenchbook.service.formats.columnar import read_hdf5, read_parquet
from wrenchbook.service.formats.csv import read_csv
from wrenchbook.service.formats.cycles import with_cycles
from wrenchbook.service.formats.header import POSITION
from wrenchbook.service.formats.json import read_json
from wrenchbook.service.formats.limits import of_current_setup, within_limits
from wrenchbook.service.formats.logs import joined_loads, with_loads
from wrenchbook.service.formats.lvm import MAGIC, read_lvm
from wrenchbook.service.formats.mat import read_mat
from wrenchbook.service.formats.options import (
    MEASURED,
    Options,
    ParsedTable,
    ReadReport,
    is_corrected,
)
from wrenchbook.service.formats.rig import rigged, with_known_point, zeroed
from wrenchbook.service.formats.tdms import read_tdms
from wrenchbook.service.formats.units import FORCE, si_factor
from wrenchbook.service.formats.xlsx import read_xls, read_xlsx
from wrenchbook.service.sandbox import Limits, Part, SandboxError, run
from wrenchbook.surrogate.findings.find import MAX_ROWS, find
from wrenchbook.surrogate.findings.response import RigFinding
from wrenchbook.surrogate.table.rows import Rows, is_unknown, joined, nulls, unknown_column
from wrenchbook.surrogate.table.space import DEFAULT, Space

MAX_PREVIEW = 100
MAX_BLOCK = 1_000  # rows that are appended at once: read in hundredths of a second
# Of a file, packed or not: two million rows of 12 numbers, or a million with 17 digits each.
MAX_BYTES = 512 * 1024 * 1024
# A million rows of 17 digits take 20 s and 300 MB.
_LIMITS = Limits(memory=1024 << 20, seconds=60.0, output=1024 << 20)
_NUMBERS = ("seq", "wrench", "displacement", "uncertainty", "compliance", "curvature")
_READERS: dict[str, Callable[[Path, Options, ReadReport], Iterator[ParsedTable]]] = {
    "csv": read_csv,
    "xlsx": read_xlsx,
    "parquet": read_parquet,
    "hdf5": read_hdf5,
    "json": read_json,
    "mat": read_mat,
    "lvm": read_lvm,
    "tdms": read_tdms,
    "xls": read_xls,
}
# Of formats whose packages raise many classes of errors for damaged files.
_UNREADABLE = {
    "xlsx": "is no readable XLSX workbook: {}; save it again",
    "parquet": "is damaged, or not Parquet; write it again",
    "mat": "is damaged, or not a MATLAB file; save it again with save('t.mat', '-v7')",
    "tdms": "cannot be read as TDMS: {}; export it again, or as CSV",
    "xls": "cannot be read as .xls (save it as .xlsx): {}",
}
_TEXT_FORMATS = {"csv", "json"}  # a damaged file of one can look like the other
_BLOCK = 1 << 20
_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_OFFSETS = (0, 512, 1024, 2048)  # behind a user block
_MAGIC: dict[bytes, ImportFormat] = {
    b"PAR1": "parquet",
    b"MATLAB 5.0 MAT-file": "mat",
    b"TDSm": "tdms",
    b"\xd0\xcf\x11\xe0": "xls",
    MAGIC: "lvm",
    codecs.BOM_UTF8 + MAGIC: "lvm",
}
_OTHER_FORMATS = {
    b"%PDF": "a PDF; export the table as CSV or XLSX",
    b"TDSh": "the index of a TDMS file; send the .tdms file itself",
    b"\x89PNG": "a picture; send the table itself as CSV or XLSX",
    b"Rar!": "a RAR archive; unpack it first",
    b"7z\xbc\xaf": "a 7z archive; unpack it first",
    b"BZh": "compressed by bzip2; use gzip or no compression",
    b"\xfd7zXZ": "compressed by xz; use gzip or no compression",
    b"\x28\xb5\x2f\xfd": "compressed by zstd; use gzip or no compression",
}


@dataclass(frozen=True)
class ReadResult:
    """The report on a file, as `ReadReport.as_json` returns it, and its good rows in parts."""

    report: Mapping[str, Any]
    parts: Sequence[Part]
    space: Space = DEFAULT

    def pieces(self) -> Iterator[ParsedTable]:
        """Yield the rows in pieces."""
        inputs, outputs = len(self.space.inputs), len(self.space.outputs)
        for part in self.parts:
            n = len(part.arrays["seq"])
            note = part.fields["note"]
            columns: dict[str, Any] = {
                "uncertainty": unknown_column(n, outputs),
                "compliance": unknown_column(n, outputs, inputs),
                "curvature": np.empty((n, 0)),
                "note": [note] * n if isinstance(note, str) else note,
            }
            for name in ("source", "fingerprint"):
                text = part.fields[name]
                columns[name] = np.full(n, text) if isinstance(text, str) else np.array(text)
            columns |= dict(part.arrays)
            yield ParsedTable(**columns, space=self.space)


def read_untrusted(files: Sequence[Path], options: Options, preview: int = 0) -> ReadResult:
    """Read a table, or two logs, in a child with limits; SandboxBusyError, OSError."""
    second = str(files[1]) if len(files) > 1 else None
    arguments = {"second": second, "options": options.as_json(), "preview": preview}
    try:
        parts = run("wrenchbook.service.formats.read:table_parts", files[0], arguments, _LIMITS)
    except SandboxError as error:
        report = ReadReport()
        report.mistakes.ruin(0, "file", str(error))
        return ReadResult({**report.as_json(0, []), "findings": []}, [])
    return ReadResult(parts[-1].fields, parts[:-1], options.space)


def read_block(file: Path, options: Options) -> ReadResult:
    """Read a small JSON table, `MAX_BLOCK` rows at most, in this process; without findings.

    The caller limits its bytes. A child takes longer to start than a bench to measure a row.
    """
    report = ReadReport(format="json")
    pieces = list(_corrected(read_json(file, options, report), options, report))
    if report.read > MAX_BLOCK:
        message = f"are {report.read:,}; append at most {MAX_BLOCK:,}, or import them as a table"
        report.mistakes.ruin(0, "rows", message)
    good = sum(map(len, pieces))
    parts = [_part(piece) for piece in pieces if len(piece)]
    return ReadResult({**report.as_json(good, []), "findings": []}, parts, options.space)


def warm_up() -> None:
    """Load pint's definitions before the child of the first file starts."""
    si_factor("N", FORCE)


def table_parts(
    file: Path, second: str | None, options: Mapping[str, Any], preview: int
) -> Iterator[Part]:
    """Yield the pieces of a file, or of two logs, as parts, then the report with `preview` rows."""
    read_options = Options.from_json(options)
    report = ReadReport()
    good = 0
    shown: list[dict[str, Any]] = []
    if second is None:
        pieces = read_table_file(file, read_options, report)
    else:
        pieces = read_logs(file, Path(second), read_options, report)

    sample = FindingsSample()
    for piece in pieces:
        if report.mistakes.is_ruined:
            break
        sample.add(piece)
        for at in range(min(preview, MAX_PREVIEW, good + len(piece)) - len(shown)):
            row = {
                "row": int(piece.seq[at]),
                "wrench": piece.wrench[at].tolist(),
                "displacement": nulls(piece.displacement[at].tolist()),
            }
            shown.append(row)
        good += len(piece)
        if len(piece):
            yield _part(piece)

    findings = [] if report.mistakes.is_ruined else sample.findings(read_options, report.findings)
    yield Part({**report.as_json(good, shown), "findings": findings})


class FindingsSample:
    """Every k-th row of a file, at most twice as many as findings look at."""

    def __init__(self) -> None:
        self.parts: list[Rows] = []
        self._stride = 1
        self._skip = 0  # rows of the next piece before the next of the sample

    def add(self, piece: ParsedTable) -> None:
        """Take the next rows of the file."""
        self.parts.append(piece.take(np.arange(self._skip, len(piece), self._stride)))
        self._skip = (self._skip - len(piece)) % self._stride
        while sum(map(len, self.parts)) > 2 * MAX_ROWS:
            rows = joined(self.parts)
            self.parts = [rows.take(np.arange(0, len(rows), 2))]
            if len(rows) % 2:  # the last row is in the sample: the next is two strides on
                self._skip += self._stride
            self._stride *= 2

    def findings(self, options: Options, known: Sequence[RigFinding] = ()) -> list[dict[str, Any]]:
        """Return findings as JSON-able values; `rows` are places in the file, as of mistakes.

        `known` are those of the join of two logs; rows of a wrong join show nothing else. The other
        findings are on one wrench and its displacement: other spaces have none.
        """
        if known or not self.parts or options.load_range is None or not options.space.is_default:
            return [finding.body() for finding in known]
        solved = None if options.solved is None else np.array(options.solved)
        findings = find(joined(self.parts), options.load_range, solved, linear=options.linear)
        return [finding.body() for finding in findings]


def read_table_file(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the rows of a file that may be loaded; `report` is complete after the last piece."""
    yield from _corrected(_uncorrected_rows(path, options, report), options, report)


def read_logs(
    loads: Path, displacements: Path, options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the rows of two logs joined by time; parameters as `read_table_file`."""
    position = next(filter(POSITION.fullmatch, options.mapping), None)
    if position is not None:
        meaning = options.mapping[position]
        message = f"a position (--column '{position}={meaning}') is ambiguous with two logs"
        report.mistakes.ruin(0, "mapping", f"{message}; name the column by its label")
        return
    loads_rows = _uncorrected_rows(loads, replace(options, role="loads", zero_rows=0), report)
    loads_log = joined_loads(loads_rows, report)
    # The report has these of the displacements.
    report.read = 0
    report.format = ""
    report.gzip = False
    report.sheets = []
    report.sheet = None
    if loads_log is None:
        return
    rows = list(_uncorrected_rows(displacements, replace(options, role="displacements"), report))
    yield from _corrected(with_loads(rows, *loads_log, options, report), options, report)


def _corrected(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the rows of the interface that may be loaded, from readings in SI.

    The order of all corrections: meaning, sign and unit of each column (the readers), the join of
    two logs by time, the zero offset, the rig's frame, its load point and displacement point, the
    moment of a load cell on the ground. Then come the limits, the setup, whether the point of the
    moments must be known, the cycles of the main load (first ones left out, the branch, the mean by
    place, the mean of the cycles), and outside of this the findings.
    """
    pieces = rigged(zeroed(pieces, options, report), options, report)
    if is_corrected(options):  # the readers check other rows, with the label of each column
        pieces = (within_limits(piece, options, report) for piece in pieces)
    pieces = with_known_point(of_current_setup(pieces, options, report), options, report)
    yield from with_cycles(pieces, options, report)


def _uncorrected_rows(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the rows of a file as they are, in SI, whatever their setup."""
    try:
        if path.stat().st_size == 0:
            raise ContentError("the file is empty; export it again")
        if _is_gzip(path):
            report.gzip = True
            plain = path.with_name(f"{path.name}.plain")
            unpack(path, plain)
            path = plain
        content = _format_of(path)
        named = options.format or content
        if named != content and not {named, content} <= _TEXT_FORMATS:
            raise ContentError(f"contains {content}, not {named}; leave the option format out")
        report.format = named
        needed = options.sheet and not options.optional_sheet and options.role == "table"
        if needed and named not in ("xlsx", "xls", "tdms"):
            message = f"is for a workbook or a TDMS file, not for {named}; leave it out (--sheet)"
            report.mistakes.ruin(0, "sheet", message)
            return
        if options.role != "table" and named in ("json", "hdf5"):
            raise ContentError(
                f"must be a log with times, not {named}; send CSV, XLSX, Parquet or TDMS"
            )
        yield from _READERS[named](path, options, report)
    except ContentError as error:
        report.mistakes.ruin(0, "file", str(error))
    except ModuleNotFoundError:
        message = f"is {report.format}, which needs another package: on the server run "
        message += "pip install 'wrenchbook[rig]', or send XLSX or CSV"
        report.mistakes.ruin(0, "file", message)
    except BaseException as error:  # calamine's panic on a damaged file is no Exception
        is_of_file = isinstance(error, Exception) or type(error).__name__ == "PanicException"
        if not is_of_file or report.format not in _UNREADABLE:
            raise
        report.mistakes.ruin(0, "file", _UNREADABLE[report.format].format(error))


def _is_gzip(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(2) == b"\x1f\x8b"


def unpack(path: Path, target: Path, max_bytes: int = MAX_BYTES) -> None:
    """Unpack a gzipped file; ContentError if it is damaged, gzipped twice or too large."""
    written = 0
    try:
        with gzip.open(path) as content, target.open("wb") as unpacked:
            while block := content.read(_BLOCK):
                written += len(block)
                if written > max_bytes:
                    limit = f"{max_bytes >> 20} MiB"
                    raise ContentError(f"unpacks to more than {limit}; send it in parts")
                unpacked.write(block)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:  # a full disk is no damage
        raise ContentError(f"is a damaged gzip file ({error}); send it again") from error
    if _is_gzip(target):
        raise ContentError("is gzipped twice; gzip it once, or not at all")


def _format_of(path: Path) -> ImportFormat:
    """Return the format of a file from its content; raises ContentError."""
    with path.open("rb") as file:
        head = file.read(4096)
    for magic, content in _MAGIC.items():
        if head.startswith(magic):
            return content
    if any(head[at : at + 8] == _HDF5 for at in _HDF5_OFFSETS):
        return "hdf5"
    if head.startswith(b"PK\x03\x04"):
        return _format_of_zip(path)
    for magic, description in _OTHER_FORMATS.items():
        if head.startswith(magic):
            raise ContentError(f"is {description}")

    utf16 = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    # A header in Latin letters has a zero in every second byte, or in three of four.
    start = head[: len(head) // 4 * 4]
    wide = [start[place::4].count(0) * 4 > 0.8 * len(start) for place in range(4)]
    if sum(wide) == 3 or (not utf16 and wide in ([True, False] * 2, [False, True] * 2)):
        raise ContentError(
            "is text in UTF-32, or in UTF-16 without the mark at its beginning; save it as UTF-8"
        )
    if b"\0" in head and not utf16:
        raise ContentError(
            "is not a table, because it contains zero bytes. Send CSV, XLSX, XLS, Parquet, JSON, "
            "HDF5, MAT, LVM or TDMS, each gzipped if you like"
        )

    text = head.removeprefix(codecs.BOM_UTF8).lstrip()
    if text[:1] == b"<":
        raise ContentError("is a web page or XML, not a table; export the table as CSV or XLSX")
    return "json" if text[:1] in (b"{", b"[") else "csv"


def _format_of_zip(path: Path) -> ImportFormat:
    try:
        with zipfile.ZipFile(path) as archive:
            names = {name for name in archive.namelist() if len(name) < 100}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise ContentError(f"is a damaged zip file or workbook ({error}); save it again") from error
    if "[Content_Types].xml" in names and any(name.startswith("xl/") for name in names):
        return "xlsx"
    raise ContentError("is a zip file, not an XLSX workbook; unpack it and send the table")


def _part(piece: ParsedTable) -> Part:
    """Return a piece as a part, without unknown columns; equal texts are one text."""
    columns = {name: getattr(piece, name) for name in _NUMBERS}
    arrays = {
        name: column for name, column in columns.items() if column.size and not is_unknown(column)
    }
    source = np.where(piece.source == "", MEASURED, piece.source)
    texts = {"source": source.tolist(), "fingerprint": piece.fingerprint.tolist()}
    texts["note"] = list(piece.note)
    packed = {
        name: column[0] if len(set(column)) == 1 else column for name, column in texts.items()
    }
    return Part(packed, arrays)
