"""SQL of the audit: one entry for each write, in the write's transaction.

Entries are only added.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from wrenchbook.service.actors import CALLER
from wrenchbook.service.ledger.connection import Connection

if TYPE_CHECKING:
    from wrenchbook.service.ledger.ledger import Ledger

_COLUMNS = "time, actor, action, component, object, before, after"
_INSERT = f"INSERT INTO audit ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)"


@dataclass(frozen=True)
class AuditEntry:
    """A write: its time (seconds since the epoch), its actor, its object; JSON before and after.

    `actor` is empty for rows of jobs that were accepted before the ledger had actors; `component`
    is empty for keys, rigs and settings.
    """

    id: int
    time: float
    actor: str
    action: str
    component: str
    object: str
    before: Any
    after: Any


def note(
    db: Connection,
    action: str,
    subject: object,
    component: str = "",
    *,
    before: Any = None,
    after: Any = None,
    actor: str | None = None,
) -> None:
    """Add the entry of a write, by the context's caller unless `actor` is given."""
    actor = CALLER.get().actor if actor is None else actor
    states = (None if state is None else json.dumps(state) for state in (before, after))
    db.execute(_INSERT, (time.time(), actor, action, component, str(subject), *states))


@contextmanager
def noted(ledger: Ledger, action: str, subject: object, **more: Any) -> Iterator[None]:
    """Add the entry of a file that the block writes; a block that fails leaves no entry.

    The entry is committed after the file is written, so that a caller with a reply has both.
    """
    with ledger.writing() as db:
        note(db, action, subject, **more)
        yield


def entries(
    db: Connection,
    *,
    component: str | None = None,
    actor: str | None = None,
    action: str | None = None,
    since: float | None = None,
    until: float | None = None,
    limit: int = 100,
    below: int | None = None,
) -> list[AuditEntry]:
    """Return entries, newest first, from a time on and before another; `action` may be a GLOB."""
    terms = {"component = ?": component, "actor = ?": actor, "action GLOB ?": action}
    terms |= {"time >= ?": since, "time < ?": until, "id < ?": below}
    used = {term: value for term, value in terms.items() if value is not None}
    where = f"WHERE {' AND '.join(used)}" if used else ""
    select = f"SELECT id, {_COLUMNS} FROM audit {where} ORDER BY id DESC LIMIT ?"

    def state(text: str | None) -> Any:
        return None if text is None else json.loads(text)

    return [
        AuditEntry(*fields, *map(state, (before, after)))
        for *fields, before, after in db.execute(select, (*used.values(), limit))
    ]
