"""What a Dask worker does for a dispatcher: runs orders, keeps bundles, ends attempts.

A worker's machine needs this program and nothing of the dispatcher's: bundles come by value and are
kept under their digest, an attempt is a subprocess in a folder of its own, and what it leaves goes
back by value. All workers of a user on a machine share one folder, so an attempt that is asked for
again, since the scheduler or a server was started anew, is found there: alive or ended.
"""

import asyncio
import os
import re
import shutil
import tempfile
import threading
import time
from collections import OrderedDict
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from distributed import Worker, get_worker

from service.files import lock as flock
from service.jobs.attempt import (
    LOCK,
    OUTCOME,
    Spec,
    prepare,
    read_progress,
    write_outcome,
)
from service.jobs.engines import keeping
from service.jobs.engines.engine import ALIVE, Attempt
from service.jobs.engines.local import LocalEngine
from service.jobs.engines.order import TOPIC, Order, Reply, program_version, reply
from service.jobs.engines.parcel import BadParcelError, Files, place
from service.jobs.engines.what_is_left import files_left

FOLDER_VARIABLE = "WRENCHBOOK_WORKER_FOLDER"
LOOK_SECONDS = 0.1  # between looks at a solver that says nothing
TELL_SECONDS = 1.0  # between words to the dispatcher on how far a solver is
ASK_AGAIN_SECONDS = 30.0  # progress that has not changed is told again after so long
# What takes a solver and then its worker, a machine going down or its last memory, is not the
# job's doing: a death is told once the worker has outlived it so long.
OUTLIVE_SECONDS = 1.0
GRACE_SECONDS = 5.0  # between asking a solver to end and killing it
FREE_BYTES = 64 * 1024 * 1024  # a disk with less cannot take a solver's files
REMEMBERED = 10_000  # cancelled tasks whose orders may still be on their way

_engines: list[LocalEngine] = []  # one at most: the solvers of this worker
_engines_lock = threading.Lock()
_cancelled: OrderedDict[str, None] = OrderedDict()


class WorkerFolderError(Exception):
    """The folder for attempts and bundles cannot be used."""


def worker_folder() -> Path:
    """Return the folder that the workers of this user on this machine share; made if need be.

    Raises
    ------
    WorkerFolderError
        If it belongs to somebody else, who could put other files in the place of ours.
    """
    default = Path(tempfile.gettempdir()) / f"wrenchbook-{os.getuid()}"
    folder = Path(os.environ.get(FOLDER_VARIABLE) or default)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise WorkerFolderError(f"{folder} belongs to another user; set {FOLDER_VARIABLE}")
    for name in ("bundles", "attempts"):
        (folder / name).mkdir(exist_ok=True)
    return folder


# -- called by the engine, through the scheduler --------------------------------------------------


def look(dask_worker: Worker) -> dict[str, Any]:
    """Say who this worker is and which attempts its machine has, running or ended."""
    folder = worker_folder()
    keeping.start(folder, _solvers(dask_worker.state.nthreads))
    tasks = keeping.attempts_of(folder)
    return {"version": program_version(), "tasks": tasks, "trouble": _trouble(folder)}


async def store_bundle(name: str, files: Files) -> str | None:
    """Keep a component's files under their digest; return what is wrong if that cannot be."""
    try:
        await asyncio.to_thread(_store, name, files)
    except (OSError, BadParcelError, WorkerFolderError) as error:
        return str(error)
    return None


async def end_attempt(task: str) -> bool:
    """End the task's solver, here or as soon as its order comes; return whether it was here."""
    _cancelled[task] = None
    while len(_cancelled) > REMEMBERED:
        _cancelled.popitem(last=False)
    folder = _attempt_folder(task)
    here = folder.exists() and _solvers().poll(_bare(task, folder)) in ALIVE
    if here:
        _solvers().cancel(_bare(task, folder))
    return here


def run_order(sent: bytes) -> Reply:
    """Run one attempt to its end; ask for the bundle, or say why not, if it cannot begin."""
    worker = get_worker()
    order = Order.from_bytes(sent)
    try:
        folder = worker_folder()
        keeping.start(folder, _solvers())
        with keeping.minded(_attempt_folder(order.task)):
            if trouble := _trouble(folder):
                return reply("unfit", worker.address, why=trouble)
            bundle = folder / "bundles" / order.bundle
            if not bundle.is_dir():
                return reply("wants", worker.address)
            os.utime(bundle)  # bundles that are in use are kept
            return _run(worker, order, bundle)
    except (OSError, WorkerFolderError) as error:
        return reply("unfit", worker.address, why=str(error))


# -- one attempt ----------------------------------------------------------------------------------


def _run(worker: Worker, order: Order, bundle: Path) -> Reply:
    folder = _attempt_folder(order.task)
    spec = replace(order.spec, bundle=str(bundle))
    attempt = Attempt(order.task, folder, spec, 0, order.deadline, order.memory, order.cores)
    if order.task in _cancelled:
        return _not_begun(worker, folder, spec)
    if not (folder / OUTCOME).exists() and not flock.is_held(folder / LOCK):
        shutil.rmtree(folder, ignore_errors=True)  # of a solver that died with its worker
        prepare(folder, spec)
        _solvers().submit(attempt)
    ended = _mind(worker, attempt)
    if not ended:
        time.sleep(OUTLIVE_SECONDS)
        if trouble := _trouble(worker_folder()):  # what a solver dies of on a full disk
            return reply("unfit", worker.address, why=trouble)
    files = files_left(folder, spec)
    if not ended:
        shutil.rmtree(folder, ignore_errors=True)
    return reply("ended" if ended else "died", worker.address, files)


def _mind(worker: Worker, attempt: Attempt) -> bool:
    """Return once the attempt's solver has ended: whether it left an outcome."""
    changed = threading.Event()
    engine = _solvers()
    stop_listening = engine.listen(lambda task: changed.set() if task == attempt.task else None)
    teller = _Teller(worker, attempt)
    try:
        while (state := engine.poll(attempt)) in ALIVE:
            teller.tell()
            if attempt.task in _cancelled:
                engine.cancel(attempt)
            changed.wait(LOOK_SECONDS)
            changed.clear()
    finally:
        stop_listening()
        engine.forget(attempt)
    return state == "finished"


class _Teller:
    """Tells the dispatcher how far a solver is: what has changed, once a second at most."""

    def __init__(self, worker: Worker, attempt: Attempt) -> None:
        self._worker = worker
        self._attempt = attempt
        self._next = 0.0
        self._again = 0.0
        self._last: object = ()

    def tell(self) -> None:
        now = time.monotonic()
        if now < self._next:
            return
        progress = read_progress(self._attempt.folder)
        if progress == self._last and now < self._again:
            return
        self._last, self._next, self._again = progress, now + TELL_SECONDS, now + ASK_AGAIN_SECONDS
        told = asdict(progress) if progress else None
        word = {"task": self._attempt.task, "worker": self._worker.address, "progress": told}
        self._worker.log_event(TOPIC, word)


def _not_begun(worker: Worker, folder: Path, spec: Spec) -> Reply:
    shutil.rmtree(folder, ignore_errors=True)
    prepare(folder, spec)
    write_outcome(folder, spec, {"status": "cancelled"})
    return reply("ended", worker.address, files_left(folder, spec))


# -- this machine ---------------------------------------------------------------------------------


def _solvers(threads: int = 1) -> LocalEngine:
    """Return what runs solvers here: they live on from one order to the next.

    Who asks first says how many may be kept; a worker is looked at before it is given orders.
    """
    with _engines_lock:
        if not _engines:
            _engines.append(LocalEngine(threads, grace=GRACE_SECONDS))
        return _engines[0]


def _store(name: str, files: Files) -> None:
    folder = worker_folder()
    if trouble := _trouble(folder):
        raise WorkerFolderError(trouble)
    place(files, name, folder / "bundles")
    keeping.drop_old_bundles(folder / "bundles")


def _trouble(folder: Path) -> str | None:
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES:
        return f"{folder} is on a disk with {free >> 20} MB left; {FREE_BYTES >> 20} are needed"
    return None


def _attempt_folder(task: str) -> Path:
    if not re.fullmatch(r"[\w.-]{1,120}", task) or task.startswith("."):
        raise WorkerFolderError(f"{task!r} is no task key: it names no folder")
    return worker_folder() / "attempts" / task


def _bare(task: str, folder: Path) -> Attempt:
    return Attempt(task, folder, Spec(0, 0, "", "", "", ()))
