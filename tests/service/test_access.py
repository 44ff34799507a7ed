"""Who is let in: each call of the document, with each kind of key, and from each kind of place."""

import errno
import io
import os
import time
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from starlette.testclient import TestClient

from tests.service.expired import add_expired_key
from wrenchbook.service import keys
from wrenchbook.service.client import Client
from wrenchbook.service.files.lock import take
from wrenchbook.service.http import permission
from wrenchbook.service.http.access import SecuritySettings, security_settings
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.permission import Permission, Rates
from wrenchbook.service.keys import FILE, Key, Keyring, digest_of, is_loopback
from wrenchbook.service.workspace import Settings

TABLE_ONLY = {"name": "rig", "title": "rig", "range": {"force": [1, 2, 3], "moment": [1, 1, 1]}}
ASK = "/v1/components/bar/displacement"
WRENCH = {"force": [0, 0, 1], "moment": [0, 0, 0]}
SCOPES = ("read", "write", "admin")


def calls():
    """Every call that needs a key, by the application's own document."""
    document = create_app(Settings(Path("no-such-folder"))).openapi()
    for path, of_path in document["paths"].items():
        for method, call in of_path.items():
            if call.get("security") != []:
                yield method.upper(), path


CALLS = sorted(calls())


def url_of(path):
    for name, value in {"name": "bar", "job_id": "1", "row": "1"}.items():
        path = path.replace(f"{{{name}}}", value)
    return path


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("access")


@pytest.fixture(scope="module")
def secrets_(place):
    keyring = Keyring(place)
    return {scope: keyring.add(f"{scope}er", scope) for scope in SCOPES}


@pytest.fixture(scope="module")
def locked(place, secrets_):
    security = SecuritySettings(
        origins=frozenset({"https://lab.example"}), server_key="the-server's-own"
    )
    with TestClient(create_app(Settings(place, solvers=0, allow_decks=True), security)) as client:
        yield client


@pytest.fixture(scope="module")
def unlocked(tmp_path_factory):
    """As `wrenchbook serve` opens it on loopback."""
    folder, security = tmp_path_factory.mktemp("open"), security_settings("127.0.0.1", None, None)
    app = create_app(Settings(folder, solvers=0), security)
    with TestClient(app, base_url="http://127.0.0.1:8000") as client:
        yield client


def bearer(secret):
    return {"Authorization": f"Bearer {secret}"}


@pytest.mark.parametrize(("method", "path"), CALLS)
def test_every_call_refuses_none_and_a_wrong_key_and_every_write_a_key_for_reading(
    locked, secrets_, method, path
):
    url = url_of(path)
    wrong = (
        {},
        bearer("wb_wrong"),
        bearer(""),
        {"Authorization": secrets_["admin"]},
        {"Authorization": f"Basic {secrets_['admin']}"},
        {"Cookie": f"key={secrets_['admin']}"},
    )
    for headers in wrong:
        reply = locked.request(method, url, headers=headers)
        assert reply.status_code == 401, reply.text
        assert reply.headers["www-authenticate"].startswith("Bearer")
    if path.startswith(("/v1/keys", "/v1/audit")):
        assert locked.request(method, url, headers=bearer(secrets_["write"])).status_code == 403
    elif method != "GET":
        refused = locked.request(method, url, headers=bearer(secrets_["read"]))
        assert refused.status_code == 403, refused.text
        detail = refused.json()["detail"]
        assert "needs write" in detail
        is_query = path.endswith(("/displacement", "/displacements"))
        assert ("(--on-thin estimate) needs only read" in detail) == is_query
    elif path != "/v1/events":  # which goes on for ever
        assert locked.request(method, url, headers=bearer(secrets_["read"])).status_code not in (
            401,
            403,
        )


def test_a_liveness_probe_needs_no_key_and_is_the_one_call_that_does_not(locked):
    assert locked.get("/health/live").json() == {"status": "live"}
    paths = locked.get("/openapi.json").json()["paths"]
    open_ = [
        path
        for path, of_path in paths.items()
        if any(call.get("security") == [] for call in of_path.values())
    ]
    assert open_ == ["/health/live"]
    assert locked.get("/health/ready").status_code == 401


def test_the_document_of_the_calls_needs_no_key_and_says_that_they_do(locked, unlocked):
    document = locked.get("/openapi.json").json()
    assert document["security"] == [{"key": []}]
    assert {"401", "403", "429"} <= document["paths"]["/v1/components"]["get"]["responses"].keys()
    assert "security" not in unlocked.get("/openapi.json").json()


@pytest.mark.parametrize(
    ("on_thin", "status"),
    [("estimate", 200), ("reject", 409), ("queue", 403), ("wait", 403), (None, 403)],
)
def test_a_key_for_reading_asks_what_queues_nothing(locked, secrets_, on_thin, status):
    body = {**WRENCH} if on_thin is None else {**WRENCH, "on_thin": on_thin}
    assert locked.post(ASK, json=body, headers=bearer(secrets_["read"])).status_code == status
    many = {"wrenches": [[0.0] * 6]} | ({} if on_thin is None else {"on_thin": on_thin})
    reply = locked.post(f"{ASK}s", json=many, headers=bearer(secrets_["read"]))
    assert reply.status_code == status


def test_a_key_for_reading_asks_in_the_binary_form_as_well(locked, secrets_):
    headers = {**bearer(secrets_["read"]), "Content-Type": "application/octet-stream"}
    assert (
        locked.post(f"{ASK}s?on_thin=estimate", content=bytes(48), headers=headers).status_code
        == 200
    )
    assert locked.post(f"{ASK}s", content=bytes(48), headers=headers).status_code == 403


def test_a_deck_needs_a_key_for_admin(locked, secrets_):
    text = (
        'name = "decked"\ntitle = "t"\n[range]\nforce = [1, 1, 1]\nmoment = [1, 1, 1]\n[deck]\n'
        'file = "a.inp"\ncommand = ["id"]\n'
        'output = {reader = "calculix-dat", point = "A", rotation = "B"}\n'
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("component.toml", text)
        archive.writestr("a.inp", "$FX $FY $FZ $MX $MY $MZ\n")
    files = {"bundle": ("b.zip", buffer.getvalue(), "application/zip")}
    refused = locked.post("/v1/components", files=files, headers=bearer(secrets_["write"]))
    assert refused.status_code == 422
    assert "admin" in refused.json()["detail"]
    looked_at = locked.post("/v1/components", files=files, headers=bearer(secrets_["admin"]))
    assert "prints" in looked_at.text or "print the set" in looked_at.text


def test_keys_are_made_listed_and_revoked_over_http_and_the_secret_is_told_once(locked, secrets_):
    admin = bearer(secrets_["admin"])
    created = locked.post("/v1/keys", json={"name": "eve", "scope": "read"}, headers=admin)
    assert created.status_code == 201
    eve = bearer(created.json()["key"])
    assert locked.get("/v1/jobs", headers=eve).status_code == 200
    reported = locked.get("/v1/keys", headers=admin)
    assert "eve" in [key["name"] for key in reported.json()["keys"]]
    assert created.json()["key"] not in reported.text
    assert "digest" not in reported.text
    again = locked.post("/v1/keys", json={"name": "eve"}, headers=admin)
    assert again.status_code == 409
    assert again.json()["detail"].endswith("with: wrenchbook keys revoke eve --data FOLDER")
    unfit = locked.post("/v1/keys", json={"name": "b b"}, headers=admin)
    assert unfit.status_code == 422
    assert "name: 'b b' is not a valid key name; use 1 to 64 letters" in unfit.json()["detail"]
    assert locked.delete("/v1/keys/eve", headers=admin).status_code == 200
    assert locked.get("/v1/jobs", headers=eve).status_code == 401
    assert locked.delete("/v1/keys/eve", headers=admin).status_code == 404


def test_the_last_key_is_not_revoked_over_http_since_the_server_would_be_open(tmp_path):
    admin = bearer(Keyring(tmp_path).add("only", "admin"))
    security = security_settings("127.0.0.1", "lab.example", None)
    app = create_app(Settings(tmp_path, solvers=0), security)
    with TestClient(app, base_url="http://127.0.0.1:8000") as client:
        reply = client.delete("/v1/keys/only", headers=admin)
        assert (reply.status_code, reply.json()["type"][-8:]) == (409, "last-key")
        assert client.get("/v1/jobs").status_code == 401
        assert client.post("/v1/keys", json={"name": "new"}, headers=admin).status_code == 201
        assert client.delete("/v1/keys/only", headers=admin).status_code == 200


@pytest.fixture
def keyed(tmp_path):
    """A server whose access needs no keys, and its keys."""
    ring = Keyring(tmp_path)
    ring.add("first", "admin")
    secret = ring.add("second", "admin")
    security = security_settings("127.0.0.1", "lab.example", None)
    app = create_app(Settings(tmp_path, solvers=0), security)
    with TestClient(app, base_url="http://127.0.0.1:8000") as client:
        yield client, secret


def test_of_two_keys_that_are_revoked_at_once_one_stays(keyed, monkeypatch):
    """Each call saw the other's key, and the server was open to everybody."""
    client, secret = keyed
    keyring = client.app.state.access.keyring
    both = keyring.listed()
    monkeypatch.setattr(keyring, "listed", lambda: both)
    assert client.delete("/v1/keys/first", headers=bearer(secret)).status_code == 200
    reply = client.delete("/v1/keys/second", headers=bearer(secret))
    assert (reply.status_code, reply.json()["type"][-8:]) == (409, "last-key")
    assert client.get("/v1/jobs").status_code == 401


@pytest.mark.parametrize("end", ["revoked", "moved"])
def test_a_server_whose_last_key_is_gone_is_not_open(keyed, tmp_path, end):
    """Between `keys revoke` and `keys add` a proxy's network could change tables."""
    client, _ = keyed
    if end == "moved":
        (tmp_path / FILE).rename(tmp_path / "keys.bak")
    else:
        for name in ("first", "second"):
            Keyring(tmp_path).revoke(name)
    client.app.state.access.keyring.refresh(0.0)
    assert client.get("/v1/jobs").status_code == 401
    secret = Keyring(tmp_path).add("third", "read")
    assert client.get("/v1/jobs", headers=bearer(secret)).status_code == 200


def test_the_last_key_is_not_revoked_while_it_has_two_secrets(keyed):
    """A rotated key counted as two."""
    client, secret = keyed
    assert client.delete("/v1/keys/first", headers=bearer(secret)).status_code == 200
    rotated = client.post("/v1/keys/second/rotate", json={}, headers=bearer(secret))
    assert rotated.status_code == 201
    reply = client.delete("/v1/keys/second", headers=bearer(secret))
    assert (reply.status_code, reply.json()["type"][-8:]) == (409, "last-key")
    assert client.get("/v1/jobs").status_code == 401


@pytest.mark.parametrize(
    ("call", "body"),
    [("POST", {"name": "tom"}), ("POST /reader/rotate", {}), ("DELETE /reader", None)],
)
def test_a_busy_or_damaged_file_of_keys_is_no_unknown_key(place, locked, secrets_, call, body):
    method, _, path = call.partition(" ")
    arguments = {"json": body, "headers": bearer(secrets_["admin"])}
    lock, file = take(place / f"{FILE}.lock"), place / FILE
    try:
        busy = locked.request(method, f"/v1/keys{path}", **arguments)
    finally:
        os.close(lock)
    assert busy.status_code == 503, busy.text
    assert "repeat yours in a second" in busy.json()["detail"]
    content = file.read_text()
    file.write_text("{")
    try:
        damaged = locked.request(method, f"/v1/keys{path}", **arguments)
    finally:
        file.write_text(content)
    assert damaged.status_code == 507, damaged.text
    assert "is damaged: it is not valid JSON" in damaged.json()["detail"]


def test_more_keys_than_there_can_be_are_a_conflict(locked, secrets_, monkeypatch):
    monkeypatch.setattr(keys, "MAX_KEYS", len(SCOPES))
    admin = bearer(secrets_["admin"])
    for path, body in (("", {"name": "tom"}), ("/reader/rotate", {})):
        reply = locked.post(f"/v1/keys{path}", json=body, headers=admin)
        assert reply.status_code == 409
        assert reply.json()["type"].endswith(":keys-full")
        assert "revoke one with: wrenchbook keys revoke NAME" in reply.json()["detail"]


def test_a_key_that_is_missing_malformed_unknown_or_expired_is_refused_by_its_cause(place, locked):
    secret = add_expired_key(place, "late", "read")
    locked.app.state.access.keyring.refresh(0.0)
    for headers, why in (
        ({}, "the request has none"),
        ({"Authorization": secret}, "is not of the form Bearer KEY"),
        (bearer("wb_x"), "has no such key"),
        (bearer(secret), "The key 'late' expired at 20"),
    ):
        refused = locked.get("/v1/jobs", headers=headers)
        assert refused.status_code == 401
        assert why in refused.json()["detail"]
        is_expired = "expired" in why
        title = "The key has expired" if is_expired else "A key is needed"
        assert refused.json()["title"] == title
        assert secret not in refused.text


def test_a_private_servers_own_key_is_good_for_all(locked):
    own = bearer("the-server's-own")
    assert locked.get("/v1/keys", headers=own).status_code == 200
    assert locked.get("/v1/jobs", headers=bearer("the-server's-owm")).status_code == 401


def test_a_key_is_held_to_its_rate_and_told_when_to_come_again(place, locked, monkeypatch):
    now = time.monotonic()  # a busy machine sends fewer than one a second
    monkeypatch.setattr(permission, "time", SimpleNamespace(monotonic=lambda: now, time=time.time))
    secret = Keyring(place).add("slow", "read", rate=1.0)
    locked.app.state.access.keyring.refresh(0.0)
    statuses = [locked.get("/v1/jobs", headers=bearer(secret)).status_code for _ in range(4)]
    assert statuses == [200, 200, 429, 429]
    refused = locked.get("/v1/jobs", headers=bearer(secret))
    assert int(refused.headers["retry-after"]) >= 1


@pytest.fixture
def clock(monkeypatch):
    """The time of the rates, s, which a test sets."""
    now = [1000.0]
    monkeypatch.setattr("wrenchbook.service.http.permission.time.monotonic", lambda: now[0])
    return now


def permissions(path, rate, count, name="a"):
    """The permissions of one key in processes of one server."""
    key = Key(name, "read", digest_of(name), 0.0, rate)
    processes = [Rates() for _ in range(count)]
    for rates in processes:
        rates.share(path)
    return [Permission(key, rates) for rates in processes]


@pytest.mark.parametrize("processes", [1, 3])
@pytest.mark.parametrize("rate", [0.1, 5.0, 5000.0])
def test_what_a_key_may_send_does_not_grow_with_the_processes(tmp_path, clock, processes, rate):
    each, allowed = permissions(tmp_path / "shared" / "rates", rate, processes), 0
    for _ in range(30):  # of a fifth of a request's time, or of a second
        clock[0] += min(2.0, 0.2 / rate) if rate < 1 else 0.2
        asked = max(3, int(rate))
        allowed += sum(each[k % processes].wait() == 0.0 for k in range(asked))
    passed = clock[0] - 1000.0
    # A burst and what the time gives; a process may hold a hundredth of a second's unused.
    most = max(2.0 * rate, 1.0) + rate * (passed - 0.2)
    assert most - 1 - processes * max(1, 0.01 * rate) <= allowed <= most + 1


def test_a_machine_that_was_started_again_holds_no_key_up(tmp_path, clock):
    """Its clock begins anew; the file is of the time before."""
    path = tmp_path / "rates"
    clock[0] = 1e6
    while permissions(path, 1.0, 1)[0].wait() == 0.0:
        pass
    clock[0] = 10.0
    assert permissions(path, 1.0, 1)[0].wait() == 0.0


@pytest.mark.parametrize("before", [0.3, 2.1, 2.9, 3.9])  # s on the clock of the bucket in the file
def test_a_bucket_of_the_time_before_a_start_lifts_no_limit(tmp_path, clock, before):
    """A negative number of requests was taken, and each further one was free."""
    path = tmp_path / "rates"
    permissions(path, 100.0, 1)[0].wait()
    start = clock[0]
    clock[0] = start - before
    (permission,) = permissions(path, 100.0, 1)
    assert sum(permission.wait() == 0.0 for _ in range(1000)) <= 201


def test_a_disk_that_takes_nothing_lifts_no_limit(tmp_path, clock, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    (permission,) = permissions(tmp_path / "rates", 1.0, 1)
    monkeypatch.setattr("wrenchbook.service.http.permission.os.pwrite", full)
    assert [permission.wait() == 0.0 for _ in range(4)] == [True, True, False, False]
    monkeypatch.setattr("wrenchbook.service.http.permission.os.open", full)
    (permission,) = permissions(tmp_path / "others", 1.0, 1)
    assert [permission.wait() == 0.0 for _ in range(4)] == [True, True, False, False]


def test_a_thousand_keys_have_buckets_of_their_own(tmp_path, clock):
    each = [permissions(tmp_path / "rates", 0.5, 1, f"key{k}")[0] for k in range(1000)]
    assert all(permission.wait() == 0.0 for permission in each)
    assert not any(permission.wait() == 0.0 for permission in each)


def test_a_key_is_held_to_the_size_of_its_bodies_told_or_not(place, locked):
    secret = Keyring(place).add("small", "write", megabytes=1)
    locked.app.state.access.keyring.refresh(0.0)
    headers = {**bearer(secret), "Content-Type": "text/csv"}
    url = "/v1/components/bar/table"
    assert locked.post(url, content=bytes(2 << 20), headers=headers).status_code == 413

    def pieces():
        for _ in range(32):
            yield bytes(64 << 10)

    assert locked.post(url, content=pieces(), headers=headers).status_code == 413


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:3000"},
        {"Origin": "http://localhost:8000"},
        {"Origin": "http://127.0.0.1:8000.evil.example"},
        {"Origin": "https://lab.example.evil"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Host": "evil.example"},
        {"Host": "evil.example:8000"},
        {"Host": "127.0.0.1.evil.example"},
        {"Host": ""},
    ],
)
@pytest.mark.parametrize(
    ("method", "url", "body"),
    [
        ("POST", "/v1/components", {"json": TABLE_ONLY}),
        ("POST", "/v1/components", {"files": {"bundle": ("b.zip", b"x", "application/zip")}}),
        ("POST", ASK, {"json": WRENCH}),
        ("DELETE", "/v1/jobs", {}),
        ("GET", "/v1/components", {}),
    ],
)
def test_a_page_of_another_site_is_refused_on_loopback_too(unlocked, method, url, body, headers):
    reply = unlocked.request(method, url, headers=headers, **body)
    assert reply.status_code == 403, reply.text
    assert "rig" not in [
        component["name"] for component in unlocked.get("/v1/components").json()["components"]
    ]


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Origin": "http://127.0.0.1:8000", "Sec-Fetch-Site": "same-origin"},
        {"Host": "localhost:8000", "Origin": "http://localhost:8000"},
        {"Host": "[::1]:8000"},
        {"Sec-Fetch-Site": "none"},
    ],
)
def test_the_servers_own_page_and_programs_are_let_in(unlocked, headers):
    assert unlocked.post(ASK, json=WRENCH, headers=headers).status_code in (200, 202)


@pytest.mark.parametrize(
    "kind", ["text/plain", "application/x-www-form-urlencoded", "", "multipart/form-data"]
)
@pytest.mark.parametrize("url", [ASK, f"{ASK}s", "/v1/scenes/plan", "/v1/components/bar/fill"])
def test_json_is_taken_only_as_json(unlocked, kind, url):
    # A program may leave it out; a browser, which may too, tells its site.
    headers = {"Content-Type": kind} if kind else {"Origin": "http://127.0.0.1:8000"}
    assert unlocked.post(url, content=b"{}", headers=headers).status_code == 415


def test_a_file_for_a_listed_site_varies_by_origin_too(locked):
    reply = locked.get("/page/icon.svg", headers={"Origin": "https://lab.example"})
    assert set(reply.headers.get_list("vary")) == {"Accept-Encoding", "Origin"}


def test_a_listed_site_is_let_in_and_told_so_and_no_other_is(locked, secrets_):
    listed = {"Origin": "https://lab.example"}
    ahead = {**listed, "Access-Control-Request-Method": "POST"}
    asked = locked.options(ASK, headers=ahead)
    assert asked.status_code == 204
    assert asked.headers["access-control-allow-origin"] == "https://lab.example"
    assert "authorization" in asked.headers["access-control-allow-headers"]
    methods = asked.headers["access-control-allow-methods"].split(", ")
    assert methods == ["GET", "POST", "PUT", "DELETE"]  # those of the routes
    reply = locked.get("/v1/components", headers={**listed, **bearer(secrets_["read"])})
    assert reply.headers["access-control-allow-origin"] == "https://lab.example"
    assert "access-control-allow-credentials" not in reply.headers
    other = {"Origin": "https://evil.example", "Access-Control-Request-Method": "POST"}
    refused = locked.options(ASK, headers=other)
    assert refused.status_code in (401, 403)
    assert "access-control-allow-origin" not in refused.headers


@pytest.mark.parametrize("path", ["/v1/components", "/health/live", "/openapi.json", "/nothing"])
def test_every_reply_tells_browsers_to_do_no_more_with_it(unlocked, path):
    fields = unlocked.get(path).headers
    assert fields["x-content-type-options"] == "nosniff"
    assert fields["x-frame-options"] == "DENY"
    assert fields["referrer-policy"] == "no-referrer"
    assert "frame-ancestors 'none'" in fields["content-security-policy"]
    assert "unsafe-inline" not in fields["content-security-policy"].partition("style-src")[0]
    assert "access-control-allow-origin" not in fields


@pytest.mark.parametrize(
    ("host", "local"),
    [
        *((host, True) for host in ("127.0.0.1", "::1", "localhost", "127.8.8.8")),
        *((host, False) for host in ("0.0.0.0", "::", "10.0.0.1", "lab.example")),
    ],
)
def test_loopback_is_what_this_machine_alone_reaches(host, local):
    assert is_loopback(host) is local
    assert security_settings(host, None, None).keys_needed is not local


def test_a_key_that_no_header_can_hold_is_refused_without_telling_it():
    with pytest.raises(ValueError, match="copy the key again") as caught:
        Client("http://127.0.0.1:1", key="wb_a\nb")
    assert "wb_a" not in str(caught.value)


def test_a_key_is_taken_from_the_environment_unless_one_is_given(monkeypatch):
    monkeypatch.setenv("WRENCHBOOK_KEY", "wb_env")
    assert b"Bearer wb_env" in Client()._head("GET", "/", None, {})
    assert b"Bearer wb_own" in Client(key="wb_own")._head("GET", "/", None, {})
    monkeypatch.delenv("WRENCHBOOK_KEY")
    assert b"Authorization" not in Client()._head("GET", "/", None, {})
