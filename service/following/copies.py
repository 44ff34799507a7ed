"""Copies of another server's tables: fetched, kept on the disk, and refreshed as they grow.

A table is immutable a version, so a copy is as good as the table for as long as its version is the
newest. What a copy cannot know is whether it still is: it tells when it last was.
"""

from __future__ import annotations

import json
import logging
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import quote

import numpy as np

from fea.bundle.tables import is_slug
from fea.spec.schema import FREEDOMS
from service.client import Client, ProblemError, ServerTimeout, ServerUnreachable
from service.demand.demand import Demand
from service.files.durable import write_whole_bytes
from service.library.component import Component
from service.tables.making import in_memory, packed_bytes
from service.tables.served import ServedTable
from surrogate.build import AnyTable, build
from surrogate.kriging.threads import one_thread
from surrogate.solver_error import SolverError
from surrogate.table.hdf5 import TableFileError, read_table
from surrogate.table.rows import LoadRange, Tolerance

log = logging.getLogger(__name__)

LOOK_S = 0.5  # between questions whether anything is new: one request for all tables
PATIENCE_S = 10.0  # for the answer to one; the copies answer meanwhile
FOLDER = "copies"  # in the data directory
_AWAY = (ServerUnreachable, ServerTimeout, OSError)


class NotHereError(Exception):
    """What is asked for is more than a copy knows: the other server has to be asked."""


@dataclass(frozen=True, eq=False)
class Built:
    """One version of a component's table, and what answers from it.

    Attributes
    ----------
    content : bytes
        The HDF5 file that it is built from.
    etag : str or None
        The other server's name of this version.
    table : ServedTable
    component : str
    """

    content: bytes
    etag: str | None
    table: ServedTable
    component: str


@dataclass(frozen=True)
class Copy:
    """One version of a table.

    Attributes
    ----------
    component : Component
        What its questions are read by; its folder is nowhere.
    built : Built
    """

    component: Component
    built: Built


class Copies:
    """What a server that follows another answers from, as `service.answering` asks a workspace.

    Whatever is more than a table's answer raises `NotHereError`.

    Parameters
    ----------
    client : Client
        Of the server that is followed.
    folder : path
        Where copies are kept from one start to the next.
    """

    def __init__(self, client: Client, folder: Path) -> None:
        self._client, self._folder = client, folder
        self._copies: dict[str, Copy] = {}
        self._current: dict[str, float] = {}
        self._faults: dict[str, str] = {}
        self._away: str | None = "it has not answered yet"
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="copies", daemon=True)
        self.library = self
        self.demand = Demand(folder / "demand.json")

    def start(self) -> None:
        """Take up what is on the disk, and go on from the other server's tables."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for path in sorted(self._folder.glob("*.h5")):
            self._take_up(path)
        self.look()
        self._thread.start()

    def stop(self) -> None:
        """Look no more."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self.demand.stop()

    def surrogate(self, name: str) -> ServedTable:
        """Return what answers for a component; raises `NotHereError` without a copy."""
        return self._of(name).built.table

    def as_read(self, name: str) -> Component:
        """Return a component; raises `NotHereError` without a copy."""
        return self._of(name).component

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        raise NotHereError(name)

    def away(self) -> str | None:
        """Return why the other server cannot be asked; None if it answers."""
        return self._away

    def age(self, name: str) -> float | None:
        """Return for how long a copy may have been older than its table, s; None if ever."""
        since = self._current.get(name)
        return None if since is None else max(0.0, time.monotonic() - since)

    def told(self) -> dict[str, dict[str, Any]]:
        """Return each copy's version and age, and what is wrong with it, by component."""
        found = {}
        for name in sorted({*self._copies, *self._faults}):
            copy = self._copies.get(name)
            version = copy.built.table.version if copy else None
            found[name] = {"table_version": version, "age_s": self.age(name)}
            if name in self._faults:
                found[name]["fault"] = self._faults[name]
        return found

    def look(self) -> None:
        """Fetch what is new; what cannot be fetched is told by `away` and `told`."""
        asked = time.monotonic()
        try:
            listed = self._client.call_json("GET", "/v1/components")["components"]
        except (*_AWAY, ProblemError, ValueError, KeyError, TypeError) as error:
            if self._away is None:
                log.warning("%s is away; its tables' copies answer: %s", self._client.url, error)
            self._away = str(error)
            return
        if self._away is not None:
            log.info("following %s, %d components", self._client.url, len(listed))
        self._away = None
        known = {one["name"]: one for one in listed if is_slug(str(one.get("name")))}
        for name, one in known.items():
            self._guarded(name, one, asked)
        for name in [name for name in self._copies if name not in known]:
            self._drop(name)

    def _of(self, name: str) -> Copy:
        found = self._copies.get(name)
        if found is None:
            raise NotHereError(name)
        return found

    def _keep(self) -> None:
        while not self._stopping.wait(LOOK_S):
            try:
                self.look()
            except Exception:
                log.exception("looking for newer tables failed; trying again")

    def _guarded(self, name: str, listed: dict[str, Any], asked: float) -> None:
        """Bring one copy up to date; its failure is no other's."""
        try:
            copy = self._copies.get(name)
            if copy is None or not _is_current(copy, listed):
                self._fetch(name, copy)
            self._current[name] = asked
            self._faults.pop(name, None)
        except (*_AWAY, ProblemError, TableFileError, ValueError, KeyError) as error:
            if self._faults.get(name) != str(error):
                log.warning("the copy of %s stays as it is: %s", name, error)
            self._faults[name] = str(error)

    def _fetch(self, name: str, before: Copy | None) -> None:
        """Take the other server's version of a table, if it is another than that here."""
        path = f"/v1/components/{quote(name)}"
        told = self._client.call_json("GET", path)
        held = before.built.etag if before else None
        fields = {"If-None-Match": held} if held else None
        reply = self._client.call("GET", f"{path}/table", query={"format": "hdf5"}, headers=fields)
        content, etag = reply.content, reply.headers.get("ETag")
        if reply.status == 304:
            assert before is not None
            content, etag = before.built.content, held
        self._put(name, told, content, etag, before)
        # In this order: a kill in between leaves a tag that is too old, and what is here is fetched
        # once more. A tag that is too new would have older rows taken for the newest.
        write_whole_bytes(self._folder / f"{name}.h5", content)
        write_whole_bytes(self._folder / f"{name}.json", json.dumps([told, etag]).encode())

    def _put(
        self, name: str, told: dict[str, Any], content: bytes, etag: str | None, before: Copy | None
    ) -> None:
        built = _built(content, etag, before.built.table.built if before else None)
        others = told.get("another_setup", {})  # an older server does not tell
        built.table.other_rows = others.get("rows", 0)
        built.table.other_wrenches = others.get("wrenches", 0)
        if built.component != name:
            raise TableFileError(f"it is the table of {built.component!r}")
        self._copies[name] = Copy(_component(told), built)

    def _take_up(self, path: Path) -> None:
        """Answer from a copy of an earlier start, as old as it may be."""
        try:
            told, etag = json.loads(path.with_suffix(".json").read_bytes())
            self._put(path.stem, told, path.read_bytes(), etag, None)
        except (OSError, ValueError, KeyError, TypeError, TableFileError) as error:
            log.warning("the copy %s is fetched anew: %s", path, error)

    def _drop(self, name: str) -> None:
        """Forget the copy of a table that is no more."""
        for known in (self._copies, self._current, self._faults):
            known.pop(name, None)
        for ending in ("h5", "json"):
            (self._folder / f"{name}.{ending}").unlink(missing_ok=True)


def _built(content: bytes, etag: str | None, before: AnyTable | None) -> Built:
    """Build and pack the table of an HDF5 file as the other server does from the same rows.

    Raises
    ------
    TableFileError
        If the bytes are no table that this version reads.
    """
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        path = Path(folder) / "table.h5"
        path.write_bytes(content)
        rows, meta = read_table(path)
    # The server computes on one thread; with several, sums are added up in another order.
    with one_thread():
        table = build(
            rows,
            meta.load_range,
            tolerance=meta.tolerance,
            linear=meta.linear,
            off_axis=meta.off_axis,
            version=meta.last_seq,
            before=before,
            solver_error=SolverError.read(meta.solver_error),
            locked=meta.locked,
        )
        packed = packed_bytes(table, meta.component, meta.fingerprint)
    return Built(content, etag, in_memory(table, packed), meta.component)


def _is_current(copy: Copy, listed: dict[str, Any]) -> bool:
    """Tell whether a copy is of what the list says: rows, range, tolerance, setup."""
    return copy.built.table.version == listed["table_version"] and _said(listed) == _said_of(
        copy.component
    )


def _said(told: dict[str, Any]) -> tuple[Any, ...]:
    spans = np.array([*told["range"]["force"], *told["range"]["moment"]], dtype=float)
    tolerance = told["tolerance"] and (
        told["tolerance"]["translation"],
        told["tolerance"]["rotation"],
    )
    return spans.tobytes(), tolerance, told["linear"], told["has_fea"]


def _said_of(component: Component) -> tuple[Any, ...]:
    spans = np.stack((component.load_range.low, component.load_range.high), axis=1)
    limit = component.tolerance
    tolerance = limit and (limit.translation, limit.rotation)
    return np.ascontiguousarray(spans).tobytes(), tolerance, component.linear, component.has_fea


def _component(told: dict[str, Any]) -> Component:
    """Return a component by what the other server says of it."""
    spans = np.array([*told["range"]["force"], *told["range"]["moment"]], dtype=float)
    limit, locked = told["tolerance"], (told.get("interface") or {}).get("locked") or ()
    return Component(
        name=told["name"],
        title=told["title"],
        folder=Path(),
        fingerprint=told["fingerprint"],
        has_fea=told["has_fea"],
        linear=told["linear"],
        load_range=LoadRange(spans[:, 0], spans[:, 1]),
        tolerance=Tolerance(**limit) if limit else None,
        shipped=told["shipped"],
        idle=tuple(FREEDOMS.index(one) for one in locked),
    )
