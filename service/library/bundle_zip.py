"""A bundle's zip, unpacked, read and checked: runs in the sandbox, see `arrival`."""

from __future__ import annotations

import errno
import importlib
import json
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from wrenchbook.fea.bundle.read import Bundle, BundleError, BundleProblem, read_bundle
from wrenchbook.service.sandbox import Part
from wrenchbook.surrogate.table.hdf5 import TableFileError, leads_out

MAX_BUNDLE_BYTES: Final = 512 * 1024 * 1024  # a mesh of some million cells
PICTURE_VERTICES: Final = 2000  # a small picture shows no more; 80 kB of JSON
MOST_FILES: Final = 1000  # a component is its component.toml, a mesh, and what a deck includes
MOST_PROBLEMS: Final = 1000
_PIECE: Final = 1 << 20
_COMPRESSIONS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# What the disk is to blame for; all else is the archive's fault.
_OF_THE_DISK: Final = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EACCES)
_CANNOT_UNPACK: Final = (
    "The zip cannot be unpacked: {why}. Zip the folder again, without a password, with the usual "
    "compression (deflate) and with short file names."
)


def unpacked(archive: Path, target: str) -> Iterator[Part]:
    """Unpack a bundle's zip into a folder and read it.

    Parameters
    ----------
    archive : path
        The zip.
    target : str
        An empty folder.

    Yields
    ------
    Part
        ``problems``, each ``[where, message]``; or ``folder``, which holds the bundle, relative to
        `target`, and ``deck``, whether it names a command.
    """
    try:
        folder = extract(archive, Path(target))
        _refuse_links(folder)
        bundle = read_bundle(folder)
        require_one_interface(bundle)
    except BundleError as error:
        problems = [[one.where, one.message] for one in error.problems[:MOST_PROBLEMS]]
        yield Part({"problems": problems})
    else:
        inside = folder.relative_to(target).as_posix()
        yield Part({"problems": [], "folder": inside, "deck": bundle.deck is not None})


def require_one_interface(bundle: Bundle) -> None:
    """Raise a BundleError if the bundle has several interfaces or further inputs."""
    if bundle.others:
        raise one_problem("interface", "tables of several interfaces are not there yet")
    for one in bundle.further:
        raise one_problem(one.key, "tables with further inputs are not there yet")


def checked(folder: Path) -> Iterator[Part]:
    """Yield a part with the ``report`` of `fea.check` on a bundle, as JSON text."""
    check = importlib.import_module(
        "wrenchbook.fea.check"
    )  # here alone: no server imports finite elements
    try:
        yield Part({"report": json.dumps(check.report(folder))})
    except OSError as error:  # of the bundle's files, not of this machine's disk
        raise RuntimeError(f"{type(error).__name__}: {error}") from error


def surface(folder: Path) -> Iterator[Part]:
    """Yield the outer surface of a bundle's mesh: ``vertices`` (v, 3), ``triangles`` (t, 3)."""
    component = importlib.import_module("wrenchbook.fea.component")
    recovery = importlib.import_module("wrenchbook.fea.recovery.surface")
    reader = importlib.import_module("wrenchbook.fea.mesh.io.read")
    bundle = read_bundle(folder)
    source, deck = bundle.mesh, bundle.deck
    mesh = component.mesh_of(source) if source else reader.read_mesh(deck and deck.file, "m")
    found = recovery.surface_of(mesh, PICTURE_VERTICES)
    points = np.round(mesh.points[found.nodes], 6)  # µm: short JSON
    yield Part({}, {"vertices": points, "triangles": found.triangles})


def extract(archive: Path, target: Path) -> Path:
    """Unpack a bundle's zip and return the folder that holds component.toml.

    Raises
    ------
    BundleError
        If it cannot be unpacked, leads out of the folder or is too large.
    OSError
        If the disk is full or cannot be written.
    """
    try:
        with zipfile.ZipFile(archive) as bundle:
            _refuse_hostile(bundle)
            _unpack(bundle, target)
    except zipfile.BadZipFile as error:
        raise one_problem(
            "bundle",
            f"This is not a zip file that can be read ({error}). Zip the folder that holds "
            "component.toml and send it.",
        ) from None
    except (BundleError, MemoryError):
        raise
    except OSError as error:
        if error.errno in _OF_THE_DISK:
            raise
        raise one_problem(
            "bundle", _CANNOT_UNPACK.format(why=error.strerror or "it is damaged")
        ) from None
    except (Exception, struct.error) as error:  # whatever zipfile comes to in a damaged archive
        raise one_problem("bundle", _CANNOT_UNPACK.format(why=str(error)[:200])) from None
    folders = sorted(path.parent for path in target.rglob("component.toml"))
    if len(folders) != 1:
        raise one_problem(
            "bundle", f"The zip holds {len(folders)} files named component.toml; it must hold one."
        )
    return folders[0]


def _unpack(bundle: zipfile.ZipFile, target: Path) -> None:
    """Write each member and count its bytes: the size in its header may be wrong."""
    left = MAX_BUNDLE_BYTES
    for info in bundle.infolist():
        path = target.joinpath(*Path(info.filename).parts)
        if info.is_dir():
            path.mkdir(parents=True, exist_ok=True)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        with bundle.open(info) as packed, path.open("xb") as written:
            while piece := packed.read(_PIECE):
                left -= len(piece)
                if left < 0:
                    raise _too_large()
                written.write(piece)


def _refuse_hostile(bundle: zipfile.ZipFile) -> None:
    entries = bundle.infolist()
    if len(entries) > MOST_FILES:
        message = f"The zip holds {len(entries)} files; at most {MOST_FILES} are accepted."
        raise one_problem("bundle", message)
    if sum(info.file_size for info in entries) > MAX_BUNDLE_BYTES:
        raise _too_large()
    for info in entries:
        parts = Path(info.filename).parts
        if info.filename.startswith(("/", "\\")) or ".." in parts or ":" in info.filename:
            raise one_problem(
                "bundle",
                f"The zip holds the path {info.filename[:200]!r}, which leads out of the bundle.",
            )
        if info.compress_type not in _COMPRESSIONS:
            why = f"{info.filename[:200]!r} is compressed by method {info.compress_type}"
            raise one_problem("bundle", _CANNOT_UNPACK.format(why=why))


def _refuse_links(folder: Path) -> None:
    """Refuse HDF5 files, as some meshes are, that have other files of this machine read."""
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        try:
            outside = leads_out(path)
        except TableFileError as error:
            raise one_problem("bundle", f'"{path.name}" {error}') from None
        if outside:
            message = f'"{path.name}" has parts in other files; write it whole, without links'
            raise one_problem("bundle", message)


def _too_large() -> BundleError:
    most = MAX_BUNDLE_BYTES >> 20
    return one_problem("bundle", f"Unpacked, the zip is larger than {most} MiB, the most accepted.")


def one_problem(where: str, message: str) -> BundleError:
    """Return the error of a bundle with one mistake."""
    return BundleError([BundleProblem(where, message)])
