"""The connection to a Dask scheduler and the workers that can run attempts."""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from distributed import Client, Future

from wrenchbook.service.files.program import solver_version
from wrenchbook.service.jobs.engines import on_worker
from wrenchbook.service.jobs.engines.on_worker import TOPIC

_log = logging.getLogger(__name__)
# They log each lost connection with a traceback; `Cluster` logs it in one line.
for name in ("distributed.client", "distributed.batched"):
    logging.getLogger(name).setLevel(logging.CRITICAL)

CONNECT_SECONDS = 10.0  # also how long the client tries to reconnect before it is replaced
AWAY_SECONDS = (0.2, 5.0)  # before the first reconnection, and at most
ROSTER_SECONDS = 1.0  # between requests for the list of workers; worker events come at once
ROSTER_SECONDS_A_WORKER = 0.002  # a reply holds some kB of each
ANSWER_SECONDS = 10.0  # a scheduler that takes longer does not answer
# For a look at a worker, then it is repeated: the call to a worker that has only just registered
# may be lost, and what a slow one has imported stays imported.
LOOK_SECONDS = 3.0
CLOSE_SECONDS = 2.0  # of a client whose scheduler may be gone
LOOK_AGAIN_SECONDS = 20.0  # between looks at a worker that is not fit
MEMORY, CORES = "wrenchbook_memory", "wrenchbook_cores"
"""Resources a worker may declare: ``--resources "wrenchbook_memory=8e9 wrenchbook_cores=4"``."""


@dataclass
class WorkerState:
    """One worker, as scheduler and `on_worker.look` describe it.

    ``unfit`` is why it gets no tasks, ``tasks`` are the attempts found on its machine.
    """

    address: str
    threads: int
    memory: int
    resources: dict[str, float]
    unfit: str | None = "it has not been looked at yet"
    looked: float = -float("inf")
    tasks: frozenset[str] = field(default_factory=frozenset)

    def holds(self, memory: int, cores: int) -> bool:
        """Return whether it is large enough for a solve."""
        return self.most_memory >= memory and self.most_cores >= cores

    @property
    def most_memory(self) -> float:
        """Bytes it has: declared, else its memory limit."""
        return self.resources.get(MEMORY) or self.memory or float("inf")

    @property
    def most_cores(self) -> float:
        """Cores it has: declared, else its threads."""
        return self.resources.get(CORES) or self.threads


@dataclass(frozen=True)
class Place:
    """Where a task may run: on all workers or only on these, and the resources it takes there."""

    workers: tuple[str, ...] | None
    resources: dict[str, float]


class Cluster:
    """One scheduler and its workers. All methods run in one event loop.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786`` or ``tls://...``.
    on_progress : callable
        Called with each progress event of a worker.
    """

    def __init__(self, address: str, on_progress: Callable[[dict[str, Any]], None]) -> None:
        self.address = address
        self.workers: dict[str, WorkerState] = {}
        self._away: str | None = f"the Dask scheduler at {address} has not answered yet"
        self._on_progress = on_progress
        self._client: Client | None = None
        self._changed = asyncio.Condition()
        self._roster_due = asyncio.Event()
        self._looks: set[asyncio.Task[None]] = set()

    @property
    def trouble(self) -> str | None:
        """Why no task can be submitted at present; None if one can."""
        if self._away:
            return self._away
        if not self.workers:
            return f"the Dask scheduler at {self.address} has no workers"
        if not self.fit:
            reasons = sorted({worker.unfit or "" for worker in self.workers.values()})
            return f"no Dask worker at {self.address} can solve: {'; '.join(reasons[:3])}"
        return None

    @property
    def fit(self) -> list[WorkerState]:
        """The workers that can run attempts."""
        if self._away:
            return []
        return [worker for worker in self.workers.values() if worker.unfit is None]

    async def client(self) -> Client:
        """Return the client once it is connected to a cluster with a fit worker."""
        async with self._changed:
            while self._client is None or self._client.status != "running" or self.trouble:
                await self._changed.wait()
            return self._client

    async def cancel(self, key: str) -> None:
        """Cancel a Dask task, whichever client submitted it, once the scheduler is connected."""
        async with self._changed:
            while self._client is None or self._client.status != "running":
                await self._changed.wait()
        future: Future = Future(key, self._client)
        await self._client.cancel([future], force=True)

    async def changed(self) -> None:
        """Return once workers have changed."""
        async with self._changed:
            await self._changed.wait()

    async def gone(self, addresses: Sequence[str]) -> None:
        """Return once the scheduler has none of these workers; never if there are no addresses."""
        while not addresses or self._away or any(one in self.workers for one in addresses):
            await self.changed()

    def place(self, memory: int | None, cores: int) -> Place | str:
        """Return where a task of such needs may run, or why it has to wait.

        Declared resources are reserved by Dask; other workers are chosen by threads and memory.
        """
        fit = self.fit
        large = [worker for worker in fit if worker.holds(memory or 0, cores)]
        if not large:
            most = max((worker.most_memory for worker in fit), default=0)
            threads = max((worker.most_cores for worker in fit), default=0)
            return (
                f"no Dask worker is large enough: a solve takes {(memory or 0) / 1e9:.3g} GB and "
                f"{cores} cores, the largest workers have {most / 1e9:.3g} GB and {threads:g} cores"
            )
        resources: dict[str, float] = {}
        if all(CORES in worker.resources for worker in large):
            resources[CORES] = cores
        if memory and all(MEMORY in worker.resources for worker in large):
            resources[MEMORY] = memory
        everywhere = len(large) == len(self.workers)
        return Place(None if everywhere else tuple(one.address for one in large), resources)

    def worker_with(self, task: str) -> str | None:
        """Return a fit worker on whose machine an attempt was found; None if on none."""
        return next((worker.address for worker in self.fit if task in worker.tasks), None)

    def suspend(self, address: str, why: str) -> None:
        """Send a worker no tasks until the next look at it."""
        if worker := self.workers.get(address):
            worker.unfit, worker.looked = f"{address}: {why}", time.monotonic()
            _log.warning("a Dask worker gets nothing to solve: %s", worker.unfit)

    async def run(self) -> None:
        """Connect and follow the workers for ever.

        The client reconnects by itself for CONNECT_SECONDS; then another one takes its place.
        """
        pause = AWAY_SECONDS[0]
        while True:
            try:
                options: dict[str, Any] = {"timeout": CONNECT_SECONDS, "name": "wrenchbook"}
                client = Client(self.address, asynchronous=True, set_as_default=False, **options)
                try:
                    await client
                    pause = AWAY_SECONDS[0]
                    await self._follow(client)
                finally:
                    self._client = None
                    with contextlib.suppress(Exception):
                        closing: Any = client.close()
                        await asyncio.wait_for(closing, CLOSE_SECONDS)
                why = "the connection to it was lost"
            except Exception as error:  # a bad address, another version, no certificate
                why = str(error) or repr(error)
            await self._lose(why)
            await asyncio.sleep(pause)
            pause = min(2 * pause, AWAY_SECONDS[1])

    async def _follow(self, client: Client) -> None:
        """Keep the list of workers up to date until the client closes."""
        self._client = client
        while client.status in ("running", "connecting"):
            self._roster_due.clear()
            if client.status == "connecting":
                await self._lose("the connection to it was lost")
                await asyncio.sleep(AWAY_SECONDS[0])
                continue
            # A client that has reconnected has no subscriptions any more.
            client.subscribe_topic(TOPIC, lambda event: self._on_progress(event[1]))
            client.subscribe_topic("all", self._on_event)
            try:
                self._enrol(await asyncio.wait_for(_roster(client), ANSWER_SECONDS))
                await self._set_away(None)
            except OSError:
                await self._set_away(f"the Dask scheduler at {self.address} does not answer")
            pause = max(ROSTER_SECONDS, ROSTER_SECONDS_A_WORKER * len(self.workers))
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._roster_due.wait(), pause)

    def _on_event(self, event: tuple[float, Any]) -> None:
        if isinstance(event[1], dict) and event[1].get("action") in ("add-worker", "remove-worker"):
            self._roster_due.set()

    def _enrol(self, seen: dict[str, dict[str, Any]]) -> None:
        for address in self.workers.keys() - seen.keys():
            del self.workers[address]
        for address, found in seen.items():
            if address not in self.workers:
                limits = found["nthreads"], found["memory_limit"], found["resources"]
                self.workers[address] = WorkerState(address, *limits)
        now = time.monotonic()
        workers = self.workers.values()
        due = [one for one in workers if one.unfit and now > one.looked + LOOK_AGAIN_SECONDS]
        for worker in due:
            worker.looked = now
        if due:
            look = asyncio.create_task(self._look_at(due))
            self._looks.add(look)
            look.add_done_callback(self._looks.discard)

    async def _look_at(self, workers: Sequence[WorkerState]) -> None:
        addresses = [one.address for one in workers]
        try:
            if self._client is None:
                return
            look = self._client.run(on_worker.look, workers=addresses, on_error="return")
            found: dict[str, Any] = await asyncio.wait_for(look, LOOK_SECONDS)
        except OSError as error:
            found = dict.fromkeys(addresses, error)
        for worker in workers:
            answer = found.get(worker.address)
            worker.unfit = None
            if isinstance(answer, OSError):
                worker.looked = -float("inf")
            if why := _unfit(answer):
                worker.unfit = f"{worker.address}: {why}"
                _log.warning("a Dask worker gets nothing to solve: %s", worker.unfit)
            elif isinstance(answer, dict):
                worker.tasks = frozenset(answer["tasks"])
        await self._notify()

    async def _lose(self, why: str) -> None:
        self.workers.clear()
        await self._set_away(f"the Dask scheduler at {self.address} cannot be used: {why}")

    async def _set_away(self, why: str | None) -> None:
        if why and why != self._away:
            _log.warning("%s; it is tried again", why)
        self._away = why
        await self._notify()

    async def _notify(self) -> None:
        async with self._changed:
            self._changed.notify_all()


async def _roster(client: Client) -> dict[str, dict[str, Any]]:
    """Return what the scheduler knows of all workers; `Client.scheduler_info` leaves some out."""
    scheduler: Any = client.scheduler
    return (await scheduler.identity(n_workers=-1))["workers"]


# A worker that cannot import a function answers with the error as text.
_LACKING = ("ModuleNotFoundError", "ImportError", "AttributeError")


def _unfit(answer: Any) -> str | None:
    """Return why a worker with this answer to `look` gets no tasks; None if it gets some."""
    if isinstance(answer, Exception) and any(name in repr(answer) for name in _LACKING):
        return f"it lacks this program ({answer}): install wrenchbook[cluster,server] there"
    if not isinstance(answer, dict):
        return f"it does not answer as it should ({answer!r})"
    if answer["version"] != solver_version():
        return f"it has wrenchbook {answer['version']}, this server has {solver_version()}"
    return answer["trouble"]
