"""The way of one attempt through a Dask cluster, from its order to its files."""

import asyncio
import contextlib
import importlib
import logging
import operator
import secrets
from collections.abc import Callable
from concurrent.futures import CancelledError as FutureCancelled
from pathlib import Path
from typing import Any

from dask._task_spec import Task
from distributed import Client, Future, KilledWorker

from service.files.durable import write_whole_bytes
from service.jobs.attempt import LOCK, OUTCOME, PROGRESS, Spec, write_outcome, write_whole
from service.jobs.engines import on_worker
from service.jobs.engines.dask_link import Link, Place
from service.jobs.engines.engine import Attempt, State
from service.jobs.engines.order import WORKER_MODULE, Order, Reply
from service.jobs.engines.parcel import BadParcelError, Files, digest, pack, unpack

_log = logging.getLogger(__name__)

# An attempt that takes its worker along again and again is at fault itself. Dask gives up after
# `distributed.scheduler.allowed-failures` workers (3), and this many times that is put up with.
KILLED_TIMES = 5
FAULTS = 10  # failures of the cluster itself in turn before an attempt is given up
AGAIN_SECONDS = 1.0  # before trying again what failed on this machine or the cluster
END_SECONDS = 15.0  # longer than a worker takes to end a solver that does not hear


class Bundles:
    """Components' files: named by their digest, sent to each worker once."""

    def __init__(self) -> None:
        self._digests: dict[Path, tuple[object, str]] = {}
        self._on_the_way: dict[tuple[str, str], asyncio.Task[None]] = {}

    def name(self, folder: Path) -> str:
        """Return the digest of a component's files."""
        stats = ((path, path.stat()) for path in sorted(folder.rglob("*")))
        seen = [(str(path), stat.st_size, stat.st_mtime_ns) for path, stat in stats]
        known = self._digests.get(folder)
        if known is None or known[0] != seen:
            known = self._digests[folder] = seen, digest(pack(folder))
        return known[1]

    async def send(self, link: Link, worker: str, name: str, folder: Path) -> None:
        """Have a worker keep a component's files; those that ask meanwhile wait for the same."""
        key = worker, name
        if key not in self._on_the_way:
            sending = asyncio.ensure_future(self._send(link, worker, name, folder))
            self._on_the_way[key] = sending
            sending.add_done_callback(lambda _: self._on_the_way.pop(key, None))
        await asyncio.shield(self._on_the_way[key])

    async def _send(self, link: Link, worker: str, name: str, folder: Path) -> None:
        files = await asyncio.to_thread(pack, folder)
        if digest(files) != name:
            return  # it has changed meanwhile: the next order names it as it is now
        told = await link.call(on_worker.store_bundle, name, files, workers=[worker])
        if (said := told.get(worker)) is not None:
            link.doubt(worker, str(said))


class Errand:
    """One attempt on its way. All of it but `state` and `waits` lives in the link's event loop.

    Parameters
    ----------
    link : Link
        The connection to the cluster.
    bundles : Bundles
        Where the component's files get their name.
    attempt : Attempt
        What is to be solved; ``spec.bundle`` is the component's folder.
    again : bool
        Whether a worker may have it already.
    told : callable
        Called when its state has changed.
    """

    def __init__(
        self,
        link: Link,
        bundles: Bundles,
        attempt: Attempt,
        *,
        again: bool,
        told: Callable[[str], None],
    ) -> None:
        self.state: State = "submitted"
        self.waits: str | None = None
        self.attempt = attempt
        self._link = link
        self._bundles = bundles
        self._again = again
        self._told = told
        self._worker: str | None = None  # where it was last heard of
        self._better: str | None = None  # has the attempt, or its bundle
        self._killed = self._faults = 0
        self._leave = asyncio.Event()

    def cancel(self) -> None:
        """Have the solver ended, wherever it is."""
        self._leave.set()

    def hear(self, word: dict[str, Any]) -> None:
        """Take a worker's word on how far the solver is."""
        if self.state not in ("submitted", "running"):
            return
        self._worker = word["worker"]
        if self.state == "submitted":
            self._say("running")
        with contextlib.suppress(OSError):
            self._mark_begun()
            if word["progress"]:
                write_whole(self.attempt.folder / PROGRESS, word["progress"])

    async def go(self) -> None:
        """Bring the attempt to its end: its folder then holds what there is."""
        running = asyncio.ensure_future(self._run())
        leaving = asyncio.ensure_future(self._leave.wait())
        try:
            await asyncio.wait({running, leaving}, return_when=asyncio.FIRST_COMPLETED)
            if not running.done():
                if await self._link.end(self.attempt.task, self._worker):
                    await asyncio.wait({running}, timeout=END_SECONDS)
                if not running.done():
                    running.cancel()
                    await self._end_with({"status": "cancelled"})
                    return
            self._say(running.result())
        finally:
            running.cancel()
            leaving.cancel()

    # -- the way ------------------------------------------------------------------------------

    async def _run(self) -> State:
        while True:
            try:
                if ended := await self._try():
                    return ended
            except (BadParcelError, FileNotFoundError) as error:
                return await self._fail("component_missing", str(error), "add the component again")
            except FutureCancelled:
                self._again = True  # the scheduler has gone, or forgotten it: a worker may have it
            except KilledWorker as error:
                self._killed += 1
                self._again = True
                if self._killed >= KILLED_TIMES:
                    return await self._fail("workers_died", str(error), _KILLED_REMEDY)
            except (OSError, TimeoutError) as error:
                # The connection, or this machine's disk: no fault of the attempt's, and told.
                self._again, self.waits = True, f"a Dask worker is not reached: {error}"
                await asyncio.sleep(AGAIN_SECONDS)
                self.waits = None
            except Exception as error:
                self._faults += 1
                _log.warning("task %s is tried again: %r", self.attempt.task, error)
                if self._faults >= FAULTS:
                    return await self._fail("cluster_error", repr(error), _FAULT_REMEDY)
                await asyncio.sleep(AGAIN_SECONDS)
            self._say("submitted")

    async def _try(self) -> State | None:
        """Order the attempt once; return how it ended, or None if it is to be ordered again."""
        client = await self._link.client()
        place = await self._place()
        folder = Path(self.attempt.spec.bundle)
        name = await asyncio.to_thread(self._bundles.name, folder)
        if self._again:
            self._better = await self._link.whereabouts(self.attempt.task)
            self._again = False
        reply = await self._order(client, place, name)
        if reply is None:
            return None
        if reply["how"] == "wants":
            await self._bundles.send(self._link, reply["worker"], name, folder)
            self._better = reply["worker"]
            return None
        if reply["how"] == "unfit":
            self._link.doubt(reply["worker"], reply["why"])
            return None
        await self._take(reply["files"])
        return "finished" if reply["how"] == "ended" else "lost"

    async def _place(self) -> Place:
        while isinstance(place := self._link.place(self.attempt.memory, self.attempt.cores), str):
            if place != self.waits:
                self.waits = place
                with contextlib.suppress(OSError):
                    said = {"fraction": 0.0, "message": f"waits: {place}"}
                    write_whole(self.attempt.folder / PROGRESS, said)
            await self._link.changed()
        self.waits = None
        return place

    async def _order(self, client: Client, place: Place, name: str) -> Reply | None:
        attempt = self.attempt
        spec = attempt.spec
        order = Order(attempt.task, spec, name, attempt.deadline, attempt.memory, attempt.cores)
        better, self._better = self._better, None
        workers = [better] if better else list(place.workers or ())
        # A key of its own each time: Dask mixes up a key that is ordered again while a worker is
        # still at it. Who works on a task is settled on the worker's machine, by the task key.
        future: Future = client.submit(
            operator.methodcaller("run_order", order.to_bytes()),
            # Named, not imported: the scheduler, which reads this, need not have this program.
            Task(None, importlib.import_module, WORKER_MODULE),
            key=f"wrenchbook-{attempt.task}-{secrets.token_hex(6)}",
            pure=False,
            priority=attempt.priority,
            workers=workers or None,
            allow_other_workers=better is not None,
            resources=place.resources or None,
        )
        # Dask never gives an order for certain workers to others that come when these are gone,
        # not even one that allows it.
        answer = asyncio.ensure_future(future.result())
        nobody = asyncio.ensure_future(self._link.gone(workers))
        try:
            await asyncio.wait({answer, nobody}, return_when=asyncio.FIRST_COMPLETED)
            if not answer.done():
                self._again = True
                return None
            return answer.result()
        finally:
            answer.cancel()
            nobody.cancel()
            future.release()

    # -- the end ------------------------------------------------------------------------------

    async def _take(self, files: Files) -> None:
        """Put what came back into the attempt's folder, the outcome last; patient with a disk."""
        while True:
            try:
                await asyncio.to_thread(self._write, files)
                self.waits = None
                return
            except OSError as error:
                self.waits = f"what a worker sent cannot be written: {error}"
            await asyncio.sleep(AGAIN_SECONDS)

    def _write(self, files: Files) -> None:
        folder = self.attempt.folder
        self._mark_begun()
        unpack({name: content for name, content in files.items() if name != OUTCOME}, folder)
        if OUTCOME in files:
            write_whole_bytes(folder / OUTCOME, files[OUTCOME])

    def _mark_begun(self) -> None:
        lock = self.attempt.folder / LOCK
        if not lock.exists():
            name = self._worker or "a Dask worker"
            write_whole_bytes(lock, f"{name}\n".encode(), durable=False)

    async def _fail(self, kind: str, message: str, remedy: str) -> State:
        error = {"kind": kind, "message": message, "remedy": remedy}
        await self._end_with({"status": "failed", "error": error})
        return "finished"

    async def _end_with(self, outcome: dict[str, Any]) -> None:
        folder, spec = self.attempt.folder, self.attempt.spec
        try:
            await asyncio.to_thread(_write_unless_there, folder, spec, outcome)
            self._say("finished")
        except OSError:
            self._say("lost")  # nobody is at it; it can only be tried again

    def _say(self, state: State) -> None:
        if state != self.state:
            self.state = state
            self._told(self.attempt.task)


def _write_unless_there(folder: Path, spec: Spec, outcome: dict[str, Any]) -> None:
    if not (folder / OUTCOME).exists():
        write_outcome(folder, spec, outcome)


_KILLED_REMEDY = (
    "the workers that had it died, each time: see their logs, give them more memory or declare it "
    "(--resources wrenchbook_memory=BYTES), and retry the job"
)
_FAULT_REMEDY = "see the logs of scheduler and workers; retry the job once the cluster is well"
