"""The fields of solved rows in a folder: ``<component>/<fingerprint>/<wrench's digest>.fields``.

A row's file is found by its wrench, not by its number, so that a row that was exported and imported
again, or withdrawn and restored, still has its fields. A linear component has one file, whose six
unit fields are the complete answer. A row whose file is missing or damaged is a row without fields.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
from collections.abc import Sequence
from hashlib import blake2b
from pathlib import Path

import numpy as np

from wrenchbook.service.fields.record import (
    GEOMETRY,
    ROW,
    DamagedFieldsError,
    RowFields,
    SurfaceGeometry,
    digest_of,
    read_geometry,
    read_meta,
    read_row,
)
from wrenchbook.service.files.durable import sync

# Bytes of one component: some thousand rows of 1,000 vertices. Later rows have no fields.
MAX_BYTES = 1 << 30
_LINEAR = "linear"
_HEADER_BYTES = 1 << 20  # bytes read for a file's header, which is far shorter

_log = logging.getLogger(__name__)


class FieldStore:
    """The stored fields of all components of a data directory, up to `max_bytes` of a component.

    Several processes may use it: files appear complete and are never changed.
    """

    def __init__(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        self._folder = folder
        self._max_bytes = max_bytes

    def take(
        self, attempt: Path, component: str, fingerprint: str, wrench: Sequence[float]
    ) -> bool:
        """Move a solver's files from an attempt's folder into the store; return whether it did.

        Without files, on a full disk or beyond `max_bytes` the row has no fields, without error.
        """
        row, geometry = attempt / ROW, attempt / GEOMETRY
        try:
            if not (row.exists() and geometry.exists()):
                return False
            with row.open("rb") as file:
                linear = bool(read_meta(file.read(_HEADER_BYTES)).get("linear"))
            folder = self._setup_folder(component, fingerprint)
            folder.mkdir(parents=True, exist_ok=True)
            size = row.stat().st_size + geometry.stat().st_size
            # Files of older setups are deleted.
            if self._bytes_of(component) + size > self._max_bytes:
                for old in self._folder.joinpath(component).iterdir():
                    if old.name != fingerprint:
                        shutil.rmtree(old, ignore_errors=True)
            if self._bytes_of(component) + size > self._max_bytes:
                _log.warning("%s: no room for more fields; this row has none", component)
                return False
            geometry.replace(folder / f"{digest_of(geometry.read_bytes())}.geometry")
            row.replace(folder / f"{_LINEAR if linear else key_of(wrench)}.fields")
            sync(folder)
        except (OSError, DamagedFieldsError) as error:
            _log.warning("%s: a row's fields were not kept: %s", component, error)
            return False
        return True

    def find(
        self, component: str, fingerprint: str, wrenches: Sequence[Sequence[float]]
    ) -> list[int]:
        """Return the indices of those wrenches, each six numbers, N and N·m, that have fields."""
        try:
            names = {path.name for path in self._setup_folder(component, fingerprint).iterdir()}
        except FileNotFoundError:
            return []
        return [k for k, wrench in enumerate(wrenches) if f"{key_of(wrench)}.fields" in names]

    def row(self, component: str, fingerprint: str, wrench: Sequence[float]) -> RowFields:
        """Return the fields of one row; raises DamagedFieldsError without a file of its wrench."""
        key = key_of(wrench)
        row = self._read(self._setup_folder(component, fingerprint) / f"{key}.fields")
        if key_of(row.meta["wrench"]) != key:
            other = row.meta["wrench"]
            raise DamagedFieldsError(
                f"{key}.fields holds another wrench, {other}, not {list(wrench)}"
            )
        return row

    def linear(self, component: str, fingerprint: str) -> RowFields | None:
        """Return a linear component's unit fields; None if unsolved. Raises DamagedFieldsError."""
        path = self._setup_folder(component, fingerprint) / f"{_LINEAR}.fields"
        return self._read(path) if path.exists() else None

    def geometry(self, component: str, fingerprint: str, digest: str) -> SurfaceGeometry:
        """Return the geometry of a row's fields; raises DamagedFieldsError without such a file."""
        path = self._setup_folder(component, fingerprint) / f"{digest}.geometry"
        geometry = read_geometry(_content(path))
        if geometry.digest != digest:
            raise DamagedFieldsError(f"{path.name} holds another geometry, {geometry.digest}")
        return geometry

    def _read(self, path: Path) -> RowFields:
        """Return the fields in a file; the error of a damaged file names it."""
        try:
            return read_row(_content(path))
        except DamagedFieldsError as error:
            raise DamagedFieldsError(f"{path.name}: {error}") from error

    def _setup_folder(self, component: str, fingerprint: str) -> Path:
        return self._folder / component / fingerprint

    def _bytes_of(self, component: str) -> int:
        """Return the size of a component's files of all setups."""
        size = 0
        for path in self._folder.joinpath(component).glob("*/*"):
            with contextlib.suppress(OSError):
                size += path.stat().st_size
        return size


def key_of(wrench: Sequence[float]) -> str:
    """Return the name of a row's file, from its wrench of six numbers, N and N·m."""
    exact = (np.asarray(wrench, dtype="<f8") + 0.0).tobytes()  # no difference between 0 and -0
    return blake2b(exact, digest_size=16).hexdigest()


def _content(path: Path) -> bytes:
    """Return a file's bytes; raises DamagedFieldsError if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise DamagedFieldsError(
            f"{path.name} cannot be read: {error.strerror or error}"
        ) from error
