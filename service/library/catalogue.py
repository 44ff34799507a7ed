"""Notes on components, and archived components, in the ledger's database."""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import astuple, dataclass, replace
from typing import Any

from wrenchbook.service.ledger import Ledger, LedgerError
from wrenchbook.service.ledger.audit import note


@dataclass(frozen=True)
class CatalogueCard:
    """The entry of a component; an archived one is not listed but still answers.

    Its fields are in the order of the table's columns.
    """

    notes: str = ""
    archived: bool = False
    renamed_to: str | None = None
    copied_from: str | None = None


class Catalogue:
    """The entries of a data directory, by component."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._lock = threading.Lock()
        self._version: int | None = None  # the ledger's version when the entries were read
        self._cards: dict[str, CatalogueCard] = {}

    def __getitem__(self, name: str) -> CatalogueCard:
        with self._lock, suppress(LedgerError):  # without the ledger, the last read entries
            version = self._ledger.version()
            if version != self._version:
                with self._ledger.reading() as db:
                    rows = db.execute("SELECT * FROM catalogue").fetchall()
                self._cards = {row[0]: _card(row) for row in rows}
                self._version = version
        return self._cards.get(name, CatalogueCard())

    def change(self, name: str, **fields: Any) -> CatalogueCard:
        """Change an entry durably; raises LedgerUnavailableError if it cannot be written."""
        with self._ledger.writing() as db:
            row = db.execute("SELECT * FROM catalogue WHERE component = ?", (name,)).fetchone()
            before = _card(row) if row else CatalogueCard()
            card = replace(before, **fields)
            values = name, *astuple(card)
            db.execute("INSERT OR REPLACE INTO catalogue VALUES (?, ?, ?, ?, ?)", values)
            former = {field: getattr(before, field) for field in fields}
            note(db, "component.edit", name, name, before=former, after=fields)
        return card


def _card(row: tuple) -> CatalogueCard:
    _, notes, archived, renamed_to, copied_from = row
    return CatalogueCard(notes, bool(archived), renamed_to, copied_from)
