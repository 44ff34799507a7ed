"""The text of an input deck with the files that it includes in their place."""

from __future__ import annotations

import re
from bisect import bisect_right
from pathlib import Path

from wrenchbook.fea.spec.problems import MeshFileError

_MAX_DEPTH = 10  # decks of vehicle programmes nest four files
_MAX_FILES = 1000
_MAX_CHARACTERS = 512 * 1024 * 1024  # of a bundle, unpacked: a file included often counts each time

# Keywords of Abaqus that may have their rows in another file, and Nastran's statement.
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

    Files that it includes stand in their place: of ``*INCLUDE`` and of keywords with INPUT, and of
    Nastran's INCLUDE. Names count from the deck's folder or that of the file that has them.

    Raises OSError if the deck cannot be read, MeshFileError with file and line if an included file
    is missing, outside the deck's folder or part of itself, or if there is too much of them.
    """
    folder, ending = path.parent.resolve(), path.suffix.lower()
    pattern = _NASTRAN if ending in _NASTRAN_ENDINGS else _ABAQUS if ending == ".inp" else _NONE
    included, pieces, parts = list[Path](), list[tuple[int, str, int]](), list[str]()
    lines, size = 1, 0

    def put(part: str, name: str, line: int) -> None:
        nonlocal lines
        part += "\n" if part and not part.endswith("\n") else ""
        pieces.append((lines, name, line))
        parts.append(part)
        lines += part.count("\n")

    def take(file: Path, text: str, stack: tuple[Path, ...]) -> None:
        nonlocal size
        name = "" if len(stack) == 1 else file.relative_to(folder).as_posix()
        end, line = 0, 1
        size += len(text)
        named = [(match, _file_name(match, text)) for match in pattern.finditer(text)]
        beside = ", ".join(dict.fromkeys(inner for _, inner in named if inner))
        for match, inner in named:
            if inner is None:
                continue
            at = line + text.count("\n", end, match.start())
            try:
                for count, limit, unit in (
                    (size, _MAX_CHARACTERS, "characters in all files"),
                    (len(stack), _MAX_DEPTH, "files in each other"),
                    (len(included), _MAX_FILES, "files"),
                ):
                    if count > limit:
                        raise ValueError(f"which exceeds the limit, {limit} {unit}; include less")
                included.append(_inside(folder, stack[-1].parent, inner, beside))
                if included[-1] in stack:
                    raise ValueError("which includes itself; remove one of the two lines")
                content = _plain(included[-1])
            except (OSError, RuntimeError, ValueError) as error:
                where = f"line {at} of {name}: " if name else f"line {at}: "
                word = "*" * (pattern is _ABAQUS) + match[1].upper()
                why = str(error)
                if isinstance(error, OSError):
                    why = f"which cannot be read ({error.strerror})"
                raise MeshFileError(f'{where}{word} names "{inner[:100]}", {why}') from None
            rows = "" if match[1].upper() == "INCLUDE" else _INPUT.sub("", match[0]) + "\n"
            put(text[end : match.start()] + rows, name, line)
            take(included[-1], content, (*stack, included[-1]))
            line, end = at + match[0].count("\n"), match.end()
        put(text[end:], name, line)

    take(path, _plain(path), (path.resolve(),))
    joined = DeckText("".join(parts))
    joined.included, joined.pieces = tuple(included), tuple(pieces)
    return joined


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
    """Return the file of a name in a deck's folder, resolved; ValueError if there is none."""
    paths = dict.fromkeys((root / name).resolve() for root in (folder, here))
    inside = [path for path in paths if path.is_relative_to(folder)]
    if re.match(r"/|\w:", name) or not inside:  # whatever is there: no sender may know
        raise ValueError("which is outside the folder of the deck; move the file into it")
    files = [path for path in inside if path.is_file()]
    if not files:
        raise ValueError(f"which is not there; these must lie beside the deck: {beside}")
    if len(files) > 1:
        both = " and ".join(file.relative_to(folder).as_posix() for file in files)
        raise ValueError(f"of which there are two, {both}; rename or remove one")
    return files[0]


def _plain(path: Path) -> str:
    raw = path.read_bytes()
    encoding = "utf-8-sig"
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif b"\0" in raw[:2]:
        encoding = "utf-16-be" if raw[:1] == b"\0" else "utf-16-le"
    return raw.decode(encoding, errors="replace").replace("\r\n", "\n")
