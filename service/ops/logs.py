"""Formats of the server's log: text, or one JSON object a line."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import OrderedDict
from contextvars import ContextVar
from typing import Final, Literal

LogFormat = Literal["text", "json"]
# Optional attributes of a record: `logger.info(..., extra={"job": 7})`.
ABOUT: Final = ("job", "attempt", "component", "request_id", "actor")
REQUEST_ID: ContextVar[str | None] = ContextVar("request_id", default=None)
"""The id of the HTTP request of this context; None outside of requests."""
REPEAT_S = 60.0  # a lasting fault, such as a full disk, is one line a minute
_MAX_REPEATS = 10_000  # remembered texts, 1 MB; that of a request has its id and never repeats
_MAX_CHARACTERS = 20_000  # characters of a message or a traceback: log collectors limit lines


class JsonLines(logging.Formatter):
    """A record as JSON on one line.

    Keys: ``time`` (ISO 8601, UTC), ``level``, ``logger``, ``message``; if known ``job``,
    ``attempt``, ``component`` and ``request_id``; ``exception`` with a traceback.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        seconds = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        fields: dict[str, object] = {
            "time": f"{seconds}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage()[:_MAX_CHARACTERS],
        }
        fields |= {
            name: value for name in ABOUT if (value := getattr(record, name, None)) is not None
        }
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)[-_MAX_CHARACTERS:]
        return json.dumps(fields, default=str)


class TextLines(logging.Formatter):
    """A record on a line, with its time in UTC; a traceback follows on further lines."""

    converter = time.gmtime
    default_msec_format = "%s.%03dZ"

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S")

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the line; line ends in a message are escaped."""
        record.message = record.message.replace("\r", "\\r").replace("\n", "\\n")
        if request_id := getattr(record, "request_id", None):
            record.message += f" [request {request_id}]"
        return super().formatMessage(record)


def add_request_id(record: logging.LogRecord) -> bool:
    """Give a record the id of its request; a filter that keeps all records."""
    record.request_id = REQUEST_ID.get()
    return True


class Repeats(logging.Filter):
    """Drops a warning or error that was logged in the last `REPEAT_S` with the same text."""

    def __init__(self) -> None:
        super().__init__()
        self._logged = OrderedDict[int, float]()  # oldest first
        self._lock = threading.Lock()  # filters run before their handler's lock is taken

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether the record is logged."""
        if record.levelno < logging.WARNING:
            return True
        error = record.exc_info and record.exc_info[1]
        text = hash(f"{record.name} {record.getMessage()} {error} {REQUEST_ID.get()}")
        with self._lock:
            now = time.monotonic()
            while self._logged and now - next(iter(self._logged.values())) >= REPEAT_S:
                self._logged.popitem(last=False)
            is_new = text not in self._logged
            self._logged.setdefault(text, now)
            if len(self._logged) > _MAX_REPEATS:
                self._logged.popitem(last=False)
            return is_new


def set_up(level: str, form: LogFormat) -> None:
    """Log to standard error from `level` up."""
    shown = logging.StreamHandler()
    shown.addFilter(add_request_id)
    shown.addFilter(Repeats())
    shown.setFormatter(JsonLines() if form == "json" else TextLines())
    logging.basicConfig(level=level.upper(), handlers=[shown], force=True)
