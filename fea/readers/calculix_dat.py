"""Reader "calculix-dat": the motion that ``*NODE PRINT`` writes into the .dat file of ccx.

``point`` and ``rotation`` name two node sets of one node each, the REF NODE and the ROT NODE of a
``*RIGID BODY``, both printed with U. CalculiX prints seven digits.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from wrenchbook.fea.readers.reader import Complaint, DeckRun, OutputError, Reading, number
from wrenchbook.fea.spec.schema import Deck

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
_MOST_QUOTED = 400  # characters


class CalculixDat:
    """See the module."""

    # The three freedoms of a ROT NODE are the rotation vector, so what works on them is conjugate
    # to it. Measured against the embedded solver, whose moment is spatial, in
    # tests/fea/deck/test_deck_ccx.
    moment = "conjugate"
    keys: tuple[str, ...] = ("point", "rotation")

    def read(self, run: DeckRun, options: Mapping[str, str]) -> Reading:
        """Return the last motion printed of the two sets, which must be of the same time."""
        name = f"{run.job}.dat"
        path = run.folder / name
        if not path.is_file():
            raise OutputError(f"There is no {name}.")
        last = {key: _last(path, name, options[key]) for key in self.keys}
        times = {time for time, _ in last.values()}
        if len(times) > 1:
            raise OutputError(f"{name} ends with the two sets at different times: {sorted(times)}.")
        (_, place), (_, rotation) = last["point"], last["rotation"]
        counts = _UNKNOWNS.findall(_text(run.printed))
        return Reading((*place, *rotation), int(counts[-1]) if counts else 0)

    def complaint(self, run: DeckRun) -> Complaint | None:
        """Return the messages of ccx after ``*ERROR``; it may end with exit code 0 all the same."""
        errors = list(_errors(_text(run.printed)))
        if not errors:
            return None
        quoted = "; ".join(dict.fromkeys(errors))
        if len(quoted) > _MOST_QUOTED:
            quoted = quoted[:_MOST_QUOTED] + " ..."
        apart = any(phrase in error for error in errors for phrase in _NO_EQUILIBRIUM)
        return Complaint(quoted, apart)

    def stage(self, run: DeckRun) -> tuple[float, str] | None:
        """Return the last line of the .sta file: the increment and the time within the step."""
        fields = (_text(run.folder / f"{run.job}.sta").splitlines() or [""])[-1].split()
        try:
            step, increment, time = int(fields[0]), int(fields[1]), float(fields[5])
        except (IndexError, ValueError):
            return None
        return min(max(time, 0.0), 1.0), f"step {step}, increment {increment}, time {time:g}"

    def mistakes(self, text: str, deck: Deck) -> list[str]:
        """Return the sets that the deck does not print and the files it includes unsaid."""
        printed = {name.upper() for name in _PRINTED.findall(text)}
        known = {file.name for file in deck.files}
        unprinted = [
            f'does not print the set "{name}"; add "*NODE PRINT, NSET={name}" and "U" to the step'
            for name in (deck.output[key] for key in self.keys)
            if name.upper() not in printed
        ]
        return unprinted + [
            f'includes "{name}", which [deck] files does not name; name it, without a folder'
            for name in _INCLUDED.findall(text)
            if name not in known
        ]


def _last(path: Path, name: str, node_set: str) -> tuple[str, tuple[float, ...]]:
    """Return time and motion of the last block that `path` has of a set."""
    time, rows = "", []
    inside = False
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            head = _HEAD.match(line)
            if head is not None:
                inside = head[1].upper() == node_set.upper()
                time, rows = (head[2], []) if inside else (time, rows)
            elif inside and line.strip():
                inside = line.split()[0].isdigit()
                rows += [line.split()[1:]] if inside else []
    if len(rows) != 1:
        count = f"{len(rows)} nodes" if rows else "no displacement"
        raise OutputError(
            f'{name} has {count} of the set "{node_set}"; it must have that of one node.'
        )
    if len(rows[0]) != 3:
        raise OutputError(f'{name} is cut off at the set "{node_set}".')
    return time, tuple(number(word, name) for word in rows[0])


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
