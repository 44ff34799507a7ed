"""A bundle on its way in: unpacking its zip, checking its mesh."""

from __future__ import annotations

import errno
import json
import lzma
import subprocess
import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO

from fea.bundle.read import BundleError, Problem
from service.files.child import child_command

MAX_BUNDLE_BYTES = 512 * 1024 * 1024  # a mesh of some million cells
CHECK_SECONDS = 300
# A password or an unknown compression (RuntimeError), a damaged or an impossible member.
_UNREADABLE = (RuntimeError, zlib.error, lzma.LZMAError, EOFError, ValueError)
# A path no file can have, or a file that is a folder of another one.
_BAD_PATH = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.EEXIST)
_CANNOT_UNPACK = (
    "The zip cannot be unpacked: {why}. Zip the folder again, without a password, with the usual "
    "compression (deflate) and with short file names."
)


def extract(archive: BinaryIO, target: Path) -> Path:
    """Unpack a bundle's zip and return the folder that holds component.toml."""
    try:
        with zipfile.ZipFile(archive) as bundle:
            _refuse_hostile(bundle)
            bundle.extractall(target)
    except zipfile.BadZipFile:
        raise one_problem(
            "bundle",
            "This is not a zip file. Zip the folder that holds component.toml and send it.",
        ) from None
    except _UNREADABLE as error:
        raise one_problem("bundle", _CANNOT_UNPACK.format(why=error)) from None
    except OSError as error:
        if error.errno not in _BAD_PATH:
            raise  # the disk's fault, not the bundle's
        raise one_problem("bundle", _CANNOT_UNPACK.format(why=error.strerror)) from None
    folders = sorted(path.parent for path in target.rglob("component.toml"))
    if len(folders) != 1:
        raise one_problem(
            "bundle", f"The zip holds {len(folders)} files named component.toml; it must hold one."
        )
    return folders[0]


def _refuse_hostile(bundle: zipfile.ZipFile) -> None:
    size = sum(info.file_size for info in bundle.infolist())
    if size > MAX_BUNDLE_BYTES:
        raise one_problem(
            "bundle", f"Unpacked, the zip is {size} bytes; at most {MAX_BUNDLE_BYTES} are accepted."
        )
    for info in bundle.infolist():
        parts = Path(info.filename).parts
        if info.filename.startswith(("/", "\\")) or ".." in parts or ":" in info.filename:
            raise one_problem(
                "bundle",
                f"The zip holds the path {info.filename!r}, which leads out of the bundle.",
            )


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
        raise one_problem(
            "mesh", f"The mesh could not be read within {CHECK_SECONDS} s. Give a coarser one."
        ) from None
    try:
        report = json.loads(run.stdout.strip().splitlines()[-1])
    except (IndexError, ValueError):
        tail = run.stderr.strip()[-500:]
        raise one_problem(
            "mesh", f"The mesh check stopped without an answer. It printed: {tail}"
        ) from None
    if not report["ok"]:
        raise BundleError([Problem(p["where"], p["message"]) for p in report["problems"]])
    return report


def one_problem(where: str, message: str) -> BundleError:
    """Return the error of a bundle with one mistake."""
    return BundleError([Problem(where, message)])
