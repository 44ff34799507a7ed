"""The text of an input deck with its included files in place."""

from __future__ import annotations

import re
from bisect import bisect_right
from pathlib import Path

from wrenchbook.fea.spec.problems import MeshFileError

_MAX_DEPTH = 10  # levels of included files: decks of vehicle programmes nest four
_MAX_FILES = 1000  # included files of a deck: more than any deck of a person has
# Characters of an unpacked bundle; a file counts each time it is included.
_MAX_CHARACTERS = 512 * 1024 * 1024

# Keywords of Abaqus that may have their rows in another file; the statement of Nastran.
_ABAQUS = re.compile(
    r"\*[ \t]*(INCLUDE|NODE|ELEMENT|NSET|ELSET|SURFACE|BOUNDARY|CLOAD)\b[ \t]*"
    r"((?:(?=,)(?:,[ \t]*\n|[^\n])*)?)",
    re.I,
)
_INPUT = re.compile(r",\s*(INPUT)\s*=\s*(\"[^\"]*\"|[^,]*)", re.I)
_NASTRAN = re.compile(
    r"^[ \t]*(INCLUDE)\b[ \t]*('[^']{0,999}'|\"[^\"]{0,999}\"|[^\n$]*)", re.I | re.M
)
_NONE = re.compile(r"(?!)")
_NASTRAN_ENDINGS = (".bdf", ".nas", ".dat")


class DeckText(str):
    """A deck's text; `included` are its included files in order, with repetitions.

    `pieces`: for each stretch of the text its first line, its file (empty for the deck itself) and
    the line in that file.
    """

    included: tuple[Path, ...] = ()
    pieces: tuple[tuple[int, str, int], ...] = ((1, "", 1),)

    def place(self, line: int) -> str:
        """Name a line of the text by its file: "12" or "3 of mesh.inc"."""
        first, file, there = self.pieces[bisect_right(self.pieces, line, key=lambda p: p[0]) - 1]
        return f"{line - first + there}" + (f" of {file}" if file else "")


def deck_text(path: Path) -> DeckText:
    """Return a deck's text with newlines alone: UTF-8, or UTF-16 by its mark or its zero bytes.

    Included files replace their statements: ``*INCLUDE``, keywords with INPUT, and Nastran's
    INCLUDE. Names are relative to the deck's folder or to that of the including file.

    Raises OSError if the deck cannot be read, MeshFileError with file and line if an included file
    is missing, outside the deck's folder or part of itself, or if the files are too large.
    """
    joining = _Joining(path)
    joining.add_file(path, _plain(path), (path.resolve(),))
    joined = DeckText("".join(joining.parts))
    joined.included, joined.pieces = tuple(joining.included), tuple(joining.pieces)
    return joined


class _Joining:
    """A deck's text so far: its parts, their positions (`DeckText.pieces`), included files."""

    def __init__(self, path: Path) -> None:
        ending = path.suffix.lower()
        self.folder = path.parent.resolve()
        self.pattern = _NONE
        if ending in _NASTRAN_ENDINGS:
            self.pattern = _NASTRAN
        elif ending == ".inp":
            self.pattern = _ABAQUS
        self.parts: list[str] = []
        self.pieces: list[tuple[int, str, int]] = []
        self.included: list[Path] = []
        self.line = 1  # next line of the joined text
        self.characters = 0  # sum over all files

    def add_part(self, part: str, name: str, line: int) -> None:
        """Add a stretch of a file's text that begins at its line `line`; end it with a newline."""
        part += "\n" if part and not part.endswith("\n") else ""
        self.pieces.append((self.line, name, line))
        self.parts.append(part)
        self.line += part.count("\n")

    def add_file(self, file: Path, text: str, stack: tuple[Path, ...]) -> None:
        """Add a file with its included files; `stack`: the files that include it, itself last."""
        name = "" if len(stack) == 1 else file.relative_to(self.folder).as_posix()
        end, line = 0, 1  # index after the added text, and the line there
        self.characters += len(text)
        named = [(match, _file_name(match, text)) for match in self.pattern.finditer(text)]
        beside = ", ".join(dict.fromkeys(inner for _, inner in named if inner))
        for match, inner in named:
            if inner is None:
                continue
            at = line + text.count("\n", end, match.start())
            try:
                included, content = self.included_file(inner, stack, beside)
            except (OSError, RuntimeError, ValueError) as error:
                why = str(error)
                if isinstance(error, OSError):
                    why = f"which cannot be read ({error.strerror})"
                where = f"line {at} of {name}: " if name else f"line {at}: "
                word = "*" * (self.pattern is _ABAQUS) + match[1].upper()
                raise MeshFileError(f'{where}{word} names "{inner[:100]}", {why}') from None
            rows = "" if match[1].upper() == "INCLUDE" else _INPUT.sub("", match[0]) + "\n"
            self.add_part(text[end : match.start()] + rows, name, line)
            self.add_file(included, content, (*stack, included))
            line = at + match[0].count("\n")
            end = match.end()
        self.add_part(text[end:], name, line)

    def included_file(self, name: str, stack: tuple[Path, ...], beside: str) -> tuple[Path, str]:
        """Return the path and the text of a file that the last file of `stack` includes.

        Raises OSError if it cannot be read, ValueError with the end of a sentence if it is not
        allowed.
        """
        for count, limit, unit in (
            (self.characters, _MAX_CHARACTERS, "characters in all files"),
            (len(stack), _MAX_DEPTH, "files in each other"),
            (len(self.included), _MAX_FILES, "files"),
        ):
            if count > limit:
                raise ValueError(f"which exceeds the limit, {limit} {unit}; include less")
        path = _inside(self.folder, stack[-1].parent, name, beside)
        self.included.append(path)
        if path in stack:
            raise ValueError("which includes itself; remove one of the two lines")
        return path, _plain(path)


def _file_name(match: re.Match[str], text: str) -> str | None:
    """Return the file that a statement names; None if it has its own rows or is within a line."""
    if text[text.rfind("\n", 0, match.start()) + 1 : match.start()].strip():
        return None
    named = _INPUT.search(match[2]) if match.re is _ABAQUS else match
    if named is None and match[1].upper() != "INCLUDE":
        return None
    name = "" if named is None else "".join(part.strip() for part in named[2].splitlines())
    return name.strip(" \t\"'").replace("\\", "/")


def _inside(folder: Path, here: Path, name: str, beside: str) -> Path:
    """Return the resolved path of a file in a deck's folder; raise ValueError without one."""
    paths = dict.fromkeys((root / name).resolve() for root in (folder, here))
    inside = [path for path in paths if path.is_relative_to(folder)]
    # Whether such a file exists must stay unknown to the sender.
    if re.match(r"/|\w:", name) or not inside:
        raise ValueError("which is outside the folder of the deck; move the file into it")
    files = [path for path in inside if path.is_file()]
    if not files:
        raise ValueError(f"which is not there; these must lie beside the deck: {beside}")
    if len(files) > 1:
        both = " and ".join(file.relative_to(folder).as_posix() for file in files)
        raise ValueError(f"of which there are two, {both}; rename or remove one")
    return files[0]


def _plain(path: Path) -> str:
    """Return a file's text, decoded, with newlines alone."""
    raw = path.read_bytes()
    encoding = "utf-8-sig"
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif b"\0" in raw[:2]:
        encoding = "utf-16-be" if raw[:1] == b"\0" else "utf-16-le"
    return raw.decode(encoding, errors="replace").replace("\r\n", "\n")
