"""A replica of a data directory at a URL: blocks named by their digests, and manifests.

A file is a list of blocks, so that a changed ledger ships the blocks that differ. A manifest is
written once all its blocks are there, under a name with its own digest; ``latest.json`` names the
newest one. An interrupted write never counts as complete.
"""

from __future__ import annotations

import json
import re
import secrets
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from hashlib import blake2b
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.schema import VERSION
from wrenchbook.service.ops import backup
from wrenchbook.service.ops.backup import LEDGER, BackupError
from wrenchbook.service.settings import Settings

FORMAT = "wrenchbook replica 1"
# A commit of a row changes some six pages of the ledger, in as many blocks; the manifest has 43
# bytes a block. For a ledger of 50 MB this size ships the least, within a factor of two.
BLOCK = 1 << 16
LATEST = "latest.json"
MANIFESTS = "manifests/"
BLOCKS = "blocks/"
# In the data directory
ORIGIN = "replica-id"  # two directories never ship to the same URL
COPY = ".replica.sqlite"  # the ledger of the last manifest
STATUS = "copies.json"  # what health and doctor say of replica and backups
PACKED = re.compile(rf"{backup.TABLES}/(?!\.)[^/]+\.wbt")  # mapped by read-only servers
FILES_PART = 0.25  # of the interval, for files apart from the ledger in one round
COLLECT_S = 600.0  # between removals of blocks that no manifest needs
_MAX_NUMBER = 1e11  # of a valid manifest: s since the epoch, bytes of a ledger
_INSTEAD = "restore an earlier time with --at, or use a backup"
# Manifests that stay, by age and s apart: all of the last ten minutes, one an hour for a day, one a
# day for a week.
KEEP_S = ((600.0, 0.0), (86_400.0, 3600.0), (7 * 86_400.0, 86_400.0))
# Parts of the status, with the settings that have them written.
_SWITCHES = {"replica": "replicate", "backup": "backup_every", "followed": "read_only"}
_CREDENTIALS = re.compile(r"//[^/\s]*@")
_MANIFEST = re.compile(rf"{MANIFESTS}\d{{10,}}-[0-9a-f]{{40}}\.json")  # some disks add files
_DIGEST = re.compile("[0-9a-f]{40}")
# What reading a file that was changed raises; a deep JSON text a RecursionError.
_UNREADABLE = ValueError, KeyError, TypeError, AttributeError, RecursionError

Entry = tuple[int, tuple[str, ...]]
"""A file: its length and the digests of its blocks."""
Place = Any  # fsspec's mapping of names to bytes, with its storage `fs` and `root`


class ReplicaError(BackupError):
    """A replica that cannot be written or read; the text says why and what to do."""


@dataclass(frozen=True)
class Manifest:
    """The state of a data directory at `created`, s since the epoch: all that was committed then.

    `rows` and `jobs` are numbers, `last_row` is the highest number of a row. `files` is the entry
    of a JSON text with the entries of all files but the ledger. Writes go to `server`.
    """

    number: int
    created: float
    origin: str
    server: str
    interval: float
    rows: int
    last_row: int
    jobs: int
    ledger: Entry
    files: Entry
    ledger_schema: int = VERSION
    format: str = FORMAT


def place_of(url: str) -> Place:
    """Return the storage of a URL as a mapping; raises ReplicaError."""
    if url.startswith(("http://", "https://")):
        raise ReplicaError(
            f"{shown(url)} is a server; write the replica's URL (of serve --replicate)"
        )
    try:
        import fsspec  # half a second that only servers with a replica wait

        return fsspec.get_mapper(url, skip_instance_cache=True)
    except (ImportError, ValueError, TypeError) as error:
        remedy = "write file:///FOLDER, s3://BUCKET/FOLDER or sftp://..."
        if isinstance(error, ImportError):
            remedy = "pip install 'wrenchbook[replica]'"
        why = f"{shown(url)} cannot be used ({shown(str(error))})"
        raise ReplicaError(f"{why}; {remedy}") from error


def shown(text: str) -> str:
    """Return a text without the credentials of its URLs."""
    return _CREDENTIALS.sub("//", text)


class Replica:
    """A replica to read: its manifests, and the content of their files."""

    def __init__(self, url: str) -> None:
        self.url = shown(url)
        self.place = place_of(url)

    def manifests(self) -> list[str]:
        """Return the names of the manifests, the newest first."""
        return sorted(filter(_MANIFEST.fullmatch, self.place), reverse=True)

    def manifest(self, name: str) -> Manifest:
        """Return a manifest; raises ReplicaError if it is damaged, BackupError if it is newer."""
        try:
            content = self.place[name]
            fields: dict[str, Any] = json.loads(content)
            if name != _name(fields["number"], content):
                raise ValueError("its digest is not that of its name")
            if fields["format"] != FORMAT:
                problem = f"{name} of {self.url} has the format {str(fields['format'])[:60]!r}"
                raise BackupError(f"{problem}, not {FORMAT!r}; install the version that wrote it")
            if fields["ledger_schema"] > VERSION:
                raise BackupError(
                    f"{self.url} has ledger format {fields['ledger_schema']}, but this wrenchbook "
                    f"reads up to {VERSION}; install the version that wrote it"
                )
            numbers = fields["interval"], fields["created"], fields["ledger"][0]
            if not all(0.0 < number < _MAX_NUMBER for number in numbers):
                raise ValueError(f"interval, created and the ledger's length are {numbers}")
            fields.update(_entries({name: fields[name] for name in ("ledger", "files")}))
            return Manifest(**fields)
        except _UNREADABLE as error:
            problem = f"{name} of {self.url} is damaged: {backup.reason_of(error)}"
            raise ReplicaError(f"{problem}; {_INSTEAD}") from error

    def newest(self, until: float = float("inf")) -> Manifest:
        """Return the newest complete manifest that was created `until` then; raises BackupError."""
        names = self.manifests()
        missing = "as old as the time of --at; name a later time"
        missing = missing if names else "of a data directory; check the URL"
        why = ReplicaError(f"{self.url} has no copy {missing}")
        for name in names:
            try:
                if (manifest := self.manifest(name)).created <= until:
                    return manifest
            except ReplicaError as error:
                why = error
        raise why

    def files(self, manifest: Manifest) -> dict[str, Entry]:
        """Return the entries of all files; raises ReplicaError for one that no replica holds."""
        try:
            files = _entries(json.loads(b"".join(map(self.block, manifest.files[1]))))
        except _UNREADABLE as error:
            problem = f"the file list of manifest {manifest.number} of {self.url} is damaged"
            raise ReplicaError(f"{problem}: {backup.reason_of(error)}; {_INSTEAD}") from error
        for name in files:
            if not is_held(name):
                problem = f"{self.url} must not hold {name!r}, so it was changed"
                raise ReplicaError(f"{problem}; {_INSTEAD}")
        return {**files, LEDGER: manifest.ledger}

    def block(self, digest: str) -> bytes:
        """Return a block; raises ReplicaError if it is missing or damaged."""
        content = self.place.get(_block(digest), b"")
        if _digest(content) != digest or len(content) > BLOCK:
            raise ReplicaError(f"block {digest} of {self.url} is missing or damaged; {_INSTEAD}")
        return content


def unpack(url: str, place: Callable[[str], IO[bytes]], until: float) -> backup.Manifest:
    """Copy the files of a replica that a restore needs; raises ReplicaError."""
    replica = Replica(url)
    manifest = replica.newest(until)
    files: dict[str, tuple[int, str]] = {}
    for name, (length, blocks) in replica.files(manifest).items():
        if not PACKED.fullmatch(name):  # built again by the start
            with place(name) as file:
                file.writelines(map(replica.block, blocks))
            files[name] = length, ""
    names = "created", "rows", "last_row", "jobs", "interval"
    state = {name: getattr(manifest, name) for name in names}
    return backup.Manifest(manifest.created, manifest.ledger_schema, files, state=state)


class Shipper:
    """Ships a data directory to its URL, one `round` after the other, from one thread.

    All that was committed when a round began is in its manifest. Files apart from the ledger have
    a part of the interval in each round, so that a large table does not delay rows.
    """

    def __init__(self, settings: Settings, ledger: Ledger, *, again: bool = False) -> None:
        self._settings = settings
        self._data = settings.data
        self._ledger = ledger
        self._replica = Replica(settings.replicate or "")
        if self._replica.url.startswith("file://"):  # its owner's alone, as backups
            Path(self._replica.place.root).mkdir(0o700, parents=True, exist_ok=True)
        self._origin = _origin_of(settings.data)
        self._pointer = self._replica.place.get(LATEST, b"")  # as last read or written here
        self._number = 0  # of the last manifest
        self._files: dict[str, Entry] = {}  # of the last manifest
        self._known: set[str] = set()  # blocks that are there
        self._shipped: dict[str, object] = {}  # stamps of files that are there
        self._latest = ""
        self._manifest_version: object = None  # version of the ledger in the last manifest
        self._surfaces_behind = False
        self._collect_at = time.monotonic() + COLLECT_S
        self.facts: dict[str, Any] = {"bytes": 0}
        names = self._replica.manifests()
        if again and not names:
            raise ReplicaError(
                f"{self._replica.url} is now empty; mount it, or restart the server to copy "
                "everything again"
            )
        if names:
            newest = None
            try:
                newest = self._replica.newest()
            except ReplicaError:
                if self._pointer:  # else the first round ever was cut off
                    raise
            self._number = int(names[0][len(MANIFESTS) :].partition("-")[0])
            if newest is not None:
                self._continue_from(newest)

    def _continue_from(self, newest: Manifest) -> None:
        """Take over which files and blocks are there; ReplicaError if the origin is another."""
        if newest.origin != self._origin:
            raise ReplicaError(
                f"{self._replica.url} has the replica of another data directory; name an empty "
                "folder, also after a restore"
            )
        names = [name for name in self._replica.place if name.startswith(BLOCKS)]
        present = {name.rpartition("/")[2] for name in names}
        with suppress(ReplicaError):  # else all is shipped again
            self._files = self._replica.files(newest)
            self._known = present & _digests([*self._files.values(), newest.files])

    def round(self) -> None:
        """Ship what has changed, and note it in `facts`."""
        changed = self._ship_files()
        begun = time.time()
        version = self._ledger.version()
        if changed or version != self._manifest_version:
            self._ship_manifest(begun)
            self._manifest_version = version
            if time.monotonic() > self._collect_at:
                self.collect()
                self._collect_at = time.monotonic() + COLLECT_S
        self._write_pointer(begun)

    def _ship_files(self) -> bool:
        """Ship tables and surfaces in their part of the interval; return whether any changed."""
        deadline = time.monotonic() + FILES_PART * self._settings.replicate_interval
        self.facts["files_behind"] = 0
        changed = self._ship(backup.TABLES, deadline)
        version = self._ledger.version()
        if version != self._manifest_version or self._surfaces_behind:  # a surface comes with a row
            behind = self.facts["files_behind"]
            changed |= self._ship("fields", deadline)
            self._surfaces_behind = self.facts["files_behind"] > behind
        return changed

    def _ship_manifest(self, begun: float) -> None:
        """Ship ledger and components, then the manifest of all that is there."""
        rows, last_row, jobs = self._ledger.copy(self._data / COPY, checked=False)
        self._ship("components")  # after the ledger: no row is without its component
        with (self._data / COPY).open("rb") as file:
            self._files[LEDGER] = self._ship_file(file)
        others = {name: entry for name, entry in self._files.items() if name != LEDGER}
        settings = self._settings
        manifest = Manifest(
            number=self._number + 1,
            created=begun,
            origin=self._origin,
            server=settings.public_url or f"http://{socket.gethostname()}:{settings.port}",
            interval=settings.replicate_interval,
            rows=rows,
            last_row=last_row,
            jobs=jobs,
            ledger=self._files[LEDGER],
            files=self._ship_file(BytesIO(json.dumps(others).encode())),
        )
        content = json.dumps(asdict(manifest)).encode()
        self._check()
        self._latest = _name(manifest.number, content)
        self._write(self._latest, content)
        self._number = manifest.number
        self.facts |= {"manifest": manifest.number, "created": begun, "rows": rows}

    def _write_pointer(self, begun: float) -> None:
        """Replace `LATEST`; readers see this pointer or the one before."""
        self._check()
        pointer = json.dumps({"manifest": self._latest, "checked": begun}).encode()
        self._write(f"{LATEST}.part", pointer)
        root = self._replica.place.root
        self._replica.place.fs.mv(f"{root}/{LATEST}.part", f"{root}/{LATEST}")
        self._pointer = pointer
        self.facts["checked"] = begun

    def _check(self) -> None:
        """Raise ReplicaError unless the place is as it was left: blocks may be missing now."""
        if self._replica.place.get(LATEST, b"") != self._pointer:
            place = f"{LATEST} in {self._replica.url}"
            raise ReplicaError(
                f"another program changed {place}; stop it: only one may write there"
            )

    def collect(self) -> None:
        """Remove the manifests that need not stay, and the blocks that no manifest needs."""
        retained: list[float] = []
        needed: set[str] = set()
        place = self._replica.place
        for name in self._replica.manifests():
            with suppress(ReplicaError):
                manifest = self._replica.manifest(name)
                if stays(manifest.created, retained):
                    files = self._replica.files(manifest)
                    retained.append(manifest.created)
                    needed |= _digests([*files.values(), manifest.files])
                    continue
            del place[name]
        for name in [name for name in place if name.startswith(BLOCKS)]:
            if name.rpartition("/")[2] not in needed:
                del place[name]
        self._known &= needed

    def _ship(self, folder: str, deadline: float = float("inf")) -> bool:
        """Ship the changed files of a folder until the deadline; return whether any has changed."""
        present = self._stamps(folder)
        before = self._files
        self._files = {
            name: entry
            for name, entry in before.items()
            if name in present or not name.startswith(f"{folder}/")
        }
        changed = len(self._files) < len(before)
        for name, stamp in present.items():
            if self._shipped.get(name) == stamp:
                continue
            try:
                with (self._data / name).open("rb") as file:
                    entry = self._ship_file(file, deadline)
            except FileNotFoundError:  # a newer version has taken its place
                continue
            except TimeoutError:
                self.facts["files_behind"] += 1
                continue
            changed |= self._files.get(name) != entry
            self._files[name] = entry
            self._shipped[name] = stamp
        return changed

    def _stamps(self, folder: str) -> dict[str, object]:
        """Return the files that replicas hold in a folder, with a value that changes with each."""
        stamps: dict[str, object] = {}
        for path in (self._data / folder).rglob("*"):
            name = path.relative_to(self._data).as_posix()
            with suppress(FileNotFoundError):
                if is_held(name) and path.is_file():
                    stat = path.stat()
                    stamps[name] = stat.st_mtime_ns, stat.st_size, stat.st_ino
        return stamps

    def _ship_file(self, file: IO[bytes], deadline: float = float("inf")) -> Entry:
        """Ship a file's blocks; after a TimeoutError those that are there stay."""
        length = 0
        digests: list[str] = []
        while piece := file.read(BLOCK):
            digest = _digest(piece)
            digests.append(digest)
            length += len(piece)
            if digest not in self._known:
                if time.monotonic() > deadline:
                    raise TimeoutError
                self._write(_block(digest), piece)
                self._known.add(digest)
        return length, tuple(digests)

    def _write(self, name: str, content: bytes) -> None:
        self._replica.place[name] = content
        self.facts["bytes"] += len(content)


def stays(created: float, retained: list[float]) -> bool:
    """Return whether a manifest stays; `retained`: times of newer ones that do, newest first, s."""
    if not retained:
        return True
    age = retained[0] - created
    for max_age, apart in KEEP_S:
        if age <= max_age:
            return retained[-1] - created >= apart
    return False


def write_status(data: Path, **parts: Any) -> None:
    """Write `replica`, `backup` or `followed`, by which health and doctor judge the copies."""
    write_atomically(data / STATUS, json.dumps(read_status(data) | parts).encode(), durable=False)


def read_status(data: Path) -> dict[str, Any]:
    """Return the parts of the status; without those that were never written."""
    try:
        return json.loads((data / STATUS).read_bytes())
    except (OSError, ValueError):
        return {}


def trouble_of(status: Mapping[str, Any], settings: Settings | None = None) -> str | None:
    """Return the problems of copies; with a running server's settings also silence."""
    parts = []
    for name, part in status.items():
        silent = time.time() - part["seen"] if settings else 0.0
        if settings is None or getattr(settings, _SWITCHES[name]):
            if part["trouble"]:
                parts.append(f"{name}: {part['trouble']}")
            elif silent > part["patience"]:
                parts.append(f"{name}: its process is silent for {silent:.0f} s; see the log")
    return "; ".join(parts) or None


def is_held(name: str) -> bool:
    """Whether a replica holds a file: those of backups, and packed tables."""
    return "\0" not in name and bool(backup.HELD.fullmatch(name) or PACKED.fullmatch(name))


def _origin_of(data: Path) -> str:
    """Return the id of a data directory, made when it is first shipped."""
    try:
        return (data / ORIGIN).read_text()
    except FileNotFoundError:
        origin = secrets.token_hex(16)
        write_atomically(data / ORIGIN, origin.encode())
        return origin


def _digests(entries: Iterable[Entry]) -> set[str]:
    """Return the digests of all blocks of some files."""
    return {digest for _, blocks in entries for digest in blocks}


def _entries(fields: Mapping[str, Any]) -> dict[str, Entry]:
    for length, blocks in fields.values():
        if -(-length // BLOCK) != len(blocks):
            raise ValueError(f"{len(blocks)} blocks for a file of {length} bytes")
        if not all(map(_DIGEST.fullmatch, blocks)):
            raise ValueError("the digest of a block has not 40 hexadecimal digits")
    return {name: (length, tuple(blocks)) for name, (length, blocks) in fields.items()}


def _digest(content: bytes) -> str:
    return blake2b(content, digest_size=20).hexdigest()


def _block(digest: str) -> str:
    return f"{BLOCKS}{digest[:2]}/{digest}"


def _name(number: int, content: bytes) -> str:
    return f"{MANIFESTS}{number:010d}-{_digest(content)}.json"
