"""Processes that listen on one socket take the same number of connections."""

import asyncio
import socket
from contextlib import ExitStack

import pytest

from wrenchbook.service.workers import connection_sharing as sharing
from wrenchbook.service.workers.connection_sharing import LEAVE_S, Acceptor, ConnectionCounts


class Side:
    """What one process would be: its connections, its count, its taker."""

    def __init__(self, listening, path, number, processes, taken):
        self.open, self.taken = [], taken
        counts = ConnectionCounts(path, number, processes)
        self.taker = Acceptor(listening.dup(), counts, self.open, self.speak)

    def speak(self):
        side = self

        class Held(asyncio.Protocol):
            def connection_made(self, transport):
                side.open.append(transport)
                side.taken.release()

        return Held()


@pytest.fixture
def listening():
    with socket.create_server(("127.0.0.1", 0)) as bound:
        yield bound


def share(listening, path, sides, connections, working):
    """Connect to sides of which some work; return how many connections each has."""

    async def run():
        taken = asyncio.Semaphore(0)
        made = [Side(listening, path, number + 1, sides, taken) for number in range(sides)]
        for number in working:
            made[number].taker.start()
        with ExitStack() as stack:
            for _ in range(connections):
                client = socket.create_connection(listening.getsockname())
                stack.enter_context(client)
            for _ in range(connections):
                await asyncio.wait_for(taken.acquire(), 30)
            numbers = [len(side.open) for side in made]
            for side in made:
                side.taker.stop()
                for transport in side.open:
                    transport.close()
            await asyncio.sleep(0)
        return numbers

    return asyncio.run(run())


@pytest.mark.parametrize("sides", [2, 3])
def test_a_burst_of_connections_is_shared_evenly(listening, tmp_path, sides, monkeypatch):
    monkeypatch.setattr(
        sharing, "LEAVE_S", 5.0
    )  # until the others, however slow, have taken theirs
    numbers = share(listening, tmp_path / "counts", sides, 4 * sides, range(sides))
    assert max(numbers) - min(numbers) <= 1


def test_one_takes_all_where_the_other_takes_none(listening, tmp_path):
    assert share(listening, tmp_path / "counts", 2, 5, [0]) == [5, 0]


def test_who_has_more_leaves_a_connection_for_a_moment_only(listening, tmp_path):
    assert 0 < LEAVE_S <= 0.05
    counts = [ConnectionCounts(tmp_path / "counts", number, 2) for number in (1, 2)]
    counts[0].tell(3)
    assert counts[0].others_have_fewer()
    assert not counts[1].others_have_fewer()


def test_a_process_that_is_started_again_counts_from_nothing(tmp_path):
    ConnectionCounts(tmp_path / "counts", 1, 2).tell(7)
    other = ConnectionCounts(tmp_path / "counts", 2, 2)
    other.tell(1)
    assert not other.others_have_fewer()
    ConnectionCounts(tmp_path / "counts", 1, 2)
    assert other.others_have_fewer()
