"""Server-sent events: what is told, gone on with after a break, and bounded."""

import asyncio
import json
import socket
import struct
import threading
import types

import pytest

from tests.service.ledger_rows import claim
from tests.service.live import add_rows, add_table, as_rows, clean_wrenches, moved, served
from tests.until import until
from wrenchbook.service import events as feed_module
from wrenchbook.service.actors import CALLER, Caller, acting_as
from wrenchbook.service.client import Client, ProblemError, ServerUnreachable
from wrenchbook.service.client.client import EventParser
from wrenchbook.service.events import Feed, ListenerQuotaError
from wrenchbook.service.http.access import AccessControl, SecuritySettings
from wrenchbook.service.http.permission import Permission
from wrenchbook.service.http.problems import problem_of
from wrenchbook.service.keys import Keyring
from wrenchbook.service.ledger import LedgerBusyError

ROWS = as_rows(clean_wrenches(), moved(clean_wrenches()))


def read_events(lines):
    parser = EventParser()
    return [event for line in lines if (event := parser.feed(line)) is not None]


def heard(listener):
    """What a listener would read now."""
    wire = asyncio.run(listener.read(0.01))
    return list(read_events(wire.splitlines(keepends=True)))


def test_a_line_that_breaks_off_within_a_character_is_no_error():
    assert read_events(["data: é".encode()[:-1]]) == []


# -- the feed ---------------------------------------------------------------------------------


def test_a_listener_is_greeted_and_told_what_comes_about_its_component():
    feed = Feed()
    listener = feed.listen("bar", None, {"tables": {}})
    feed.publish("job", "bar", {"id": 1})
    feed.publish("job", "plate", {"id": 2})
    feed.publish("table", "bar", {"table_version": 3})
    assert [event.kind for event in heard(listener)] == ["hello", "job", "table"]


def test_a_key_of_some_components_hears_of_these_alone():
    feed = Feed()
    token = CALLER.set(Caller("rig", ("ba?",), admin=True))
    listener = feed.listen(None, None, {})
    CALLER.reset(token)
    for name in ("bar", "plate"):
        feed.publish("table", name, {"component": name})
    assert [event.body.get("component") for event in heard(listener)] == [None, "bar"]


def test_a_key_of_some_components_that_listens_first_does_not_narrow_what_others_hear(monkeypatch):
    callers = []

    def poll(workspace, last):
        callers.append(CALLER.get())
        return feed_module.Snapshot(versions={"bar": 1, "plate": 2}), []

    async def run():
        events = feed_module.Events(None)
        CALLER.set(Caller("rig", ("bar",), admin=True))
        first = await (await events.listen(None, None)).read(1.0)
        await events.stop()
        return first

    monkeypatch.setattr(feed_module, "poll", poll)
    hello = asyncio.run(run())
    assert b'{"tables":{"bar":1}}' in hello
    assert callers[0].may_use("plate")


def test_who_comes_back_is_told_what_it_missed_and_nothing_twice():
    feed = Feed()
    feed.publish("job", "bar", {"id": 0})
    first = feed.listen(None, None, {})
    feed.publish("job", "bar", {"id": 1})
    last = heard(first)[-1].id
    feed.leave(first)
    feed.publish("job", "bar", {"id": 2})
    feed.publish("job", "bar", {"id": 3})
    again = heard(feed.listen(None, last, {}))
    assert [event.body.get("id") for event in again] == [None, 2, 3]
    after = heard(feed.listen(None, again[-1].id, {}))
    assert [event.kind for event in after] == ["hello"]


@pytest.mark.parametrize("last", ["0badf00d.1", "x", "", ".", "é.1", "{mark}.99", "{mark}.-1"])
def test_an_id_that_is_not_known_is_told_and_not_passed_over(last):
    feed = Feed()
    feed.publish("job", "bar", {"id": 1})
    reported = heard(feed.listen(None, last.format(mark=feed._mark) or "?", {}))
    assert [event.kind for event in reported] == ["hello", "missed"]
    assert "read jobs" in reported[1].body["reason"]


def test_events_no_longer_held_are_told_as_missed(monkeypatch):
    monkeypatch.setattr(feed_module, "MAX_EVENTS", 5)
    feed = Feed()
    hello = heard(feed.listen(None, None, {}))[0]
    for number in range(6):
        feed.publish("job", "bar", {"id": number})
    assert [item.kind for item in heard(feed.listen(None, hello.id, {}))] == ["hello", "missed"]


def test_a_slow_listener_is_let_go_with_the_reason_and_holds_no_more_memory(monkeypatch):
    monkeypatch.setattr(feed_module, "MAX_EVENTS", 200)
    feed = Feed()
    slow, quick = feed.listen(None, None, {}), feed.listen(None, None, {})
    heard(slow)
    for number in range(201):
        feed.publish("job", "bar", {"id": number})
        heard(quick)
    assert [event.kind for event in heard(slow)] == ["dropped"]
    assert slow.ended
    assert feed.listeners == 1


def test_one_who_does_not_read_is_let_go_and_its_place_is_free(monkeypatch):
    from wrenchbook.service.http.routes import events as route

    monkeypatch.setattr(route, "SEND_S", 0.05)
    feed = Feed()

    async def listen():
        async def receive():
            await asyncio.Event().wait()

        async def send(message):
            if message["type"] == "http.response.body":
                await asyncio.Event().wait()  # the sockets have no room for more

        stream = route.EventStream(feed, feed.listen(None, None, {}))
        assert feed.listeners == 1
        await asyncio.wait_for(stream({"type": "http"}, receive, send), 20)

    asyncio.run(listen())
    assert feed.listeners == 0


def is_heard(client):
    """Whether there is room to listen."""
    try:
        return next(client.events(timeout_s=60)).kind == "hello"
    except ProblemError as error:
        if error.status == 503:
            return False
        raise


# -- over HTTP --------------------------------------------------------------------------------


def test_a_new_version_of_a_table_is_told_to_who_listens(tmp_path):
    with served(tmp_path) as client:
        add_table(client, "part", ROWS[:10])
        events = client.events("part", timeout_s=60)
        hello = next(events)
        assert hello.kind == "hello"
        add_rows(client, "part", ROWS[10:])
        reported = next(events)
        assert (reported.kind, reported.body["component"]) == ("table", "part")
        assert reported.body["table_version"] > hello.body["tables"]["part"]
        assert reported.body["rows"] == len(ROWS)
        events.close()


def test_the_life_of_jobs_is_told_whoever_changes_them(tmp_path):
    """Another process claims and ends a job; its steps are told all the same."""
    from wrenchbook.service.ledger import Ledger

    with served(tmp_path) as client:
        events = client.events("plate_thin", timeout_s=60)
        next(events)
        job = client.displacement("plate_thin", [0, 0, -5]).job
        assert next(events).body["status"] == "waiting"
        other = Ledger(tmp_path / "ledger.sqlite")
        claim(other, "another")
        assert next(events).body["status"] == "running"
        other.commit(job.id, 1, (1e-6,) * 6)
        other.close()
        reported = [next(events), next(events)]
        assert {item.kind for item in reported} == {"job", "table"}
        done = next(item for item in reported if item.kind == "job").body
        assert (done["id"], done["status"]) == (job.id, "done")
        events.close()


def test_a_listener_is_greeted_after_the_first_look_so_that_nothing_between_is_lost(monkeypatch):
    polled, may_end = threading.Event(), threading.Event()

    def poll(workspace, last):
        polled.set()
        assert may_end.wait(600)
        return feed_module.Snapshot(), []

    async def run():
        events = feed_module.Events(None)
        listening = asyncio.create_task(events.listen(None, None))
        await asyncio.to_thread(polled.wait, 60)
        assert not listening.done()
        may_end.set()
        await listening
        await events.stop()

    monkeypatch.setattr(feed_module, "poll", poll)
    asyncio.run(run())


def test_many_changed_jobs_are_one_event(tmp_path):
    with served(tmp_path) as client:
        events = client.events(timeout_s=60)
        next(events)
        client.record("plate_thin", [[0, 0, -float(number), 0, 0, 0] for number in range(1, 101)])
        client.start_recording("plate_thin")
        reported = next(events)
        assert (reported.kind, reported.body["count"]) == ("jobs", 100)
        events.close()


def test_a_ledger_that_gives_no_answer_is_busy_and_told_when_to_connect_again(
    tmp_path, monkeypatch
):
    may_end = threading.Event()
    monkeypatch.setattr(feed_module, "FIRST_POLL_S", 0.1)
    monkeypatch.setattr(feed_module, "poll", lambda *_: may_end.wait(60))
    ledger = types.SimpleNamespace(path=tmp_path / "ledger.sqlite")

    async def run():
        events = feed_module.Events(types.SimpleNamespace(ledger=ledger))
        try:
            await events.listen(None, None)
        finally:
            may_end.set()
            await events.stop()

    with pytest.raises(
        LedgerBusyError, match=rf"within 0.1 s, .*doctor --data {tmp_path}"
    ) as caught:
        asyncio.run(run())
    problem = problem_of(caught.value)
    assert (problem.status, problem.body["title"]) == (503, "The ledger is busy")
    assert problem.headers == {"Retry-After": "10"}


def test_after_a_break_it_goes_on_where_it_was(tmp_path):
    with served(tmp_path) as client:
        events = client.events("plate_thin", timeout_s=60)
        hello = next(events)
        events.close()
        again = client.events("plate_thin", after=hello.id, timeout_s=60)
        client.displacement("plate_thin", [0, 0, -5])
        assert [next(again).kind, next(again).kind] == ["hello", "job"]
        again.close()


def test_a_first_stream_that_is_reset_is_connected_again():
    """The iteration raised ConnectionResetError until a first stream had ended by itself."""
    head = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n\r\n"
    heard_one = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            for number in (1, 2):
                peer, _ = server.accept()
                peer.recv(65_536)
                peer.sendall(head + b"event: job\ndata: {}\nid: %d\n\n" % number)
                assert heard_one.wait(60)
                peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                peer.close()

        thread = threading.Thread(target=serve)
        thread.start()
        with Client(f"http://127.0.0.1:{server.getsockname()[1]}") as client:
            events = client.events(timeout_s=60)
            assert next(events).id == "1"
            heard_one.set()
            assert next(events).id == "2"
        thread.join()


def test_an_iteration_ends_after_its_time_without_an_event_for_all_heartbeats(
    tmp_path, monkeypatch
):
    from wrenchbook.service.http.routes import events as route

    monkeypatch.setattr(route, "HEARTBEAT_S", 0.1)
    with served(tmp_path) as client:
        for seconds in (0.5, 5.0, 50.0):  # a slow machine may need longer for the first
            kinds = [event.kind for event in client.events(timeout_s=seconds)]
            if kinds:
                break
        assert kinds == ["hello"]


def test_one_listener_too_many_is_503_and_a_place_is_free_when_one_goes(tmp_path, monkeypatch):
    monkeypatch.setattr(feed_module, "MAX_LISTENERS", 2)
    with served(tmp_path) as client:
        held = [client.events(timeout_s=60) for _ in range(2)]
        for item in held:
            next(item)
        with pytest.raises(ProblemError, match="503 Too many listeners"):
            next(client.events())
        held[0].close()
        until(lambda: is_heard(client))  # as soon as the server has seen it go
        held[1].close()
    with pytest.raises(ServerUnreachable):
        next(client.events())


def test_a_key_with_32_listeners_is_429_and_leaves_places_to_others():
    feed = Feed()
    with acting_as("rig"):
        for _ in range(32):
            feed.listen(None, None, {})
        with pytest.raises(ListenerQuotaError, match="32 listeners of 'rig' are connected") as over:
            feed.listen(None, None, {})
    refusal = problem_of(over.value)
    assert (refusal.status, refusal.headers) == (429, {"Retry-After": "20"})
    with acting_as("other"):
        assert not feed.listen(None, None, {}).ended


def test_heartbeats_come_while_nothing_happens(tmp_path, monkeypatch):
    from wrenchbook.service.http.routes import events as route

    monkeypatch.setattr(route, "HEARTBEAT_S", 0.1)
    with served(tmp_path) as client:
        host, port = client.url.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port)), timeout=600) as connection:
            connection.sendall(b"GET /v1/events HTTP/1.1\r\nHost: x\r\n\r\n")
            received = b""
            while received.count(b"\n:\n\n") < 2 and received.count(b":\n\n") < 2:
                received += connection.recv(4096)
    assert b"text/event-stream" in received
    assert b"no-store" in received


def test_lines_are_read_as_the_standard_says():
    lines = b": beat\n\nid: a.1\nevent: job\ndata: {\ndata: }\nretry: 5\n\nid: a.2\n\nevent: x\n\n"
    results = list(read_events(lines.splitlines(keepends=True)))
    assert [(result.kind, result.body, result.id) for result in results] == [("job", {}, "a.1")]
    assert json.dumps(results[0].body) == "{}"


# -- keys -------------------------------------------------------------------------------------


def rest_of(events):
    """The kinds of all further events of a stream, and the status that its next request got."""
    kinds = []
    try:
        kinds += [event.kind for event in events]
    except ProblemError as error:
        return kinds, error.status
    return kinds, None


def test_a_stream_ends_with_its_key_and_tells_nothing_that_comes_later(tmp_path):
    """It went on delivering events after the key was revoked."""
    keyring = Keyring(tmp_path)
    ops, victim = keyring.add("ops", "admin"), keyring.add("victim", "read")
    with served(tmp_path, key=ops) as client, Client(client.url, key=victim) as listening:
        events = listening.events(timeout_s=60)
        assert next(events).kind == "hello"
        keyring.revoke("victim")
        assert rest_of(events) == ([], 401)
        add_table(client, "secret", ROWS[:10])
        going_on = client.events(timeout_s=60)
        assert next(going_on).kind == "hello"
        keyring.add("another", "read")  # a change that is none of this stream's key
        add_rows(client, "secret", ROWS[10:])
        assert next(going_on).kind == "table"
        going_on.close()


def test_a_stream_without_a_key_ends_once_there_are_keys(tmp_path):
    with served(tmp_path) as client:
        events = client.events(timeout_s=60)
        assert next(events).kind == "hello"
        Keyring(tmp_path).add("ops", "admin")
        assert rest_of(events) == ([], 401)


def test_a_key_revoked_while_its_stream_begins_is_seen(tmp_path):
    """Between the check of the request and the first event a look at the keys may have passed."""
    keyring = Keyring(tmp_path)
    secret = keyring.add("victim", "read")
    access, listener = AccessControl(keyring, SecuritySettings()), Feed().listen(None, None, {})
    permission = Permission(keyring.find(secret))
    keyring.revoke("victim")
    access.end_with_key(listener, permission)
    assert listener.ended


def test_a_private_servers_own_stream_outlives_a_change_of_keys(tmp_path):
    keyring = Keyring(tmp_path)
    security = SecuritySettings(server_key="the-server's-own")
    access, listener = AccessControl(keyring, security), Feed().listen(None, None, {})
    request = ("GET", "/v1/events", {b"authorization": b"Bearer the-server's-own"})
    keyring.add("ops", "admin")
    access.end_with_key(listener, access.check(*request))
    keyring.revoke("ops")
    access.check(*request)
    assert not listener.ended
