"""What an attempt's folder holds at its end, as much of it as may travel."""

import contextlib
from pathlib import Path

from service.jobs.attempt import LOCK, LOG, OUTCOME, PROGRESS, SPEC, Spec, write_outcome
from service.jobs.engines.parcel import Files

OUTCOME_BYTES = 8 * 1024 * 1024  # a displacement, a compliance and a history are some kB
LOG_BYTES = 1024 * 1024  # the end of a log is what is read
FILES_BYTES = 32 * 1024 * 1024  # a failed solve's mesh, a deck's files
NAMES = 20  # files that stayed behind are named in the log, not more than these
_STAY = {SPEC, LOCK, PROGRESS}


def files_left(folder: Path, spec: Spec) -> Files:
    """Return the files an ended attempt left, bounded; what stays behind is named in the log.

    An outcome too large to be one becomes a failure that says so.

    Parameters
    ----------
    folder : Path
        The attempt's folder; its solver has ended.
    spec : Spec
        What it solved.
    """
    if _size(folder / OUTCOME) > OUTCOME_BYTES:
        write_outcome(folder, spec, _too_large(_size(folder / OUTCOME)))
    files: Files = {}
    room, stayed = FILES_BYTES, []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not path.is_file() or path.name.startswith(".") or name in {*_STAY, LOG}:
            continue
        if _size(path) > room:
            stayed.append(f"{name} ({_size(path)} bytes)")
            continue
        files[name] = path.read_bytes()
        room -= len(files[name])
    files[LOG] = _log(folder / LOG, stayed)
    return files


def _log(path: Path, stayed: list[str]) -> bytes:
    """Return the log's end; said first is what else there was, for its last line is a cause."""
    size = _size(path)
    said = b""
    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        file.seek(max(0, size - LOG_BYTES))
        said = file.read(LOG_BYTES)
    notes = [f"[{size - LOG_BYTES} bytes of this log are left out here]"] * (size > LOG_BYTES)
    if stayed:
        names = ", ".join(stayed[:NAMES]) + (", ..." if len(stayed) > NAMES else "")
        notes.append(f"[too large to be sent, left on the worker: {names}]")
    return "".join(f"{note}\n" for note in notes).encode() + said


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _too_large(size: int) -> dict[str, object]:
    error = {
        "kind": "answer_too_large",
        "message": f"the solver's answer is {size} bytes; at most {OUTCOME_BYTES} are taken",
        "remedy": "have the solver give the displacement and write other results to files",
    }
    return {"status": "failed", "error": error}
