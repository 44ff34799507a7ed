"""Readers of the interface's motion in the files of an outside solver.

"calculix-dat" reads the output of ``*NODE PRINT`` in the .dat file of ccx, and "numbers" reads six
numbers in a file. A new reader is a small class with the members of `DeckReader`, offered under the
entry point group "wrenchbook.deck_readers":

    [project.entry-points."wrenchbook.deck_readers"]
    my-solver = "my_package:MyReader"

A bundle names it with ``output = {reader = "my-solver", ...}``. Often no reader is needed: the
command can be a script that runs the solver and writes six numbers, for the reader "numbers".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from typing import Protocol

from wrenchbook.fea.spec.schema import Deck


class OutputError(ValueError):
    """The interface's motion is not in the output; the message names what is missing, and where."""


@dataclass(frozen=True)
class DeckRun:
    """The files of one run of a deck."""

    folder: Path  # holds all files of the run
    job: str  # the deck's name without its ending
    printed: Path  # the file with the program's standard output and errors


@dataclass(frozen=True)
class Reading:
    """The motion read from an output."""

    # Six finite numbers: translation (in the deck's length unit) and rotation vector (rad)
    displacement: tuple[float, ...]
    unknowns: int = 0  # degrees of freedom solved for; 0 where the solver does not print them


@dataclass(frozen=True)
class Complaint:
    """An error that a solver reports: its text, and whether the solver found no equilibrium."""

    quoted: str
    not_converged: bool = False


class DeckReader(Protocol):
    """A reader of an outside solver's output; made without arguments.

    A subclass defines `moment`, `keys` and `read`, and may keep the other methods.
    """

    moment: str
    """The usual moment of this solver: see `fea.spec.schema.Deck`."""
    keys: tuple[str, ...]
    """The keys of ``[deck] output`` it needs besides ``reader``."""

    def read(self, run: DeckRun, options: Mapping[str, str]) -> Reading:
        """Return the motion in the output of a run.

        Raises OutputError if the motion cannot be read.
        """
        ...

    def complaint(self, run: DeckRun) -> Complaint | None:
        """Return the errors the solver reported; None if its exit code alone shows a failure."""
        return None

    def stage(self, run: DeckRun) -> tuple[float, str] | None:
        """Return the progress of a run, 0 to 1, and a message; None if unknown."""
        return None

    def mistakes(self, text: str, deck: Deck) -> list[str]:
        """Return mistakes in the text of a deck and its files that are visible without a run."""
        return []


def number(word: str, where: str) -> float:
    """Return a word of a solver's output as a finite number.

    Fortran drops the letter of an exponent that has three digits: 0.1234567-101.

    Raises OutputError for any other word.
    """
    text = word
    for sign in "+-":
        head, mark, digits = word.rpartition(sign)
        if mark and head[-1:].isdigit() and digits.isdigit():
            text = f"{head}e{sign}{digits}"
    try:
        value = float(text)
    except ValueError:
        raise OutputError(
            f'{where} has "{word}", which is not a number; check model and output.'
        ) from None
    if not math.isfinite(value):
        raise OutputError(f'{where} has "{word}", which is not finite; check the supports.')
    return value


_HEAD = re.compile(r"^ displacements \(vx,vy,vz\) for set (\S+) and time\s+(\S+)\s*$")
_UNKNOWNS = re.compile(r"number of equations\s+(\d+)")
_NO_EQUILIBRIUM = (
    "too many cutbacks",
    "increment size smaller than minimum",
    "diverge",
    "max. # of increments",
    "too many iterations",
    "no convergence",
)
_PRINTED = re.compile(r"^\*NODE\s*PRINT\b.*?\bNSET\s*=\s*([^,\s]+)", re.IGNORECASE | re.MULTILINE)
_INCLUDED = re.compile(
    r"^\*INCLUDE\b.*?\bINPUT\s*=\s*\"?([^,\"\n]+?)\"?\s*$", re.IGNORECASE | re.MULTILINE
)
MAX_QUOTED = 400  # characters of a solver's output in a message: longer texts are cut


class CalculixDat(DeckReader):
    """Reader "calculix-dat"; see the module."""

    # The three freedoms of a ROT NODE are the rotation vector, so the moment on them is conjugate
    # to it. tests/fea/deck/test_deck_ccx compares it with the embedded solver, whose moment is
    # spatial.
    moment = "conjugate"
    keys: tuple[str, ...] = ("point", "rotation")

    def read(self, run: DeckRun, options: Mapping[str, str]) -> Reading:
        """Return the last motion printed of the two sets, which must be of the same time."""
        name = f"{run.job}.dat"
        path = run.folder / name
        if not path.is_file():
            raise OutputError(
                f"The solver wrote no file {name}; add *NODE PRINT with U for the sets "
                f"{options['point']} and {options['rotation']} to the step."
            )
        last = {key: _last(path, name, options[key]) for key in self.keys}
        times = {time for time, _ in last.values()}
        if len(times) > 1:
            ends = ", ".join(f"{options[key]} at {time}" for key, (time, _) in last.items())
            raise OutputError(
                f"{name} ends with the sets {ends}; give both *NODE PRINT cards the same FREQUENCY."
            )
        (_, translation), (_, rotation) = last["point"], last["rotation"]
        counts = _UNKNOWNS.findall(_text(run.printed))
        return Reading((*translation, *rotation), int(counts[-1]) if counts else 0)

    def complaint(self, run: DeckRun) -> Complaint | None:
        """Return the messages of ccx after ``*ERROR``, which may end with exit code 0."""
        errors = list(_errors(_text(run.printed)))
        if not errors:
            return None
        quoted = "; ".join(dict.fromkeys(errors))
        if len(quoted) > MAX_QUOTED:
            quoted = quoted[:MAX_QUOTED] + " ..."
        no_equilibrium = any(phrase in error for error in errors for phrase in _NO_EQUILIBRIUM)
        return Complaint(quoted, no_equilibrium)

    def stage(self, run: DeckRun) -> tuple[float, str] | None:
        """Return the last line of the .sta file: the increment and the time within the step."""
        fields = (_text(run.folder / f"{run.job}.sta").splitlines() or [""])[-1].split()
        try:
            step, increment, time = int(fields[0]), int(fields[1]), float(fields[5])
        except (IndexError, ValueError):
            return None
        return min(max(time, 0.0), 1.0), f"step {step}, increment {increment}, time {time:g}"

    def mistakes(self, text: str, deck: Deck) -> list[str]:
        """Return the sets that the deck does not print, and included files missing in ``files``."""
        printed = {name.upper() for name in _PRINTED.findall(text)}
        known = {file.name for file in deck.files}
        unprinted = [
            f'does not print the set "{name}"; add "*NODE PRINT, NSET={name}" and "U" to the step'
            for name in (deck.output[key] for key in self.keys)
            if name.upper() not in printed
        ]
        return unprinted + [
            f'includes "{name}", which [deck] files does not list; add it, without a folder'
            for name in _INCLUDED.findall(text)
            if name not in known
        ]


def _last(path: Path, name: str, node_set: str) -> tuple[str, tuple[float, ...]]:
    """Return time and motion of a set's last block in the file `path`."""
    time = ""
    rows = []
    others = dict[str, None]()
    inside = False
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            head = _HEAD.match(line)
            if head is not None:
                inside = head[1].upper() == node_set.upper()
                others[head[1]] = None
                time, rows = (head[2], []) if inside else (time, rows)
            elif inside and line.strip():
                inside = line.split()[0].isdigit()
                rows += [line.split()[1:]] if inside else []
    if not rows:
        printed = f"; it has {', '.join(others)}" if others else ""
        raise OutputError(
            f'{name} has no displacement of the set "{node_set}"{printed}. Name a set in '
            f'[deck.output], or add "*NODE PRINT, NSET={node_set}" and "U" to the step.'
        )
    if len(rows) > 1:
        count = f"{len(rows)} nodes of the set"
        raise OutputError(f'{name} has {count} "{node_set}", but must have one; leave one in it.')
    if len(rows[0]) != 3:
        missing = f"with {len(rows[0])} of 3 displacements"
        raise OutputError(f'{name} ends within the set "{node_set}", {missing}; see log.txt.')
    return time, tuple(number(word, f'{name}, set "{node_set}",') for word in rows[0])


def _errors(text: str) -> Iterator[str]:
    """Yield each message that begins with ``*ERROR``, with its further lines joined."""
    message: list[str] = []
    for line in [*text.splitlines(), ""]:
        begins = "*ERROR" in line
        if message and (begins or not line.strip() or line.lstrip().startswith("*")):
            yield " ".join(message)
            message = []
        if begins or message:
            message.append(" ".join(line.split()))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


class NumbersReader(DeckReader):
    """Reader "numbers": a text file of six numbers, written by the command itself.

    ``file`` names it; ``{job}`` stands for the deck's name without its ending. The numbers are the
    translation and the rotation vector, separated by blanks, commas or ends of line.
    """

    moment = "spatial"
    keys: tuple[str, ...] = ("file",)

    def read(self, run: DeckRun, options: Mapping[str, str]) -> Reading:
        """Return the six numbers."""
        name = options["file"].replace("{job}", run.job)
        try:
            texts = (run.folder / name).read_text(encoding="utf-8").replace(",", " ").split()
        except OSError as error:
            raise OutputError(f"The command wrote no {name} ({error.strerror}).") from None
        except UnicodeDecodeError:
            raise OutputError(f"{name} is not UTF-8 text; let the command write UTF-8.") from None
        if len(texts) != 6:
            six = "six, translation and rotation vector"
            raise OutputError(f"{name} has {len(texts)} numbers; the command must write {six}.")
        return Reading(tuple(number(word, name) for word in texts))


ENTRY_POINTS = "wrenchbook.deck_readers"
"""The group of entry points under which packages offer readers."""

_BUILT_IN: dict[str, type[DeckReader]] = {"calculix-dat": CalculixDat, "numbers": NumbersReader}


def reader_names() -> tuple[str, ...]:
    """Return the names of all built-in and installed readers."""
    return tuple(sorted({*_BUILT_IN, *(entry.name for entry in _entry_points())}))


def reader_named(name: str) -> DeckReader:
    """Return the reader of a name.

    Raises KeyError if there is none.
    """
    if name in _BUILT_IN:
        return _BUILT_IN[name]()
    for entry in _entry_points():
        if entry.name == name:
            return entry.load()()
    raise KeyError(name)


def _entry_points() -> EntryPoints:
    return entry_points(group=ENTRY_POINTS)
