"""The live tables: one surrogate a component, rebuilt off the request path as rows arrive."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from service.ledger import Ledger, LedgerRow, LedgerUnavailableError, News
from service.library.component import Component
from service.library.library import Library
from service.tables.files import TableFiles
from surrogate.build import AnyTable, build
from surrogate.rows import Rows

log = logging.getLogger(__name__)

POLL_S = 0.02
REST = 1.0  # seconds of rest after each second of building: requests share the interpreter
SAVE_AFTER_QUIET_S = 1.0
TROUBLE_S = 1.0  # before trying again what failed


class TableBehindError(Exception):
    """The table does not hold yet all rows that the ledger has; ask again."""


class Tables:
    """Surrogates by component name, following the ledger.

    A request takes the surrogate there is (`surrogate`, a dictionary look-up); one thread watches
    the ledger for rows committed, withdrawn or restored by this or any other process on the
    machine, builds the next version, swaps it in, and writes the table's HDF5 file once it has
    been quiet for a second. What goes wrong with one component is told by `faults` and stays its
    own.

    Parameters
    ----------
    ledger, library:
        Where rows come from and which components there are.
    folder:
        Folder of the HDF5 tables, one ``<name>.h5`` each.
    """

    def __init__(self, ledger: Ledger, library: Library, folder: Path) -> None:
        self._ledger = ledger
        self._library = library
        self._files = TableFiles(folder, ledger)
        self._surrogates: dict[str, AnyTable] = {}
        self._seen: dict[str, int] = {}
        self._built_for: dict[str, Component] = {}
        self._unsaved: dict[str, float] = {}
        self._faults: dict[str, str] = {}
        self._unwritten: dict[str, str] = {}
        self._failures = 0
        self._again = False
        self._grown = threading.Condition()
        self._wake = threading.Event()
        self._rest_until = 0.0
        self._stopping = False
        self._thread = threading.Thread(target=self._follow, name="tables", daemon=True)

    def start(self) -> None:
        """Load every table, catch up with the ledger, and start following it."""
        for name in self._library.names():
            self._guarded(name, self._bring_up, self._faults)
        self._thread.start()

    def stop(self) -> None:
        """Stop following and write what is not written yet."""
        self._stopping = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()
        self._save(quiet_s=0.0)

    def surrogate(self, name: str) -> AnyTable:
        """Return the newest surrogate of a component.

        Raises
        ------
        UnknownComponentError
            If the library has no such component.
        """
        found = self._surrogates.get(name)
        return found if found is not None else self._first(name)

    def faults(self) -> dict[str, str]:
        """Return why a component's table is not what the ledger says, by its name."""
        return {**self._files.doubts, **self._unwritten, **self._faults}

    def notify(self) -> None:
        """Look at the ledger now rather than at the next poll."""
        self._wake.set()

    def catch_up(self, name: str, timeout: float) -> bool:
        """Wait until all that is committed when this is called is in the component's surrogate.

        Returns False if time ran out, or if the table cannot be built: see `faults`.
        """
        goal, before = self._ledger.last_seq(name), self._failures
        component = self._library[name]
        self._again = True  # what failed is tried once more, now that somebody waits for it
        self.notify()

        def settled() -> bool:
            return holds() or (name in self._faults and self._failures > before)

        def holds() -> bool:
            return self._seen.get(name, 0) >= goal and self._built_for.get(name) is component

        with self._grown:
            self._grown.wait_for(settled, timeout)
            return holds()

    def caught_up(self, name: str, timeout: float) -> AnyTable:
        """Return a surrogate that holds all rows committed when this is called.

        Raises
        ------
        TableBehindError
            If it is not there after `timeout` seconds.
        """
        if self.catch_up(name, timeout):
            return self.surrogate(name)
        why = self._faults.get(name) or f"its newest rows are not in it after {timeout:g} s"
        raise TableBehindError(
            f"the table of {name!r} is older than the ledger: {why}. Nothing was asked for; "
            "ask again in a while"
        )

    def _first(self, name: str) -> AnyTable:
        """Make the empty surrogate of a component that was added after the start."""
        component = self._library[name]
        with self._grown:
            found = self._surrogates.setdefault(name, _surrogate(component, Rows.empty(), 0))
        self._again = True
        self.notify()
        return found

    def _follow(self) -> None:
        seen = None
        while not self._stopping:
            self._wake.wait(POLL_S)
            self._wake.clear()
            try:
                now = self._ledger.version(), self._library.version()
                if (now != seen or self._is_due()) and time.monotonic() >= self._rest_until:
                    self._again = False
                    for name in self._library.names():
                        self._guarded(name, self._bring_up, self._faults)
                    seen = now
                self._save(SAVE_AFTER_QUIET_S)
            except LedgerUnavailableError:
                self._wait(TROUBLE_S)  # the ledger itself tells of it
            except Exception:
                log.exception("following the ledger failed; trying again")
                self._wait(TROUBLE_S)

    def _is_due(self) -> bool:
        """Tell whether there is work the ledger's version does not tell of."""
        new = any(name not in self._seen for name in list(self._surrogates))
        return self._again and (new or bool(self._faults))

    def _wait(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while not self._stopping and time.monotonic() < until:
            time.sleep(POLL_S)

    def _guarded(self, name: str, step: Callable[[str], None], faults: dict[str, str]) -> None:
        """Do something for one component, whose failure is no other's."""
        try:
            step(name)
            faults.pop(name, None)
        except Exception as error:
            why = str(error) or repr(error)
            if faults.get(name) != why:
                log.exception("the table of %s is not as it should be", name)
            with self._grown:
                faults[name] = why
                self._failures += 1
                self._grown.notify_all()

    def _bring_up(self, name: str) -> None:
        """Bring one component's surrogate to what the ledger has now."""
        component = self._library[name]
        if self._built_for.get(name) is not component:
            self._seen.pop(name, None)  # its files were edited: not all rows there are its own
        seen = self._seen.get(name)
        if seen is not None and self._ledger.last_seq(name) == seen:
            return
        try:
            if seen is None:
                rows, after = self._files.load(component)
            else:
                rows, after = self._surrogates[name].rows, seen
            news = self._ledger.news(name, after)
        except LedgerUnavailableError:
            if self._built_for.get(name) is not component:
                self._build(component, *self._unchecked(component))
            raise
        self._build(component, _with_news(component, rows, news), news.last_seq)
        if news.last_seq != after:
            self._unsaved[name] = time.monotonic()
        with self._grown:
            self._seen[name] = news.last_seq
            self._grown.notify_all()

    def _unchecked(self, component: Component) -> tuple[Rows, int]:
        """Return what a component's file holds, for as long as the ledger cannot be asked."""
        found = self._files.read(component)
        if found is None or found[1].fingerprint != component.fingerprint:
            return Rows.empty(), 0
        return found[0], found[1].last_seq

    def _build(self, component: Component, rows: Rows, version: int) -> None:
        started = time.monotonic()
        surrogate = _surrogate(component, rows, version)
        with self._grown:
            self._surrogates[component.name] = surrogate
            self._built_for[component.name] = component
        seconds = time.monotonic() - started
        self._rest_until = time.monotonic() + REST * seconds
        log.debug("%s: version %d, %.3f s", component.name, surrogate.version, seconds)

    def _save(self, quiet_s: float) -> None:
        now = time.monotonic()
        for name, since in list(self._unsaved.items()):
            if now - since >= quiet_s:
                self._guarded(name, self._write, self._unwritten)

    def _write(self, name: str) -> None:
        self._unsaved[name] = time.monotonic() + TROUBLE_S  # when it is tried again if it fails
        surrogate = self._surrogates[name]
        self._files.save(self._library[name], surrogate.rows, surrogate.version)
        del self._unsaved[name]


def _surrogate(component: Component, rows: Rows, version: int) -> AnyTable:
    """Build the surrogate; its version is the number of the ledger's newest change in it."""
    return build(
        rows,
        component.load_range,
        tolerance=component.tolerance,
        linear=component.linear,
        version=version,
    )


def _with_news(component: Component, rows: Rows, news: News) -> Rows:
    kept = rows.take(~np.isin(rows.seq, list(news.gone))) if news.gone else rows
    return kept + _usable(component, news.rows)


def _usable(component: Component, rows: Iterable[LedgerRow]) -> Rows:
    """Keep rows of this setup and measured ones; FEA rows of another setup are never mixed in."""
    return Rows.from_records(
        [
            {
                "seq": row.seq,
                "wrench": row.wrench,
                "displacement": row.displacement,
                "compliance": row.compliance,
                "uncertainty": row.uncertainty,
                "source": row.source,
                "fingerprint": row.fingerprint,
            }
            for row in rows
            if row.fingerprint in ("", component.fingerprint)
        ]
    )
