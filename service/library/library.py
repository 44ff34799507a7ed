"""The library: the components this server knows, shipped ones and those added by users."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
import threading
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from fea.bundle.read import Bundle, BundleError, Problem, read_bundle
from fea.bundle.shipped import SHIPPED
from service.files.child import child_command
from service.files.durable import sync_folder
from surrogate.rows import LoadRange, Tolerance

MAX_BUNDLE_BYTES = 512 * 1024 * 1024
CHECK_SECONDS = 300
CHECK_FILE = "check.json"  # beside component.toml: what the check found at the upload
_DECKS_REFUSED = (
    "A deck names a command that the server's solvers run, and this server takes none from "
    "outside. Ask its operator to start it with: wrenchbook serve --allow-decks; or to put the "
    "bundle's folder into the data directory's components folder"
)


@dataclass(frozen=True)
class Component:
    """One component as the service sees it; the mesh stays with the solver."""

    name: str
    title: str
    folder: Path
    fingerprint: str
    has_fea: bool
    linear: bool
    load_range: LoadRange
    tolerance: Tolerance | None
    shipped: bool


class UnknownComponentError(KeyError):
    """No component of that name; carries the names there are."""

    def __init__(self, name: str, known: list[str]) -> None:
        super().__init__(name)
        self.name = name
        self.known = known

    def __str__(self) -> str:
        known = ", ".join(self.known) or "none yet"
        return f"There is no component {self.name!r}. The library has: {known}."


class ComponentExistsError(ValueError):
    """A component of that name is there already; nothing was changed."""


class Library:
    """Components by name.

    Parameters
    ----------
    own:
        Folder of the components users add; created when missing. A component there may not take
        a shipped component's name.
    shipped:
        Folder of the components that come with the program.
    allow_decks:
        Whether bundles with a deck, and so with a command to run, may be added.

    Raises
    ------
    BundleError
        If a bundle in either folder cannot be read.
    """

    def __init__(self, own: Path, shipped: Path = SHIPPED, *, allow_decks: bool = False) -> None:
        self._own = own
        self._allow_decks = allow_decks
        self._lock = threading.Lock()
        own.mkdir(parents=True, exist_ok=True)
        self._components: dict[str, Component] = {}
        for folder in _bundle_folders(shipped):
            self._register(folder, shipped=True)
        for folder in _bundle_folders(own):
            self._register(folder, shipped=False)

    def names(self) -> list[str]:
        """Return the names of all components, sorted."""
        return sorted(self._components)

    def __contains__(self, name: str) -> bool:
        return name in self._components or self._look_for(name)

    def __getitem__(self, name: str) -> Component:
        if name not in self:
            raise UnknownComponentError(name, self.names())
        return self._components[name]

    def _look_for(self, name: str) -> bool:
        """Take up a component that another process has added to the same data directory."""
        folder = self._own / name
        if folder.parent != self._own or not (folder / "component.toml").is_file():
            return False
        with self._lock:
            if name not in self._components:
                self._register(folder, shipped=False)
        return name in self._components

    def add_zip(self, archive: BinaryIO) -> Component:
        """Add a component from a zip of its bundle folder.

        Raises
        ------
        BundleError
            If the archive, its component.toml or its mesh has mistakes; nothing is changed then.
        ComponentExistsError
            If the name is taken.
        """
        with self._incoming() as incoming:
            folder = _extract(archive, Path(incoming))
            if read_bundle(folder).deck is not None and not self._allow_decks:
                raise _one_problem("deck", _DECKS_REFUSED)
            report = check_mesh(folder)
            (folder / CHECK_FILE).write_text(json.dumps(report), encoding="utf-8")
            return self._adopt(folder)

    def add_table_only(
        self,
        name: str,
        title: str,
        force: list[list[float]],
        moment: list[list[float]],
        tolerance: dict[str, float] | None,
    ) -> Component:
        """Add a component that has no finite-element setup, only rows loaded from outside.

        Parameters
        ----------
        force, moment:
            Three ``[low, high]`` pairs each, N and N·m.
        tolerance:
            ``{"translation": m, "rotation": rad}`` or None for no limit.
        """
        lines = [f"name = {json.dumps(name)}", f"title = {json.dumps(title)}", "[range]"]
        lines += [f"force = {json.dumps(force)}", f"moment = {json.dumps(moment)}"]
        if tolerance:
            lines += ["[tolerance]", *(f"{key} = {value!r}" for key, value in tolerance.items())]
        with self._incoming() as incoming:
            folder = Path(incoming) / "bundle"
            folder.mkdir()
            (folder / "component.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
            return self._adopt(folder)

    def _incoming(self) -> tempfile.TemporaryDirectory[str]:
        """Make a folder beside the library, so that a bundle can be moved in by one rename."""
        return tempfile.TemporaryDirectory(prefix=".incoming-", dir=self._own)

    def _adopt(self, folder: Path) -> Component:
        """Move a checked bundle into the library under its own name, in one step."""
        bundle = read_bundle(folder)
        with self._lock:
            if bundle.name in self._components:
                raise ComponentExistsError(
                    f"A component {bundle.name!r} is there already. Give the new one another name: "
                    "rows of one setup are never mixed with rows of another."
                )
            final = self._own / bundle.name
            shutil.move(folder, final)
            sync_folder(self._own)
            return self._register(final, shipped=False)

    def _register(self, folder: Path, *, shipped: bool) -> Component:
        component = _component(read_bundle(folder), shipped=shipped)
        self._components = {**self._components, component.name: component}
        return component


def check_mesh(folder: Path) -> dict[str, Any]:
    """Build the bundle's mesh and resolve its groups, in a process of its own.

    The web process never imports the finite-element stack; a bad mesh file can cost that process
    its life without costing the server anything.

    Raises
    ------
    BundleError
        With every problem found, or with what the check printed if it died.
    """
    command = child_command("fea.check", str(folder))
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, timeout=CHECK_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        raise _one_problem(
            "mesh", f"The mesh could not be read within {CHECK_SECONDS} s. Give a coarser one."
        ) from None
    try:
        report = json.loads(run.stdout.strip().splitlines()[-1])
    except (IndexError, ValueError):
        tail = run.stderr.strip()[-500:]
        raise _one_problem(
            "mesh", f"The mesh check stopped without an answer. It printed: {tail}"
        ) from None
    if not report["ok"]:
        raise BundleError([Problem(p["where"], p["message"]) for p in report["problems"]])
    return report


def _one_problem(where: str, message: str) -> BundleError:
    return BundleError([Problem(where, message)])


def _bundle_folders(parent: Path) -> list[Path]:
    """List the folders that hold a component.toml, leaving half-arrived ones out."""
    if not parent.is_dir():
        return []
    found = (path.parent for path in parent.glob("*/component.toml"))
    return sorted(folder for folder in found if not folder.name.startswith("."))


def _component(bundle: Bundle, *, shipped: bool) -> Component:
    limit = bundle.tolerance
    return Component(
        name=bundle.name,
        title=bundle.title,
        folder=bundle.folder,
        fingerprint=bundle.fingerprint,
        has_fea=bundle.has_fea,
        linear=bundle.analysis is not None and not bundle.analysis.nonlinear,
        load_range=LoadRange(
            np.asarray(bundle.range.low, dtype=float), np.asarray(bundle.range.high, dtype=float)
        ),
        tolerance=Tolerance(limit.translation, limit.rotation) if limit else None,
        shipped=shipped,
    )


def _extract(archive: BinaryIO, target: Path) -> Path:
    """Unpack a bundle's zip and return the folder that holds component.toml."""
    try:
        with zipfile.ZipFile(archive) as bundle:
            _refuse_hostile(bundle)
            bundle.extractall(target)
    except zipfile.BadZipFile:
        raise _one_problem(
            "bundle",
            "This is not a zip file. Zip the folder that holds component.toml and send it.",
        ) from None
    folders = sorted(path.parent for path in target.rglob("component.toml"))
    if len(folders) != 1:
        raise _one_problem(
            "bundle", f"The zip holds {len(folders)} files named component.toml; it must hold one."
        )
    return folders[0]


def _refuse_hostile(bundle: zipfile.ZipFile) -> None:
    size = sum(info.file_size for info in bundle.infolist())
    if size > MAX_BUNDLE_BYTES:
        raise _one_problem(
            "bundle", f"Unpacked, the zip is {size} bytes; at most {MAX_BUNDLE_BYTES} are accepted."
        )
    for info in bundle.infolist():
        parts = Path(info.filename).parts
        if info.filename.startswith(("/", "\\")) or ".." in parts or ":" in info.filename:
            raise _one_problem(
                "bundle",
                f"The zip holds the path {info.filename!r}, which leads out of the bundle.",
            )
