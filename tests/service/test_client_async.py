"""The client for asyncio: the calls of the blocking client, many at once."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import threading

import pytest

from tests.service.live import add_table, as_rows, clean_wrenches, moved, served
from tests.service.stub_server import Answer, Stub
from wrenchbook.service.client import (
    Client,
    ProblemError,
    Scene,
    ServerTimeout,
    ServerUnreachable,
)
from wrenchbook.service.client.async_client import AsyncClient
from wrenchbook.service.client.mount import Mount

DONE = {"id": 1, "status": "done"}
PROBLEM = {
    "type": "urn:x",
    "title": "No such job",
    "status": 404,
    "detail": "the modes must be 1 to 7",
}
CALLS = sorted(name for name in dir(Client) if not name.startswith("_"))
OWN = ("abandon",)  # of the connection


@pytest.mark.parametrize("name", [name for name in CALLS if name not in OWN])
def test_each_call_of_the_client_has_the_same_signature_in_the_asynchronous_one(name: str):
    ours, theirs = getattr(AsyncClient, name), getattr(Client, name)
    assert inspect.signature(AsyncClient) == inspect.signature(Client)
    assert inspect.signature(ours) == inspect.signature(theirs)
    assert ours.__doc__ == theirs.__doc__


def test_fifty_calls_are_on_the_wire_at_once(stub: Stub):
    together = threading.Barrier(50, timeout=600)

    def respond(seen) -> Answer:
        together.wait()  # fifty requests are inside at once
        return Answer({"id": int(seen.path.rsplit("/", 1)[1]), "status": "done"})

    async def gathered() -> list[int]:
        async with AsyncClient(stub.url, timeout=600) as client:
            jobs = await asyncio.gather(*(client.job(number) for number in range(50)))
        return [job.id for job in jobs]

    stub.respond = respond
    assert asyncio.run(gathered()) == list(range(50))


def test_a_cancelled_call_leaves_the_client_usable(stub: Stub):
    inside, release = threading.Event(), threading.Event()

    def respond(_) -> Answer:
        inside.set()
        release.wait(600)
        return Answer({"id": 2, "status": "running"})

    async def cancelled() -> int:
        async with AsyncClient(stub.url, timeout=600) as client:
            stub.respond = respond
            task = asyncio.create_task(client.job(2))
            assert await asyncio.to_thread(inside.wait, 20)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            stub.answers(Answer(DONE))
            number = (await client.job(1)).id  # its own answer, not that of the cancelled call
            release.set()
            return number

    assert asyncio.run(cancelled()) == 1
    assert len(set(stub.sockets)) == 2


def test_a_cancelled_iteration_ends_the_stream_at_once():
    """The server's stream is silent: the thread that reads it is woken by the cancellation."""
    opened, ended = threading.Event(), threading.Event()

    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n\r\n")
        await writer.drain()
        opened.set()
        await reader.read()  # the end of the connection
        ended.set()
        writer.close()

    async def cancelled() -> None:
        async with await asyncio.start_server(silent, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            async with AsyncClient(f"http://127.0.0.1:{port}", timeout=600) as client:
                task = asyncio.create_task(anext(client.events()))
                assert await asyncio.to_thread(opened.wait, 20)
                task.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await task
                assert await asyncio.to_thread(ended.wait, 20)

    asyncio.run(cancelled())


def test_a_cancelled_filling_sends_no_further_request(stub: Stub):
    """The job never ends: the thread that waits for it ends at its next poll."""
    inside, release = threading.Event(), threading.Event()

    def respond(seen) -> Answer:
        if seen.method == "POST":
            return Answer({"jobs": [{"id": 1, "status": "running"}], "stage": "first"})
        inside.set()
        release.wait(600)
        return Answer({"id": 1, "status": "running"})

    async def cancelled() -> None:
        async with AsyncClient(stub.url, timeout=600) as client:
            threads = client._threads
            task = asyncio.create_task(anext(client.fill_until("plate")))
            assert await asyncio.to_thread(inside.wait, 20)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            release.set()
            await asyncio.to_thread(threads.shutdown)  # waits for them

    stub.respond = respond
    asyncio.run(cancelled())
    assert len(stub.seen) == 2


def test_a_client_goes_from_one_event_loop_to_the_next(stub: Stub):
    client = AsyncClient(stub.url, timeout=5.0)

    async def once() -> bool:
        async with client:
            return (await client.job(1)).ended

    assert [asyncio.run(once()) for _ in range(2)] == [True, True]
    assert len(set(stub.sockets)) == 2


def outcome(url: str, call: str, *args, timeout: float = 5.0) -> tuple[BaseException, ...]:
    """The errors of the blocking client and of the asynchronous one."""

    async def awaited() -> None:
        async with AsyncClient(url, timeout) as client:
            await getattr(client, call)(*args)

    def blocking() -> None:
        with Client(url, timeout) as client:
            getattr(client, call)(*args)

    errors = []
    for run in (blocking, lambda: asyncio.run(awaited())):
        with pytest.raises(Exception) as caught:
            run()
        errors.append(caught.value)
    return tuple(errors)


@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        (Answer(PROBLEM, 404, "application/problem+json"), ProblemError),
        (Answer(b"bad gateway", 502, "text/plain"), ProblemError),
        (Answer(drop=True), ServerUnreachable),
        (Answer(held=True), ServerTimeout),
    ],
    ids=["problem", "text", "dropped", "late"],
)
def test_the_errors_of_both_clients_are_the_same(stub: Stub, answer: Answer, kind: type):
    stub.answers(answer)
    ours, theirs = outcome(stub.url, "job", 1, timeout=0.3 if answer.held else 60.0)
    assert type(ours) is type(theirs) is kind
    assert str(ours) == str(theirs)


def test_a_wrong_argument_is_the_same_error_in_both_clients_and_nothing_is_sent(stub: Stub):
    ours, theirs = outcome(stub.url, "displacement", "plate", [1, 2])
    assert type(ours) is type(theirs)
    assert isinstance(ours, ValueError)
    assert str(ours) == str(theirs)
    assert not stub.seen


def test_a_mount_says_that_it_needs_the_blocking_client():
    client = AsyncClient("http://127.0.0.1:9")
    with pytest.raises(TypeError, match="pass a Client"):
        Mount(client, "plate", [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 0])


def test_events_rounds_tables_and_plans_of_a_server_are_awaited(tmp_path):
    rows = as_rows(clean_wrenches(), moved(clean_wrenches()))
    scene = Scene({"part": {"force": [0, 0, [-50, 0]], "moment": [0, 0, 0]}})
    with served(tmp_path) as blocking:
        add_table(blocking, "part", rows)

        async def calls() -> None:
            async with AsyncClient(blocking.url) as client:
                async with contextlib.aclosing(client.events("part", timeout_s=20)) as events:
                    assert (await anext(events)).kind == "hello"
                with pytest.raises(ProblemError, match="409"):
                    [result async for result in client.fill_until("part")]
                table = await client.download("part")
                assert not await asyncio.to_thread(table.refresh)
                table.close()
                plans = await scene.plan(client)
                assert plans["part"].decision == scene.plan(blocking)["part"].decision

        asyncio.run(calls())
