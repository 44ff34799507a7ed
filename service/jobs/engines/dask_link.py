"""The connection to a Dask scheduler: built anew when it is lost, with who works there."""

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from distributed import Client

from service.jobs.engines import on_worker
from service.jobs.engines.order import TOPIC, program_version

_log = logging.getLogger(__name__)
# Each connection that is lost would be told with a traceback; what is to be said the link says.
logging.getLogger("distributed.client").setLevel(logging.CRITICAL)

CONNECT_SECONDS = 10.0
AWAY_SECONDS = (0.2, 5.0)  # before connecting again: the first time, and at most
ROSTER_SECONDS = 1.0  # between looks at who works there, a thousand workers and fewer
ROSTER_SECONDS_A_WORKER = 0.002  # a reply holds some kB of each
ANSWER_SECONDS = 10.0  # a scheduler that takes longer is told of
DEAF_ANSWERS = 3  # so many answers missed in turn, and the connection is built anew
CALL_SECONDS = 30.0  # a worker that is stopped never answers
CLOSE_SECONDS = 2.0  # for saying goodbye to a scheduler that may be gone
# For a first look at a worker: what it imports for that takes seconds. A call to one that has only
# just come may be lost, and is made again at once.
LOOK_SECONDS = 8.0
PROBE_AGAIN_SECONDS = 20.0  # before a worker that is not fit is looked at again
MEMORY, CORES = "wrenchbook_memory", "wrenchbook_cores"
"""Resources a worker may declare: ``--resources "wrenchbook_memory=8e9 wrenchbook_cores=4"``."""


@dataclass
class Worker:
    """One worker, as the scheduler and a look at it tell; `unfit` says why it gets no orders."""

    address: str
    threads: int
    memory: int
    resources: dict[str, float]
    unfit: str | None = "it has not been looked at yet"
    looked: float = field(default=-1e9)


@dataclass(frozen=True)
class Place:
    """Where an order may go: all workers or only these, and the resources it takes there."""

    workers: tuple[str, ...] | None
    resources: dict[str, float]


class Link:
    """The connection to one scheduler. All of it lives in one event loop.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786`` or ``tls://...``.
    hear : callable
        Told each word of progress that workers say.
    """

    def __init__(self, address: str, hear: Callable[[dict[str, Any]], None]) -> None:
        self.address = address
        self.workers: dict[str, Worker] = {}
        self._away: str | None = f"the Dask scheduler at {address} has not answered yet"
        self._hear = hear
        self._client: Client | None = None
        self._news = asyncio.Condition()
        self._found: dict[str, str] = {}
        self._found_at = 0.0
        self._finding = asyncio.Lock()

    # -- what is there ------------------------------------------------------------------------

    @property
    def trouble(self) -> str | None:
        """Why no order can be given at present; None if one can."""
        if self._away:
            return self._away
        if not self.workers:
            return f"the Dask scheduler at {self.address} has no workers"
        if not self.fit:
            reasons = sorted({worker.unfit or "" for worker in self.workers.values()})
            return f"no Dask worker at {self.address} can solve: {'; '.join(reasons[:3])}"
        return None

    @property
    def fit(self) -> list[Worker]:
        """The workers that can be given orders."""
        if self._away:
            return []
        return [worker for worker in self.workers.values() if worker.unfit is None]

    async def client(self) -> Client:
        """Return the connection once there is one with a worker that can be given orders."""
        async with self._news:
            while self._client is None or self.trouble:
                await self._news.wait()
            return self._client

    async def changed(self) -> None:
        """Return once something has changed about the workers, or a few seconds have gone."""
        async with self._news:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._news.wait(), PROBE_AGAIN_SECONDS)

    async def gone(self, addresses: Sequence[str]) -> None:
        """Return once none of these workers is there any more; never if there are none."""
        while not addresses or any(address in self.workers for address in addresses):
            await self.changed()

    def place(self, memory: int | None, cores: int) -> Place | str:
        """Return where an order of such needs may go, or why it has to wait.

        Workers that declare resources are given what these hold; others by threads and memory.
        """
        fit = self.fit
        large = [worker for worker in fit if _holds(worker, memory or 0, cores)]
        if not large:
            most = max((_memory(worker) for worker in fit), default=0)
            threads = max((_cores(worker) for worker in fit), default=0)
            return (
                f"no Dask worker is large enough: a solve takes {(memory or 0) / 1e9:.3g} GB and "
                f"{cores} cores, the largest workers have {most / 1e9:.3g} GB and {threads:g} cores"
            )
        needs: dict[str, float] = {}
        if all(CORES in worker.resources for worker in large):
            needs[CORES] = cores
        if memory and all(MEMORY in worker.resources for worker in large):
            needs[MEMORY] = memory
        everywhere = len(large) == len(self.workers)
        return Place(None if everywhere else tuple(worker.address for worker in large), needs)

    def doubt(self, address: str, why: str) -> None:
        """Give a worker no orders until it has been looked at again."""
        if worker := self.workers.get(address):
            worker.unfit, worker.looked = f"{address}: {why}", time.monotonic()
            _log.warning("Dask worker %s gets nothing to solve: %s", address, why)

    # -- what is asked of workers ---------------------------------------------------------------

    async def call(
        self,
        function: Callable[..., Any],
        *args: Any,
        workers: Sequence[str],
        seconds: float = CALL_SECONDS,
    ) -> dict:
        """Have workers call a function; returns what each answered, or an exception, by address.

        Raises
        ------
        OSError, TimeoutError
            If scheduler or workers do not answer.
        """
        if self._client is None:
            raise OSError(self._away or f"the connection to {self.address} was lost")
        asked = self._client.run(function, *args, workers=list(workers), on_error="return")
        return await asyncio.wait_for(asked, seconds)

    async def whereabouts(self, task: str) -> str | None:
        """Return the worker on whose machine an attempt is, alive or ended; None if on none."""
        await self.client()
        async with self._finding:
            if time.monotonic() > self._found_at + ROSTER_SECONDS:
                told = await self.call(on_worker.look, workers=[one.address for one in self.fit])
                good = ((at, said) for at, said in told.items() if isinstance(said, dict))
                self._found = {task: at for at, said in good for task in said["tasks"]}
                self._found_at = time.monotonic()
            return self._found.get(task)

    async def end(self, task: str, worker: str | None) -> bool:
        """End an attempt's solver on its worker, or on whichever has it; return whether one did."""
        workers = [worker] if worker in self.workers else [one.address for one in self.fit]
        try:
            told = await self.call(on_worker.end_attempt, task, workers=workers)
        except (OSError, TimeoutError):
            return False
        return any(said is True for said in told.values())

    # -- the connection -------------------------------------------------------------------------

    async def keep(self) -> None:
        """Connect, follow who works there, and connect again when that ends; for ever."""
        pause = AWAY_SECONDS[0]
        while True:
            try:
                client = Client(
                    self.address,
                    asynchronous=True,
                    set_as_default=False,
                    timeout=CONNECT_SECONDS,
                    name="wrenchbook",
                )
                try:
                    await client
                    pause = AWAY_SECONDS[0]
                    await self._follow(client)
                    why = "the connection to it was lost"
                finally:
                    await self._lose(client)
            except Exception as error:  # an address that is none, another version, no certificate
                why = str(error) or repr(error)
            await self._say_away(f"the Dask scheduler at {self.address} cannot be used: {why}")
            await asyncio.sleep(pause)
            pause = min(2 * pause, AWAY_SECONDS[1])

    async def _follow(self, client: Client) -> None:
        client.subscribe_topic(TOPIC, lambda event: self._hear(event[1]))
        self._client, missed = client, 0
        while client.status == "running" and missed < DEAF_ANSWERS:
            try:
                await self._enrol(await asyncio.wait_for(_roster(client), ANSWER_SECONDS))
                self._away, missed = None, 0
            except TimeoutError:
                missed += 1
                self._away = f"the Dask scheduler at {self.address} does not answer"
            async with self._news:
                self._news.notify_all()
            await asyncio.sleep(max(ROSTER_SECONDS, ROSTER_SECONDS_A_WORKER * len(self.workers)))

    async def _enrol(self, seen: dict[str, dict[str, Any]]) -> None:
        for address in self.workers.keys() - seen.keys():
            del self.workers[address]
        for address, told in seen.items():
            if address not in self.workers:
                self.workers[address] = Worker(
                    address, told["nthreads"], told["memory_limit"], told["resources"]
                )
        now = time.monotonic()
        due = [w for w in self.workers.values() if w.unfit and now > w.looked + PROBE_AGAIN_SECONDS]
        if not due:
            return
        for worker in due:
            worker.looked = now
        asyncio.get_running_loop().create_task(self._look_at(due))

    async def _look_at(self, workers: Sequence[Worker]) -> None:
        try:
            addresses = [one.address for one in workers]
            told = await self.call(on_worker.look, workers=addresses, seconds=LOOK_SECONDS)
        except (OSError, TimeoutError) as error:
            for worker in workers:
                worker.looked = -math.inf
            told = dict.fromkeys((one.address for one in workers), error)
        for worker in workers:
            said = told.get(worker.address)
            worker.unfit = _unfit(said)
            if worker.unfit:
                worker.unfit = f"{worker.address}: {worker.unfit}"
                _log.warning("a Dask worker gets nothing to solve: %s", worker.unfit)
        async with self._news:
            self._news.notify_all()

    async def _lose(self, client: Client) -> None:
        self._client = None
        self.workers.clear()
        with contextlib.suppress(Exception):
            await asyncio.wait_for(_closed(client), CLOSE_SECONDS)

    async def _say_away(self, why: str) -> None:
        if why != self._away:
            _log.warning("%s; it is tried again", why)
        self._away = why
        async with self._news:
            self._news.notify_all()


async def _roster(client: Client) -> dict[str, dict[str, Any]]:
    """Return what the scheduler knows of each worker; what a client caches leaves workers out."""
    scheduler: Any = client.scheduler
    told = await scheduler.identity(n_workers=-1)
    return told["workers"]


async def _closed(client: Client) -> None:
    if (closing := client.close()) is not None:
        await closing


# An error of a worker that cannot read what it is asked comes as text.
_LACKING = ("ModuleNotFoundError", "ImportError", "AttributeError")


def _unfit(said: Any) -> str | None:
    """Return why a worker that answered so gets no orders; None if it gets some."""
    if isinstance(said, Exception) and any(name in repr(said) for name in _LACKING):
        return f"it lacks this program ({said}): install wrenchbook[cluster,server] there"
    if not isinstance(said, dict):
        return f"it does not answer as it should ({said!r})"
    if said["version"] != program_version():
        return f"it has wrenchbook {said['version']}, this server has {program_version()}"
    return said["trouble"]


def _memory(worker: Worker) -> float:
    return worker.resources.get(MEMORY) or worker.memory or float("inf")


def _cores(worker: Worker) -> float:
    return worker.resources.get(CORES) or worker.threads


def _holds(worker: Worker, memory: int, cores: int) -> bool:
    return _memory(worker) >= memory and _cores(worker) >= cores
