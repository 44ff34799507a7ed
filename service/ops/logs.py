"""The server's log: lines for people, or one JSON object a line for programs that gather logs."""

from __future__ import annotations

import json
import logging
import time
from typing import Final, Literal

LogFormat = Literal["text", "json"]
# What a record may say beside its message: `logger.info(..., extra={"job": 7})`.
ABOUT: Final = ("job", "attempt", "component")
_MOST_CHARACTERS = 20_000  # of a message or a traceback; a line must fit into what carries it


class JsonLines(logging.Formatter):
    """A record as JSON on one line, whatever its message holds.

    Keys: ``time`` (ISO 8601, UTC), ``level``, ``logger``, ``message``; where they are known
    ``job``, ``attempt`` and ``component``; ``exception`` with the traceback of a mistake.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        seconds = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        fields: dict[str, object] = {
            "time": f"{seconds}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage()[:_MOST_CHARACTERS],
        }
        fields |= {
            name: value for name in ABOUT if (value := getattr(record, name, None)) is not None
        }
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)[-_MOST_CHARACTERS:]
        return json.dumps(fields, default=str)


class TextLines(logging.Formatter):
    """A record on a line, its time in UTC; a traceback follows on lines of its own."""

    converter = time.gmtime
    default_msec_format = "%s.%03dZ"

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S")

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the line; what a client has sent makes no second one."""
        record.message = record.message.replace("\r", "\\r").replace("\n", "\\n")
        return super().formatMessage(record)


def set_up(level: str, how: LogFormat) -> None:
    """Send all that is logged to the standard error, from `level` up, in one form."""
    shown = logging.StreamHandler()
    shown.setFormatter(JsonLines() if how == "json" else TextLines())
    logging.basicConfig(level=level.upper(), handlers=[shown], force=True)
