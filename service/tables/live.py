"""The live tables: one surrogate a component, rebuilt off the request path as rows arrive."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from service.contract import CONTRACT
from service.ledger import Ledger, LedgerRow, NewRow
from service.library.library import Component, Library
from surrogate.build import AnyTable, build
from surrogate.rows import Rows
from surrogate.store import TableFileError, TableMeta, read_table, write_table

log = logging.getLogger(__name__)

POLL_S = 0.02
REST = 1.0  # seconds of rest after each second of building: requests share the interpreter
SAVE_AFTER_QUIET_S = 1.0


class Tables:
    """Surrogates by component name, following the ledger.

    A request takes the surrogate there is (`surrogate`, a dictionary look-up); one thread watches
    the ledger for rows committed by this or any other process on the machine, builds the next
    version, swaps it in, and writes the table's HDF5 file once it has been quiet for a second.

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
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._surrogates: dict[str, AnyTable] = {}
        self._seen: dict[str, int] = {}
        self._unsaved: dict[str, float] = {}
        self._grown = threading.Condition()
        self._wake = threading.Event()
        self._rest_until = 0.0
        self._stopping = False
        self._thread = threading.Thread(target=self._follow, name="tables", daemon=True)

    def start(self) -> None:
        """Load every table, catch up with the ledger, and start following it."""
        for name in self._library.names():
            component = self._library[name]
            rows, self._seen[name] = self._load(component)
            self._build(component, rows)
        self._take_new_rows()
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

    def notify(self) -> None:
        """Look at the ledger now rather than at the next poll."""
        self._wake.set()

    def catch_up(self, name: str, timeout: float) -> bool:
        """Wait until every row a component has now is in its surrogate; False if time ran out."""
        goal = self._ledger.last_seq(name)
        self.notify()
        with self._grown:
            return self._grown.wait_for(lambda: self._seen.get(name, 0) >= goal, timeout)

    def _first(self, name: str) -> AnyTable:
        """Make the empty surrogate of a component that was added after the start."""
        component = self._library[name]
        with self._grown:
            return self._surrogates.setdefault(name, _surrogate(component, Rows.empty()))

    def _load(self, component: Component) -> tuple[Rows, int]:
        """Read a table's file; the ledger holds every row, so a bad file costs only time."""
        path = self._path(component.name)
        if not path.exists():
            return Rows.empty(), 0
        try:
            rows, meta = read_table(path)
        except TableFileError as error:
            log.warning("table %s is read from the ledger instead: %s", component.name, error)
            return Rows.empty(), 0
        if meta.last_seq > self._ledger.last_seq(component.name):
            self._restore(component, rows)
            return Rows.empty(), 0
        if meta.fingerprint != component.fingerprint:
            log.info("table %s is of another setup; reading the ledger", component.name)
            return Rows.empty(), 0
        return rows, meta.last_seq

    def _restore(self, component: Component, rows: Rows) -> None:
        """Put a table file's rows back into a ledger that has lost them."""
        lost = [_new_row(rows, place) for place in range(len(rows))]
        inserted, _ = self._ledger.insert_rows(component.name, "", lost)
        log.warning(
            "%s: %d rows of the table file were missing in the ledger and are there again",
            component.name,
            inserted,
        )

    def _follow(self) -> None:
        seen = -1
        while not self._stopping:
            self._wake.wait(POLL_S)
            self._wake.clear()
            try:
                now = self._ledger.version()
                if now != seen and time.monotonic() >= self._rest_until:
                    self._take_new_rows()
                    seen = now
                self._save(SAVE_AFTER_QUIET_S)
            except Exception:
                log.exception("following the ledger failed; trying again")
                time.sleep(1.0)

    def _take_new_rows(self) -> None:
        for name in self._library.names():
            seen = self._seen.get(name, 0)
            if self._ledger.last_seq(name) == seen:
                continue
            news = self._ledger.rows(name, after=seen)
            component = self._library[name]
            self._build(component, self.surrogate(name).rows + _usable(component, news))
            with self._grown:
                self._seen[name] = news[-1].seq
                self._grown.notify_all()

    def _build(self, component: Component, rows: Rows) -> None:
        started = time.monotonic()
        surrogate = _surrogate(component, rows)
        with self._grown:
            self._surrogates[component.name] = surrogate
        if len(rows):
            self._unsaved[component.name] = time.monotonic()
        seconds = time.monotonic() - started
        self._rest_until = time.monotonic() + REST * seconds
        log.debug("%s: version %d, %.3f s", component.name, surrogate.version, seconds)

    def _save(self, quiet_s: float) -> None:
        now = time.monotonic()
        for name, since in list(self._unsaved.items()):
            if now - since >= quiet_s:
                component, surrogate = self._library[name], self._surrogates[name]
                write_table(self._path(name), surrogate.rows, _meta(component, surrogate))
                del self._unsaved[name]

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.h5"


def _surrogate(component: Component, rows: Rows) -> AnyTable:
    """Build the surrogate; its version is the ledger's number of its newest row."""
    return build(
        rows,
        component.load_range,
        tolerance=component.tolerance,
        linear=component.linear,
        version=int(rows.seq.max()) if len(rows) else 0,
    )


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


def _new_row(rows: Rows, place: int) -> NewRow:
    compliance, uncertainty = rows.compliance[place], rows.uncertainty[place]
    return NewRow(
        wrench=rows.wrench[place].tolist(),
        displacement=rows.displacement[place].tolist(),
        source=str(rows.source[place]),
        compliance=compliance.tolist() if np.isfinite(compliance).all() else None,
        uncertainty=uncertainty.tolist() if np.isfinite(uncertainty).all() else None,
        origin="table file",
        fingerprint=str(rows.fingerprint[place]),
    )


def _meta(component: Component, surrogate: AnyTable) -> TableMeta:
    return TableMeta(
        component=component.name,
        last_seq=surrogate.version,
        load_range=component.load_range,
        fingerprint=component.fingerprint,
        contract=" ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items()),
    )
