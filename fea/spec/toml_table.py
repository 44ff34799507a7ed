"""Reading a TOML table key by key, collecting every mistake instead of stopping at the first."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from wrenchbook.fea.spec.problems import BundleProblem, suggest

_NAMES = {str: "a text", bool: "true or false", list: "a list", dict: "a table"}
_MISSING = object()
_MOST = 10**9
# Control characters, line ends, and marks that turn the writing direction of what follows: a
# terminal obeys the first, a page shows another word than it holds with the last.
_STEERING = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


class Keys:
    """One table of the file and where it stands.

    Each reading method takes a key; it notes a `BundleProblem` and returns None if the value will
    not do. `close` notes the keys that no method has read.

    table: the parsed table.
    problems: the list that all tables of one file share.
    where: the path of this table, empty for the whole file.
    """

    def __init__(
        self, table: Mapping[str, Any], problems: list[BundleProblem], where: str = ""
    ) -> None:
        self._table = table
        self._known: list[str] = []
        self.problems = problems
        self.where = where

    def __contains__(self, key: str) -> bool:
        return key in self._table

    def __iter__(self) -> Iterator[str]:
        return iter(self._table)

    def is_array(self, key: str) -> bool:
        """Return whether `key` is an array, as ``[[key]]`` makes it."""
        return isinstance(self._table.get(key), list)

    def path(self, key: str) -> str:
        """Return the full path of `key`, as problems name it."""
        return f"{self.where}.{key}" if self.where else key

    def wrong(self, key: str, message: str) -> None:
        """Note a mistake at `key`."""
        self.problems.append(BundleProblem(self.path(key), message))

    def close(self) -> None:
        """Note every key that no method has read, with the nearest known one."""
        for key in self._table:
            if key not in self._known:
                known = ", ".join(self._known)
                hint = suggest(key, self._known)
                self.wrong(key, f"unknown key{hint} (known here: {known})")

    def raw(self, key: str, kind: type, required: bool = True) -> Any:
        """Return the value of `key` if it is of the TOML type `kind`, else None."""
        self._known.append(key)
        value = self._table.get(key, _MISSING)
        if value is _MISSING:
            if required:
                self.wrong(key, f"missing; write {_NAMES[kind]}")
            return None
        if type(value) is not kind:
            self.wrong(key, f"must be {_NAMES[kind]}, not {_shown(value)}")
            return None
        return value

    def text(self, key: str, required: bool = True) -> str | None:
        """Return a text that is not blank, of one line, with no character that steers a screen."""
        value = self.raw(key, str, required)
        if value is not None and (steering := _STEERING.search(value)):
            self.wrong(key, f"must be of one line of letters and signs, not hold {steering[0]!r}")
            return None
        if value is not None and not value.strip():
            self.wrong(key, "must not be empty")
            return None
        return value

    def choice(self, key: str, among: Sequence[str], required: bool = True) -> str | None:
        """Return one of the words `among`."""
        if required and key not in self._table:
            self._known.append(key)
            self.wrong(key, f"missing; write one of {', '.join(among)}")
            return None
        value = self.text(key, required)
        if value is not None and value not in among:
            self.wrong(key, f'"{value}" is none of {", ".join(among)}{suggest(value, among)}')
            return None
        return value

    def flag(self, key: str, required: bool = True) -> bool | None:
        """Return a truth value."""
        return self.raw(key, bool, required)

    def number(
        self,
        key: str,
        unit: str,
        *,
        above: float = -math.inf,
        below: float = math.inf,
        required: bool = True,
    ) -> float | None:
        """Return a finite number strictly between two bounds; `unit` is for the message."""
        self._known.append(key)
        if key not in self._table:
            if required:
                self.wrong(key, f"missing; write a number in {unit}")
            return None
        return self.as_number(key, self._table[key], unit, above, below)

    def whole(self, key: str, least: int, required: bool = True) -> int | None:
        """Return a whole number from `least` to a thousand million."""
        self._known.append(key)
        if key not in self._table:
            if required:
                self.wrong(key, f"missing; write a whole number from {least} up")
            return None
        value = self._table[key]
        if type(value) is not int or not least <= value <= _MOST:
            allowed = f"a whole number from {least} to {_MOST}"
            self.wrong(key, f"must be {allowed}, not {_shown(value)}")
            return None
        return value

    def as_number(
        self,
        key: str,
        value: object,
        unit: str,
        above: float = -math.inf,
        below: float = math.inf,
    ) -> float | None:
        """Check `value`, an item at `key`, as a finite number strictly between two bounds."""
        number = _finite(value)
        if number is None:
            self.wrong(key, f"must be a finite number in {unit}, not {_shown(value)}")
        elif not above < number < below:
            bounds = [f"above {above:g}"] if above > -math.inf else []
            bounds += [f"below {below:g}"] if below < math.inf else []
            self.wrong(key, f"must be {' and '.join(bounds)} ({unit}), not {number:g}")
        else:
            return number
        return None

    def numbers(self, key: str, count: int, unit: str, required: bool = True) -> list[float] | None:
        """Return a list of `count` finite numbers."""
        values = self.raw(key, list, required)
        if values is None:
            return None
        return self.as_numbers(key, values, count, unit)

    def as_numbers(self, key: str, values: object, count: int, unit: str) -> list[float] | None:
        """Check `values`, an item at `key`, as a list of `count` finite numbers."""
        if type(values) is not list or len(values) != count:
            self.wrong(key, f"must be a list of {count} numbers in {unit}, not {_shown(values)}")
            return None
        numbers = [self.as_number(f"{key}[{i}]", value, unit) for i, value in enumerate(values)]
        return None if None in numbers else numbers  # type: ignore[return-value]

    def texts(
        self, key: str, required: bool = True, least: int = 0, repeats: bool = False
    ) -> tuple[str, ...] | None:
        """Return a list of texts, at least `least` of them; none twice, unless with `repeats`."""
        values = self.raw(key, list, required)
        if values is None:
            return None
        bad = [value for value in values if type(value) is not str or not value.strip()]
        if bad:
            self.wrong(key, f"must be a list of texts; {_shown(bad[0])} is not one")
        elif not repeats and len(set(values)) < len(values):
            self.wrong(key, "names something twice; keep one of the two")
        elif len(values) < least:
            self.wrong(key, f"must name at least {least}")
        else:
            return tuple(values)
        return None

    def table(self, key: str, required: bool = True) -> Keys | None:
        """Return the table below `key`."""
        value = self.raw(key, dict, required)
        return None if value is None else Keys(value, self.problems, self.path(key))

    def tables(self, key: str, required: bool = True) -> list[Keys]:
        """Return the tables of an array ``[[key]]``; empty if it will not do."""
        values = self.raw(key, list, required)
        if values is None:
            return []
        if not values or any(type(value) is not dict for value in values):
            self.wrong(key, f"must be one or more tables, each under [[{self.path(key)}]]")
            return []
        paths = (f"{self.path(key)}[{i}]" for i in range(len(values)))
        return [Keys(value, self.problems, at) for value, at in zip(values, paths, strict=True)]


def _finite(value: object) -> float | None:
    """Return `value` as a float; None for text, truth values, infinities, NaN and overflow."""
    if type(value) not in (int, float):
        return None
    try:
        number = float(value)  # type: ignore[arg-type]
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _shown(value: object) -> str:
    """Return `value` shortened to what fits into a message."""
    text = repr(value).replace("'", '"') if type(value) is not bool else str(value).lower()
    return text if len(text) <= 60 else text[:57] + "..."


def bundle_file(keys: Keys, key: str, folder: Path, required: bool = True) -> Path | None:
    """Return the path of a file of the bundle that exists and lies within its folder."""
    name = keys.text(key, required)
    if name is None:
        return None
    path = folder / name
    # Resolved, so that a symbolic link out of the folder is refused too.
    if Path(name).is_absolute() or not path.resolve().is_relative_to(folder.resolve()):
        keys.wrong(key, f'"{name}" is outside the bundle; put the file into its folder')
        return None
    try:
        there = path.is_file()
    except OSError as error:  # a name that no disk takes
        keys.wrong(key, f'"{name[:100]}" cannot be a file ({error.strerror})')
        return None
    if not there:
        known = sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
        keys.wrong(key, f'there is no file "{name}" in the bundle (it has {", ".join(known)})')
        return None
    return path
