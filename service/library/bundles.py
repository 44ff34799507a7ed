"""Bundles of components: uploads, unpacked and checked in the sandbox, and copies.

The web process never imports the finite-element stack; a bad archive or mesh can crash the sandbox
without harm to the server. `unpacked`, `checked`, `surface` and `faces` run there.
"""

from __future__ import annotations

import errno
import importlib
import json
import math
import re
import shutil
import tomllib
import zipfile
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from wrenchbook.fea.bundle.read import BundleError, BundleProblem, read_bundle
from wrenchbook.fea.spec.problems import STEERING
from wrenchbook.service.files.redact import redact
from wrenchbook.service.files.toml import toml_text
from wrenchbook.service.library.component import Component
from wrenchbook.service.sandbox import MIB, Limits, Part, Sandbox, SandboxError, run
from wrenchbook.surrogate.table.foreign import leads_out
from wrenchbook.surrogate.table.hdf5 import TableFileError

MAX_BUNDLE_BYTES: Final = 512 * 1024 * 1024  # bytes: a mesh of some million cells
# Unpacked bytes by those of the zip, beyond the bytes of any zip: a mesh packs 3 to 20 times, a
# file of zeros 1,000 times.
MAX_RATIO: Final = 100
MIN_BUNDLE_BYTES: Final = 16 * 1024 * 1024
# Files: a component is its component.toml, a mesh, and files that a deck includes.
MAX_FILES: Final = 1000
MAX_PROBLEMS: Final = 1000
PICTURE_VERTICES: Final = 2000  # vertices of a small picture, which shows no more; 80 kB of JSON
# Triangles: 6 MB of JSON; a browser rotates more only with delays.
MAX_FACE_TRIANGLES: Final = 200_000
# The largest mesh of a generator, two million cells, takes 3 GB; a solve of half of it takes days.
CHECK: Final = Limits(memory=2048 * MIB, seconds=300.0, output=MAX_BUNDLE_BYTES)
# Pieces of 1 MiB, the archive's list of files, and a small component.toml.
UNPACK: Final = Limits(memory=256 * MIB, seconds=120.0, output=MAX_BUNDLE_BYTES)
_MODULE: Final = "wrenchbook.service.library.bundles"
CHECKER: Final = f"{_MODULE}:checked"
_PIECE: Final = 1 << 20
# Errors of the disk; all others are the archive's.
_OF_THE_DISK: Final = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EACCES)
_CANNOT_UNPACK: Final = (
    "The zip cannot be unpacked: {why}. Zip the folder again, without a password, with the usual "
    "compression (deflate) and with short file names."
)
_TOO_LARGE: Final = (
    "The zip unpacks to more than {} MiB, the limit for a zip of its size. Leave large files out."
)
_NO_REPORT: Final = "The mesh check stopped ({why}). Check it with: wrenchbook check FOLDER"
# Patterns of a component.toml: the first table, below the top-level keys; the lines of these keys.
_FIRST_TABLE = re.compile(r"^\s*\[", re.MULTILINE)
_LINE = {key: re.compile(rf"^[ \t]*{key}[ \t]*=.*$", re.MULTILINE) for key in ("name", "title")}
# Slots separate from those of `run`: a check may take minutes. It imports 75 MB, so no process
# stays.
_checks: Final = Sandbox(keep=False)


def problem_at(where: str, message: str) -> BundleError:
    """Return the error of a bundle with one mistake."""
    return BundleError([BundleProblem(where, message)])


def unpack(archive: BinaryIO, incoming: Path, *, complete: bool = True) -> tuple[Path, bool]:
    """Unpack a bundle's zip below `incoming`; return its folder, and whether it has a deck.

    Without `complete` its component.toml may lack entries, and the deck is not required.

    Raises BundleError if the archive or its component.toml has mistakes or is too large to be read,
    SandboxBusyError if too many others are being read, OSError if the disk is full.
    """
    copy, target = incoming / "bundle.zip", incoming / "bundle"
    target.mkdir()
    archive.seek(0)
    with copy.open("wb") as file:
        shutil.copyfileobj(archive, file, _PIECE)
    arguments = {"target": str(target), "complete": complete}
    try:
        (part,) = run(f"{_MODULE}:unpacked", copy, arguments, UNPACK)
    except SandboxError as error:
        raise problem_at("bundle", str(error)) from None
    copy.unlink()
    if part.fields["problems"]:
        raise BundleError([BundleProblem(where, why) for where, why in part.fields["problems"]])
    return target / part.fields["folder"], bool(part.fields["deck"])


def check_mesh(folder: Path) -> dict[str, Any]:
    """Build the bundle's mesh and find its groups, in a subprocess; return the report.

    Raises BundleError with every problem or with the cause of the check's end, SandboxBusyError if
    too many others are being checked.
    """
    try:
        (part,) = _checks.run(CHECKER, folder, None, CHECK)
        report = json.loads(part.fields["report"])
        if report["ok"]:
            return report
        problems = [
            BundleProblem(problem["where"], problem["message"])
            for problem in report["problems"][:MAX_PROBLEMS]
        ]
    except SandboxError as error:
        if error.kind == "memory" or "bad_alloc" in str(error):
            limit = CHECK.memory >> 20
            why = f"The mesh check needs more than {limit} MiB of memory. Give a coarser mesh."
        elif error.kind in ("time", "elapsed", "crash", "size"):
            why = f"{error} Or give a coarser mesh."
        else:
            why = _NO_REPORT.format(why=redact(f"{error.kind}: {error}")[:300])
        raise problem_at("mesh", why) from None
    except (ValueError, KeyError, TypeError) as error:
        raise problem_at("mesh", _NO_REPORT.format(why=f"a malformed report: {error}")) from None
    raise BundleError(problems)


@lru_cache(maxsize=64)
def surface_of(folder: Path, _fingerprint: str) -> dict[str, Any]:
    """Return the outer surface of a bundle's mesh, ``vertices`` in m and ``triangles``.

    Raises SandboxError or SandboxBusyError if its mesh cannot be built within the limits of a
    check, or too many others are built.
    """
    (part,) = _checks.run(f"{_MODULE}:surface", folder, None, CHECK)
    arrays = {name: np.array(array) for name, array in part.arrays.items()}
    for array in arrays.values():
        array.setflags(write=False)  # all callers have the same
    return arrays


@lru_cache(maxsize=8)
def known_faces_of(folder: Path, _fingerprint: str) -> bytes:
    """Return `faces_of` a component's folder, which stays."""
    return faces_of(folder)


def faces_of(folder: Path) -> bytes:
    """Return as JSON the numbered ``faces`` of a bundle's mesh, and their plotly ``figure``.

    Raises BundleError if no surface can be read or drawn, SandboxBusyError as `surface_of`.
    """
    try:
        (part,) = _checks.run(f"{_MODULE}:faces", folder, None, CHECK)
    except SandboxError as error:
        raise problem_at("mesh", redact(str(error))) from None
    return part.arrays["json"].tobytes()


def copy_bundle(component: Component, name: str, title: str | None, folder: Path) -> None:
    """Copy a component's folder, with another name in its component.toml.

    Nothing else changes, so that its fingerprint, and with it the meaning of its rows, stays.

    Raises BundleError, and leaves no folder, if the name or the title cannot be edited line by line
    in the file.
    """
    text = (component.folder / "component.toml").read_text(encoding="utf-8-sig")
    begins = _FIRST_TABLE.search(text)
    end = begins.start() if begins else len(text)
    head = text[:end]
    entries = {"name": name} if title is None else {"name": name, "title": title}
    for key, value in entries.items():
        line = f"{key} = {toml_text(value)}"
        if _LINE[key].search(head):
            head = _LINE[key].sub(lambda _, line=line: line, head, count=1)
        else:
            head = f"{line}\n{head}"
    edited = head + text[end:]
    try:
        is_as_meant = tomllib.loads(edited) == tomllib.loads(text) | entries
    except tomllib.TOMLDecodeError:
        is_as_meant = False
    if not is_as_meant:
        raise problem_at(
            "component.toml",
            f"the name and title of {component.name!r} cannot be changed for a copy; write each on "
            'one line, such as name = "plate", at the top of the file, then copy again',
        )
    shutil.copytree(component.folder, folder, symlinks=False, dirs_exist_ok=False)
    (folder / "component.toml").write_text(edited, encoding="utf-8")


# -- in the sandbox ---------------------------------------------------------------------------


def unpacked(archive: Path, target: str, complete: bool) -> Iterator[Part]:
    """Unpack a bundle's zip into an empty folder and, if it is to be `complete`, read it.

    Yields a part with ``problems``, each ``[where, message]``; without any also ``folder``, the
    bundle's folder relative to `target`, and ``deck``, whether it names a command.
    """
    try:
        folder = extract(archive, Path(target))
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            try:  # an HDF5 file, as some meshes are, may refer to other files of this machine
                outside = leads_out(path)
            except TableFileError as error:
                raise problem_at("bundle", f'"{path.name}" {error}') from None
            if outside:
                message = f'"{path.name}" has parts in other files; write all in one file'
                raise problem_at("bundle", message)
        has_deck = complete and read_bundle(folder).deck is not None
    except BundleError as error:
        problems = error.problems[:MAX_PROBLEMS]
        yield Part({"problems": [[problem.where, problem.message] for problem in problems]})
    else:
        inside = folder.relative_to(target).as_posix()
        yield Part({"problems": [], "folder": inside, "deck": has_deck})


def checked(folder: Path) -> Iterator[Part]:
    """Yield a part with the ``report`` of `fea.check` on a bundle, as JSON text."""
    # Imported in this function only: no server imports finite elements.
    check = importlib.import_module("wrenchbook.fea.check")
    try:
        yield Part({"report": json.dumps(check.report(folder))})
    except OSError as error:  # an error of the bundle's files, not of this machine's disk
        raise RuntimeError(
            f"{error.filename} cannot be read ({error.strerror}); let the server's user read it"
        ) from error


def surface(folder: Path) -> Iterator[Part]:
    """Yield the outer surface of a bundle's mesh: ``vertices`` (v, 3), ``triangles`` (t, 3)."""
    sources = importlib.import_module("wrenchbook.fea.mesh.sources")
    recovery = importlib.import_module("wrenchbook.fea.recovery.fields")
    reader = importlib.import_module("wrenchbook.fea.mesh.io.read")
    bundle = read_bundle(folder)
    source, deck = bundle.mesh, bundle.deck
    unit = deck and deck.unit
    mesh = sources.mesh_of(source) if source else reader.read_mesh(deck and deck.file, unit)
    outside = recovery.shown_surface(mesh, PICTURE_VERTICES)
    points = mesh.points[outside.nodes]
    decimals = 5 - math.floor(math.log10(np.ptp(points, axis=0).max()))  # short JSON
    points = np.round(points, decimals)
    yield Part({}, {"vertices": points, "triangles": outside.triangles})


def faces(folder: Path) -> Iterator[Part]:
    """Yield the reply of `faces_of`, ``json``, as bytes."""
    reporting = importlib.import_module("wrenchbook.fea.check.reporting")
    commands = importlib.import_module("wrenchbook.fea.check.commands")
    problems: list[BundleProblem] = []
    surface = reporting.surface_in(folder, problems)
    if surface is None:
        if not problems:  # mistakes of the TOML text itself
            problems = [
                BundleProblem(**problem)
                for problem in reporting.report(folder)["problems"]
                if problem["where"].startswith(("component", "line"))
            ]
        texts = [f"{problem.where}: {problem.message}" for problem in problems]
        raise ValueError("; ".join(texts) or "has no [mesh] and no .inp deck with solids; add one")
    if (count := len(surface.triangles)) > MAX_FACE_TRIANGLES:
        raise ValueError(
            f"{count} triangles are more than {MAX_FACE_TRIANGLES}, the limit of a picture; draw "
            "them with: wrenchbook check FOLDER --plot FILE.html"
        )
    listed = [reporting.listed(surface, face) for face in surface.faces]
    figure = commands.faces_figure(surface, listed).to_json()
    text = f'{{"faces": {json.dumps(listed)}, "figure": {figure}}}'
    yield Part({}, {"json": np.frombuffer(text.encode(), np.uint8)})


def extract(archive: Path, target: Path) -> Path:
    """Unpack a bundle's zip and return the folder of its component.toml.

    Raises BundleError if it cannot be unpacked, leads out of the folder or is too large, OSError if
    the disk is full or cannot be written.
    """
    try:
        limit = MAX_RATIO * archive.stat().st_size
        with zipfile.ZipFile(archive) as bundle:
            _unpack(bundle, target, min(max(limit, MIN_BUNDLE_BYTES), MAX_BUNDLE_BYTES))
    except zipfile.BadZipFile as error:
        raise problem_at(
            "bundle",
            f"The file cannot be read as a zip ({error}). Zip the folder that holds component.toml "
            "and send it.",
        ) from None
    except (BundleError, MemoryError):
        raise
    except OSError as error:
        if error.errno in _OF_THE_DISK:
            raise
        why = error.strerror or "it is damaged"
        raise problem_at("bundle", _CANNOT_UNPACK.format(why=why)) from None
    except Exception as error:  # any error of zipfile in a damaged archive
        raise problem_at("bundle", _CANNOT_UNPACK.format(why=str(error)[:200])) from None
    folders = sorted(path.parent for path in target.rglob("component.toml"))
    if not folders:
        raise problem_at("bundle", "The zip holds no component.toml. Zip the folder that has it.")
    if len(folders) > 1:
        places = ", ".join(str(path.relative_to(target)) for path in folders[:5])
        why = f"The zip holds {len(folders)} files component.toml, in {places}; leave exactly one."
        raise problem_at("bundle", why)
    return folders[0]


def _unpack(bundle: zipfile.ZipFile, target: Path, limit: int) -> None:
    """Refuse a hostile archive, then write each member, together at most `limit` bytes."""
    entries = bundle.infolist()
    too_large = problem_at("bundle", _TOO_LARGE.format(limit >> 20))
    if len(entries) > MAX_FILES:
        message = f"The zip holds {len(entries)} files, more than {MAX_FILES}; leave files out."
        raise problem_at("bundle", message)
    if sum(info.file_size for info in entries) > limit:
        raise too_large
    counts = Counter(bundle.namelist())
    for info in entries:
        if message := _refusal(info, counts[info.filename]):
            raise problem_at("bundle", message)
    remaining = limit  # counted here: the size in a header may be wrong
    for info in entries:
        path = target.joinpath(*Path(info.filename).parts)
        if info.is_dir():
            path.mkdir(parents=True, exist_ok=True)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        with bundle.open(info) as packed, path.open("xb") as written:
            while piece := packed.read(_PIECE):
                remaining -= len(piece)
                if remaining < 0:
                    raise too_large
                written.write(piece)


def _refusal(info: zipfile.ZipInfo, count: int) -> str:
    """Return why a member that is there `count` times is refused, with the remedy; or nothing."""
    name = info.filename[:200]
    if (
        info.filename.startswith(("/", "\\"))
        or ".." in Path(info.filename).parts
        or ":" in info.filename
    ):
        return f"The zip holds the path {name!r}, which is outside the bundle; remove it."
    if STEERING.search(info.filename):
        return f"The zip holds the file name {name!r}, which has control characters; rename it."
    if count > 1:
        return f"The zip holds {count} files {name!r}; leave exactly one."
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return _CANNOT_UNPACK.format(why=f"{name!r} is compressed by method {info.compress_type}")
    return ""
