"""The estimated error of the solver of each setup, in the ledger's database.

The solver's process estimates it with the first solve of a setup, and it belongs to all rows of the
setup. Without an estimate error bars lack the discretisation error, replies say so, and the next
solve estimates it again.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Mapping
from typing import Any

from wrenchbook.service.ledger import Ledger, LedgerError
from wrenchbook.surrogate.solver_error import SolverError

_log = logging.getLogger(__name__)


class SolverErrors:
    """The error estimates of a data directory; several processes may use it."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._claimed: set[tuple[str, str]] = set()
        self._lock = threading.Lock()

    def claim(self, component: str, fingerprint: str) -> bool:
        """Return whether a solve that starts now should estimate; one at a time in this process.

        It should also if an older version's estimate lacks the growth of the error with the load.
        """
        key = component, fingerprint
        with self._lock:
            if key in self._claimed:
                return False
            known = self.read(*key)
            if known is not None and known.can_grow:
                return False
            self._claimed.add(key)
            return True

    def record(self, component: str, fingerprint: str, estimate: Mapping[str, Any] | None) -> None:
        """Store the estimate of an ended solve, or let the next solve estimate; raises no error."""
        try:
            if estimate is not None:
                SolverError(estimate)
                self._write(component, fingerprint, estimate)
        except (LedgerError, ValueError, TypeError) as error:
            _log.warning("%s: the solver's error was not kept: %s", component, error)
        finally:
            with self._lock:
                self._claimed.discard((component, fingerprint))

    def copy(self, component: str, fingerprint: str, other: str) -> None:
        """Give a component's copy, which has the same setup, the same estimate.

        Raises LedgerUnavailableError if the ledger cannot be written.
        """
        known = self.read(component, fingerprint)
        if known is not None:
            self._write(other, fingerprint, known.values)

    def read(self, component: str, fingerprint: str) -> SolverError | None:
        """Return the estimate of a setup; None if there is none, or it cannot be read."""
        where = "SELECT estimate FROM solver_errors WHERE component = ? AND fingerprint = ?"
        try:
            with self._ledger.reading() as db:
                row = db.execute(where, (component, fingerprint)).fetchone()
            return SolverError(json.loads(row[0])) if row else None
        except (LedgerError, ValueError, TypeError, AttributeError) as error:
            _log.warning("%s: the solver's error cannot be read: %s", component, error)
            return None

    def _write(self, component: str, fingerprint: str, estimate: Mapping[str, Any]) -> None:
        values = component, fingerprint, json.dumps(dict(estimate), allow_nan=False)
        with self._ledger.writing() as db:
            db.execute("INSERT OR REPLACE INTO solver_errors VALUES (?, ?, ?)", values)
