"""One large JSON object read member by member, and one of its lists item by item.

The standard library's decoder wants all of a text at once: a table of 256 MB took seven times that.
Here it gets one value at a time, out of a window of the text.
"""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

MOST_VALUE = 1 << 20  # characters of one value: a row with its 54 numbers has some 1,500
_BLANKS = re.compile(r"[ \t\n\r]*")
_BLOCK = 1 << 18  # bytes read at once


class JsonError(ValueError):
    """The text is no JSON, or no object; the message says where."""


class _Window:
    """The part of the text that is being looked at."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._decoder = codecs.getincrementaldecoder("utf-8-sig")()
        self._ended = False
        self._dropped = 0
        self.text = ""
        self.at = 0

    def more(self) -> bool:
        """Read on; False at the end of the file."""
        if self._ended:
            return False
        block = self._file.read(_BLOCK)
        self._ended = not block
        try:
            fresh = self._decoder.decode(block, final=self._ended)
        except UnicodeDecodeError as error:
            raise JsonError(f"is not JSON: {error.reason}; save it as UTF-8") from error
        self._dropped += self.at
        self.text, self.at = self.text[self.at :] + fresh, 0
        return not self._ended or bool(fresh)

    def peek(self) -> str:
        """Return the next character that is no blank, empty at the end."""
        while True:
            found = _BLANKS.match(self.text, self.at)
            self.at = found.end() if found else self.at
            if self.at < len(self.text):
                return self.text[self.at]
            if not self.more():
                return ""

    def expect(self, characters: str) -> str:
        """Take the next character, which has to be one of some."""
        found = self.peek()
        if not found or found not in characters:
            wanted = " or ".join(f"'{one}'" for one in characters)
            raise JsonError(f"is not JSON: {wanted} is missing at {self.place()}")
        self.at += 1
        return found

    def value(self, decoder: json.JSONDecoder) -> Any:
        """Take one value.

        A number that ends where the window does may go on, so more is read before it is believed.
        """
        self.peek()
        problem: Exception | None = None
        while True:
            try:
                value, end = decoder.raw_decode(self.text, self.at)
                if end < len(self.text) or self._ended:
                    self.at = end
                    return value
                self.more()
                continue
            except RecursionError as error:
                raise JsonError("is not JSON of a table: it is nested too deeply") from error
            except ValueError as error:
                problem = error
            if len(self.text) - self.at > MOST_VALUE or not self.more():
                raise JsonError(f"is not JSON: {_reason(problem)} after {self.place()}")

    def place(self) -> str:
        """Return where the window stands, for people."""
        return f"character {self._dropped + self.at:,}"


def members(
    file: BinaryIO,
    streamed: str,
    *,
    item: Callable[[Any], Any],
    parse_float: Callable[[str], float],
    pairs: Callable[[list[tuple[str, Any]]], Any],
) -> Iterator[tuple[str, Any]]:
    """Yield the members of the object that a file holds: key and value.

    Parameters
    ----------
    file : binary file
        UTF-8.
    streamed : str
        The key whose list is told item by item, each as `item` makes it.
    item : callable
    parse_float, pairs : callable
        As ``parse_float`` and ``object_pairs_hook`` of `json.JSONDecoder`.

    Raises
    ------
    JsonError
        If it is no JSON, no object, or one of its values is longer than `MOST_VALUE`.
    """
    window = _Window(file)
    decoder = json.JSONDecoder(parse_float=parse_float, object_pairs_hook=pairs)
    if window.peek() != "{":
        value = window.value(decoder)
        _end(window)
        yield "", value
        return
    for key in _keys(window, decoder):
        if key == streamed and window.peek() == "[":
            yield key, []
            for value in _items(window, decoder):
                yield key, item(value)
        else:
            yield key, window.value(decoder)
    _end(window)


def _keys(window: _Window, decoder: json.JSONDecoder) -> Iterator[str]:
    """Yield the keys of an object, each to be followed by its value's being taken."""
    keys = set[str]()
    window.expect("{")
    if window.peek() == "}":
        window.expect("}")
        return
    while True:
        key = window.value(decoder)
        if not isinstance(key, str):
            raise JsonError(f"is not JSON: a key is no text before {window.place()}")
        if key in keys:
            raise JsonError(f"the key {key!r} stands twice in one object; keep one")
        keys.add(key)
        window.expect(":")
        yield key
        if window.expect(",}") == "}":
            return


def _items(window: _Window, decoder: json.JSONDecoder) -> Iterator[Any]:
    window.expect("[")
    if window.peek() == "]":
        window.expect("]")
        return
    while True:
        yield window.value(decoder)
        if window.expect(",]") == "]":
            return


def _end(window: _Window) -> None:
    if window.peek():
        raise JsonError(f"is not JSON: there is more behind its end, at {window.place()}")


def _reason(problem: Exception | None) -> str:
    return problem.msg if isinstance(problem, json.JSONDecodeError) else str(problem)
