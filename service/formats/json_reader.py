"""JSON texts decoded value by value, with the place of each mistake."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

_BLANKS = re.compile(r"[ \t\n\r]*")


class JsonError(ValueError):
    """The text is no JSON, or no object; the message has the place."""


class JsonReader:
    """The text of a JSON file, decoded one value at a time.

    Parameters
    ----------
    text : str
    parse_float, parse_int : callable
        What numbers become, of their text.
    """

    def __init__(
        self,
        text: str,
        parse_float: Callable[[str], Any] = float,
        parse_int: Callable[[str], Any] = int,
    ) -> None:
        self._decoder = json.JSONDecoder(
            parse_float=parse_float, parse_int=parse_int, object_pairs_hook=_unique
        )
        self._text, self._at = text, 0

    def members(self) -> Iterator[str]:
        """Yield the keys of an object; the caller takes the value of each."""
        keys = set[str]()
        for key in self._values("{", "}"):
            if not isinstance(key, str):
                raise JsonError(f"is not JSON: a key is no text before {self._place()}")
            if key in keys:
                raise JsonError(_twice(key))
            keys.add(key)
            self._expect(":")
            yield key

    def items(self) -> Iterator[Any]:
        """Yield the values of a list."""
        return self._values("[", "]")

    def _values(self, start: str, end: str) -> Iterator[Any]:
        self._expect(start)
        if self.peek() == end:
            self._expect(end)
            return
        while True:
            yield self.value()
            if self._expect("," + end) == end:
                return

    def value(self) -> Any:
        """Return the next value; raises JsonError."""
        self.peek()
        try:
            value, self._at = self._decoder.raw_decode(self._text, self._at)
        except RecursionError as error:
            raise JsonError("is not JSON of a table: it is nested too deeply") from error
        except ValueError as error:
            reason = error.msg if isinstance(error, json.JSONDecodeError) else str(error)
            raise JsonError(f"is not JSON: {reason} after {self._place()}") from error
        return value

    def peek(self) -> str:
        """Return the next character that is no blank, empty at the end."""
        found = _BLANKS.match(self._text, self._at)
        self._at = found.end() if found else self._at
        return self._text[self._at : self._at + 1]

    def end(self) -> None:
        """Raise JsonError if there is more text."""
        if self.peek():
            raise JsonError(f"is not JSON: there is more behind its end, at {self._place()}")

    def _expect(self, characters: str) -> str:
        """Take the next character, which is one of some."""
        found = self.peek()
        if not found or found not in characters:
            expected = " or ".join(f"'{one}'" for one in characters)
            raise JsonError(f"is not JSON: {expected} is missing at {self._place()}")
        self._at += 1
        return found

    def _place(self) -> str:
        return f"character {self._at:,}"


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object; raises ValueError if a key stands twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(_twice(next(key for key in keys if keys.count(key) > 1)))
    return found


def _twice(key: str) -> str:
    return f"the key {key!r} stands twice in one object; keep one"
