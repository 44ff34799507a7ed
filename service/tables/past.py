"""Tables as they were at an earlier version, built on request."""

from __future__ import annotations

import threading
from collections import OrderedDict

from anyio import CapacityLimiter

from wrenchbook.service.ledger import Ledger
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables.live import Tables
from wrenchbook.service.tables.mapped import MappedTables
from wrenchbook.service.tables.packed_files import origin_of
from wrenchbook.service.tables.rows import own_rows, table_rows
from wrenchbook.service.tables.served import ServedTable, in_memory, make, packed_bytes
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.surrogate.table.rows import Rows, joined

# A study reads one version, or compares a few.
MOST_TABLES = 4
# Rows of an earlier version, and of all that are kept: as many take some ten seconds to build and
# some 100 MB; the newest table alone is worth more.
MOST_ROWS = 100_000


class PastTooLargeError(Exception):
    """An earlier version has more rows than are built for a question."""


class PastDamagedError(Exception):
    """An earlier version has lost rows: it cannot be repeated."""


class PastTables:
    """Tables of earlier versions; those used last are kept.

    A table is a function of its rows alone, so that an earlier version answers with the digits
    that it answered with then.

    Parameters
    ----------
    ledger, library:
        Where rows come from and which components there are.
    now:
        The newest tables: a question of the newest version is theirs.
    errors:
        What is known of the solver's own error, now.

    Attributes
    ----------
    turns : CapacityLimiter
        For event loops: a request that waits to build takes none of the threads that answer.
    """

    def __init__(
        self, ledger: Ledger, library: Library, now: Tables | MappedTables, errors: SolverErrors
    ) -> None:
        self._ledger, self._library, self._now, self._errors = ledger, library, now, errors
        self._kept: OrderedDict[tuple[str, int], tuple[Component, ServedTable]] = OrderedDict()
        self._lock = threading.Lock()
        self.turns = CapacityLimiter(1)

    def cached(self, name: str, version: int) -> ServedTable | None:
        """Return a version's table if it is there already; it takes microseconds.

        Raises
        ------
        UnknownComponentError
            If there is no such component.
        """
        component = self._library[name]
        newest = self._now.present().get(name)
        if newest is not None and newest.version == version:
            return newest
        found = self._kept.get((name, version))
        return found[1] if found is not None and found[0] is component else None

    def surrogate(self, name: str, version: int) -> ServedTable:
        """Return a component's table as it was at a version; one is built at a time.

        Raises
        ------
        UnknownComponentError
            If there is no such component.
        UnknownVersionError
            If the table has not come to that version yet.
        PastTooLargeError
            If it had more than `MOST_ROWS` rows.
        PastDamagedError
            If one of its rows is damaged on the disk.
        """
        component = self._library[name]
        with self._lock:
            found = self.cached(name, version)
            if found is None:
                found = self._built(component, version)
                self._keep((name, version), component, found)
            return found

    def _built(self, component: Component, version: int) -> ServedTable:
        pieces, count = [Rows.empty(component.space)], 0
        with self._ledger.table_at(component.name, version) as table:
            for lot in table.lots:
                count += len(lot)
                if count > MOST_ROWS:
                    raise PastTooLargeError(
                        f"version {version} of {component.name!r} has more than {MOST_ROWS} rows: "
                        "too many to be built for a question. Export it with table_version, import "
                        "it into a component of its own, and ask that"
                    )
                pieces.append(table_rows(component, own_rows(component, lot)))
        self._check_whole(component.name, version)
        origin = origin_of(self._ledger, component, version, self._errors)
        table = make(component, joined(pieces), version, errors=self._errors)
        name, fingerprint = component.name, component.fingerprint
        return in_memory(table, packed_bytes(table, name, fingerprint, origin))

    def _check_whole(self, name: str, version: int) -> None:
        lost = [seq for seq, of in self._ledger.damaged.items() if of == name and seq <= version]
        if lost:
            raise PastDamagedError(
                f"row {lost[0]} is damaged on the disk: version {version} of {name!r} cannot be "
                "repeated as it was. The newest version answers without that row; settle it with "
                "wrenchbook doctor"
            )

    def _keep(self, key: tuple[str, int], component: Component, table: ServedTable) -> None:
        self._kept[key] = component, table
        while len(self._kept) > MOST_TABLES or self._rows() > MOST_ROWS:
            self._kept.popitem(last=False)

    def _rows(self) -> int:
        return sum(table.row_count for _, table in self._kept.values())
