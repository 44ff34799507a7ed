"""The text of an input deck with the files that it includes in their place."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path

from wrenchbook.fea.spec.problems import MeshFileError

_MAX_DEPTH = 10  # decks of vehicle programmes nest four files
_MAX_INCLUDES = 1000
_MAX_CHARACTERS = 512 * 1024 * 1024  # of a bundle, unpacked: a file included often counts each time

# Keywords of Abaqus that may have their rows in another file, and Nastran's statement.
_ABAQUS = re.compile(
    r"\*[ \t]*(INCLUDE|NODE|ELEMENT|NSET|ELSET|SURFACE|BOUNDARY|CLOAD)\b[ \t]*"
    r"((?:(?=,)(?:,[ \t]*\n|[^\n])*)?)",
    re.I,
)
_INPUT = re.compile(r",\s*INPUT\s*=\s*(\"[^\"]*\"|[^,]*)", re.I)
_NASTRAN = re.compile(
    r"^[ \t]*(INCLUDE)\b[ \t]*('[^']{0,999}'|\"[^\"]{0,999}\"|[^\n$]*)", re.I | re.M
)
_NASTRAN_ENDINGS = (".bdf", ".nas", ".dat")


class DeckText(str):
    """A deck's text; `included` are the files in it, in their order, each as often as it comes.

    `pieces` are the first line of each stretch of the text, and its file (empty of the deck) and
    line there.
    """

    included: tuple[Path, ...] = ()
    pieces: tuple[tuple[int, str, int], ...] = ((1, "", 1),)

    def place(self, line: int) -> str:
        """Name a line of the text by its file: "12" or "3 of mesh.inc"."""
        first, file, there = self.pieces[bisect_right(self.pieces, line, key=lambda p: p[0]) - 1]
        return f"{line - first + there}" + (f" of {file}" if file else "")


def deck_text(path: Path) -> DeckText:
    """Return a deck's text with newlines alone: UTF-8, or UTF-16 by its mark or its zero bytes.

    Files of ``*INCLUDE, INPUT=`` and of keywords with INPUT, and of Nastran's INCLUDE, stand in
    their place. Their names count from the deck's folder or that of the file that includes them.

    Raises
    ------
    OSError
        If the deck cannot be read.
    MeshFileError
        If an included file is missing, outside the deck's folder or part of itself, or there is too
        much of them; it names file and line.
    """
    pattern = _NASTRAN if path.suffix.lower() in _NASTRAN_ENDINGS else _ABAQUS
    if path.suffix.lower() not in (".inp", *_NASTRAN_ENDINGS):
        return DeckText(_plain(path))
    folder, included, size = path.parent.resolve(), list[Path](), 0

    def stretches(file: Path, stack: tuple[Path, ...]) -> Iterator[tuple[str, str, int]]:
        """Yield parts of the text, each with its file and first line."""
        nonlocal size
        text, end, line = _plain(file), 0, 1
        name = "" if len(stack) == 1 else stack[-1].relative_to(folder).as_posix()
        size += len(text)
        for match in _statements(pattern, text):
            file_name = _file_name(match)
            if file_name is None:
                continue
            at = line + text.count("\n", end, match.start())
            where = f"line {at}" + (f" of {name}" if name else "")
            star = "*" if pattern is _ABAQUS else ""
            where += f': {star}{match[1].upper()} names "{file_name[:100]}"'
            inner = _inside(folder, stack[-1].parent, file_name, where, pattern, text)
            if inner in stack:
                raise MeshFileError(f"{where}, which includes itself; take one of the two out")
            included.append(inner)
            if len(stack) > _MAX_DEPTH or len(included) > _MAX_INCLUDES:
                most = f"{_MAX_DEPTH} deep and {_MAX_INCLUDES} in all"
                raise MeshFileError(f"{where}, one file too many: they may be {most}")
            if size > _MAX_CHARACTERS:
                most = _MAX_CHARACTERS >> 20
                raise MeshFileError(f"{where}; a deck with its files may have {most} MiB in all")
            head = "" if match[1].upper() == "INCLUDE" else _INPUT.sub("", match[0]) + "\n"
            yield text[end : match.start()] + head, name, line
            yield from stretches(inner, (*stack, inner))
            line, end = at + match[0].count("\n"), match.end()
        yield text[end:], name, line

    lines, pieces, parts = 1, [], []
    for part, file, line in stretches(path, (path.resolve(),)):
        ended = part if not part or part.endswith("\n") else f"{part}\n"
        pieces.append((lines, file, line))
        lines += ended.count("\n")
        parts.append(ended)
    text = DeckText("".join(parts))
    text.included, text.pieces = tuple(included), tuple(pieces)
    return text


def _statements(pattern: re.Pattern[str], text: str) -> Iterator[re.Match[str]]:
    """Yield the matches with nothing before them on their line."""
    for match in pattern.finditer(text):
        if not text[text.rfind("\n", 0, match.start()) + 1 : match.start()].strip():
            yield match


def _file_name(match: re.Match[str]) -> str | None:
    """Return the file that a match of a pattern names; None of a keyword that has its own rows."""
    name: str | None = match[2]
    if match.re is _ABAQUS:
        given = _INPUT.search(match[2])
        name = given[1] if given else None
    if name is None and match[1].upper() != "INCLUDE":
        return None
    joined = "".join(part.strip() for part in (name or "").splitlines())
    return joined.strip(" \t\"'").replace("\\", "/")


def _inside(
    folder: Path, here: Path, name: str, where: str, pattern: re.Pattern[str], text: str
) -> Path:
    """Return the file of a name in a deck's folder, resolved; MeshFileError if it is none."""
    beside = "put the file into the deck's folder and name it from there"
    if Path(name).is_absolute() or re.match(r"\w:", name):
        raise MeshFileError(f"{where}, which is no name within the deck's folder; {beside}")
    try:
        paths = dict.fromkeys((root / name).resolve() for root in (folder, here))
        if not all(path.is_relative_to(folder) for path in paths if path.exists()):
            raise MeshFileError(f"{where}, which is outside the deck's folder; {beside}")
        files = [path for path in paths if path.is_file()]
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, MeshFileError):
            raise
        raise MeshFileError(f"{where}, which cannot be a file; {beside}") from None
    if not files:
        names = dict.fromkeys(filter(None, map(_file_name, _statements(pattern, text))))
        message = f"must lie beside the deck: {', '.join(names)}"
        raise MeshFileError(f"{where}, which is not there; these {message}")
    if len(files) > 1:
        raise MeshFileError(
            f"{where}, of which there are two, by the deck and by the including file"
        )
    return files[0]


def _plain(path: Path) -> str:
    raw = path.read_bytes()
    encoding = "utf-8-sig"
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif b"\0" in raw[:2]:
        encoding = "utf-16-be" if raw[:1] == b"\0" else "utf-16-le"
    return raw.decode(encoding, errors="replace").replace("\r\n", "\n")
