"""The library: the components of this server, shipped ones and those added by users."""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.spec.keys import is_slug
from wrenchbook.service.actors import CALLER, NotPermittedError
from wrenchbook.service.files.durable import NO_ROOM, sync, sync_tree
from wrenchbook.service.files.toml import toml_value
from wrenchbook.service.library import bundles
from wrenchbook.service.library.component import (
    CHECK_FILE,
    BrokenComponentError,
    Component,
    ComponentExistsError,
    LibraryUnavailableError,
    UnknownComponentError,
    component_of,
)

log = logging.getLogger(__name__)

POLL_SECONDS = 1.0  # interval of polls for edited files while no request reads them
# Ten ticks of the kernel: within a tick a folder's time of change may stay the same.
TICK_NS = 100_000_000
_DECKS_REFUSED = (
    "A deck names a command for the server's solvers, and this server accepts no uploaded decks. "
    "Ask its operator for serve --allow-decks, or to put the bundle's folder into the data "
    "directory's components folder"
)
_NOT_BY_THIS_KEY = (
    "A deck names a command that solvers run, so only an admin key may add one; create such a key "
    "with: wrenchbook keys add NAME --scope admin --data FOLDER (the server's data directory)"
)
_NAME_EXISTS = (
    "There already is a component {name!r}. Give the new one another name, because rows of "
    "different setups are never mixed."
)


class Library:
    """Components by name: those in the folder `local`, which users add, and the shipped ones.

    A component in `local` must not have a shipped component's name. A bundle that cannot be read is
    left out and listed by `broken`. `allow_decks`: bundles with a deck, whose command solvers run,
    may be added. `on_added` is called with each added component; `on_checked` with an upload, and
    `on_copy` with a component and its copy's name, before others see the new one: its OSError adds
    nothing. A new component becomes visible within the context `noted(name)`. A request sees the
    components that its key may use.
    """

    def __init__(
        self,
        local: Path,
        shipped: Path = SHIPPED,
        *,
        allow_decks: bool = False,
        on_added: Callable[[Component], None] = lambda _: None,
        on_checked: Callable[[Component], None] = lambda _: None,
        on_copy: Callable[[Component, str], None] = lambda *_: None,
        noted: Callable[[str], contextlib.AbstractContextManager[None]] = (
            lambda _: contextlib.nullcontext()
        ),
    ) -> None:
        self._local = local
        self._shipped = shipped
        self._on_added = on_added
        self._on_checked = on_checked
        self._on_copy = on_copy
        self._allow_decks = allow_decks
        self._noted = noted
        self._lock = threading.Lock()
        self._version = 0
        self._next_poll = 0.0
        self._local_stamp = 0
        self._components: dict[str, Component] = {}
        self._broken: dict[Path, str] = {}  # by folder: a shipped one may have the same name
        with contextlib.suppress(OSError):  # the upload of a component reports it
            local.mkdir(parents=True, exist_ok=True)
        for folder in _bundle_folders(shipped):
            self._load(folder, shipped=True)
        for folder in _bundle_folders(local):
            self._load(folder, shipped=False)

    def all(self) -> list[Component]:
        """Return all components, by name."""
        components = [self.get(name) for name in sorted(self._components)]
        return [component for component in components if component is not None]

    def names(self) -> list[str]:
        """Return the names of all components, sorted."""
        return [component.name for component in self.all()]

    def version(self) -> int:
        """Return a number that differs after a component was added, changed or broken.

        Files that no request reads are checked once in `POLL_SECONDS`, additions by other processes
        at once.
        """
        with contextlib.suppress(OSError):
            stamp = os.stat(self._local).st_mtime_ns  # noqa: PTH116 (fifty times a second)
            if stamp != self._local_stamp or time.time_ns() - stamp <= TICK_NS:
                self._local_stamp = stamp
                for folder in _bundle_folders(self._local):
                    known = self._components.get(folder.name)
                    if (known is None or known.folder != folder) and folder not in self._broken:
                        self._reread(folder.name, folder)
        if time.monotonic() >= self._next_poll:
            self._next_poll = time.monotonic() + POLL_SECONDS
            self.names()
            for folder in self._broken:  # repaired, readable again, or removed
                self._reread(folder.name, folder)
        return self._version

    def broken(self) -> dict[str, str]:
        """Return by folder of the library the reason why its component cannot be used."""
        broken = self._broken.items()
        may_use = CALLER.get().may_use
        return {folder.name: reason for folder, reason in broken if may_use(folder.name)}

    def __contains__(self, name: str) -> bool:
        return self.get(name) is not None

    def get(self, name: str) -> Component | None:
        """Return a component; None if there is none."""
        return self._find(name) if CALLER.get().may_use(name) else None

    def __getitem__(self, name: str) -> Component:
        component = self.get(name)
        if component is None:
            if name in (broken := self.broken()):
                raise BrokenComponentError(name, self.names(), broken[name])
            raise UnknownComponentError(name, self.names())
        return component

    def as_read(self, name: str) -> Component:
        """Return a component as last read; no file is read now. Raises UnknownComponentError."""
        component = self._components.get(name)
        return self[name] if component is None else component

    def _find(self, name: str) -> Component | None:
        """Return a component in the present state of its files."""
        component = self._components.get(name)
        return component if component is not None and component.is_as_read() else self._reread(name)

    def _reread(self, name: str, folder: Path | None = None) -> Component | None:
        """Read a component again that was edited on the disk, or added by another process."""
        before = self._components.get(name)
        if folder is None and before:
            folder = before.folder
        elif folder is None and is_slug(name):
            folders = (parent / name for parent in (self._shipped, self._local))
            folder = next((path for path in folders if (path / "component.toml").is_file()), None)
        if folder is not None:
            with self._lock:
                if self._components.get(name) is before:
                    self._load(folder, shipped=folder.parent == self._shipped)
        return self._components.get(name)

    def add_zip(self, archive: BinaryIO, *, decks: bool = True) -> Component:
        """Add a component from a zip of its bundle folder.

        `decks`: whether the sender may add a deck, if the server takes any. An error changes
        nothing.

        Raises BundleError if the archive, its component.toml or its mesh has mistakes,
        ComponentExistsError if the name is taken, and LibraryUnavailableError if the disk is full.
        """
        with self._incoming() as incoming:
            folder, has_deck = bundles.unpack(archive, incoming)
            if has_deck and not (self._allow_decks and decks):
                why = _NOT_BY_THIS_KEY if self._allow_decks else _DECKS_REFUSED
                raise bundles.problem_at("deck", why)
            report = bundles.check_mesh(folder)
            (folder / CHECK_FILE).write_text(json.dumps(report), encoding="utf-8")
            checked = component_of(read_bundle(folder), shipped=False)
            component = self._adopt(folder, lambda _: self._on_checked(checked))
        self._on_added(component)
        return component

    def faces_of_zip(self, archive: BinaryIO) -> bytes:
        """Return `bundles.faces_of` of a zip that may have [mesh] alone; raises as `add_zip`."""
        with self._incoming() as incoming:
            return bundles.faces_of(bundles.unpack(archive, incoming, complete=False)[0])

    def add_table_only(self, **entries: Any) -> Component:
        """Add a component that has no finite-element setup, only rows loaded from outside.

        The entries are those of its component.toml: ``name``, ``title``, ``range`` or ``interface``
        (a list of ``{"name", "range"}``), ``inputs`` and ``tolerance``, SI.

        Raises the errors of `add_zip`.
        """
        lines = [f"{key} = {toml_value(value)}" for key, value in entries.items()]
        with self._incoming() as incoming:
            folder = incoming / "bundle"
            folder.mkdir()
            (folder / "component.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
            component = self._adopt(folder)
        self._on_added(component)
        return component

    def add_copy(self, name: str, new: str, title: str | None) -> Component:
        """Add a component with the setup of another and a new name, without rows.

        Raises UnknownComponentError if there is no component `name`, and the errors of `add_zip`.
        """
        source = self[name]
        with self._incoming() as incoming:
            folder = incoming / "bundle"
            bundles.copy_bundle(source, new, title, folder)
            component = self._adopt(folder, lambda copied: self._on_copy(source, copied))
        self._on_added(component)
        return component

    @contextlib.contextmanager
    def _incoming(self) -> Iterator[Path]:
        """Make a folder beside the library, so that a bundle can be moved into it by one rename."""
        try:
            self._local.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(prefix=".incoming-", dir=self._local) as folder:
                yield Path(folder)
        except OSError as error:
            why = error.strerror or str(error)  # those of a copy are texts
            codes = [code for code in NO_ROOM if os.strerror(code) in why]
            why = os.strerror(codes[0]) if codes else why
            remedy = NO_ROOM[codes[0]] if codes else "let the server's user write there"
            raise LibraryUnavailableError(
                f"The component could not be written to {self._local}: {why}. "
                f"Nothing was added; {remedy}, then send the component again."
            ) from error

    def _adopt(self, folder: Path, before: Callable[[str], None] = lambda _: None) -> Component:
        """Move a checked bundle into the library under its own name, in one step.

        `before` is called with that name while the component is still invisible.
        """
        name = read_bundle(folder).name
        if not CALLER.get().may_use(name):
            patterns = ", ".join(CALLER.get().components)
            raise NotPermittedError(
                f"the key allows {patterns}, not {name!r}; give the component a name that matches, "
                f"or create a key with: wrenchbook keys add NAME --component {name} "
                "--data FOLDER (the server's data directory)"
            )
        final = self._local / name
        with self._lock:
            # On the disk too: another process may have added it, or its files may be damaged.
            if name in self._components or os.path.lexists(final):
                raise ComponentExistsError(_NAME_EXISTS.format(name=name))
            sync_tree(folder)
            before(name)
            with self._noted(name):
                try:
                    folder.rename(final)  # never into an existing folder, as shutil.move would
                except OSError as error:
                    if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                        raise ComponentExistsError(_NAME_EXISTS.format(name=name)) from error
                    raise
                sync(self._local)
            return self._register(final, shipped=False)

    def _load(self, folder: Path, *, shipped: bool) -> None:
        """Register a folder's component, or record why it cannot be registered."""
        try:
            self._register(folder, shipped=shipped)
        except Exception as error:  # any error of a damaged file belongs to this component
            reason = str(error) or repr(error)
            broken = {k: v for k, v in self._broken.items() if k != folder}
            if folder.is_dir():  # else it was removed
                if self._broken.get(folder) != reason:
                    log.error("the component in %s cannot be used: %s", folder, reason)
                broken[folder] = reason
            self._broken = broken
            known = self._components.get(folder.name)
            if known is not None and known.folder == folder and not known.is_as_read():
                self._components = {k: v for k, v in self._components.items() if k != folder.name}
                self._version += 1
        else:
            self._broken = {k: v for k, v in self._broken.items() if k != folder}

    def _register(self, folder: Path, *, shipped: bool) -> Component:
        """Read the component of a folder, and add it to the library or replace it there."""
        started = time.time_ns()
        component = component_of(read_bundle(folder), shipped=shipped)
        if any(stamp and stamp[0] > started for stamp in component.stamp):
            component = replace(component, stamp=())  # edited during the reading: to be read again
        name = component.name
        if not shipped and name != folder.name:  # it would answer in another component's place
            message = f'is "{name}", but the folder is "{folder.name}"; give both the same name'
            raise bundles.problem_at("name", message)
        if not shipped and name in self._components and self._components[name].shipped:
            message = f'"{name}" is a shipped component; choose another name'
            raise bundles.problem_at("name", message)
        self._components = {**self._components, name: component}
        self._version += 1
        return component


def _bundle_folders(parent: Path) -> list[Path]:
    """List the folders with a component.toml, without incomplete ones."""
    if not parent.is_dir():
        return []
    folders = (path.parent for path in parent.glob("*/component.toml"))
    return sorted(folder for folder in folders if not folder.name.startswith("."))
